"""Stand logs in time: rest, steps and ramps of one map give the map's model.

The bench of tests/helpers/stand_in_time.py shares nothing with coaxlink.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import stand_in_time as bench_of
from stand_in_time import Array, Bench

from coaxlink.data import Samples
from coaxlink.data.averaging import conditions
from coaxlink.data.tare import without_tares
from coaxlink.report.identify import sentence
from coaxlink.rotor import Identification, identify
from coaxlink.rotor.fit import Options
from coaxlink.rotor.identification import _simplest

SHARED = Path(__file__).parents[2] / ".." / "shared" / "data" / "coax"
PAPER = bench_of.paper()
RAMPS = ("ramps", "ramps, rest at both ends")


def identified(bench: Bench, log: dict[str, Array], form: str = "auto") -> Identification:
    return identify(Samples(log, "run"), form, speed_max_rpm=bench.full, options=Options(max_order=2))


@pytest.mark.parametrize("shape", bench_of.shapes(PAPER))
def test_a_run_is_its_map_a_row_a_condition(shape: str) -> None:
    log = bench_of.run(PAPER, bench_of.shapes(PAPER)[shape], 2)
    found = conditions(without_tares(Samples(log, "run")))
    rpm = np.stack([found["upper_rpm"], found["lower_rpm"]], axis=1)
    near = np.abs(rpm[:, None] - PAPER.points[None]).max(axis=2) / PAPER.full  # (conditions, points)
    if shape in RAMPS:  # between the map's points as well
        assert found.rows < 0.2 * len(log["time_s"]) and (near.min(axis=0) < 0.02).all()
    else:
        short = "0.5 s" in shape  # some of its steps have not settled when the next begins
        assert 49 * (0.8 if short else 1.0) <= found.rows <= 51
        assert (near.min(axis=1) < (0.02 if short else 0.004)).all()
    true = PAPER.loads(*rpm.T)
    loads = np.stack([found[name] for name in bench_of.COLUMNS], axis=1)
    off = np.abs(loads - true)[:, [0, 2]] / np.abs(true[:, [0, 2]]).max(axis=0)
    assert np.median(off) < 0.002 and off.max() < 0.02  # 0.003 is the noise of a row


@pytest.mark.parametrize("shape", ["rest last", "rests between steps", "ramps, rest at both ends"])
def test_rest_changes_neither_form_nor_model(shape: str) -> None:
    bench = replace(PAPER, inertia_kg_m2=0.0)
    found = identified(bench, bench_of.run(bench, bench_of.shapes(bench)[shape], 4))
    assert found.form == "crm"
    true = bench.loads(*bench.points.T)
    for k, load in enumerate(found.fits):
        off = found.fits[load].predict(*(bench.points / bench.full).T) - true[:, k]
        assert np.sqrt(np.mean(off**2)) < 0.002 * np.abs(true[:, k]).max()
    assert found.channels["coaxial_thrust"].rmse < 0.5 < found.comparison["srm"]["coaxial_thrust"].rmse


def test_rest_rows_of_an_averaged_log_change_nothing() -> None:
    log = bench_of.averaged(PAPER, 1)
    plain, rested = identified(PAPER, log), identified(PAPER, bench_of.with_rest_rows(log))
    assert rested.data.samples.rows == 49 and rested.data.logged == 51
    assert rested.model.terms() == plain.model.terms()


def test_a_map_that_comes_down_to_rest_keeps_that_row() -> None:
    levels = 5400.0 * np.linspace(0.0, 1.0, 8)
    u, v = np.meshgrid(levels, levels, indexing="ij")
    bench = replace(PAPER, points=np.stack([u.ravel(), v.ravel()], axis=1), sweep=np.arange(64) // 8)
    log = Samples(bench_of.averaged(bench, 1), "map")
    assert conditions(log) is log


def test_auto_takes_no_form_that_loses_to_a_lone_rotors_law() -> None:
    """An error in one block alone is one standard error whatever its size: no form is as good by it."""
    found = identified(PAPER, bench_of.averaged(PAPER, 1), "crm")
    own = np.where(found.data.fold % 2, 1.0, -1.0)
    off = {"srm": 1.0 + 0.05 * own, "cpcm": np.where(found.data.fold == 3, 9.0, 0.09), "crm": 0.1 + 0.0 * own}
    predicted = {
        form: {load: y + share * 0.02 * np.nanmax(y) for load, y in found.data.loads.items()}
        for form, share in off.items()
    }
    assert _simplest(found.data, predicted) == "crm"
    assert _simplest(found.data, {f: predicted[f] for f in ("srm", "cpcm")}) == "srm"


def test_the_answer_says_where_the_lone_rotors_law_misses_less() -> None:
    found = identified(PAPER, bench_of.averaged(PAPER, 1))
    assert "law misses only" not in sentence(found)
    channels = found.channels | {"coaxial_thrust": replace(found.channels["coaxial_thrust"], rmse=50.0)}
    assert "the usual u² law misses only" in sentence(replace(found, channels=channels))


@pytest.mark.shared_data
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared real data is not beside this checkout")
@pytest.mark.parametrize("name", ["mn4014_16in_zD055", "propdrive_11in_zD07", "u5_16in_zD05"])
def test_public_maps_run_in_time_give_their_maps_model(name: str) -> None:
    bench = bench_of.of_map(SHARED / f"{name}.csv", 0.0)
    averaged = identified(bench, bench_of.averaged(bench, 0))
    run = bench_of.run(bench, bench_of.shapes(bench)["rest at both ends"], 0)
    found = identified(bench, run)
    assert found.form == averaged.form
    for load, fit in found.fits.items():
        u = (bench.points / bench.full).T
        off = fit.predict(*u) - averaged.fits[load].predict(*u)
        left = averaged.data.loads[load] - averaged.fits[load].predict(*u)
        assert np.sqrt(np.mean(off**2)) < 0.6 * np.sqrt(np.mean(left**2))  # that of a model of 15 terms
