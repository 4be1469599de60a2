"""A tachometer that lies for a while, against rotors that really turn at another speed for a while."""

from __future__ import annotations

import numpy as np
import pytest
from residual_rig import FULL_RPM, steady_loads

from coaxlink import files
from coaxlink.channels.stand import stand_frame
from coaxlink.data import Samples
from coaxlink.instruments.stand.suspects import find_suspects
from coaxlink.residual import refine_stand
from coaxlink.rotor import load_rotor_model

RPM, RATE = 6200.0, 10.0


def bench(
    seed: int, *, from_s: float, to_s: float, turns: float = 1.0, reads: float = 1.0, side: str = "lower"
) -> Samples:
    """Random holds; for a while a rotor turns `turns` times as fast, its tachometer shows `reads` of it."""
    random = np.random.default_rng(seed)
    throttle = np.repeat(random.uniform(0.2, 0.95, (80, 2)), 15, axis=0)
    time = np.arange(len(throttle)) / RATE
    stretch = (time >= from_s) & (time < to_s)
    k = ("upper", "lower").index(side)
    speed = throttle * (1.08 - 0.1 * throttle)  # a motor under load
    speed[stretch, k] *= turns
    shown = speed.copy()
    shown[stretch, k] *= reads
    u, v = speed.T
    loads = {
        "upper_thrust_N": 61.0 * u**2 + 14.0 * u,
        "upper_torque_Nm": 1.4 * u**2 + 0.5 * u,
        "lower_thrust_N": 66.0 * v**2 + 11.0 * v - 30.0 * u**2 + 2.0 * u**2 * v**2,
        "lower_torque_Nm": 1.5 * v**2 + 0.5 * v - 0.6 * u**2,
    }
    columns = {"time_s": time, "upper_throttle": throttle[:, 0], "lower_throttle": throttle[:, 1]}
    columns["upper_rpm"] = RPM * shown[:, 0] + 4.0 * random.standard_normal(len(u))
    columns["lower_rpm"] = RPM * shown[:, 1] + 4.0 * random.standard_normal(len(u))
    for name, clean in loads.items():
        columns[name] = clean + 0.005 * clean.max() * random.standard_normal(len(u))
    return Samples(columns, "bench")


@pytest.mark.slow
def test_steps_between_two_speeds_flag_nobody() -> None:
    """One rotor, two throttles, a lag between them: what slow rows fit says nothing of the fast ones."""
    random = np.random.default_rng(5)
    throttle = np.tile(np.repeat([0.25, 0.8], 30), 12)
    speed = np.zeros(len(throttle))
    for k in range(len(throttle)):
        target = throttle[k] * (1.1 - 0.25 * throttle[k]) + (0.06 if throttle[k] > 0.5 else 0.0)
        speed[k] = target if k == 0 else speed[k - 1] + 0.45 * (target - speed[k - 1])
    columns = {
        "time_s": 0.1 * np.arange(len(throttle)),
        "upper_throttle": throttle,
        "upper_rpm": RPM * speed + 4.0 * random.standard_normal(len(speed)),
        "upper_thrust_N": 60.0 * speed**2.0 + 0.2 * random.standard_normal(len(speed)),
        "upper_torque_Nm": 1.4 * speed**2.0 + 0.005 * random.standard_normal(len(speed)),
    }
    answer = refine_stand(Samples(columns, "steps"))
    assert not answer.suspect_data and "rotor_lag" in [e.name for e in answer.effects]


@pytest.mark.slow
def test_a_rotor_that_really_drops_out_here_and_there_does_not_make_its_tachometer_lie() -> None:
    log = bench(6, from_s=0.0, to_s=0.0)
    rows = (np.arange(log.rows) // 5) % 20 == 7
    u = np.where(rows, 0.5, 1.0) * log["upper_rpm"] / RPM
    v = log["lower_rpm"] / RPM
    wake = (66.0 * v**2 + 11.0 * v - 30.0 * u**2 + 2.0 * (u * v) ** 2, 1.5 * v**2 + 0.5 * v - 0.6 * u**2)
    dropped = log.with_columns(
        upper_rpm=RPM * u,
        upper_thrust_N=61.0 * u**2 + 14.0 * u,
        upper_torque_Nm=1.4 * u**2 + 0.5 * u,
        lower_thrust_N=wake[0],
        lower_torque_Nm=wake[1],
    )
    assert not [s for s in refine_stand(dropped).suspect_data if s.column == "upper_rpm"]


@pytest.mark.slow
def test_a_reading_that_stands_while_the_wake_moves_its_load_too_is_flagged() -> None:
    log = bench(7, from_s=0.0, to_s=0.0)
    read = log["lower_rpm"].copy()
    read[400:640] = read[400]
    answer = refine_stand(log.with_columns(lower_rpm=read))
    assert [(s.column, s.rows) for s in answer.suspect_data] == [("lower_rpm", "401-640")]


def test_a_rotor_that_is_held_while_the_other_moves_may_read_one_number() -> None:
    log = bench(8, from_s=0.0, to_s=0.0)
    u, v = log["upper_rpm"] / RPM, log["lower_rpm"] / RPM
    v[400:640] = 0.6
    held = log.with_columns(
        lower_rpm=RPM * v,
        lower_thrust_N=66.0 * v**2 + 11.0 * v - 30.0 * u**2 + 2.0 * (u * v) ** 2,
        lower_torque_Nm=1.5 * v**2 + 0.5 * v - 0.6 * u**2,
    ).without("upper_throttle", "lower_throttle")
    assert find_suspects(stand_frame(held, None)).suspects == ()


def walked(seed: int) -> Samples:
    """A walk of both speeds, the lower one's pulses counted twice in a band: loads four times too small."""
    random = np.random.default_rng(seed)
    speeds = np.full((900, 2), 0.6)
    for side in (0, 1):
        for k in range(1, 900):
            speeds[k, side] = np.clip(speeds[k - 1, side] + 0.03 * random.standard_normal(), 0.15, 1.0)
    loads = steady_loads(*speeds.T)
    loads += np.array([[0.05], [0.001], [0.05], [0.001]]) * random.standard_normal(loads.shape)
    read = FULL_RPM * speeds + 2.0 * random.standard_normal(speeds.shape)
    read[(speeds[:, 1] > 0.42) & (speeds[:, 1] < 0.58), 1] *= 2.0
    columns = {"time_s": np.arange(900.0), "upper_rpm": read[:, 0], "lower_rpm": read[:, 1]}
    names = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
    return Samples({**columns, **dict(zip(names, loads, strict=True))}, "walk")


def test_no_cell_is_flagged_where_the_rotors_other_load_is_off_as_well() -> None:
    """Both loads are those of half the speed: it is the tachometer."""
    frame = stand_frame(walked(9), load_rotor_model(files.example("rotor_paper.toml")))
    (suspect,) = find_suspects(frame).suspects
    assert suspect.column == "lower_rpm" and "+100.0 %" in suspect.why
