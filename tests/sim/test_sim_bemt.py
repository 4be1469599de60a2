"""The blade-element pair: momentum theory's own limits, the pairs it was fitted to, and a flight on it."""

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from sim.flights import fly
from sim.physics.bemt import RHO, BemtPair, BladeNumbers, pair_air, pair_loads
from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.simulation import Simulation, build
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
DATA = Path(__file__).parents[3] / "shared" / "data" / "coax"
IDEAL = BladeNumbers(0.2, 0.1, 0.6, 0.25, 0.0, mach=0.0, bluff=0.0)


def test_a_lone_rotor_hovers_on_momentum_theory() -> None:
    tip, u = 120.0, np.array([0.3, 0.6, 0.9])
    thrust, torque, *_ = pair_loads(IDEAL, tip, u, 0.0)
    flow = np.sqrt(thrust / (2 * RHO * math.pi * 0.2**2))
    assert torque * tip * u / 0.2 == pytest.approx(thrust * flow)  # ideal power
    s = 0.6
    inflow = np.sqrt((s / 16) ** 2 + s * 0.25 / 12) - s / 16  # closed form of the hover inflow ratio
    assert flow / (tip * u) == pytest.approx(inflow)
    assert thrust[1] / thrust[0] == pytest.approx(4.0)  # no Reynolds, no Mach: the square of speed


def test_the_wake_costs_the_lower_rotor_and_nobody_else() -> None:
    alone = pair_loads(IDEAL, 120.0, 0.0, 0.6)
    below = pair_loads(IDEAL, 120.0, 0.6, 0.6)
    assert below[2] < 0.95 * alone[2] and below[0] == pytest.approx(alone[2], rel=0.05)
    far = pair_loads(BladeNumbers(0.2, 4.0, 0.6, 0.25, 0.0, mach=0.0, bluff=0.0), 120.0, 0.6, 0.6)
    ring = 1 / math.sqrt(2)  # fully contracted: half of the disc sees twice the flow
    assert below[2] != pytest.approx(far[2]) and 0 < far[2] < alone[2] and ring < 1


def test_climb_unloads_and_the_lower_rotor_may_be_felt_above() -> None:
    still, up = (pair_loads(IDEAL, 120.0, 0.6, 0.6, c)[0] for c in (0.0, 2.0))
    assert up < still
    felt = BladeNumbers(0.2, 0.1, 0.6, 0.25, 0.0, mach=0.0, bluff=0.0, feedback=0.5)
    assert pair_loads(felt, 120.0, 0.6, 0.9)[0] < still
    near, away = (
        pair_loads(BladeNumbers(0.2, z, 0.6, 0.25, 0.0, mach=0.0, feedback=0.5), 120.0, 0.6, 0.9)[0]
        for z in (0.05, 0.4)
    )
    assert near < away


def test_the_papers_pair_comes_out_within_what_its_file_says() -> None:
    bemt, paper = read_pair(Path("kde5215_bemt")), read_pair(EXAMPLES / "rotor_paper.toml")
    u, v = (a.ravel() for a in np.meshgrid(np.arange(0.18, 0.91, 0.09), np.arange(0.18, 0.91, 0.09)))
    error = np.sqrt(np.mean((bemt.loads(u, v) - paper.loads(u, v)) ** 2, axis=1))
    assert (error < [2.0, 0.06, 2.7, 0.04]).all()
    assert bemt.loads(0.9, 0.0)[2] == pytest.approx(paper.loads(0.9, 0.0)[2], abs=3.0)
    assert isinstance(bemt, BemtPair)


@pytest.mark.skipif(not DATA.is_dir(), reason="the real stand data is not beside the repository")
def test_a_real_pair_comes_out_within_what_its_file_says() -> None:
    pair = read_pair(Path("mn4014_bemt"))
    assert isinstance(pair, BemtPair)
    errors = []
    for name, spacing in (("055", 0.55), ("07", 0.7), ("085", 0.85), ("1", 1.0)):
        blades = BladeNumbers(**{**vars(pair.blades), "spacing_m": spacing * 0.4115})
        for row in csv.DictReader((DATA / f"mn4014_16in_zD{name}.csv").read_text().splitlines()):
            a, b = float(row["Speed Left [rpm]"]), float(row["Speed Right [rpm]"])
            if min(a, b) < 300:
                continue
            read = [0.00980665 * float(row["Thrust Left [g]"]), abs(float(row["Torque Left [Nm]"]))]
            read += [0.00980665 * float(row["Thrust Right [g]"]), abs(float(row["Torque Right [Nm]"]))]
            top = pair.speed_max_rpm
            errors.append(pair_loads(blades, pair.tip_m_s, a / top, b / top) - read)
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert len(errors) > 380 and (rms < [0.52, 0.009, 1.1, 0.04]).all()


