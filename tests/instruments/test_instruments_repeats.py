"""Readings that repeat: coarse steps are no stuck sensor, a stuck or copied one is found among them too."""

from __future__ import annotations

import numpy as np
import pytest
from case_table import case_table

from coaxlink.data.resolution import is_coarse, resolution_of
from coaxlink.data.samples import Samples
from coaxlink.instruments.flight import columns
from coaxlink.instruments.flight.flown_log import FlownLog

MG, MRAD = 9.80665e-3, 1e-3
RATE = 50.0


def column_faults(log):
    return columns.column_faults(FlownLog.of(log))


def flight(
    seed: int = 0, seconds: float = 60.0, noise: float = 1.0, ground_s: float = 0.0, grows_s: float = 0.0
) -> Samples:
    """A vehicle that swings gently, or comes to it from a still hover, as a log of floats: the attitude
    moves, gyro and velocity with it."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds + ground_s, 1.0 / RATE)
    up = np.clip((t - ground_s) / 2.0, 0.0, 1.0)
    quiet = 0.05 + 0.95 * (np.sin(2 * np.pi * t / 23.0) > 0.0)  # stretches in which little happens
    quiet = np.convolve(quiet, np.ones(50) / 50, mode="same")
    if grows_s:
        quiet *= np.clip(t / grows_s, 0.0, 1.0) ** 3
    roll, pitch = (0.12 * up * quiet * np.sin(2 * np.pi * t / p) for p in (3.1, 4.3))
    yaw = 0.5 * up * quiet * np.sin(2 * np.pi * t / 6.0)
    columns = {"time_s": t, "roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw}
    dr, dp, dy = (np.gradient(a, t) for a in (roll, pitch, yaw))
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    rates = dr - dy * sp, dp * cr + dy * sr * cp, -dp * sr + dy * cr * cp
    lift = 9.80665 * (1.0 + 0.03 * up * quiet * np.sin(2 * np.pi * t / 2.3))
    cy, sy = np.cos(yaw), np.sin(yaw)
    pull = (-lift * (cr * sp * cy + sr * sy), -lift * (cr * sp * sy - sr * cy), -lift * cr * cp + 9.80665)
    for k, axis in enumerate("xyz"):
        columns[f"gyro_{axis}_rad_s"] = rates[k] + noise * 2e-4 * rng.standard_normal(len(t))
        true = -lift if axis == "z" else 0.0 * t
        columns[f"accel_{axis}_m_s2"] = true + noise * 3e-3 * rng.standard_normal(len(t))
        velocity = np.cumsum(pull[k]) / RATE
        columns[f"vel_{'ned'[k]}_m_s"] = velocity + noise * 0.01 * rng.standard_normal(len(t))
    for n in range(1, 9):
        columns[f"motor{n}"] = np.where(up > 0.0, 0.5, 0.1) + 0.01 * rng.standard_normal(len(t))
    return Samples(columns)


def rounded(log: Samples) -> Samples:
    """As ArduPilot sends it: mg and mrad/s, cut towards zero."""
    steps = {n: MG if n.startswith("accel") else MRAD for n in log.columns if n.startswith(("accel", "gyro"))}
    return log.with_columns(**{n: np.trunc(log[n] / s) * s for n, s in steps.items()})


def test_resolution_is_the_smallest_step() -> None:
    coarse = rounded(flight())
    assert resolution_of(coarse["gyro_x_rad_s"]) == pytest.approx(MRAD)
    assert resolution_of(coarse["accel_z_m_s2"]) == pytest.approx(MG)
    assert np.isnan(resolution_of(np.full(50, 0.3))) and np.isnan(resolution_of(np.full(5, np.nan)))
    assert is_coarse(coarse["gyro_z_rad_s"], MRAD)
    fine = flight()["gyro_z_rad_s"]
    assert not is_coarse(fine, resolution_of(fine))
    # thirty steps of noise: no two readings in a row are the same for long
    noisy = np.round(np.random.default_rng(0).standard_normal(5000) * 30.0)
    assert not is_coarse(noisy, 1.0)


def test_coarse_steps_are_neither_stuck_nor_copied() -> None:
    with case_table() as case:
        for noise in (0.02, 1.0, 3.0):
            with case(f"{noise}"):
                log = rounded(flight(noise=noise, ground_s=40.0))
                still = np.diff(log["gyro_z_rad_s"]) == 0.0
                assert still.mean() > 0.3  # it does repeat itself
                assert not column_faults(log)


def test_a_velocity_of_short_digits_may_repeat_while_the_vehicle_hardly_moves() -> None:
    step = 1e-4
    for seed in range(3):
        clean = flight(seed, noise=0.0, grows_s=20.0)
        speeds = {f"vel_{a}_m_s": step * np.round(clean[f"vel_{a}_m_s"] / step) for a in "ned"}
        assert np.ptp(speeds["vel_n_m_s"][10:60]) == 0.0  # a second and more of one reading
        assert not is_coarse(speeds["vel_n_m_s"], step)  # of a column that is fine as a whole
        assert column_faults(flight(seed, grows_s=20.0).with_columns(**speeds)) == []


def test_a_stuck_axis_is_found_whatever_its_resolution() -> None:
    with case_table() as case:
        for coarse in (False, True):
            for column in ("gyro_x_rad_s", "gyro_z_rad_s", "accel_z_m_s2"):
                with case(f"{column}, {coarse}"):
                    log = flight()
                    values = log[column].copy()
                    first = int(28 * RATE)  # in a stretch in which much happens
                    values[first : first + 250] = values[first]
                    log = log.with_columns(**{column: values})
                    found = column_faults(rounded(log) if coarse else log)
                    assert [name for name, _, _ in found] == [column]
                    rows = np.flatnonzero(found[0][1])
                    assert abs(rows[0] - first) <= 12 and abs(rows[-1] - first - 249) <= 12


def test_an_axis_that_never_worked_is_found() -> None:
    with case_table() as case:
        for coarse in (False, True):
            with case(f"{coarse}"):
                log = flight().with_columns(gyro_y_rad_s=np.zeros(3000))
                found = column_faults(rounded(log) if coarse else log)
                assert [name for name, _, _ in found] == ["gyro_y_rad_s"] and found[0][1].mean() > 0.9


def test_a_copied_stretch_is_found_whatever_its_resolution() -> None:
    with case_table() as case:
        for coarse in (False, True):
            with case(f"{coarse}"):
                log = flight(noise=2.0)
                log = rounded(log) if coarse else log
                names = [n for n in log.columns if n.startswith(("accel", "gyro"))]
                moved = {n: log[n].copy() for n in names}
                for values in moved.values():
                    values[2000:2200] = values[1300:1500]
                ((_, rows, why),) = column_faults(log.with_columns(**moved))
                assert "stand in the log before" in why
                at = np.flatnonzero(rows)
                assert at[0] == pytest.approx(2000, abs=3) and at[-1] == pytest.approx(2199, abs=3)


def test_the_resolution_of_the_log_outlives_resampling() -> None:
    from coaxlink.data.logs.streams import TimeSeries, merge

    coarse = rounded(flight())
    t = coarse["time_s"]
    motors = TimeSeries.of(t[:-3] + 0.007, {"motor1": coarse["motor1"][:-3], "motor2": coarse["motor2"][:-3]})
    merged = merge("x", motors, [TimeSeries.of(t, {"gyro_x_rad_s": coarse["gyro_x_rad_s"]})], ())
    assert merged.resolution["gyro_x_rad_s"] == pytest.approx(MRAD)
    assert resolution_of(merged["gyro_x_rad_s"]) < 0.5 * MRAD  # between two rows it is finer
    assert merged.take(np.arange(50)).resolution == merged.resolution
