"""The sequential test in the air, told what the simulated world's telemetry tells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table

from coaxlink.files import example
from coaxlink.health.sequential import CALL, SequentialTest, fault_shapes, log_normal
from coaxlink.health.stream import HealthInterval, Stream
from coaxlink.mixer.plain import PlainRotors
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import load_vehicle
from sim.effects import HiddenEffect
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.vehicle import read_vehicle

ROTORS = Path(example("rotor_paper.toml"))
ONSET_S = 22.3
WINDY = (
    HiddenEffect("wind", 6.0, 0.0, {"direction_deg": 40.0}, "dryden"), HiddenEffect("rotor_drag", 0.1),
    HiddenEffect("axial_inflow", 0.7), HiddenEffect("battery_voltage", 0.6),
    HiddenEffect("cg_offset", 0.008, 0.0, {"direction_deg": 100.0}),
)  # fmt: skip


@pytest.fixture(scope="module", params=["x8_demo.toml", "y6.toml"])
def flown(request):
    """(vehicle, a way to fly it)."""
    vehicle = load_vehicle(example(request.param), ROTORS)
    made = make_design(
        read_vehicle(example(request.param)), read_pair(ROTORS), report_px4(vehicle, "fitted").params
    )

    def fly(*effects, plan="wander", seed=1, seconds=25.0):
        return fly_quick(made, FlightWorld((*WINDY, *effects), seed, plan, seconds), 8)[1]

    return vehicle, fly


def determined(vehicle, log, test=None):
    """Verdicts over a log at 50 Hz."""
    stream, test = Stream(vehicle), test or SequentialTest(vehicle)
    commands = np.stack([log[f"motor{i + 1}"] for i in range(stream.count)], axis=1)
    rates = np.stack([log[f"gyro_{a}_rad_s"] for a in "xyz"], axis=1)
    found = []
    for t, u, w, a in zip(log["time_s"].tolist(), commands, rates, log["accel_z_m_s2"].tolist(), strict=True):
        stream.command(t, u)
        found += [test.step(block) for block in stream.reading(t, w, a)]
    return found


@pytest.mark.slow
def test_a_rotor_that_loses_a_tenth_is_named_within_two_seconds(flown):
    with case_table() as case:
        for rotor, law in ((2, "share"), (5, "tip"), (6, "weak_motor")):
            with case(f"{rotor}, {law}"):
                vehicle, fly = flown
                fault = HiddenEffect("degraded_rotor", 0.1, ONSET_S, {"rotor": float(rotor)}, law)
                verdicts = determined(vehicle, fly(fault))
                called = next(v for v in verdicts if v.called)
                assert called.called.rotor == rotor and called.called.probability >= CALL
                assert 0.0 < called.time_s - ONSET_S < 2.0
                later = [v for v in verdicts if called.time_s + 0.8 < v.time_s < called.time_s + 1.2]
                sizes = [x.loss for v in later for x in v.suspicions if x.rotor == rotor]
                assert sizes and 0.05 < np.median(sizes) < 0.15  # the first blocks hold a part of it
                assert all(v.word in ("not known yet", "sound") for v in verdicts if v.time_s < ONSET_S)


@pytest.mark.slow
def test_sound_flights_in_wind_and_sag_call_nobody(flown):
    with case_table() as case:
        for plan in ("hover", "circle", "wander", "steps"):
            with case(f"{plan}"):
                vehicle, fly = flown
                assert not [v for v in determined(vehicle, fly(plan=plan)) if v.called]


def test_a_sudden_push_that_is_no_rotors_is_none(flown):
    vehicle, _ = flown
    stream = list(made_blocks(vehicle, 200, np.random.default_rng(3)))
    pushed = [
        replace(b, measured=b.measured + (np.array([8.0, 0.5, 0.0, 0.6]) if k > 120 else 0.0))
        for k, b in enumerate(stream)
    ]
    test = SequentialTest(vehicle)
    verdicts = [test.step(b) for b in pushed]
    assert not [v for v in verdicts if v.called]
    assert max(v.disturbed for v in verdicts) > 0.5


def test_the_size_holds_the_truth_wherever_in_a_block_the_loss_sets_in(flown):
    vehicle, _ = flown
    rotors, loss, rotor = PlainRotors.of(vehicle), 0.1, 2
    for part in (1.0, 0.7, 0.4, 0.1):
        test, found = SequentialTest(vehicle), []
        for k, b in enumerate(made_blocks(vehicle, 140, np.random.default_rng(3))):
            share = 0.0 if k < 120 else part if k == 120 else 1.0
            lost = share * loss * fault_shapes(vehicle, rotors, b.speeds)[1, rotor - 1]
            found = test.step(replace(b, measured=b.measured + lost)).suspicions
        assert found[0].rotor == rotor
        assert found[0].loss == pytest.approx(loss, abs=0.06 * loss), part
        assert abs(found[0].loss - loss) < 1.96 * found[0].loss_sd < 0.3 * loss


def made_blocks(vehicle, count, rng):
    """Blocks of a hover whose residual is nothing but white noise."""
    frame, rotors = vehicle.airframe, PlainRotors.of(vehicle)
    speed = 0.6
    for _ in range(30):
        lift = rotors.wrench([speed] * len(frame.rotors))[0]
        speed *= np.sqrt(frame.mass_kg * 9.81 / lift)
    u = np.full(len(frame.rotors), speed)
    wrench = rotors.wrench(u)
    noise = np.array([0.5, 0.02, 0.02, 0.02])
    for k in range(count):
        yield HealthInterval(
            0.1 * (k + 1),
            0.1,
            wrench + noise * rng.standard_normal(4),
            wrench,
            np.zeros(4),
            np.zeros(4),
            u,
            k == 0,
        )


def test_noise_alone_hardly_ever_brings_a_probability(flown):
    # the sum of likelihood ratios less the blocks is a martingale: its mean over a flight is at most
    # WINDOW, and by Markov's inequality the chance of more than WATCH at this limit is below 1e-3 a block
    vehicle, _ = flown
    rng = np.random.default_rng(7)
    test = SequentialTest(vehicle)
    verdicts = [test.step(b) for b in made_blocks(vehicle, 1500, rng)]
    assert max((v.suspicions[0].probability for v in verdicts if v.suspicions), default=0.0) < 0.05


def test_shapes_are_what_the_rotors_would_lose(flown):
    vehicle, _ = flown
    frame, count = vehicle.airframe, len(vehicle.airframe.rotors)
    u = np.linspace(0.45, 0.65, count)
    shapes = fault_shapes(vehicle, PlainRotors.of(vehicle), u)
    thrust, torque = frame.loads(vehicle.model, u)
    for i in range(count):
        less = np.where(np.arange(count) == i, 0.0, 1.0)
        blade = frame.wrench(thrust * less, torque - 0.6 * torque * (1 - less)) - frame.wrench(thrust, torque)
        np.testing.assert_allclose(shapes[1, i], blade, atol=1e-9)
        slow = u.copy()
        slow[i] *= 1 - 1e-6
        there = frame.loads(vehicle.model, slow)
        slope = (frame.wrench(*there) - frame.wrench(thrust, torque)) / (1 - there[0][i] / thrust[i])
        np.testing.assert_allclose(shapes[-1, i], slope, rtol=1e-3, atol=1e-3)


def test_what_is_stale_or_no_number_makes_no_block(flown):
    vehicle, _ = flown
    stream, n = Stream(vehicle), len(vehicle.airframe.rotors)
    done = []
    for k in range(100):
        t = 0.02 * k
        if not 0.8 < t < 1.2:  # commands stop for a while
            stream.command(t, [0.5] * n)
        stream.command(t, [np.nan] * n)
        stream.reading(t, (np.nan, 0.0, 0.0), -9.8)
        done += stream.reading(t, (0.0, 0.0, 0.0), -9.8)
    assert done and all(np.isfinite(b.predicted).all() for b in done)
    assert not [b for b in done if 0.95 < b.time_s < 1.25]
    assert next(b.after_gap for b in done if b.time_s > 1.25)
    # and a vehicle that starts again is a new one
    stream.command(0.0, [0.5] * n)
    assert stream.reading(0.0, (0.0, 0.0, 0.0), -9.8) == []


def test_without_an_accelerometer_and_at_ten_hertz_it_still_names(flown):
    vehicle, fly = flown
    log = fly(HiddenEffect("degraded_rotor", 0.15, ONSET_S, {"rotor": 2.0}), seconds=27.0)
    slow = {k: v[::5] for k, v in log.items()} | {"accel_z_m_s2": np.full(len(log["time_s"][::5]), np.nan)}
    called = next(v for v in determined(vehicle, slow) if v.called)
    assert called.called.rotor == 2 and called.time_s > ONSET_S


def test_a_companion_without_scipy_weighs_as_with_it():
    from scipy.special import log_ndtr

    x = np.linspace(-60.0, 9.0, 701)
    np.testing.assert_allclose(log_normal(x), log_ndtr(x), atol=1e-6)
