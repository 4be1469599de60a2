"""The decision: its terms are those that were trained, and more evidence never lowers a probability."""

from __future__ import annotations

import pytest

from coaxlink.residual.diagnosis.decide import WAYS, calibration, opened_terms, probability, terms_of
from coaxlink.residual.diagnosis.features import MOST_EVIDENCE, Candidate

KINDS = [
    f"{kind}_{way}" for kind in ("nothing", "free", "cause", "rival") for way in ("raw", "tempered", "own")
]


def reported(log_evidence, **more):
    numbers = dict.fromkeys((*KINDS, "freed"), log_evidence)
    usual = {"beside": 0.0, "load": -1.0, "members": 1.0, "forms": 0.0}
    return probability("name", terms_of(Candidate(("air_density",), numbers | usual | more)))


def test_every_trained_term_is_worked_out():
    numbers = dict.fromkeys((*KINDS, "freed", "beside", "load", "members", "forms"), 1.0)
    assert set(calibration()["name"]["weights"]) <= set(terms_of(Candidate(("x",), numbers)))
    assert set(calibration()["open"]["weights"]) == set(opened_terms(dict.fromkeys(WAYS, 1.0), ()))


def test_more_is_there_as_surely_as_its_weakest_number_says():
    log_evidence = dict.fromkeys(WAYS, 300.0)
    whole, weak = (
        probability("open", opened_terms(n, ())) for n in (log_evidence, log_evidence | {"own": 2.0})
    )
    assert weak < calibration()["level"]["open"] < whole
    assert probability("open", opened_terms(log_evidence, ("wind",))) < whole


def test_more_evidence_makes_a_name_more_probable():
    every = [reported(log_evidence) for log_evidence in (-5.0, 3.0, 20.0, 100.0, 1000.0)]
    assert every == sorted(every) and every[0] < 0.1 and every[-1] > 0.9


@pytest.mark.parametrize("kind", ["nothing", "free", "rival"])
def test_one_rival_that_is_level_is_enough_to_withhold_a_name(kind):
    level = {f"{kind}_{way}": 0.0 for way in ("raw", "tempered", "own")}
    assert reported(300.0, **level) < calibration()["level"]["name"]


@pytest.mark.parametrize("weaker", [{"freed": 0.0}, {"forms": 3.0}])
def test_what_speaks_against_a_name_lowers_its_probability(weaker):
    assert reported(100.0, **weaker) < reported(100.0)


def test_that_no_rival_was_worth_a_visit_is_no_evidence_for_a_weak_name():
    unvisited = {f"{kind}_{way}": MOST_EVIDENCE for kind in ("free", "cause", "rival") for way in WAYS}
    assert reported(8.0, **unvisited, freed=MOST_EVIDENCE) < calibration()["level"]["name"]
