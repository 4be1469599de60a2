"""Bench data made here, from eq. 17 written out: nothing of the code under test has a part in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.data import Samples

LEVELS = np.arange(11) * 0.09
TRUTH = {
    "upper.thrust_N": {"u_u^2": 55.9517, "u_u": 22.4464},
    "upper.torque_Nm": {"u_u^2": 1.2437, "u_u": 0.7155},
    "lower.thrust_N": {
        "u_u^2 u_l^2": 2.755,
        "u_l^2": 64.721,
        "u_u u_l": -2.547,
        "u_l": 12.402,
        "u_u^2": -37.502,
        "1": 0.801,
    },
    "lower.torque_Nm": {"u_u u_l^2": 0.307, "u_l^2": 1.466, "u_l": 0.573, "u_u^2": -0.695},
}
COLUMNS = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")


def grid() -> tuple[np.ndarray, np.ndarray]:
    """(121,) upper and lower speeds, the lower one swept at each upper level."""
    u, v = np.meshgrid(LEVELS, LEVELS, indexing="ij")
    return u.ravel(), v.ravel()


def eq17(u: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
    return [
        55.9517 * u**2 + 22.4464 * u,
        1.2437 * u**2 + 0.7155 * u,
        2.755 * u**2 * v**2 + 64.721 * v**2 - 2.547 * u * v + 12.402 * v - 37.502 * u**2 + 0.801,
        0.307 * u * v**2 + 1.466 * v**2 + 0.573 * v - 0.695 * u**2,
    ]


def pair_log(
    u: np.ndarray,
    v: np.ndarray,
    loads: Sequence[np.ndarray],
    noise: Sequence[float],
    random: np.random.Generator,
    rpm: float,
) -> Samples:
    """A stand log of the loads in the order of `COLUMNS`, with white noise of each."""
    values = [y + s * random.standard_normal(len(u)) for y, s in zip(loads, noise, strict=True)]
    return Samples(
        {"upper_rpm": rpm * u, "lower_rpm": rpm * v, **dict(zip(COLUMNS, values, strict=True))}, "x.csv"
    )


def stand(seed: int, loads=eq17, noise=(0.5, 0.01), rpm: float = 5400.0) -> Samples:
    """A stand log of the grid with white noise and throttles."""
    u, v = grid()
    log = pair_log(u, v, loads(u, v), noise * 2, np.random.default_rng(seed), rpm)
    return log.with_columns(upper_throttle=u, lower_throttle=v)
