"""Logs of one propeller put together."""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink.data import Samples
from coaxlink.data.join import join
from coaxlink.errors import InputError


def log(name: str, **columns: list[float]) -> Samples:
    return Samples({k: np.array(v) for k, v in columns.items()}, name, (f"read {name}",))


PAIR = {
    "upper_rpm": [1.0, 2.0],
    "lower_rpm": [3.0, 4.0],
    "upper_thrust_N": [5.0, 6.0],
    "lower_thrust_N": [7.0, 8.0],
}


def test_a_rotor_alone_stands_beside_a_still_one_of_unknown_load() -> None:
    both = join([log("pair", **PAIR, voltage_V=[1, 1]), log("alone", upper_rpm=[9.0], upper_thrust_N=[10.0])])
    assert both["upper_rpm"].tolist() == [1, 2, 9]
    assert both["lower_rpm"].tolist() == [3, 4, 0]
    assert both["lower_thrust_N"][:2].tolist() == [7, 8] and np.isnan(both["lower_thrust_N"][2])
    said = "\n".join(both.notes)
    assert not both.has("voltage_V") and "left out, not in every log: voltage_V" in said
    assert "read pair" in said and "alone (1 rows)" in said


def test_a_pair_that_lacks_a_load_does_not_make_one_up() -> None:
    part = {k: v for k, v in PAIR.items() if k != "lower_thrust_N"}
    both = join([log("pair", **PAIR), log("part", **part)])
    assert np.isnan(both["lower_thrust_N"][2:]).all() and both["lower_rpm"].tolist() == [3, 4, 3, 4]


def test_rpm_and_throttle_cannot_be_mixed() -> None:
    with pytest.raises(InputError, match="throttled: column upper_rpm: missing"):
        join([log("pair", **PAIR), log("throttled", upper_throttle=[0.5], upper_thrust_N=[1.0])])


def test_one_log_is_itself() -> None:
    only = log("pair", **PAIR)
    assert join([only]) is only
