"""A thrust stand for testing `refine` on stand logs: its own rotors, its own laws of what goes wrong."""

from __future__ import annotations

import numpy as np

FULL_RPM = 5400.0


def steady_loads(a, b):
    """(4, rows): upper thrust and torque, lower thrust and torque at speeds a (upper), b (lower), eq. 17."""
    wake = 2.755 * (a * b) ** 2 - 2.547 * a * b - 37.502 * a**2
    lower = 64.721 * b**2 + 12.402 * b + 0.801 + wake
    drag = 0.307 * a * b**2 + 1.466 * b**2 + 0.573 * b - 0.695 * a**2
    return np.stack([a * (55.9517 * a + 22.4464), a * (1.2437 * a + 0.7155), lower, drag])


def run(seed=0, *, rpm=True, throttle=True, noise=1.0, **true):
    """Columns of two passes over a grid, up and down again, 2 s a point; `true` says what goes wrong."""
    rng = np.random.default_rng(seed)
    levels = np.linspace(0.1, 0.9, 9)
    sweep = np.concatenate([levels, levels[::-1]])
    a, b = np.repeat(levels, len(sweep)), np.tile(sweep, len(levels))
    a, b = np.concatenate([a, a[::-1]]), np.concatenate([b, b])
    rows = len(a)
    t = 2.0 * np.arange(rows)
    life = t / t[-1]
    volts = 25.0 - 2.5 * life**1.3 - 0.35 * (a + b)
    celsius = 15.0 + 9.0 * np.sin(5.0 * life)
    heat = 25.0 + 45.0 * (1 - np.exp(-t / 150.0)) + 10 * np.sin(11 * life)
    spacing = np.where(life < 0.5, 0.12, 0.18)
    ua, ub = a.copy(), b.copy()
    for u in (ua, ub):
        if "battery" in true:
            u *= 1 + true["battery"] * (volts / 25.0 - 1) * (1 + 0.2 * (volts / 25.0 - 1))
        if "heat" in true:
            u *= 1 / (1 + true["heat"] * (heat - 25.0) / 100.0)
    loads = steady_loads(ua, ub)
    if "interference" in true:
        loads[0] -= true["interference"] * ub**2.2 * np.sqrt(ua)
        loads[1] -= 0.02 * true["interference"] * ub**2.2
    if "air" in true:
        loads *= 288.15 / (celsius + 273.15)
    if "spacing" in true:
        alone = steady_loads(0 * ua, ub)
        loads[2:] += true["spacing"] * (alone[2:] - loads[2:]) * (spacing / 0.15 - 1)
    if "power" in true:
        loads[:2] *= ua ** true["power"]
        loads[2:] *= ub ** true["power"]
    if "drift" in true:
        loads[2] += true["drift"] * t / 60.0
    if "bump" in true:
        loads[0] += true["bump"] * np.exp(-(((ua - 0.5) / 0.1) ** 2 + ((ub - 0.6) / 0.12) ** 2))
    loads += noise * np.array([[0.4], [0.008], [0.4], [0.008]]) * rng.standard_normal(loads.shape)
    if "stuck" in true:
        loads[1, 100:130] = loads[1, 100]
    if "repeated" in true:
        loads[:, 200:230] = loads[:, 120:150]
    columns = {"time_s": t}
    shown = [(a, ua), (b, ub)]
    if "swapped" in true:
        shown.reverse()
    for name, (command, speed) in zip(("upper", "lower"), shown, strict=True):
        if rpm:
            reading = speed * (1 + true.get("tachometer", 0.0) * (speed > 0.55) * (name == "lower"))
            columns[f"{name}_rpm"] = FULL_RPM * reading + 2.0 * rng.standard_normal(rows)
        if throttle:
            columns[f"{name}_throttle"] = command
    names = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
    columns |= dict(zip(names, loads, strict=True))
    columns["voltage_V"] = volts + 0.01 * rng.standard_normal(rows)
    columns["air_temperature_C"] = celsius
    columns["motor_temperature_C"] = heat + 0.2 * rng.standard_normal(rows)
    columns["rotor_spacing_m"] = spacing
    columns["operator_mood"] = rng.standard_normal(rows).cumsum()
    return columns


def followed(seed, rate_hz, lag_s, *, down=1.0, hold_s=1.0, ramp=False, rows=1000):
    """Columns of throttles that jump from one set-point to the next, or go straight to it, and of the loads
    of rotors that follow them late; `down`: by so many times as long when they slow down.
    """
    rng = np.random.default_rng(seed)
    step, hold = 1.0 / rate_hz, round(hold_s * rate_hz)
    levels = rng.uniform(0.2, 0.95, (rows // hold + 2, 2))
    at = np.arange(rows) / hold
    if ramp:
        command = np.stack([np.interp(at, np.arange(len(levels)), levels[:, c]) for c in (0, 1)], axis=1)
    else:
        command = levels[at.astype(int)]
    parts = 20 if ramp else 1  # between two rows
    speed, now = np.empty_like(command), command[0]
    for k in range(rows):
        before = command[max(k - 1, 0)]
        for j in range(parts):
            aim = before + (command[k] - before) * (j + 0.5) / parts if ramp else command[k]
            now = aim + (now - aim) * np.exp(-step / parts / np.where(aim < now, down * lag_s, lag_s))
        speed[k] = now
    loads = steady_loads(*speed.T)
    loads += 0.6 * np.array([[0.4], [0.008], [0.4], [0.008]]) * rng.standard_normal(loads.shape)
    names = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
    throttles = {"upper_throttle": command[:, 0], "lower_throttle": command[:, 1]}
    return {"time_s": step * np.arange(rows), **throttles, **dict(zip(names, loads, strict=True))}
