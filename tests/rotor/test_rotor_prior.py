"""The prior of a pair: physics at its limits, readers of single-rotor tables (pairs: research/real_data)."""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink.data.single import APC, MAKER, STAND, UIUC, SingleTable, read_single_table
from coaxlink.errors import InputError
from coaxlink.rotor.contracted_wake import Blades, calibrated, lower_shares
from coaxlink.rotor.prior import Propeller, pair_prior

DIAMETER, PITCH = 0.4115, 0.1346  # 16.2 x 5.3 in


def blades(**changed):
    values = {
        "pitch_ratio": 0.33, "zero_lift_rad": 0.06, "lift_slope": 5.7,
        "tip_loss": 1.15, "drag_rise": 0.05, "upwash": 0.5, **changed,
    }  # fmt: skip
    return Blades(**{k: np.array([v]) for k, v in values.items()})


def rotor(**changed):
    return calibrated(blades(**changed), np.array([0.0083]), np.array([0.0008]))


def test_the_faster_and_the_further_the_upper_rotor_the_more_its_wake_takes():
    free = rotor(upwash=0.0)
    thrust, torque = lower_shares(free, 0.5, np.array([0.0, 0.5, 1.0, 1.5]))
    assert (thrust[0, 0], torque[0, 0]) == pytest.approx((1.0, 1.0), abs=1e-6)  # alone
    assert np.all(np.diff(thrust[0]) < 0)
    near, _ = lower_shares(free, 0.1, np.array([1.0]))
    assert thrust[0, 2] < near[0, 0] < 1  # further down the wake has sped up


def test_solidity_and_drag_make_the_rotor_that_they_were_told_from():
    """Against the annular balance solved by bisection here, annulus by annulus."""
    made = rotor()
    s, a = float(made.solidity[0]), 5.7
    r = np.linspace(0.1, 1.0, 2001)
    r = (r[1:] + r[:-1]) / 2
    theta = np.arctan(0.33 / (np.pi * r)) + 0.06
    low, high = np.zeros_like(r), np.ones_like(r)
    for _ in range(60):  # 4 r lambda^2 = sigma a r^2 (theta - lambda / r) / 2
        middle = (low + high) / 2
        less = 4 * r * middle**2 < 0.5 * s * a * (theta * r**2 - middle * r)
        low, high = np.where(less, middle, low), np.where(less, high, middle)
    thrust = np.mean(4 * r * low**2) * 0.9
    assert thrust == pytest.approx(0.0083, rel=2e-3)


def table_of(rpm, k_thrust, k_torque, origin=STAND):
    return SingleTable(rpm, k_thrust * rpm**2, k_torque * rpm**2, None, origin, "made here")


@pytest.mark.slow
def test_the_upper_rotor_is_the_tables_and_the_level_is_its_interval():
    rpm = np.linspace(2000, 6000, 9)
    prior = pair_prior(table_of(rpm, 6.0e-7, 1.2e-8, MAKER), Propeller(DIAMETER, 0.2, PITCH))
    u = np.array([0.5, 0.9])
    pair = prior.model.loads(u, u)
    assert pair.upper_thrust == pytest.approx(6.0e-7 * (u * 6000) ** 2, rel=0.02)
    spread = prior.spread("upper.thrust_N", u, u) / pair.upper_thrust
    assert np.all((spread > 0.9 * MAKER.thrust) & (spread < 2 * MAKER.thrust))
    assert np.all(pair.lower_thrust < pair.upper_thrust)
    again = pair_prior(table_of(rpm, 6.0e-7, 1.2e-8, MAKER), Propeller(DIAMETER, 0.2, PITCH))
    assert again.model.terms() == prior.model.terms()


