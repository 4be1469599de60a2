"""Rate gains beside a new table: what they are worth is worked out here from the firmware's own mix."""

import json

import numpy as np
import pytest
from memory_net import Net, Standin, meet, plugged

from coaxlink.airframe import load_airframe
from coaxlink.cli import main
from coaxlink.files import example
from coaxlink.mavlink.parameters import Parameters
from coaxlink.rotor import load_rotor_model
from coaxlink.tables.behaviour import Behaviour
from coaxlink.tables.rate_gains import axis_gains, gains_line, preserved_gains, wanted_gains
from firmware_params import px4

X8 = example("x8_paper.toml")
NAMES = ("MC_ROLLRATE_K", "MC_PITCHRATE_K", "MC_YAWRATE_K")


def flown(*gain):
    return Behaviour(0.4, (0.5,) * 8, 400.0, gain, (1.0, 1.0, 1.0), 0.0)


def test_scales_are_old_over_new_and_only_held_gains_are_written():
    gains = axis_gains("px4", flown(20.0, 30.0, 1.0), flown(10.0, 30.0, 2.0), {"MC_ROLLRATE_K": 0.8})
    assert [g.scale for g in gains] == [0.5, 1.0, 2.0]
    written, problem = wanted_gains("px4", gains)
    assert written == {"MC_ROLLRATE_K": 0.4}
    assert "MC_PITCHRATE_K" in problem and "MC_YAWRATE_K" in problem
    line = gains_line(gains, "on board")
    assert "2.00 (roll)" in line and "0.50 (yaw)" in line and "pitch" not in line


def test_ardupilots_p_i_and_d_are_scaled_each():
    board = {f"ATC_RAT_{a}_{k}": 0.1 for a in ("RLL", "PIT", "YAW") for k in "PID"}
    gains_ = preserved_gains(
        "ardupilot", flown(20.0, 30.0, 1.0), flown(10.0, 30.0, 1.0), board, "on board", write=True
    )
    assert gains_.written["ATC_RAT_RLL_D"] == 0.05 and gains_.written["ATC_RAT_YAW_I"] == 0.1
    assert len(gains_.written) == 9 and gains_.problem == ""


def test_an_axis_that_is_lost_or_turned_round_is_no_matter_of_gains():
    for new in (0.0, -3.0):
        gains = axis_gains("px4", flown(10.0, 10.0, new), flown(10.0, 10.0, 2.0), dict.fromkeys(NAMES, 1.0))
        assert "yaw lost or turned round" in gains_line(gains, "on board"), new
        assert set(wanted_gains("px4", gains)[0]) == set(NAMES[:2]), new


def test_a_gain_out_of_px4s_range_is_not_written():
    gains = axis_gains("px4", flown(1.0, 1.0, 1.0), flown(9.0, 1.0, 1.0), dict.fromkeys(NAMES, 1.0))
    written, problem = wanted_gains("px4", gains)
    assert written == {} and "MC_ROLLRATE_K = 9" in problem


def moment_per_unit(params, axis):
    """N m that a small demand on one axis brings in hover: the board's mix on the paper's rotors."""
    frame, model = load_airframe(X8), load_rotor_model(example("rotor_paper.toml"))
    mix = px4.realise(params)

    def wrench(demand, thrust):
        control = [0.0] * 6
        control[axis], control[5] = demand, -thrust
        return frame.wrench(*frame.loads(model, mix.throttle(mix.setpoints(control))))

    low, high = 0.0, 1.0
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if wrench(0.0, middle)[0] < 196.133 else (low, middle)
    return (wrench(0.01, high)[axis + 1] - wrench(-0.01, high)[axis + 1]) / 0.02


@pytest.mark.slow
def test_loops_stay_as_they_were_on_board_and_restore_brings_the_old_gains_back(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))

    def run(*arguments):
        with pytest.raises(SystemExit) as ended:
            main([str(a) for a in arguments])
        assert ended.value.code == 0, arguments

    def values(board):
        with meet(board) as session:
            return {n: v.value for n, v in Parameters(session).read_all().values.items()}

    with plugged(Net()) as net:
        board = Standin(net)
        url = board.url
        before = values(board)
        made = ("--keep-gains", "--out", "t", "--json", "t.json")
        run("table", X8, "--firmware", "px4", "--connect", url, *made)
        run("upload", "t", "--connect", url, "--yes", "--json", "u.json")
        after = values(board)
        run("verify", "t", "--connect", url)
        run("restore", json.loads((tmp_path / "u.json").read_text())["backup"], "--connect", url, "--yes")
        restored = values(board)
    for axis, name in enumerate(NAMES):
        loop = [moment_per_unit(held, axis) * held[name] for held in (before, after)]
        assert loop[1] == pytest.approx(loop[0], rel=2e-3)
    assert after["MC_YAWRATE_K"] > 1.2 * before["MC_YAWRATE_K"]  # this table needs it
    assert [restored[n] for n in NAMES] == [before[n] for n in NAMES]
    rows = json.loads((tmp_path / "t.json").read_text())["rate_gains"]
    assert [row["axis"] for row in rows] == ["roll", "pitch", "yaw"]
    assert np.isclose(rows[2]["keeps_the_loop"]["MC_YAWRATE_K"], after["MC_YAWRATE_K"])
