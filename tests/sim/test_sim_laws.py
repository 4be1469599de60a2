"""Other laws of the same physics, in flight and on the stand: each against its own formula."""

import math
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table

from sim.effects import FORMS, HiddenEffect
from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.stand.effects import StandEffect, StandSetup, measure
from sim.stand.laws import LAWS, friction
from sim.truth import Truth, read_truth, truth_text
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
PAIR = read_pair(EXAMPLES / "rotor_paper.toml")
HOVER = np.array([0.441] * 4 + [0.648] * 4)


def flown(effect: HiddenEffect | None = None, u: np.ndarray = HOVER, height: float = 5.0) -> Plant:
    """A vehicle at rest in the air, its rotors at speed, the effect on."""
    plant = Plant(read_vehicle(EXAMPLES / "x8_demo.toml"), PAIR)
    plant.state[:] = 0.0
    plant.state[2], plant.state[6], plant.state[13], plant.state[14] = -height, 1.0, 0.9, 30.0
    plant.speeds[:] = u
    Truth((effect,) if effect else ()).act(plant)
    plant.advance(u, 0)
    return plant


def heights(plant: Plant) -> np.ndarray:
    return 0.2 - plant.position[2] - plant.vehicle.position_m[:, 2]


def test_ground_effect_by_cheeseman_and_bennett_and_by_hayden() -> None:
    with case_table() as case:
        for height in (0.5, 0.9, 2.0):
            with case(f"{height}"):
                free, gain = flown(height=height).thrust.copy(), 0.2 / math.e
                image = flown(
                    HiddenEffect("ground_effect", 0.2, 0.0, {"scale_m": 0.8}, "cheeseman"), height=height
                )
                h = heights(image)
                radius = (
                    4 * 0.8 * math.sqrt(gain / (1 + gain))
                )  # so that the gain at 0.8 m is the exponential law's
                assert image.thrust / free == pytest.approx(1 / (1 - (radius / (4 * h)) ** 2))
                power = flown(
                    HiddenEffect("ground_effect", 0.2, 0.0, {"scale_m": 0.8}, "hayden"), height=height
                )
                assert power.thrust / free == pytest.approx(
                    (1 + ((1 + gain) ** 1.5 - 1) * (0.8 / h) ** 2) ** (2 / 3)
                )


def test_drag_by_mass_flow_and_by_flapping() -> None:
    each = 20.0 * 9.80665 / 8
    for law, weight in (
        ("momentum", lambda u, t: 0.55 * np.sqrt(t / each)),
        ("flapping", lambda u, t: 0.55**2 * t / each / u),
    ):
        p = flown(HiddenEffect("rotor_drag", 1.2, 0.0, {}, law))
        p.state[3] = 3.0
        p.advance(HOVER, 0)
        force = p.specific_force[0] * 20.0
        assert force == pytest.approx(-1.2 * 3.0 * weight(HOVER, p.thrust).sum())
        assert force == pytest.approx(-1.2 * 3.0 * HOVER.sum(), rel=0.25)  # as large as by speed


def test_inflow_by_momentum_balances_blades_and_air() -> None:
    with case_table() as case:
        for climb in (-3.0, 0.5, 3.0):
            with case(f"{climb}"):
                size = 4.0
                p = flown(HiddenEffect("axial_inflow", size, 0.0, {}, "momentum"))
                still = p.thrust.copy()
                p.state[5] = -climb
                p.advance(HOVER, 0)
                tip = 5400 * math.pi / 30 * 0.235
                hover = math.sqrt(20.0 * 9.80665 / 8 / (2 * 1.225 * math.pi * 0.235**2)) / (0.55 * tip)
                slope = 2 * size * hover**2 / (1 - size * hover)
                for share, u in zip(p.thrust / still, HOVER, strict=True):
                    up = climb / (tip * u)
                    low, high = up + 1e-9 if up > 0 else 1e-9, 1.0  # bisect: momentum (l (l - l_c)) = blades
                    for _ in range(80):
                        flow = 0.5 * (low + high)
                        blades = hover**2 + slope * (hover - flow)
                        low, high = (flow, high) if flow * (flow - up) < blades else (low, flow)
                    assert share == pytest.approx(flow * (flow - up) / hover**2, rel=1e-6)
                if climb == 0.5:
                    mean = (tip * HOVER).mean()
                    assert (p.thrust / still).mean() == pytest.approx(1 - size * climb / mean, abs=0.01)


def test_a_motor_under_load_and_a_giving_governor() -> None:
    for law in ("motor", "shepherd"):
        p = flown(HiddenEffect("battery_voltage", 0.6, 0.0, {"reference_V": 33.6}, law))
        p.parameters[p.index.RESISTANCE] = 0.0
        p.advance(HOVER, 400)
        v = p.voltage / 33.6
        r = 0.25 * HOVER
        y = v if law == "shepherd" else (np.sqrt((1 - r) ** 2 + 4 * r * v) - (1 - r)) / (2 * r)
        assert p.speeds == pytest.approx(HOVER * (1 + 0.6 * (y - 1)), rel=2e-3)
        assert p.speeds[0] < 0.99 * HOVER[0]


