"""Columns that are not what they say, in all or a part of a log: named, left out, and nothing claimed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from residual_rig import run

from coaxlink.data import Samples
from coaxlink.residual import refine_stand
from coaxlink.residual.channels.stand import stand_frame
from coaxlink.residual.faults.stand_faults import find_suspects
from coaxlink.rotor import RotorModel, load_rotor_model
from sim.physics.rotors import read_pair
from sim.stand import effects as bench

EXAMPLES = Path(__file__).parents[3] / "examples"

UPPER, LOWER = ("upper_thrust_N", "upper_torque_Nm"), ("lower_thrust_N", "lower_torque_Nm")
PART = slice(150, 230)


@pytest.fixture(scope="module")
def paper() -> RotorModel:
    return load_rotor_model(EXAMPLES / "rotor_paper.toml")


def exchanged(columns: dict, rows: slice, *pairs: tuple[str, str]) -> dict:
    for a, b in pairs:
        one, two = columns[a].copy(), columns[b].copy()
        one[rows], two[rows] = columns[b][rows], columns[a][rows]
        columns[a], columns[b] = one, two
    return columns


def span(rows: str) -> tuple[int, int]:
    first, last = map(int, rows.split("-"))
    return first - 1, last


def nothing_claimed(answer) -> bool:
    return answer.effects == () and answer.ambiguous == ()


@pytest.mark.parametrize(
    ("column", "factor", "unit"),
    [
        ("lower_torque_Nm", 100.0, "N cm"),
        ("upper_thrust_N", 1 / 9.80665, "kgf"),
        ("lower_thrust_N", 1000 / 9.80665, "gf"),
        ("lower_torque_Nm", -1.0, "sign"),
    ],
)
def test_another_unit_or_sign_takes_the_channel_out(paper, column: str, factor: float, unit: str) -> None:
    columns = run(seed=1)
    columns[column] = factor * columns[column]
    answer = refine_stand(Samples(columns, "rig"), paper)
    (suspect,) = answer.suspect_data
    assert (suspect.column, suspect.rows) == (column, "all") and unit in suspect.why
    assert nothing_claimed(answer) and answer.unexplained == ()
    assert column.rsplit("_", 1)[0] not in answer.channels and len(answer.channels) == 5


@pytest.mark.parametrize("given", [True, False])
def test_another_unit_from_a_row_on(paper, given: bool) -> None:
    columns = run(seed=2)
    columns["upper_torque_Nm"][220:] *= 100.0
    answer = refine_stand(Samples(columns, "rig"), paper if given else None)
    (suspect,) = answer.suspect_data
    assert suspect.column == "upper_torque_Nm" and "N cm" in suspect.why
    assert span(suspect.rows) == (pytest.approx(220, abs=3), pytest.approx(324, abs=3))
    assert nothing_claimed(answer)
    assert answer.channels["upper_torque"].rmse_after < 0.01


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("what", ["loads", "speeds"])
def test_labels_swapped_for_a_while(paper, what: str, given: bool) -> None:
    pairs = [*zip(UPPER, LOWER, strict=True)] if what == "loads" else [("upper_rpm", "lower_rpm")]
    columns = exchanged(run(seed=3, throttle=False), PART, *pairs)
    answer = refine_stand(Samples(columns, "rig"), paper if given else None)
    (suspect,) = answer.suspect_data
    assert "swapped" in suspect.why
    assert span(suspect.rows) == (pytest.approx(PART.start, abs=4), pytest.approx(PART.stop, abs=4))
    assert nothing_claimed(answer)
    assert answer.channels["lower_thrust"].rmse_after < 0.5


@pytest.mark.parametrize("given", [True, False])
def test_half_a_bridge_for_a_while_is_flagged(paper, given: bool) -> None:
    columns = run(seed=12)
    columns["upper_thrust_N"][PART] *= 0.5
    answer = refine_stand(Samples(columns, "rig"), paper if given else None)
    (suspect,) = answer.suspect_data
    assert suspect.column == "upper_thrust_N" and 0.49 < float(suspect.why.split()[0]) < 0.51
    assert span(suspect.rows) == (pytest.approx(PART.start, abs=4), pytest.approx(PART.stop, abs=4))
    assert nothing_claimed(answer)


ONE_PASS = 162  # rows of `run`: the upper rotor goes up once


@pytest.mark.parametrize("pairs", [[*zip(UPPER, LOWER, strict=True)], [("upper_thrust_N", "lower_thrust_N")]])
def test_loads_exchanged_where_only_the_second_part_has_such_speeds(pairs: list[tuple[str, str]]) -> None:
    columns = {k: v[:ONE_PASS] for k, v in run(seed=9, throttle=False).items()}
    answer = refine_stand(Samples(exchanged(columns, slice(92, None), *pairs), "rig"))
    (suspect,) = answer.suspect_data
    assert set(suspect.column.split(", ")) == {name for pair in pairs for name in pair}
    assert span(suspect.rows) == (pytest.approx(92, abs=3), ONE_PASS)
    assert nothing_claimed(answer)


@pytest.mark.parametrize("true", [{}, {"interference": 12.0}, {"power": 0.4}, {"bump": 12.0}, {"drift": 3.0}])
def test_one_pass_whose_loads_are_what_they_say_is_not_flagged(true: dict) -> None:
    columns = {k: v[:ONE_PASS] for k, v in run(seed=10, throttle=False, **true).items()}
    assert find_suspects(stand_frame(Samples(columns, "rig"), None)).suspects == ()


@pytest.mark.parametrize(
    "pairs", [[*zip(UPPER, LOWER, strict=True)], [("upper_thrust_N", "lower_thrust_N")], [UPPER]]
)
def test_columns_exchanged_throughout(paper, pairs: list[tuple[str, str]]) -> None:
    answer = refine_stand(Samples(exchanged(run(seed=4), slice(None), *pairs), "rig"), paper)
    (suspect,) = answer.suspect_data
    assert set(suspect.column.split(", ")) == {name for pair in pairs for name in pair}
    assert suspect.rows == "all" and nothing_claimed(answer)


def test_torque_and_thrust_of_one_rotor_are_told_apart_without_a_model() -> None:
    answer = refine_stand(Samples(exchanged(run(seed=5), slice(None), UPPER), "rig"))
    assert [s.column for s in answer.suspect_data] == ["upper_thrust_N, upper_torque_Nm"]
    assert nothing_claimed(answer)


def test_one_column_copied_into_another(paper) -> None:
    columns = run(seed=6)
    columns["upper_thrust_N"][PART] = columns["lower_thrust_N"][PART]
    answer = refine_stand(Samples(columns, "rig"), paper)
    (suspect,) = answer.suspect_data
    assert span(suspect.rows) == (PART.start, PART.stop) and "digit by digit" in suspect.why
    assert nothing_claimed(answer)


def test_a_copy_is_found_among_coarse_readings_too(paper) -> None:
    """Swings of both speeds, torques in steps of two noises, and thirty rows of one column in the other."""
    columns = run(seed=3)
    for name in ("upper_torque_Nm", "lower_torque_Nm"):
        columns[name] = np.round(columns[name] / 0.02) * 0.02
    order = np.random.default_rng(0).permutation(len(columns["time_s"]))  # no level is held
    columns = {n: v if n == "time_s" else v[order] for n, v in columns.items()}
    columns["lower_torque_Nm"][100:130] = columns["upper_torque_Nm"][100:130]
    (suspect,) = refine_stand(Samples(columns, "rig.csv"), paper).suspect_data
    assert suspect.column == "upper_torque_Nm, lower_torque_Nm" and suspect.rows == "101-130"


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("rows", [slice(None), PART])
def test_throttles_swapped(paper, rows: slice, given: bool) -> None:
    columns = exchanged(run(seed=7, battery=0.5), rows, ("upper_throttle", "lower_throttle"))
    answer = refine_stand(Samples(columns, "rig"), paper if given else None)
    (suspect,) = answer.suspect_data
    assert suspect.column == "upper_throttle, lower_throttle"
    if rows == PART:
        assert span(suspect.rows) == (pytest.approx(PART.start, abs=4), pytest.approx(PART.stop, abs=4))
        assert [e.name for e in answer.effects] == ["battery_voltage"]
    else:
        assert suspect.rows == "all" and nothing_claimed(answer) and "upper_speed" not in answer.channels


@pytest.mark.parametrize("given", [True, False])
def test_a_saturated_cell(paper, given: bool) -> None:
    columns = run(seed=8)
    limit = np.quantile(columns["lower_thrust_N"], 0.8)
    over = columns["lower_thrust_N"] > limit
    columns["lower_thrust_N"][over] = limit
    answer = refine_stand(Samples(columns, "rig"), paper if given else None)
    (suspect,) = answer.suspect_data
    assert suspect.column == "lower_thrust_N" and "saturated" in suspect.why
    assert nothing_claimed(answer) and answer.unexplained == ()


def test_real_effects_are_no_wrong_labels(paper) -> None:
    for seed, true in enumerate(({"battery": 0.9}, {"air": 1.0}, {"power": 0.25}, {"interference": 8.0})):
        for model in (paper, None):
            log = Samples(run(seed=30 + seed, rpm="battery" not in true, **true), "rig")
            assert find_suspects(stand_frame(log, model)).suspects == (), (true, model is None)


@pytest.mark.parametrize(("side", "share"), [("upper", 0.05), ("lower", -0.06), ("upper", -0.03)])
@pytest.mark.parametrize("throttle", [True, False])
def test_a_tachometer_that_is_off_throughout(paper, side: str, share: float, throttle: bool) -> None:
    columns = run(seed=9, throttle=throttle)
    columns[f"{side}_rpm"] *= 1.0 + share
    answer = refine_stand(Samples(columns, "rig"), paper)
    (suspect,) = answer.suspect_data
    assert suspect.column == f"{side}_rpm" and suspect.rows == "all"
    found = float(suspect.why.split("reads ")[1].split(" %")[0]) / 100.0
    assert found == pytest.approx(share, abs=0.006)
    assert nothing_claimed(answer)


def test_no_tachometer_is_flagged_of_what_the_air_or_the_cells_do(paper) -> None:
    columns = run(seed=10, air=1.0)
    assert [e.name for e in refine_stand(Samples(columns, "rig"), paper).effects] == ["air_density"]
    columns = run(seed=11)
    for k, name in enumerate(
        (*UPPER, *LOWER)
    ):  # all loads less by one share, as in thin air that is not logged
        columns[name] = columns[name] * (0.94 + 0.002 * k)
    answer = refine_stand(Samples(columns, "rig"), paper)
    assert not any("rpm" in s.column for s in answer.suspect_data)
    columns = run(seed=12)
    for name in UPPER:  # two cells another day: within what a nuisance model may be off by
        columns[name] = columns[name] * 0.97
    assert refine_stand(Samples(columns, "rig"), paper).suspect_data == ()


def test_no_tachometer_is_flagged_of_a_ripple_in_one_load(paper, tmp_path) -> None:
    """One speed's share takes a seventh of it, over all loads it is near the noise: that is no evidence."""
    truth = tmp_path / "truth.toml"
    truth.write_text(
        '[stand]\npattern = "ramps"\ndrive = "rpm"\nsweeps = 1\n'
        '[[effects]]\nname = "strange"\nsize = 1.03651\nchannel = "lower_thrust"\n'
    )
    pair = read_pair(EXAMPLES / "rotor_paper.toml")
    answer = refine_stand(Samples(bench.measure(pair, bench.read_bench(truth), seed=129), "bench"), paper)
    assert answer.suspect_data == () and nothing_claimed(answer)
    assert [u.channel for u in answer.unexplained] == ["lower_thrust"]
