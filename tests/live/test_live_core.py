"""What a demand means, which are admitted, and what goes out for them; no clock, no link."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from live_line import CRM, HOVER, X8

from coaxlink.errors import InputError
from coaxlink.live.counts import Counters, Histogram
from coaxlink.live.mixer_core import DemandScale, MixCore
from coaxlink.mixer import StandardCoefficients
from coaxlink.vehicle import Vehicle


def core(law: str = "coaxial") -> MixCore:
    return MixCore(Vehicle(X8, CRM), law)


def test_what_controls_mean_by_hand() -> None:
    # thrust scale is 1 when all entries are alike: setpoint s on each of eight rotors of 73.06 N.
    # Roll: every rotor at +-0.1807 m: entries e = +-1/(8 * 73.06 * 0.1807), scale sqrt(8 e^2 / 4) = sqrt(2) e
    scale = DemandScale(X8, StandardCoefficients(73.06, 1.9))
    roll = 8 * 73.06 * 0.1807 / math.sqrt(2.0)
    assert scale.wrench([0, 0, 0, 0.4]) == pytest.approx([8 * 73.06 * 0.4, 0, 0, 0], abs=1e-3)
    assert scale.wrench([0.1, 0, 0, 0]) == pytest.approx([0, 0.1 * roll, 0, 0], abs=1e-3)
    assert scale.wrench([0, 0, 0.1, 0]) == pytest.approx([0, 0, 0, 0.1 * 8 * 1.9], abs=1e-3)


def test_a_demand_becomes_the_wrench_it_means_on_the_rotor_model() -> None:
    c = core()
    out = c.step(1000, 0, [0.02, -0.03, 0.05, 0.3, 0, 0, 0, 0])
    assert out is not None and len(out) == 8
    assert X8.wrench(*X8.loads(CRM, out)) == pytest.approx(c.wrench, abs=1e-6)
    assert c.wrench[0] > 100 and c.wrench[1] > 0 > c.wrench[2]


def test_admission() -> None:
    """Stamp, group and controls after a good demand: whether it is answered, and what is counted."""
    nan, inf = math.nan, math.inf
    rows = [
        (1_004_000, 0, HOVER, ""),
        (1_004_000, 1, HOVER, "other_group"),
        (1_004_000, 0, [1.5, -1.5, 1.5, 1.5, 0, 0, 0, 0], "clamped"),
        (1_004_000, 0, [0, 0, 0, -0.5, 0, 0, 0, 0], "clamped"),
        *((1_004_000, 0, [*HOVER[:k], v, *HOVER[k + 1 :]], "not_finite")
          for k in range(4) for v in (nan, inf, -inf)),
        *((1_004_000, 0, [*HOVER[:k], v, *HOVER[k + 1 :]], "absurd")
          for k in range(4) for v in (1.51, -1.51, 1e30)),
    ]  # fmt: skip
    for stamp, group, controls, reason in rows:
        c = core("standard")
        assert c.step(1_000_000, 0, HOVER) is not None
        out = c.step(stamp, group, list(controls))
        counted = {k: v for k, v in vars(c.counters).items() if isinstance(v, int) and v}
        assert (out is not None) == (reason in ("", "clamped")), (stamp, group, controls)
        assert counted == ({reason: 1} if reason else {}), (stamp, group, controls)
        if out is not None:
            assert all(0.0 <= u <= 1.0 for u in out)
        assert c.step(1_008_000, 0, HOVER) is not None  # a bad one does not lock the good ones out


def test_outputs_keep_their_range_whatever_the_demand() -> None:
    rng = np.random.default_rng(5)
    for law in ("standard", "reduced", "coaxial", "exact"):
        c, answered = core(law), 0
        for k in range(60):
            demand = list(rng.uniform(-1, 1, 8) * 10.0 ** rng.uniform(-2, 3))
            out = c.step(1000 * (k + 1), 0, demand)
            answered += out is not None
            assert out is None or all(0.0 <= u <= 1.0 for u in out)
        assert answered > 5 and c.counters.absurd == 60 - answered


def test_a_law_that_gives_what_is_no_speed_is_not_passed_on() -> None:
    for rubbish in (math.nan, 1.2, -0.1):
        law = SimpleNamespace(name="mad", speeds=lambda w, x=rubbish: np.full(8, x), dropped=())
        c = MixCore(Vehicle(X8, CRM), law)
        assert c.step(1000, 0, HOVER) is None
        assert c.counters.refused_outputs == 1 and c.sent == [0.0] * 8


def test_more_motors_than_the_message_carries_are_refused() -> None:
    nine = replace(X8, rotors=(*X8.rotors, replace(X8.rotors[0], number=9, level="single", pair=None)))
    with pytest.raises(InputError, match="8 rotors at most"):
        MixCore(Vehicle(nine, CRM), SimpleNamespace())  # type: ignore[arg-type]


def test_the_histogram_tells_percentiles_within_its_bins_and_does_not_grow() -> None:
    h = Histogram()
    bins, times = len(h.bins), [1e-6 * (50 + k) for k in range(1000)]
    for t in random.Random(1).sample(times, len(times)):
        h.add(t)
    assert abs(h.percentile(50) / 549.5e-6 - 1) < 0.05
    assert abs(h.percentile(99) / 1039e-6 - 1) < 0.05
    assert h.percentile(100) <= h.largest_s == max(times)
    assert len(h.bins) == bins


def test_counters_add_up() -> None:
    c = Counters()
    c.answered(1e-4, [1.0, -2.0, 0.0, 0.0], True)
    c.answered(3e-4, [-3.0, 0.0, 0.0, 0.0], False)
    account = c.account(0.5)
    assert account["cycles"] == 2 and account["rate_hz"] == 4.0 and account["axes_given_up"] == 1
    assert account["allocation_error"] == {"mean": [2.0, 1.0, 0.0, 0.0], "max": [3.0, 2.0, 0.0, 0.0]}