def test_the_packs_relax_as_their_laws_say() -> None:
    volts_of = {}
    for law in ("power", "motor", "shepherd"):
        p = flown(HiddenEffect("battery_voltage", 1e-9, 0.0, {}, law))
        p.state[2] = -1e5
        volts = []
        for _ in range(12):
            p.advance(HOVER, 1000)
            volts.append(p.voltage)
        volts_of[law] = np.array(volts)
        current, charge = p.current, p.charge
        drop = 0.025 * current
        rest = 8 * (3.55 + 0.6 * charge - 0.35 * math.exp(-charge / 0.06))
        if law == "power":
            assert volts[-1] == pytest.approx(rest - drop, abs=0.02)
        elif law == "motor":
            slow = 0.25 * drop * (2 - math.exp(-12 / 3.0) - math.exp(-12 / 40.0))
            assert volts[-1] == pytest.approx(rest - 0.5 * drop - slow, abs=0.03)
        else:
            spent = 1 - charge
            cell = 3.8 - 0.012 * (spent + 0.1 * current * (1 - math.exp(-1.2)) * 360 / 25200) / charge
            assert volts[-1] == pytest.approx(8 * (cell + 0.36 * math.exp(-4 * spent)) - drop, abs=0.03)
    assert (
        volts_of["motor"][0] > volts_of["power"][0]
        and len({round(float(v[-1]), 2) for v in volts_of.values()}) == 3
    )


def test_lags_of_second_order_and_unequal_ways() -> None:
    p = flown(HiddenEffect("rotor_lag", 0.04, 0.0, {}, "second_order"))  # 0.06 s in all
    p.state[p.index.SPEED + 8 :][:8] = HOVER
    p.advance(HOVER + 0.1, 45)
    t = 0.045 / 0.03
    assert p.speeds - HOVER == pytest.approx(0.1 * (1 - (1 + t) * math.exp(-t)), rel=1e-9)
    p = flown(HiddenEffect("rotor_lag", 0.04, 0.0, {"down_over_up": 2.0}, "asymmetric"))
    way = np.where(np.arange(8) % 2, 0.1, -0.1)
    p.advance(HOVER + way, 45)
    tau = np.where(way > 0, 0.04, 0.08)
    assert p.speeds - HOVER == pytest.approx(way * (1 - np.exp(-0.045 / tau)), rel=1e-9)


def test_rotors_react_to_the_rate_their_lag_gives_them() -> None:
    for law, rate in (("second_order", 0.0), ("asymmetric", 0.05 / (0.02 * 2 / 2.8))):
        p = flown(HiddenEffect("rotor_lag", 0.0, 0.0, {}, law))
        p.state[p.index.SPEED + 8 :][:8] = HOVER
        command = HOVER + 0.05 * (p.vehicle.spin > 0)
        p.advance(command, 0)
        before = p.out[5]
        Truth((HiddenEffect("rotor_inertia_torque", 0.002),)).act(p)
        p.advance(command, 0)
        expected = 4 * 0.002 * (5400 * math.pi / 30) * rate
        assert (p.out[5] - before) * 1.60 == pytest.approx(expected, abs=1e-9)


def test_weak_short_hung_and_moved() -> None:
    sound = flown()
    short = flown(HiddenEffect("degraded_rotor", 0.2, 0.0, {"rotor": 2.0}, "tip"))
    assert short.thrust[1] / sound.thrust[1] == pytest.approx(0.8)
    assert short.torque[1] / sound.torque[1] == pytest.approx(0.8**1.25)
    weak = flown(HiddenEffect("degraded_rotor", 0.2, 0.0, {"rotor": 2.0}, "weak_motor"))
    weak.advance(HOVER, 300)
    assert weak.speeds[1] / HOVER[1] == pytest.approx(math.sqrt(0.8))
    hung = flown(HiddenEffect("mass_change", 2.0, 0.0, {"below_m": 0.2}, "hung"))
    i = np.array([hung.parameters[k] for k in (hung.index.IXX, hung.index.IYY, hung.index.IZZ)])
    gained = 20.0 * 2.0 / 22.0 * 0.2**2  # Steiner's
    assert i - hung.vehicle.inertia_kg_m2 == pytest.approx([gained, gained, 0.0])
    assert hung.parameters[hung.index.CZ] == pytest.approx(0.2 * 2.0 / 22.0)
    moved = flown(HiddenEffect("cg_offset", 0.01, 0.0, {"direction_deg": 0.0}, "ballast"))
    reach = 0.01 * 20.0 / 1.5  # how far 1.5 kg were moved
    steiner = 1.5 * (reach - 0.01) ** 2 + 18.5 * 0.01**2
    i = np.array([moved.parameters[k] for k in (moved.index.IXX, moved.index.IYY, moved.index.IZZ)])
    assert i - moved.vehicle.inertia_kg_m2 == pytest.approx([0.0, steiner, steiner])
    assert moved.out[4] * i[1] == pytest.approx(-0.01 * moved.thrust.sum())


