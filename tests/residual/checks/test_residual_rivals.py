"""Claims against their rivals: what equals one makes a doubt of it, what beats one takes its place."""

from __future__ import annotations

import numpy as np
import pytest
from residual_rig import FULL_RPM, steady_loads
from scipy.signal import lsim

from coaxlink import files
from coaxlink.data import Samples
from coaxlink.residual.answer.assemble import separable
from coaxlink.residual.answer.stand import judge_stand
from coaxlink.residual.channels.stand import stand_frame
from coaxlink.residual.search.time_trend import _unknown_columns
from coaxlink.rotor import load_rotor_model

LOADS = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
NOISE = np.array([[0.4], [0.008], [0.4], [0.008]])
PAPER = load_rotor_model(files.example("rotor_paper.toml"))


def stand(speeds, loads, seed, *, rpm=True, **columns):
    """A log of speeds (rows, 2) and loads (4, rows) with white noise."""
    rng = np.random.default_rng(seed)
    loads = loads + NOISE * rng.standard_normal(loads.shape)
    if rpm:
        reading = FULL_RPM * speeds + 2.0 * rng.standard_normal(speeds.shape)
        columns |= {"upper_rpm": reading[:, 0], "lower_rpm": reading[:, 1]}
    return Samples(columns | dict(zip(LOADS, loads, strict=True)), "test")


def ask(samples, model=None):
    return judge_stand([samples], model, lambda _: None)


def names(answer):
    return {effect.name for effect in answer.effects}


def sessions(spacing, seed):
    """Six sessions over one grid, each in an air of its own; (6,) spacings."""
    levels = np.linspace(0.2, 0.95, 8)
    u = np.stack(np.meshgrid(levels, levels, indexing="ij"), axis=-1).reshape(-1, 2)
    pressure = np.array([96.0, 99.5, 94.0, 101.0, 97.5, 92.0]) * 1e3
    each, speeds = len(u), np.tile(u, (6, 1))
    pa, air = np.repeat(pressure, each), np.repeat(pressure / 101_325.0, each)
    loads = steady_loads(*speeds.T) * air
    return stand(
        speeds, loads, seed, time_s=3.0 * np.arange(len(pa)), air_pressure_Pa=pa,
        air_temperature_C=np.full(len(pa), 15.0), rotor_spacing_m=np.repeat(spacing, each),
    )  # fmt: skip


IN_STEP = 0.12 + 0.06 * (np.array([96.0, 99.5, 94.0, 101.0, 97.5, 92.0]) - 92.0) / 9.0


@pytest.mark.parametrize("seed", [1, 2])
def test_two_causes_in_step_are_a_doubt_and_no_name(seed):
    answer = ask(sessions(IN_STEP, seed))
    assert not answer.effects
    (doubt,) = answer.ambiguous
    assert {"air_density", "rotor_spacing"} <= set(doubt.names)
    chance = dict(zip(doubt.names, doubt.probability, strict=True))
    assert all(0.001 < chance[name] < 0.98 for name in ("air_density", "rotor_spacing"))
    assert sum(doubt.probability) == pytest.approx(0.98, abs=1e-3)  # it may be what has no name yet
    assert "rotor_spacing_m stands still" in doubt.separate_by
    assert not answer.unexplained  # what either would explain is no open end


@pytest.mark.parametrize("seed", [1, 2])
def test_a_cause_that_goes_its_own_way_is_named(seed):
    answer = ask(sessions(IN_STEP[[3, 0, 5, 1, 4, 2]], seed))
    assert names(answer) == {"air_density"} and not answer.ambiguous


def walk(rows, seed):
    """(rows, 2) speeds that wander slowly through 0.2 to 1."""
    rng = np.random.default_rng(seed)
    steps = 0.12 * rng.standard_normal((rows, 2))
    return 0.2 + 0.8 * np.abs((np.cumsum(steps, axis=0) + rng.uniform(0, 2, 2)) % 2.0 - 1.0)


@pytest.mark.parametrize("seed", [3, 4])
def test_an_effect_is_judged_in_its_best_shape(seed):
    """Wave drag near full speed and less lift: of no one shape of the grid, most of it within the tilt."""
    speeds = walk(700, seed)
    loads = steady_loads(*speeds.T)
    for side in (0, 1):
        steep = speeds[:, side] ** 5
        loads[2 * side] *= 1.0 - 0.02 * steep
        loads[2 * side + 1] *= 1.0 + 0.03 * steep
    answer = ask(stand(speeds, loads, seed, time_s=0.5 * np.arange(700.0)), PAPER)
    assert names(answer) == {"blade_speed_law"}


def test_a_speed_loop_that_rings_has_no_hysteresis_beside_its_lag():
    """Throttles in sines, speeds behind them with a damping of a half: one effect, in a further form."""
    t = np.arange(2000.0) / 20.0
    throttle = 0.6 + 0.13 * np.stack(
        [np.sin(2.1 * t) + np.sin(5.3 * t + 1.0), np.sin(2.9 * t + 2.0) + np.sin(7.1 * t)], axis=1
    )
    loop = ([36.0], [1.0, 6.0, 36.0])
    speeds = np.stack([lsim(loop, x - x[0], t)[1] + x[0] for x in throttle.T], axis=1)
    speeds = np.clip(speeds, 0.1, 1.0)
    given = {"upper_throttle": throttle[:, 0], "lower_throttle": throttle[:, 1]}
    answer = ask(stand(speeds, steady_loads(*speeds.T), 5, rpm=False, time_s=t, **given))
    assert names(answer) == {"rotor_lag"}