def solved(b: BladeNumbers, tip: float, u: tuple[float, float], climb: float, edge: float) -> list[float]:
    """Loads of both rotors and their drag along the disc, root by root, by none of the world's code."""
    x = b.spacing_m / b.radius_m
    reach = x / math.sqrt(1 + x * x)
    inner = math.sqrt(1 / (1 + reach))
    area, density = math.pi * b.radius_m**2, 1.225

    def ring(speed: float, slope: float, wc: float, r0: float, r1: float) -> tuple[float, float]:
        two, three, one = r1**2 - r0**2, r1**3 - r0**3, r1 - r0

        def blades(w: float) -> float:
            lift = b.pitch_rad * (speed**2 * three / 3 + edge**2 * one / 2) - speed * w * two / 2
            return density * area * slope / 2 * lift

        w = brentq(
            lambda w: blades(w) - 2 * density * area * two * (w - wc) * math.hypot(w, edge), wc - 60, wc + 90
        )
        return blades(w), w

    def blade(share: float) -> tuple[float, float, float]:
        c = min(max(share, 0.15), 1.2)
        slope = b.lift * c**b.reynolds / math.sqrt(1 - b.mach * (0.75 * tip * c / 340) ** 2)
        return tip * share, slope, b.drag * c ** (-0.5 * abs(b.reynolds))

    (va, sa, da), (vb, sb, db) = blade(u[0]), blade(u[1])
    thrust, flow = ring(va, sa, climb, 0.0, 1.0)
    jet = max(flow - climb, 0) * b.wake * (1 + reach) / (1 + (x * edge / flow) ** 2)
    core, through = ring(vb, sb, climb + jet, 0.0, inner)
    outer, around = ring(vb, sb, climb, inner, 1.0)
    lean = density * area * sa * b.pitch_rad * flow / 4
    lean_b = density * area * sb * b.pitch_rad * (through * inner + around * (1 - inner)) / 4
    profile, profile_b = density * area * da * va / 4, density * area * db * vb / 4

    def torque(power: float, k: float, drag: float, v: float) -> float:
        return b.radius_m * ((b.induced * power - k * edge**2) / v + drag / 2 * (v + edge**2 / v))

    bluff = b.bluff * density / 2 * jet**2 * area * inner**2 * math.exp(-4 * u[1])
    return [
        thrust,
        torque(thrust * flow, lean, profile, va),
        core + outer - bluff,
        torque(core * through + outer * around, lean_b, profile_b, vb),
        lean + profile,
        lean_b + profile_b,
    ]


FLOWN = [((0.45, 0.6), 0.0, 0.0), ((0.45, 0.6), 2.0, 0.0), ((0.5, 0.5), -1.5, 3.0)]
FLOWN += [((0.3, 0.8), 1.0, 8.0), ((0.9, 0.25), 0.0, 12.0), ((0.2, 0.2), 0.0, 2.0)]


def test_stand_and_flight_turn_the_solved_equations() -> None:
    for name in ("kde5215_bemt", "mn4014_bemt"):
        for u, climb, edge in FLOWN:
            turns_the_solved_equations(read_pair(Path(name)), u, climb, edge)


def turns_the_solved_equations(pair: Any, u: tuple[float, float], climb: float, edge: float) -> None:
    direct = solved(pair.blades, pair.tip_m_s, u, climb, edge)
    assert pair_air(pair.blades, pair.tip_m_s, *u, climb, edge) == pytest.approx(direct, rel=1e-6, abs=1e-6)
    plant = Plant(read_vehicle(EXAMPLES / "x8_demo.toml"), pair)
    k = plant.index
    plant.parameters[[k.MASS, k.IXX, k.IYY, k.IZZ]] = 1e9  # held where it is
    command = np.where(plant.vehicle.level == 1, u[1], u[0])
    plant.state[[k.POS + 2, k.VEL, k.VEL + 2]] = -1e4, edge, -climb
    plant.parameters[k.GRAVITY] = 0.0
    plant.speeds[:] = command
    plant.advance(command, 400)
    low = plant.vehicle.level == 1
    felt = [plant.thrust[~low], plant.torque[~low], plant.thrust[low], plant.torque[low]]
    for got, expected, scale in zip(felt, direct, (60.0, 1.5, 90.0, 2.2), strict=False):
        assert got == pytest.approx(expected, abs=1e-4 * scale)
    drag = -plant.specific_force[0] * 1e9
    assert drag == pytest.approx(4 * edge * (direct[4] + direct[5]), rel=1e-3, abs=1e-6)


def test_an_idle_rotor_in_the_wake_is_a_wheel_and_wind_blows_the_wake_away() -> None:
    idle = pair_loads(IDEAL, 120.0, 0.8, np.array([0.08, 0.6]))
    assert idle[3][0] < 0 < idle[3][1]  # driven, then driving
    calm, cross = (pair_air(IDEAL, 120.0, 0.6, 0.6, 0.0, e) for e in (0.0, 12.0))
    alone = pair_air(IDEAL, 120.0, 0.0, 0.6, 0.0, 12.0)
    assert cross[0] > calm[0] and calm[2] < 0.8 * calm[0] and cross[2] > 0.9 * alone[2]


def test_inflow_settles_within_milliseconds_and_keeps_the_order_of_the_steps() -> None:
    plant = Plant(read_vehicle(EXAMPLES / "x8_demo.toml"), read_pair(Path("kde5215_bemt")))
    plant.state[plant.index.POS + 2] = -1e4
    plant.speeds[:] = 0.6
    thrust = []
    for _ in range(30):
        plant.advance(np.full(8, 0.6), 1)
        thrust.append(plant.thrust[0])
    assert thrust[0] > 1.15 * thrust[-1] and thrust[15] == pytest.approx(thrust[-1], rel=0.01)
    start = plant.state.copy()

    def end(step: float) -> np.ndarray:
        plant.state[:] = start
        plant.state[[3, 10, 11, 12]] = 6.0, 1.0, -1.0, 0.5
        plant.advance(np.full(8, 0.6) + 0.02 * (np.arange(8) % 3), round(0.2 / step), step)
        return plant.state[:13].copy()

    exact = end(0.000125)
    errors = [np.abs(end(h) - exact).max() for h in (0.002, 0.001, 0.0005)]
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([4.0, 4.0], abs=0.5)


@pytest.mark.slow
def test_it_flies_and_its_air_is_felt() -> None:
    autopilot = build(Simulation(EXAMPLES / "x8_demo.toml", rotor=Path("kde5215_bemt")), []).autopilot
    log = fly(autopilot, "paper")
    assert log["height_m"].max() == pytest.approx(4.7, abs=0.3) and log["height_m"][-1] < 0.3
