"""The fitted table under limits: kept in what PX4 itself makes of the parameters, at a cost that is said."""

import json
from pathlib import Path

import numpy as np
import pytest

from coaxlink.airframe import load_airframe
from coaxlink.cli import main
from coaxlink.errors import CheckFailed, InputError
from coaxlink.mixer.constrained import constrained_table
from coaxlink.mixer.fitted import fit_table, px4_columns
from coaxlink.mixer.limits import Limit, load_limits
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle
from firmware_params import px4

EXAMPLES = Path(__file__).parents[2] / "examples"
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
X8 = load_airframe(EXAMPLES / "x8_paper.toml")
WEIGHT = 20.0 * 9.80665


class Board:
    """PX4 with a table in its parameters, float32 and all; demands as PX4 has them, in its own units."""

    def __init__(self, table, frame=X8):
        self.mix, self.frame = px4.realise(px4.table_to_params(px4_columns(frame, table))), frame

    def speeds(self, thrust, yaw=0.0):
        setpoints = self.mix.setpoints([0.0, 0.0, yaw, 0.0, 0.0, -thrust])
        return self.mix.throttle(setpoints)

    def wrench(self, thrust, yaw=0.0):
        return self.frame.wrench(*self.frame.loads(CRM, self.speeds(thrust, yaw)))

    def hover(self):
        low, high = 0.0, 1.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.wrench(middle)[0] < WEIGHT else (low, middle)
        return high

    def ceiling(self):
        full = [t for t in np.linspace(0.3, 1.0, 701) if self.speeds(t).max() < 1.0 - 1e-6]
        return self.wrench(full[-1])[0]

    def yaw(self):
        hover, free = self.hover(), 0.0
        for y in np.linspace(0.0, 1.0, 701):
            u = self.speeds(hover, y)
            free = y if u.max() < 1.0 - 1e-6 and u.min() > 1e-6 else free
        return self.wrench(hover, free)[3]


@pytest.mark.slow
def test_ceiling_and_yaw_hold_on_board_and_what_they_cost_is_said():
    limits = [
        Limit("ceiling_N", low=440.0),
        Limit("yaw_Nm", low=7.0),
        Limit("hover_share", low=0.45, high=0.6),
    ]
    made = constrained_table(Vehicle(X8, CRM), limits)
    board, plain = Board(made.table), Board(made.fitted)
    assert board.ceiling() == pytest.approx(440.0, abs=1.2) and plain.ceiling() < 415.0
    assert board.yaw() > 6.93 and plain.yaw() < 6.5
    thrust, _ = X8.loads(CRM, board.speeds(board.hover()))
    share = [thrust[u] / (thrust[u] + thrust[w]) for u, w in X8.pairs]
    assert min(share) > 0.45 and max(share) < 0.6
    ceiling, yaw, share_limit = made.limits
    assert made.table.chosen.power > ceiling.without.power  # the ceiling is paid for
    assert ceiling.without.ceiling_N < 440.0 and yaw.without.yaw_Nm < 7.0
    # a limit that the others keep already costs nothing
    assert share_limit.without.power == pytest.approx(made.table.chosen.power, rel=1e-4)
    # rotors of a level stay alike
    assert np.ptp(made.table.ct[:4]) < 1e-6 and np.ptp(made.table.ct[4:]) < 1e-6


@pytest.mark.slow
def test_no_other_split_keeps_the_ceiling_at_less_power():
    made = constrained_table(Vehicle(X8, CRM), [Limit("ceiling_N", low=440.0)])
    others = fit_table(Vehicle(X8, CRM), shares=np.linspace(0.70, 0.82, 7)).trade
    keeping = [t.power for t in others if t.ceiling_N >= 440.0]
    assert keeping and made.table.chosen.power < min(keeping) * 1.001
    assert made.table.chosen.error[0] < 0.1


