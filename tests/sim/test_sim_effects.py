"""Ceiling, heat, air, battery swap, late and shaken sensors, pushes: each against its own formula."""

import math
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table

from sim.effects import HiddenEffect
from sim.flights import fly, write_flight
from sim.line.truthlog import TruthLog
from sim.physics.bemt import pair_loads
from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.physics.sensors import READ_S, Noise, Sensors
from sim.px4.autopilot import Mode
from sim.simulation import Simulation, build
from sim.truth import Truth
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
HOVER = np.array([0.441] * 4 + [0.648] * 4)
QUIET = Noise(*[0.0] * 10)


def flown(*effects: HiddenEffect, height: float = 5.0, rotor: str = "") -> Plant:
    """At rest in the air, rotors at speed, effects on."""
    pair = read_pair(Path(rotor) if rotor else EXAMPLES / "rotor_paper.toml")
    plant = Plant(read_vehicle(EXAMPLES / "x8_demo.toml"), pair)
    plant.state[:] = 0.0
    plant.state[2], plant.state[6], plant.state[13], plant.state[14] = 0.2 - height, 1.0, 0.9, 31.0
    plant.speeds[:] = HOVER
    Truth(effects).act(plant)
    plant.advance(HOVER, 0)
    return plant


def test_a_ceiling_draws_by_momentum_theory_or_by_an_image() -> None:
    with case_table() as case:
        for height in (5.5, 5.0, 3.0):
            with case(f"{height}"):
                free = flown(height=height).thrust.copy()
                left = 6.0 - (height - flown().vehicle.position_m[:, 2])
                under = flown(HiddenEffect("ceiling_effect", 0.5, 0.0, {"ceiling_m": 6.0}), height=height)
                square = (0.235 / left) ** 2
                assert under.thrust / free == pytest.approx((1 + np.sqrt(1 + 0.5 * square)) / 2)
                image = flown(
                    HiddenEffect("ceiling_effect", 0.5, 0.0, {"ceiling_m": 6.0}, "image"), height=height
                )
                assert image.thrust / free == pytest.approx(1 / (1 - 0.125 * square))


def test_windings_warm_by_their_current_and_slow_the_rotors() -> None:
    p = flown()
    p.state[2] = -1e6
    m, q = p.motor, p.torque.copy()
    for _ in range(60):
        p.advance(HOVER, 1000)
    # C dT/dt = I^2 R (1 + a T) - T / K: first order
    loss = (q / m.torque_Nm_A) ** 2 * m.resistance_ohm
    rate = (1 / m.cooling_K_W - 0.00393 * loss) / m.heat_capacity_J_K
    expected = loss / m.heat_capacity_J_K / rate * (1 - np.exp(-rate * 60.0))
    assert p.windings == pytest.approx(expected, rel=2e-3) and p.windings.min() > 5.0
    assert p.motor_currents == pytest.approx(q / m.torque_Nm_A)
    for law in ("resistance", "linear"):
        hot = flown(HiddenEffect("motor_heating", 0.08, 0.0, {}, law))
        first = hot.state[hot.index.SPEED + 16 :][:8]
        first[:] = 100.0
        hot.advance(HOVER, 200)
        warm = hot.windings
        if law == "linear":
            share = 1 - 0.08 * warm / 100
        else:
            r = 0.08 / (0.393 - 0.08) * HOVER / 0.7
            ohm = 1 + 0.00393 * warm
            share = (np.sqrt((1 - r) ** 2 + 4 * r * ohm) - (1 - r)) / (2 * r * ohm)
        assert hot.speeds == pytest.approx(HOVER * share, rel=1e-3)
        assert 0.03 < 1 - hot.speeds[4] / HOVER[4] < 0.1


def test_thin_air_carries_less_with_eq_17_and_with_blades() -> None:
    ratio = (1 - 2.25577e-5 * 2000.0) ** 5.25588 * 288.15 / 303.15
    thin = HiddenEffect("air_density", 1.0, 0.0, {"altitude_m": 2000.0, "temperature_C": 30.0})
    assert flown(thin).thrust == pytest.approx(flown().thrust * ratio)
    p = flown(thin, rotor="kde5215_bemt")
    p.parameters[[p.index.MASS, p.index.IXX, p.index.IYY, p.index.IZZ]] = 1e9
    p.parameters[p.index.GRAVITY] = 0.0
    p.advance(HOVER, 300)
    blades = p.pair.blades  # type: ignore[attr-defined]
    still = pair_loads(blades, p.pair.tip_m_s, 0.441, 0.648)  # type: ignore[attr-defined]
    assert p.thrust[[0, 4]] == pytest.approx(ratio * still[[0, 2]], rel=1e-4)


def test_a_pack_is_swapped_once_the_vehicle_stands() -> None:
    truth = Truth((HiddenEffect("battery_swap", 1.0, 2.0, {"resistance_ohm": 0.04}),))
    p = flown()
    p.steps = 2500
    truth.act(p)
    assert p.charge == pytest.approx(0.9)  # in the air nobody can
    p.state[2], p.state[14] = 0.008, 25.0
    p.speeds[:] = 0.0
    truth.act(p)
    assert p.charge == 1.0 and p.parameters[p.index.RESISTANCE] == 0.04
    assert p.voltage == pytest.approx(8 * (3.55 + 0.6 - 0.35 * math.exp(-1 / 0.06)))
    p.state[13] = 0.5
    truth.act(p)
    assert p.charge == 0.5  # once


