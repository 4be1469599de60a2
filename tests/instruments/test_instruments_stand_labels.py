"""Columns that are not what they say, in all or a part of a log: named, left out, and nothing claimed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from case_table import case_table
from residual_rig import run

from coaxlink.channels.stand import stand_frame
from coaxlink.data import Samples
from coaxlink.instruments.stand.suspects import find_suspects
from coaxlink.residual import refine_stand
from coaxlink.rotor import RotorModel, load_rotor_model

EXAMPLES = Path(__file__).parents[2] / "examples"

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


def test_another_unit_or_sign_takes_the_channel_out(paper) -> None:
    with case_table() as case:
        for column, factor, unit in (
            ("lower_torque_Nm", 100.0, "N cm"),
            ("upper_thrust_N", 1 / 9.80665, "kgf"),
            ("lower_thrust_N", 1000 / 9.80665, "gf"),
            ("lower_torque_Nm", -1.0, "sign"),
        ):
            with case(f"{column}, {factor}, {unit}"):
                columns = run(seed=1)
                columns[column] = factor * columns[column]
                answer = refine_stand(Samples(columns, "rig"), paper)
                (suspect,) = answer.suspect_data
                assert (suspect.column, suspect.rows) == (column, "all") and unit in suspect.why
                assert nothing_claimed(answer) and answer.unexplained == ()
                assert column.rsplit("_", 1)[0] not in answer.channels and len(answer.channels) == 5


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("pairs", [[*zip(UPPER, LOWER, strict=True)], [("upper_thrust_N", "lower_thrust_N")]])
def test_loads_exchanged_where_only_the_second_part_has_such_speeds(pairs: list[tuple[str, str]]) -> None:
    columns = {k: v[:ONE_PASS] for k, v in run(seed=9, throttle=False).items()}
    answer = refine_stand(Samples(exchanged(columns, slice(92, None), *pairs), "rig"))
    (suspect,) = answer.suspect_data
    assert set(suspect.column.split(", ")) == {name for pair in pairs for name in pair}
    assert span(suspect.rows) == (pytest.approx(92, abs=3), ONE_PASS)
    assert nothing_claimed(answer)


def test_one_pass_whose_loads_are_what_they_say_is_not_flagged() -> None:
    with case_table() as case:
        for true in ({}, {"interference": 12.0}, {"power": 0.4}, {"bump": 12.0}, {"drift": 3.0}):
            with case(f"{true}"):
                columns = {k: v[:ONE_PASS] for k, v in run(seed=10, throttle=False, **true).items()}
                assert find_suspects(stand_frame(Samples(columns, "rig"), None)).suspects == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    "pairs", [[*zip(UPPER, LOWER, strict=True)], [("upper_thrust_N", "lower_thrust_N")], [UPPER]]
)
def test_columns_exchanged_throughout(paper, pairs: list[tuple[str, str]]) -> None:
    answer = refine_stand(Samples(exchanged(run(seed=4), slice(None), *pairs), "rig"), paper)
    (suspect,) = answer.suspect_data
    assert set(suspect.column.split(", ")) == {name for pair in pairs for name in pair}
    assert suspect.rows == "all" and nothing_claimed(answer)


@pytest.mark.slow
def test_torque_and_thrust_of_one_rotor_are_told_apart_without_a_model() -> None:
    answer = refine_stand(Samples(exchanged(run(seed=5), slice(None), UPPER), "rig"))
    assert [s.column for s in answer.suspect_data] == ["upper_thrust_N, upper_torque_Nm"]
    assert nothing_claimed(answer)


def test_loads_exchanged_throughout_are_found_without_a_model() -> None:
    """The upper rotor's loads hang on its own speed alone: of two readings of all rows one fits."""
    columns = exchanged(run(seed=4), slice(None), ("upper_thrust_N", "lower_thrust_N"))
    found = find_suspects(stand_frame(Samples(columns, "rig"), None))
    assert [(s.column, s.rows) for s in found.suspects] == [("upper_thrust_N, lower_thrust_N", "all")]


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_real_effects_are_no_wrong_labels(paper) -> None:
    for seed, true in enumerate(({"battery": 0.9}, {"air": 1.0}, {"power": 0.25}, {"interference": 8.0})):
        for model in (paper, None):
            log = Samples(run(seed=30 + seed, rpm="battery" not in true, **true), "rig")
            assert find_suspects(stand_frame(log, model)).suspects == (), (true, model is None)
