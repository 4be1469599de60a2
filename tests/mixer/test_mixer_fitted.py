"""The fitted table: what PX4's own law makes of it follows the rotors, at near least power."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError
from coaxlink.mixer.fitted import fit_table, px4_columns
from coaxlink.rotor import RotorModel, load_rotor_model
from coaxlink.vehicle import Vehicle
from firmware_params import ardupilot as ap
from firmware_params import px4

EXAMPLES = Path(__file__).parents[2] / "examples"
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
# mean thrust error to be had, N; a Y6 asks more of one curve
CLOSE = {"x8_paper": 0.05, "coax_tilted": 0.05, "y6": 0.25}


@lru_cache
def fitted(name):
    airframe = load_airframe(EXAMPLES / f"{name}.toml")
    return airframe, fit_table(Vehicle(airframe, CRM))


def mean_error(airframe, speeds):
    """(4,) over wrenches the fit has not seen, in the paper's envelope scaled to the vehicle."""
    scale = airframe.mass_kg / 20.0
    turn = 4 * scale * max(float(np.hypot(*r.position_m[:2])) for r in airframe.rotors) / 0.2556
    low, high = [150 * scale, -turn, -turn, -turn / 4], [260 * scale, turn, turn, turn / 4]
    wrenches = np.random.default_rng(77).uniform(low, high, (150, 4))
    loads = airframe.loads(CRM, np.array([speeds(*w) for w in wrenches]))
    return np.abs(airframe.wrench(*loads) - wrenches).mean(axis=0)


@pytest.mark.slow
def test_px4s_own_law_delivers_the_wrench():
    for name, close in CLOSE.items():
        airframe, table = fitted(name)
        mix = px4.realise(px4.table_to_params(px4_columns(airframe, table)))  # float32, as on board
        assert not mix.warnings, name

        def speeds(thrust, roll, pitch, yaw, mix=mix):
            return mix.throttle(mix.setpoints(np.array([roll, pitch, yaw, 0, 0, -thrust]) * mix.scale))

        mean = mean_error(airframe, speeds)
        assert mean[0] <= close and mean[1:3].max() < 0.1 and mean[3] < 0.02, (name, mean)


@pytest.mark.slow
def test_ardupilots_own_law_delivers_it_too():
    airframe = fitted("x8_paper")[0]
    table = fit_table(Vehicle(airframe, CRM), spin_min=0.05)
    x, y = np.array([r.position_m[:2] for r in airframe.rotors]).T
    columns = np.linalg.pinv(np.stack([-y * table.ct, x * table.ct, table.yaw, table.ct]))
    top = np.abs(columns).max(axis=0) / [0.5, 0.5, 0.5, 1.0]
    factors = tuple(map(tuple, (columns / top).tolist()))
    motor = ap.MotorParameters(thst_expo=table.curve, spin_min=0.05, spin_max=1.0, spin_arm=0.03)
    mix = ap.realise(ap.ApTable(15, factors, motor, 0))

    def speeds(thrust, roll, pitch, yaw):
        return mix.output(ap.Demand(*(np.array([roll, pitch, yaw, thrust]) * top).tolist())).actuator

    mean = mean_error(airframe, speeds)
    # the spin range bends the curve a little more than one factor can follow
    assert mean[0] < 0.15 and mean[1:].max() < 0.05


@pytest.mark.slow
def test_it_costs_next_to_no_power_and_keeps_the_ceiling():
    _, table = fitted("x8_paper")
    assert abs(table.chosen.power_excess) < 0.002 and table.chosen.ceiling_N > 400.0
    assert 0.7 < table.curve < 0.75
    shares = [t.share for t in table.trade]
    assert shares == sorted(shares)
    assert table.trade[-1].power_excess > 0.04  # equal columns: what an equal split costs
    # single rotors beside pairs are not fitted at the price of power
    _, mixed = fitted("mixed_hexa")
    assert mixed.chosen.error[0] < 0.25 and abs(mixed.chosen.power_excess) < 0.03


@pytest.mark.slow
def test_a_model_a_little_off_has_as_good_a_table():
    # a model updated by flights moves by per cents; its table on itself must not jump
    airframe, found = fitted("y6")[0], {}
    for factors in ((0.976, 0.960, 0.993, 1.013), (0.971, 1.048, 1.006, 0.948), (1.0, 0.956, 1.058, 1.033)):
        terms = {
            load: {term: f * c for term, c in own.items()}
            for (load, own), f in zip(CRM.terms().items(), factors, strict=True)
        }
        model = RotorModel.from_terms(CRM.form, CRM.speed_max_rpm, terms)
        found[factors] = fit_table(Vehicle(airframe, model)).chosen.error
    assert all(e[0] < 0.3 and max(e[1:3]) < 0.07 for e in found.values()), found


def test_an_envelope_out_of_reach_is_said():
    with pytest.raises(InputError, match="cannot fly its envelope"):
        fit_table(Vehicle(fitted("x8_paper")[0], CRM), wrenches=np.array([[900.0, 0, 0, 0]]))