@pytest.mark.slow
def test_what_is_not_printed_widens_the_intervals():
    rpm = np.linspace(2000, 6000, 9)
    known = pair_prior(table_of(rpm, 6.0e-7, 1.2e-8), Propeller(DIAMETER, 0.2, PITCH))
    power = SingleTable(rpm, 6e-7 * rpm**2, None, 1.2e-8 * rpm**3 * np.pi / 30 / 0.8, STAND, "made here")
    guessed = pair_prior(power, Propeller(DIAMETER, 0.2))
    u = np.array([0.7])
    for load in ("upper.torque_Nm", "lower.torque_Nm"):
        assert guessed.spread(load, u, u)[0] > 1.1 * known.spread(load, u, u)[0]
    assert any("motor's efficiency" in reported for reported in guessed.guessed)
    assert any("`pitch_m`" in reported for reported in guessed.guessed)
    nothing = pair_prior(SingleTable(rpm, 6e-7 * rpm**2, None, None, STAND, "x"), Propeller(DIAMETER, 0.2))
    assert any("figure of merit" in reported for reported in nothing.guessed)


def test_figures_of_no_propeller_and_lengths_that_are_no_metres_are_refused():
    rpm = np.linspace(2000, 6000, 9)
    for diameter in (0.2, 0.9):
        with pytest.raises(InputError, match="no propeller of"):
            pair_prior(table_of(rpm, 6.0e-7, 1.2e-8), Propeller(diameter, 0.1, diameter / 3))
    wrong = {
        "`diameter_m`: 0.03 to 2.5 m are expected, found 16": (16, 0.1),
        "`spacing_m`": (0.4, 30.0),
        "`pitch_m`: 0.06 to 0.48 m are expected, found 5 (5 in is 0.127 m)": (0.4, 0.1, 5),
    }
    for text, lengths in wrong.items():
        with pytest.raises(InputError) as caught:
            Propeller(*lengths)
        assert text in str(caught.value)
    with pytest.raises(InputError, match="more than 0"):
        pair_prior(table_of(rpm, 6.0e-7, 1.2e-8), Propeller(DIAMETER, 0.2, PITCH), speed_max_rpm=0.0)


SHEET = """Item,Prop,Throttle,Volts (V),Amps (A),Watts (W),Thrust (G),RPM,Torque (N*m)
MN4014,16*5.4,50%,22.2,4.2,93,800,3690,0.16
,,65%,,7.5,166,1190,4480,0.23
,,75%,,10.5,233,1500,5020,0.30
,,100%,,19.5,433,2250,6110,0.44
"""


def test_readers_of_every_layout_give_newtons(tmp_path):
    sheet = tmp_path / "maker.csv"
    sheet.write_text(SHEET)
    read = read_single_table(sheet, DIAMETER)
    assert read.origin is MAKER
    assert read.thrust_N == pytest.approx(np.array([0.8, 1.19, 1.5, 2.25]) * 9.80665)
    assert read.power_W == pytest.approx([93, 166, 233, 433])

    n, d = np.array([3000, 4000, 5000, 6000]) / 60, 0.254
    uiuc = tmp_path / "apcsf_10x4.7_static.txt"
    uiuc.write_text("RPM        CT         CP\n" + "".join(f"{60 * x:.3f} 0.1120 0.0440\n" for x in n))
    read = read_single_table(uiuc, d)
    assert read.origin is UIUC
    assert read.thrust_N == pytest.approx(0.112 * 1.225 * n**2 * d**4)
    assert read.torque_Nm == pytest.approx(0.044 * 1.225 * n**3 * d**5 / (2 * np.pi * n))

    apc = tmp_path / "PER3_10x47SF.dat"
    blocks = "".join(
        f"         PROP RPM =     {60 * x:.0f}\n\n   V    J    Pe    Ct    Cp   PWR\n"
        " (mph) (Adv) - - - (Hp)\n\n"
        "   0.0  0.00  0.00  0.1180  0.0480  0.01\n   5.0  0.20  0.30  0.1000  0.0470  0.01\n"
        for x in n
    )
    apc.write_text("    10x4.7SF    (10x4.7SF.dat)\n\n" + blocks)
    read = read_single_table(apc, d)
    assert read.origin is APC
    assert read.thrust_N == pytest.approx(0.118 * 1.225 * n**2 * d**4)
