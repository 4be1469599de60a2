"""The decision: its terms are those that were trained, and more evidence never lowers a probability."""

from __future__ import annotations

import pytest

from coaxlink.residual.diagnosis.decide import calibration, opened_terms, probability, terms_of
from coaxlink.residual.diagnosis.features import Candidate

KINDS = [f"{kind}_{way}" for kind in ("nothing", "free", "rival") for way in ("raw", "tempered", "own")]


def candidate(nats, name="air_density", **more):
    usual = {
        "size_noise": 0.5,
        "beside": 0.0,
        "steady": 5.0,
        "agree": 0.9,
        "at_bound": 0.0,
        "members": 1.0,
        "forms": 0.0,
    }
    numbers = dict.fromkeys((*KINDS, "freed", "bent"), nats) | usual | more
    return Candidate((name,), numbers)


def test_every_trained_term_is_worked_out_and_no_other():
    assert set(calibration()["name"]["weights"]) == set(terms_of(candidate(10.0)))
    opened = dict.fromkeys(("raw", "own", "tempered", "steady", "agree"), 1.0)
    assert set(calibration()["open"]["weights"]) == set(opened_terms(opened))


def test_more_evidence_makes_a_name_more_probable():
    said = [probability("name", terms_of(candidate(nats))) for nats in (-5.0, 3.0, 20.0, 100.0, 1000.0)]
    assert said == sorted(said) and said[0] < 0.1 and said[-1] > 0.9


@pytest.mark.parametrize("weakest", [*KINDS, "freed", "bent"])
def test_one_rival_that_is_level_is_enough_to_withhold_a_name(weakest):
    said = probability("name", terms_of(candidate(300.0, **{weakest: 0.0})))
    assert said < calibration()["level"]["name"]