def test_every_reading_is_late_by_the_delay() -> None:
    p = flown(HiddenEffect("sensor_delay", 0.04))
    sensors, true, read = Sensors(p, 3, QUIET), [], []
    for _ in range(60):
        true.append(float(p.velocity[2]))
        read.append(sensors.read())
        p.advance(HOVER * 0.9, 4)
    assert [r.velocity[2] for r in read[10:]] == true[:-10]
    assert read[-1].time_s == pytest.approx(59 * READ_S) and read[0].velocity[2] == true[0]


def test_a_power_module_reads_late_scaled_and_in_steps() -> None:
    extra = {"offset_A": 0.7, "delay_s": 0.4, "step_A": 0.1}
    p = flown(HiddenEffect("power_module", 0.1, 0.0, extra))
    sensors = Sensors(p, 3, QUIET)
    p.state[p.index.CURRENT] = 50.0
    assert sensors.read().current == pytest.approx(55.7)
    p.state[p.index.CURRENT] = 60.0
    read = [sensors.read().current for _ in range(1000)]
    assert read[99] == pytest.approx(0.7 + 1.1 * (50.0 + 10.0 * (1.0 - math.exp(-1.0))), abs=0.051)
    assert read[-1] == pytest.approx(66.7)
    assert all(abs(10.0 * amps - round(10.0 * amps)) < 1e-6 for amps in read)


@pytest.mark.parametrize(("law", "times"), [("unbalance", 1), ("blade_pass", 2)])
def test_rotors_shake_at_their_rate_as_their_speed_squared(law: str, times: int) -> None:
    p = flown(HiddenEffect("vibration", 6.0, 0.0, {}, law))
    p.speeds[:] = 0.0
    p.speeds[3] = 0.5
    sensors = Sensors(p, 1, QUIET)
    shaken = np.array([sensors.read().accel for _ in range(5000)]) - p.specific_force
    assert shaken.std(axis=0) == pytest.approx(6.0 * 0.25 / math.sqrt(2) * np.array([1, 1, 0.3]), rel=0.01)
    peak = np.argmax(np.abs(np.fft.rfft(shaken[:, 0]))) / (5000 * READ_S)
    assert peak == pytest.approx(times * 0.5 * 5400 / 60, abs=0.1)


def test_strange_pushes_come_and_go() -> None:
    truth = Truth((HiddenEffect("strange", 12.0, 1.0),))
    p, pushes = flown(), []
    for k in range(400):
        p.steps = 100 * k
        truth.act(p)
        p.advance(HOVER, 0)
        pushes.append(p.specific_force[2] * 20.0 + p.thrust.sum())
    assert set(np.round(pushes, 6)) == {0.0, 12.0} and pushes[:10] == pytest.approx([0.0] * 10, abs=1e-9)
    assert 0.1 < np.mean(np.array(pushes) > 1) < 0.6


@pytest.mark.slow
def test_the_plants_own_log_has_currents_and_heat(tmp_path: Path) -> None:
    true = TruthLog()
    log = fly(build(Simulation(EXAMPLES / "x8_demo.toml"), []).autopilot, "paper", true.watch)
    columns = true.columns()
    assert len(columns["time_s"]) == len(log["time_s"])
    assert {"winding8_K", "motor_current1_A", "thrust5_N", "wind_n_m_s", "speed3"} <= set(columns)
    assert np.diff(columns["winding1_K"])[1000:3000].min() > 0 and columns["current_A"].max() > 20
    write_flight(tmp_path / "true.csv", columns)
    assert (tmp_path / "true.csv").read_text().startswith("time_s,pos_n_m")


@pytest.mark.slow
@pytest.mark.parametrize(("firmware", "within_s"), [("px4", 3.0), ("ardupilot", 1.5)])
@pytest.mark.parametrize("lost", [0.4, 1.0])
def test_with_a_failed_rotor_it_lands_and_disarms_in_time(
    firmware: str, within_s: float, lost: float
) -> None:
    pilot = build(Simulation(EXAMPLES / "x8_demo.toml", firmware=firmware), []).autopilot
    pilot.truth = Truth((HiddenEffect("degraded_rotor", lost, 8.0, {"rotor": 5.0}),))
    if firmware == "ardupilot":
        pilot.set_ap_mode(4)  # type: ignore[attr-defined]
    pilot.arm()
    pilot.take_off(2.0)
    up = 0.0
    for k in range(45 * 250):
        if k == 10 * 250:
            if firmware == "ardupilot":
                pilot.set_ap_mode(9)  # type: ignore[attr-defined]
            else:
                pilot.set_mode(Mode.LAND)
        pilot.step()
        up = pilot.plant.time_s if pilot.plant.height > 0.22 else up
        if not pilot.armed:
            break
    assert up > 10.0 and not pilot.armed and pilot.plant.time_s - up < within_s
    assert np.abs(pilot.plant.quaternion[1:3]).max() < 0.02
