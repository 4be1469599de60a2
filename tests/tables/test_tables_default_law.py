"""Which table a vehicle gets where nobody named a law, and that one figure has one definition."""

from dataclasses import replace
from pathlib import Path

import pytest

from coaxlink.errors import InputError
from coaxlink.mixer import make_law
from coaxlink.mixer.comparison import compare
from coaxlink.mixer.demands import envelope
from coaxlink.mixer.fitted import TableFit
from coaxlink.mixer.worth import weigh
from coaxlink.tables.behaviour import behaviour
from coaxlink.tables.default_law import YAW_SHARE, choose_law
from coaxlink.tables.px4 import px4_commands, report_px4
from coaxlink.vehicle import Vehicle, load_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"


def _vehicle(name, mass=1.0):
    vehicle = load_vehicle(EXAMPLES / name)
    declared = replace(vehicle.declared, mass_kg=mass * vehicle.declared.mass_kg)
    return Vehicle(declared, vehicle.rotors, vehicle.conditions)


def _speeds(vehicle):
    return lambda law, fit: px4_commands(report_px4(vehicle, law, fit=fit).mix)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "mass", "law", "why"),
    [
        ("x8_paper.toml", 1.0, "fitted", "the fitted table: its ceiling is 2.09"),
        ("y6.toml", 1.0, "balanced", "the balanced table, not the fitted one"),  # it hardly yaws
        ("x8_paper.toml", 1.1, "balanced", "the balanced table, not the fitted one"),  # it hardly climbs
    ],
)
def test_the_law_is_chosen_by_the_margins(name, mass, law, why):
    vehicle = _vehicle(name, mass)
    chosen = choose_law(vehicle, _speeds(vehicle))
    assert chosen.law == law and why in chosen.why
    flown, standard = (
        weigh(vehicle, _speeds(vehicle)(law, fit))
        for law, fit in (("fitted", chosen.fit), ("standard", None))
    )
    assert flown.thrust_to_weight >= min(1.99, 0.98 * standard.thrust_to_weight)
    assert flown.limits[2].moment_Nm >= 0.98 * YAW_SHARE * standard.limits[2].moment_Nm
    assert flown.hover_W < standard.hover_W
    named = report_px4(vehicle, "balanced")  # asked for by its name: the same table, or the fitted one itself
    assert named.params == report_px4(vehicle, chosen.law, fit=chosen.fit).params and named.law == "balanced"


def test_a_balanced_table_that_does_not_exist_is_said(monkeypatch):
    monkeypatch.setattr(TableFit, "with_margins", lambda *_: None)
    with pytest.raises(InputError, match="no table near the fitted one keeps both"):
        report_px4(_vehicle("x8_paper.toml", 1.1), "balanced")


def test_compare_and_table_mean_the_same_ceiling_and_yaw():
    vehicle = _vehicle("x8_paper.toml")
    speeds = px4_commands(report_px4(vehicle, "standard").mix)
    worth, flown = weigh(vehicle, speeds), behaviour(vehicle, speeds)
    (row,) = compare(vehicle, [("standard", make_law("standard", vehicle))], envelope(vehicle.airframe, 10))
    for ceiling, yaw in ((flown.ceiling_N, flown.authority_Nm[2]), (row.ceiling_N, row.yaw_Nm)):
        assert ceiling == pytest.approx(worth.ceiling_N, rel=0.005)
        assert yaw == pytest.approx(worth.limits[2].moment_Nm, rel=0.005)