def test_two_large_effects_that_hide_one_another_are_both_named():
    """A distance that a servo moves up and down and a zero that creeps: either alone leaves the other."""
    t = 0.3 * np.arange(1200.0)
    speeds = 0.25 + 0.7 * np.abs(np.stack([t / 11.0, t / 17.0 + 0.4], axis=1) % 2.0 - 1.0)
    loads = steady_loads(*speeds.T)
    spacing = 0.15 + 0.05 * np.sin(2.0 * np.pi * t / 150.0)
    alone = steady_loads(0.0 * speeds[:, 0], speeds[:, 1])
    loads[2:] += 0.35 * (alone[2:] - loads[2:]) * (spacing / 0.15 - 1.0)
    loads[2] += 5.0 * np.sqrt(t / t[-1])
    answer = ask(stand(speeds, loads, 6, time_s=t, rotor_spacing_m=spacing))
    assert names(answer) == {"rotor_spacing", "sensor_drift"}


@pytest.mark.parametrize(("seed", "power"), [(5, 0.12), (6, -0.1)])
def test_a_spacing_that_takes_a_share_of_the_whole_lower_loads_is_no_drifting_room(seed, power):
    t = 1.0 * np.arange(800)
    speeds = walk(800, seed)
    apart = 0.3 * (1.0 + 0.55 * np.sin(2.0 * np.pi * t / 310.0 + 4.0))
    loads = steady_loads(*speeds.T)
    loads[2] *= (apart / 0.3) ** power
    loads[3] *= (apart / 0.3) ** (0.5 * power)
    answer = ask(stand(speeds, loads, seed, time_s=t, rotor_spacing_m=apart), PAPER)
    assert names(answer) == {"rotor_spacing"} and not answer.ambiguous
    found = {p.name: p.value for p in answer.effects[0].parameters}
    assert found["loads_share"] == pytest.approx(power, rel=0.2)
    assert found["torque_loads_share"] == pytest.approx(0.5 * power, rel=0.2)


def test_sessions_of_several_spacings_that_change_each_load_its_own_way_are_no_drift():
    apart = np.repeat([0.10, 0.28, 0.17, 0.23], 195)
    t = 0.5 * np.arange(len(apart)) + np.repeat([0.0, 600.0, 1200.0, 1800.0], 195)
    speeds = walk(len(apart), 8)
    loads = steady_loads(*speeds.T)
    for load, share in zip(loads, (0.03, 0.02, 0.06, -0.03), strict=True):
        load *= 1.0 + share * (apart / 0.16 - 1.0)
    answer = ask(stand(speeds, loads, 8, time_s=t, rotor_spacing_m=apart), PAPER)
    assert names(answer) == {"rotor_spacing"} and not answer.ambiguous


def test_the_square_of_a_column_that_nothing_knows_stands_beside_every_effect():
    speeds = walk(300, 4)
    loads = steady_loads(*speeds.T)
    hum = np.cos(np.linspace(0.0, 7.0, 300))
    frame = stand_frame(stand(speeds, loads, 4, hum=hum), PAPER)
    (columns,) = _unknown_columns(frame)
    wanted = frame.predicted[:, 2] * (0.3 * hum**2 - 0.1 * hum)
    fit = np.column_stack([columns[:, 2], frame.predicted[:, 2]])  # a level is the nuisance model's
    left = wanted - fit @ np.linalg.lstsq(fit, wanted, rcond=None)[0]
    assert np.std(left) < 1e-9 * np.std(wanted)


def test_rivals_of_a_doubt_beside_another_effect_stand_in_the_problem_that_is_asked(monkeypatch):
    seen = []

    def recorded(problem, selection, doubt, variables):
        seen.extend(any(t.option is o for o in problem.options) for t in selection.last.values())
        return separable(problem, selection, doubt, variables)

    monkeypatch.setattr("coaxlink.residual.answer.doubts.separable", recorded)
    log = sessions(IN_STEP, 1)
    answer = ask(log.with_columns(upper_torque_Nm=log["upper_torque_Nm"] - 1e-4 * log["time_s"]))
    assert names(answer) == {"sensor_drift"} and answer.ambiguous
    assert seen and all(seen)


def swept(levels, rows):
    """(n, 2) speeds: both up and down, then the lower one up and down at each held level of the upper one."""
    up = np.linspace(0.0, 0.95, rows)
    there = np.concatenate([up, up[::-1]])
    held = [np.stack([np.full(2 * rows, level), there], axis=1) for level in levels]
    return np.concatenate([np.stack([there, there], axis=1), *held])


def through_sticking_slides(loads, play):
    """Loads (4, rows) with thrusts that are read once they are a play behind."""
    read = loads.copy()
    for k in (0, 2):
        at = loads[k, 0]
        for n, load in enumerate(loads[k]):
            at = min(max(at, load - play), load + play)
            read[k, n] = at
    return read


# with the larger loss the slides' own loads are a form of hysteresis that shows only beside it
@pytest.mark.parametrize(("play", "loss"), [(1.8, 4.0), (2.2, 4.0), (1.4, 6.0)])
def test_an_interference_that_sticking_slides_hide_from_a_held_rotor_is_no_drift(play, loss):
    speeds = swept([0.3, 0.5, 0.7, 0.9, 0.0], 75)
    loads = steady_loads(*speeds.T)
    loads[0] -= loss * speeds[:, 1] ** 1.4 * speeds[:, 0] ** 0.6
    read = through_sticking_slides(loads, play)
    answer = ask(stand(speeds, read, 4, time_s=0.1 * np.arange(len(speeds))), PAPER)
    assert names(answer) == {"hysteresis", "lower_on_upper_interference"}
    thrust = answer.channels["upper_thrust"]
    assert thrust.rmse_after < 1.1 * thrust.noise_floor
