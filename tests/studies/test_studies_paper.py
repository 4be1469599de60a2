"""The ledger recomputes: its figures are held to arithmetic done by hand or with other tools here."""

import math

import numpy as np
import pytest

from coaxlink.airframe import load_airframe
from coaxlink.files import example
from coaxlink.mixer import allocate
from coaxlink.report.paper import markdown, tables
from coaxlink.rotor import load_rotor_model
from coaxlink.studies.paper import printed_laws
from coaxlink.studies.paper.reproduction import recompute
from coaxlink.vehicle import Vehicle

pytestmark = pytest.mark.slow
WEIGHT = 20.0 * 9.81


@pytest.fixture(scope="module")
def ledger():
    return recompute(fly_table_4=False, pair=None)


def line(ledger, claim, what):
    lines = next(c for c in ledger.claims if c.id == claim).lines
    return next(x for x in lines if what in x.what).computed


def lower_thrust(u, v):
    """Eq. 17 by hand."""
    return 2.755 * u**2 * v**2 + 64.721 * v**2 - 2.547 * u * v + 12.402 * v - 37.502 * u**2 + 0.801


def pair_thrust(u, v):
    return 55.9517 * u**2 + 22.4464 * u + lower_thrust(u, v)


def test_every_table_and_contradiction_has_a_claim_and_what_was_not_flown_says_so(ledger):
    verdicts = {c.id: c.verdict for c in ledger.claims}
    expected = {"table-1", "table-2", "table-4", "table-5", "figure-4", "figure-5", "eq-15", "eq-16", "eq-18"}
    assert expected | {f"contradiction-{n}" for n in range(1, 12)} == set(verdicts)
    assert verdicts["table-4"] == verdicts["contradiction-11"] == "not checked"
    assert verdicts["table-5"] == "cannot be reproduced"


def test_figures_are_those_of_arithmetic_by_hand(ledger):
    u = math.sqrt(WEIGHT / 8 / 73.06)
    share = WEIGHT / 4 / (46.98**2 + 69.89**2)  # minimum norm: u^2 in the ratio of the columns
    fast, slow = math.sqrt(46.98 * share), math.sqrt(69.89 * share)
    grid = np.linspace(0, 0.9, 11)
    a, b = (g.ravel() for g in np.meshgrid(grid, grid))
    squares = np.stack([b**2, a**2], axis=1)
    p_0l, p_1l = np.linalg.solve(squares.T @ squares, squares.T @ lower_thrust(a, b))
    for claim, what, value in (
        ("contradiction-1", "standard mixer", 4 * pair_thrust(u, u) - WEIGHT),
        ("contradiction-1", "reduced mixer", 4 * pair_thrust(fast, slow) - WEIGHT),
        ("contradiction-9", "p_0l", p_0l),
        ("contradiction-9", "p_1l", p_1l),
    ):
        assert line(ledger, claim, what) == pytest.approx(value, rel=1e-6), what
    # the facts of the paper, found with other tools
    assert line(ledger, "contradiction-3", "kept: u_l^2") == pytest.approx(26.8, abs=0.05)
    assert line(ledger, "contradiction-2", "largest departure") < 1e-9


def test_text_and_tables_hold_every_claim(ledger):
    text = markdown(ledger)
    assert all(f"## {c.id}\n" in text for c in ledger.claims)
    assert sum(1 for _ in tables(ledger)) == 1 + sum(bool(c.lines) for c in ledger.claims)


def test_the_printed_laws_have_the_papers_mistakes():
    vehicle = Vehicle(load_airframe(example("x8_paper.toml")), load_rotor_model(example("rotor_paper.toml")))
    result = allocate(printed_laws(vehicle)["coaxial-printed"], vehicle, [WEIGHT, 0.0, 0.0, 0.4])
    assert result.error == pytest.approx([0.0, 0.0, 0.0, -0.4], abs=1e-8) and result.dropped == ("yaw",)
    printed = Vehicle(vehicle.airframe, load_rotor_model(example("rotor_srm_paper.toml")))
    level, yawing = (
        printed_laws(printed)["standard-printed"].speeds([WEIGHT, 0, 0, y]) ** 2 for y in (0, 0.05)
    )
    full = printed.model.loads(1.0, 1.0)
    delivered = np.abs(yawing - level).sum() * float(full.upper_torque)
    assert delivered == pytest.approx(0.05 * float(full.upper_thrust), rel=1e-6)  # 73 times the demand