@pytest.mark.slow
def test_one_rotor_is_spared_and_the_others_work_around_it():
    made = constrained_table(Vehicle(X8, CRM), [Limit("speed", high=0.7, rotors=(7,))])
    speeds = Board(made.table).speeds(Board(made.table).hover())
    assert speeds[6] < 0.7 and made.limits[0].before > 0.8
    assert made.limits[0].now == pytest.approx(0.7, abs=2e-4)
    assert speeds[6] < min(speeds[4], speeds[5], speeds[7]) - 0.03


def test_a_table_that_keeps_everything_is_the_fitted_one():
    made = constrained_table(Vehicle(X8, CRM), [Limit("ceiling_N", low=400.0), Limit("equal", of="mirror")])
    assert np.array_equal(made.table.ct, made.fitted.ct) and made.table.curve == made.fitted.curve
    assert all(k.without.power == made.table.chosen.power for k in made.limits)


@pytest.mark.slow
def test_what_cannot_be_kept_is_refused_with_how_far_one_gets():
    full = X8.wrench(*X8.loads(CRM, np.ones(8)))[0]
    with pytest.raises(CheckFailed, match=r"ceiling at least 600\.0 N: the nearest gets to") as caught:
        constrained_table(Vehicle(X8, CRM), [Limit("ceiling_N", low=600.0)])
    reached = float(str(caught.value).rpartition("gets to ")[2].split()[0])
    assert 0.97 * full < reached <= full + 0.1


def test_a_file_that_is_wrong_says_where(tmp_path):
    path, wrong = tmp_path / "limits.toml", {}
    for text, says in {
        "": "limit",
        'kind = "magic"': "kind",
        'kind = "speed"': "max is expected",
        'kind = "speed"\nmax = 1.5': "at most 1",
        'kind = "speed"\nmax = 0.5\nrotors = [9]': "1 to 8",
        'kind = "yaw_Nm"\nmax = 3.0': "min is expected",
        'kind = "hover_share"\nmin = 0.7\nmax = 0.2': "above max",
        'kind = "ceiling_N"\nmin = nan': "min",
        'kind = "equal"': "levels",
        'kind = "ceiling_N"\nmin = 400.0\nrotors = [1]': "kind speed",
        'kind = "ceiling_N"\nleast = 400.0': "least",
    }.items():
        path.write_text(f"[[limit]]\n{text}\n" if text else "")
        with pytest.raises(InputError) as caught:
            load_limits(path, X8)
        said = str(caught.value)
        if says not in said or "limits.toml" not in said or "\n" in said:
            wrong[text] = said
    assert not wrong


@pytest.mark.slow
def test_the_verb_shows_writes_and_refuses(tmp_path, capsys):
    frame, limits = str(EXAMPLES / "x8_paper.toml"), str(EXAMPLES / "limits.toml")
    command = ["table", frame, "--firmware", "ardupilot", "--constrain", limits]
    with pytest.raises(SystemExit) as ended:
        main([*command, "--out", str(tmp_path / "out"), "--json", str(tmp_path / "t.json")])
    assert ended.value.code == 0
    said = capsys.readouterr().out
    assert "limits hold" in said and "ceiling at least 440.0 N" in said
    document = json.loads((tmp_path / "t.json").read_text())
    assert document["limits"]["now"]["ceiling_N"] == pytest.approx(440.0, abs=0.1)
    assert len(document["limits"]["kept"]) == 3 and list((tmp_path / "out").glob("*.param"))
    (tmp_path / "far.toml").write_text('[[limit]]\nkind = "yaw_Nm"\nmin = 99.0\n')
    command[-1] = str(tmp_path / "far.toml")
    with pytest.raises(SystemExit) as ended:
        main([*command, "--out", str(tmp_path / "none")])
    assert ended.value.code == 1 and not (tmp_path / "none").exists()
    assert "yaw in hover at least 99.00 N m: the nearest gets to" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main([*command, "--law", "reduced"])
    assert ended.value.code == 2
