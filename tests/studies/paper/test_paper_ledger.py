"""The ledger recomputes: its figures are held to arithmetic done by hand or with other tools here."""

import math

import numpy as np
import pytest

from coaxlink import files
from coaxlink.cli.reproduce import build
from coaxlink.report.paper import markdown, tables


@pytest.fixture(scope="module")
def ledger():
    return build(fly_table_4=False, pair=None)


def line(ledger, entry, what):
    found = next(e for e in ledger.entries if e.id == entry)
    return next(x for x in found.lines if what in x.what).computed


def lower_thrust(u, v):
    """Eq. 17 by hand."""
    return 2.755 * u**2 * v**2 + 64.721 * v**2 - 2.547 * u * v + 12.402 * v - 37.502 * u**2 + 0.801


def test_there_is_an_entry_for_every_table_and_contradiction(ledger):
    ids = [e.id for e in ledger.entries]
    assert len(ids) == len(set(ids))
    expected = {"table-1", "table-2", "table-4", "table-5", "figure-4", "figure-5", "eq-15", "eq-16", "eq-18"}
    assert expected | {f"contradiction-{n}" for n in range(1, 12)} == set(ids)


def test_hover_of_the_printed_mixers_on_eq_17(ledger):
    weight = 20.0 * 9.81
    u = math.sqrt(weight / 8 / 73.06)
    standard = 4 * (55.9517 * u**2 + 22.4464 * u + lower_thrust(u, u)) - weight
    assert line(ledger, "contradiction-1", "standard mixer") == pytest.approx(standard, rel=1e-6)
    share = weight / 4 / (46.98**2 + 69.89**2)  # minimum norm: u^2 in the ratio of the columns
    fast, slow = math.sqrt(46.98 * share), math.sqrt(69.89 * share)
    reduced = 4 * (55.9517 * fast**2 + 22.4464 * fast + lower_thrust(fast, slow)) - weight
    assert line(ledger, "contradiction-1", "reduced mixer") == pytest.approx(reduced, rel=1e-6)


def test_least_squares_reduction_of_eq_17(ledger):
    grid = np.linspace(0, 0.9, 11)
    u, v = (g.ravel() for g in np.meshgrid(grid, grid))
    squares = np.stack([v**2, u**2], axis=1)
    p_0l, p_1l = np.linalg.solve(squares.T @ squares, squares.T @ lower_thrust(u, v))
    assert line(ledger, "contradiction-9", "p_0l") == pytest.approx(p_0l, rel=1e-6)
    assert line(ledger, "contradiction-9", "p_1l") == pytest.approx(p_1l, rel=1e-6)


def test_what_the_l1_norm_keeps_when_relaxed(ledger):
    found_lines = next(e for e in ledger.entries if e.id == "contradiction-3").lines
    values = {x.what: x.computed for x in found_lines}
    assert values["kept: u_l^2"] == pytest.approx(
        26.8, abs=0.05
    )  # the facts of the paper, found with other tools
    assert values["kept: u_l"] == pytest.approx(23.6, abs=0.05)


def test_the_yaw_error_is_the_demand(ledger):
    assert line(ledger, "contradiction-2", "largest departure") < 1e-9


def test_what_was_not_flown_says_so(ledger):
    verdicts = {e.id: e.verdict for e in ledger.entries}
    assert verdicts["table-4"] == "not checked"
    assert verdicts["contradiction-11"] == "not checked"
    assert verdicts["table-5"] == "cannot be reproduced"


def test_page_and_tables_hold_every_entry(ledger):
    page = markdown(ledger)
    assert all(f"## {e.id}\n" in page for e in ledger.entries)
    assert sum(1 for _ in tables(ledger)) == 1 + sum(bool(e.lines) for e in ledger.entries)


def test_a_real_pair_gives_the_last_contradiction_a_figure(tmp_path):
    log = tmp_path / "pair.csv"
    rows = ["time_s,upper_rpm,lower_rpm,upper_thrust_N,upper_torque_Nm,lower_thrust_N,lower_torque_Nm"]
    for i, (u, v) in enumerate((u, v) for u in (1000, 2000, 3000, 4000) for v in (1000, 2000, 3000, 4000)):
        thrust = 1e-6 * u * u - 1e-7 * u * v  # a tenth lost at equal speeds
        rows.append(f"{i},{u},{v},{thrust},{thrust / 50},{1e-6 * v * v},{2e-8 * v * v}")
    log.write_text("\n".join(rows) + "\n")
    entry = build(fly_table_4=False, pair=log).entries[-1]
    alone, change = (x.computed for x in entry.lines)
    assert change / alone == pytest.approx(-0.1, abs=1e-6)
    assert files.example("rotor_eq15.toml").is_file()
