"""ArduPilot's own motor mixer, recorded, against what firmware_params says it will do."""

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from firmware_params import ardupilot as ap
from firmware_params.errors import TableError

VECTORS = json.loads((Path(__file__).parents[1] / "data" / "ardupilot_vectors.json").read_text())
FRAMES, SETS = VECTORS["frames"], VECTORS["parameter_sets"]
FLAGS = ["roll", "pitch", "yaw", "throttle_lower", "throttle_upper"]
GROUPS = Counter(case["group"] for case in VECTORS["cases"])


def _table(frame, params):
    given = FRAMES[frame]
    factors = tuple(map(tuple, given.get("given_factors", [])))
    parameters = ap.MotorParameters.from_params(SETS[params])
    return ap.ApTable(given["frame_class"], factors, parameters, given["frame_type"] or 0)


@pytest.mark.parametrize("frame", FRAMES)
def test_used_factors(frame):
    np.testing.assert_allclose(
        ap.used_factors(_table(frame, "default")), FRAMES[frame]["used_factors"], atol=1e-6
    )


@pytest.mark.parametrize("group", GROUPS)
def test_equals_the_golden_vectors(group):
    for case in (c for c in VECTORS["cases"] if c["group"] == group):
        given, wanted = case["inputs"], case["outputs"]
        demand = ap.Demand(
            given["roll"],
            given["pitch"],
            given["yaw"],
            given["throttle"],
            given["throttle_avg_max"],
            given["throttle_thrust_max"],
            given.get("spool", "THROTTLE_UNLIMITED"),
            given.get("battery_ratio", 1.0),
            given.get("lift_max", 1.0),
            given.get("air_density_ratio", 1.0),
            given.get("thrust_boost", False),
            given.get("thrust_boost_ratio", 0.0),
            given.get("motor_lost_index", 0),
        )
        out = ap.realise(_table(case["frame"], case["params"])).output(demand)
        where = f"case {case['id']} {case['frame']} {case['params']}"
        np.testing.assert_allclose(out.thrust, wanted["thrust"], atol=1e-6, err_msg=where)
        np.testing.assert_allclose(out.actuator, wanted["actuator"], atol=1e-5, err_msg=where)
        assert np.abs(out.pwm - np.array(wanted["pwm"])).max() <= 1, where
        assert out.throttle_out == pytest.approx(wanted["throttle_out"], abs=1e-6), where
        for flag, expected in zip(FLAGS, wanted["limit"], strict=True):
            if flag not in case.get("edge_flags", []):
                assert (flag in out.limits) == bool(expected), f"{where}: {flag}"


def test_all_448_cases_are_there():
    assert sum(GROUPS.values()) == 448


@pytest.mark.parametrize("name", VECTORS["curves"])
def test_the_thrust_curve_and_its_inverse(name):
    mix = ap.realise(_table("x8", name))
    x, actuator, back = np.array(VECTORS["curves"][name]).T
    np.testing.assert_allclose(mix.throttle(x), actuator, atol=1e-5)
    np.testing.assert_allclose(mix.thrust_of(x), back, atol=1e-5)


def test_traps_are_named():
    def found(frame, params):
        return {f.id for f in ap.realise(_table(frame, params)).warnings}

    assert found("x8", "quad") == set()
    assert found("rcrm15", "quad") == {"ap.silent-clip"}
    assert found("rcrm15", "quads15") == {"ap.silent-clip", "ap.spin-min"}
    assert "ap.thrust-balance" in found("odd15", "quad")


@pytest.mark.parametrize(
    "table",
    [
        ap.ApTable(1),
        ap.ApTable(15),
        ap.ApTable(15, ((0.5, 0.5, 0.5, 1.0),) * 13),
        ap.ApTable(17, ((float("nan"), 0.5, 0.5, 1.0),) * 4),
    ],
)
def test_what_ardupilot_would_not_take_is_refused(table):
    with pytest.raises(TableError):
        ap.realise(table)
