"""ArduPilot's own motor mixer, recorded, against what firmware_params says it will do."""

import json
from pathlib import Path

import numpy as np
import pytest

from firmware_params import ardupilot as ap
from firmware_params.errors import TableError

VECTORS = json.loads((Path(__file__).parents[1] / "data" / "ardupilot_vectors.json").read_text())
FRAMES, SETS = VECTORS["frames"], VECTORS["parameter_sets"]
FLAGS = ["roll", "pitch", "yaw", "throttle_lower", "throttle_upper"]


def _table(frame, params):
    given = FRAMES[frame]
    factors = tuple(map(tuple, given.get("given_factors", [])))
    parameters = ap.MotorParameters.from_params(SETS[params])
    return ap.ApTable(given["frame_class"], factors, parameters, given["frame_type"] or 0)


def test_used_factors():
    for frame, wanted in FRAMES.items():
        factors = ap.used_factors(_table(frame, "default"))
        np.testing.assert_allclose(factors, wanted["used_factors"], atol=1e-6, err_msg=frame)


def test_equals_the_448_golden_vectors():
    assert len(VECTORS["cases"]) == 448
    for case in VECTORS["cases"]:
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


def test_the_thrust_curve_and_its_inverse():
    for name, rows in VECTORS["curves"].items():
        mix = ap.realise(_table("x8", name))
        x, actuator, back = np.array(rows).T
        np.testing.assert_allclose(mix.throttle(x), actuator, atol=1e-5, err_msg=name)
        np.testing.assert_allclose(mix.thrust_of(x), back, atol=1e-5, err_msg=name)


def test_traps_are_named():
    def found(frame, params):
        return {f.id for f in ap.realise(_table(frame, params)).warnings}

    assert found("x8", "quad") == set()
    assert found("rcrm15", "quad") == {"ap.silent-clip"}
    assert found("rcrm15", "quads15") == {"ap.silent-clip", "ap.spin-min"}
    assert "ap.thrust-balance" in found("odd15", "quad")


def test_what_ardupilot_would_not_take_is_refused():
    many, nan = ((0.5, 0.5, 0.5, 1.0),) * 33, ((float("nan"), 0.5, 0.5, 1.0),) * 4
    for table in (ap.ApTable(9), ap.ApTable(15), ap.ApTable(15, many), ap.ApTable(17, nan)):
        with pytest.raises(TableError):
            ap.realise(table)


def test_what_the_board_keeps():
    assert ap.as_stored("FRAME_CLASS", 15.7) == 15.0 and ap.as_stored("FRAME_CLASS", 300) == 127.0
    assert ap.as_stored("MOT_THST_EXPO", 0.65) == float(np.float32(0.65))
    found = ap.out_of_range({"MOT_THST_EXPO": 5.0, "FRAME_CLASS": 14.5, "MOT_SPIN_MIN": float("nan")})
    assert {f.id for f in found} == {"ap.out-of-range", "ap.truncated", "ap.not-finite"}
    assert [ap.servo_function(n) for n in (1, 8, 9, 12, 13, 32)] == [33, 40, 82, 85, 160, 179]