def test_wind_grows_with_height_or_pushes_in_proportion() -> None:
    truth = Truth((HiddenEffect("wind", 5.0, 0.0, {}, "shear"),))
    p = flown()
    for height, share in ((1.0, (1 / 4) ** 0.2), (4.0, 1.0), (8.0, 2**0.2)):
        p.state[2] = 0.2 - height
        truth.act(p)
        assert p.parameters[p.index.WIND] == pytest.approx(5.0 * share)
    p = flown(HiddenEffect("wind", 5.0, 0.0, {"body_drag_kg_m": 0.1}, "linear"))
    assert p.specific_force[0] * 20.0 == pytest.approx(0.1 * 25.0)
    p.state[3] = 2.5
    p.advance(HOVER, 0)
    assert p.specific_force[0] * 20.0 == pytest.approx(0.1 * 5.0 * 2.5)


@pytest.mark.slow
def test_dryden_gusts_across_the_wind_forget_faster() -> None:
    truth = Truth((HiddenEffect("wind", 4.0, 0.0, {"gust_m_s": 1.5}, "dryden"),))
    p, felt = flown(), []
    for _ in range(80000):
        truth.act(p)
        p.steps += 50
        felt.append(p.parameters[p.index.WIND : p.index.WIND + 3].copy())
    air = np.array(felt) - [4.0, 0.0, 0.0]
    assert air.std(axis=0) == pytest.approx([1.5, 1.5, 0.75], rel=0.12)
    lag = 50  # 2.5 s: exp(-1) along, exp(-1) (1 - 1/2) across
    correlations = [np.mean(a[lag:] * a[:-lag]) / np.mean(a * a) for a in air.T]
    assert correlations == pytest.approx([math.exp(-1), 0.5 * math.exp(-1), 0.5 * math.exp(-1)], abs=0.06)


def test_a_law_survives_its_file(tmp_path: Path) -> None:
    path = tmp_path / "truth.toml"
    effects = tuple(HiddenEffect(n, 0.1, 1.0, {}, law) for n, f in FORMS.items() for law in f.laws)
    path.write_text(truth_text(Truth(effects)))
    assert read_truth(path).effects == effects


SIZES = {
    "battery_voltage": 0.6,
    "air_density": 1.0,
    "sensor_drift": 0.6,
    "lower_on_upper_interference": 5.0,
    "blade_speed_law": 0.1,
    "hysteresis": 0.08,
    "rotor_lag": 0.3,
    "rotor_spacing": 0.4,
    "motor_heating": 0.1,
    "dead_band": 0.08,
    "strange": 4.0,
}
LOADS = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")


@pytest.mark.slow
def test_every_law_of_the_stand_is_as_large_as_the_first_and_another() -> None:
    for name in LAWS:
        compare_laws(name)


def compare_laws(name: str) -> None:
    ramps = name in ("hysteresis", "rotor_lag", "dead_band")
    how = {"pattern": "ramps"} if ramps else {"sweeps": 4}

    def run(*effects: StandEffect) -> dict[str, np.ndarray]:
        return measure(PAIR, StandSetup(effects, drive="throttle", **how), seed=2)  # type: ignore[arg-type]

    plain, by = run(), {}
    for law in LAWS[name]:
        log = run(StandEffect(name, SIZES[name], 0.0, 2, law))
        by[law] = {c: log[c] - plain[c] for c in LOADS}
    first = by[LAWS[name][0]]
    channel = max(LOADS, key=lambda c: np.std(first[c]) / np.std(plain[c]))
    strength = {law: np.sqrt(np.mean(d[channel] ** 2)) for law, d in by.items()}
    for law in LAWS[name][1:]:
        assert 0.4 < strength[law] / strength[LAWS[name][0]] < 2.5, (name, law, strength)
        apart = np.sqrt(np.mean((by[law][channel] - first[channel]) ** 2))
        assert apart > (0.001 if name == "air_density" else 0.05) * strength[law], (name, law)


def test_a_sticking_slide_is_behind_by_its_width() -> None:
    load = np.concatenate([np.linspace(0, 10, 101), np.linspace(10, 0, 101)])
    read = friction(1.5, load)
    assert read[60] == pytest.approx(load[60] - 1.5) and read[150] == pytest.approx(load[150] + 1.5)
