"""What is left after the effects: does it still depend on anything that was recorded?

Each channel's residual is held against each variable through a smooth of eight hats; a dependence counts
when it is found again on held-out blocks, stands far outside coloured noise over all looks, and is large
enough to matter. What is found between neighbouring rows is no neighbours' noise (`coloured_noise.py`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from coaxlink.residual.regression.autocorrelation import autocorrelation_time
from coaxlink.residual.regression.coloured_noise import Colours

Array = NDArray[np.float64]
COMBINED = (16, 32)
TURNING = 0.05  # of full speed: a rotor at rest makes no beat
HATS = 8
FINE_S = 1.2  # between the knots of a flight's fine smooth of time
FINE_MOST = 20_000_000  # rows times knots: a longer flight is not looked at that finely
FINE_ROWS, FINE_HATS = 4, 200  # rows a hat of a fine smooth, at least; hats, at most
MOTOR = "motor"  # variables of one motor each
ANGLES, HARMONICS = ("yaw_rad",), 3  # what begins anew after a turn
ALPHA = 1e-4
SURROGATES = 100  # copies of a residual: seconds
SHARE = 0.12  # of the residual's variance, held out
SIZE = 0.006  # of the reference load, 95th percentile


@dataclass(frozen=True)
class Dependence:
    """A residual channel that follows a variable."""

    channel: int
    variable: str
    share: float  # of the held-out variance
    size: float  # 95th percentile of the smooth over the reference load
    rms: float  # of the smooth, in the channel's unit
    where: str


def hats(values: Array, knots: Array) -> Array:
    """(rows, K) piecewise linear basis on increasing knots (K,)."""
    at = np.clip(np.searchsorted(knots, values) - 1, 0, len(knots) - 2)
    share = np.clip((values - knots[at]) / (knots[at + 1] - knots[at]), 0.0, 1.0)
    out = np.zeros((len(values), len(knots)))
    rows = np.arange(len(values))
    out[rows, at], out[rows, at + 1] = 1.0 - share, share
    return out


def knots_of(values: Array, count: int = HATS) -> Array | None:
    """Knots at quantiles, or None where the variable does not vary."""
    knots = np.unique(np.quantile(values, np.linspace(0.0, 1.0, count)))
    if len(knots) < 3 or knots[-1] - knots[0] < 1e-9 * max(1.0, abs(float(knots[-1]))):
        return None
    return knots


def grid_hats(first: Array, second: Array, count: int = 7) -> Array | None:
    """(rows, K) tensor basis over two variables, cells without data left out; None if either stands still."""
    knots = [np.linspace(v.min(), v.max(), count) for v in (first, second)]
    if any(k[-1] - k[0] < 1e-6 for k in knots):
        return None
    a, b = (hats(v, k) for v, k in zip((first, second), knots, strict=True))
    whole = (a[:, :, None] * b[:, None, :]).reshape(len(first), -1)
    return whole[:, whole.sum(axis=0) > 1.0]


def dependences(
    residual: Array,
    variables: Mapping[str, Array],
    block: NDArray[np.intp],
    fold: NDArray[np.intp],
    reference: Array,
    floor: Array,
) -> list[Dependence]:
    """Significant dependences of residual (rows, C) on variables (rows,), strongest of each channel first.

    `fold` (rows,) says in which fold a row is held out; `floor` (C,) is the noise floor in the channels'
    unit.
    """
    out: list[Dependence] = []
    looks = max(1, len(variables) * residual.shape[1])
    half = np.arange(len(fold)) * 2 // len(fold)
    flown = "upper_speed" not in variables
    colours = Colours(residual, floor, reference, flown)
    nonlinear = _less_straight(residual, [v for name, v in variables.items() if name.startswith(MOTOR)])
    for name, values, basis, folding in _nuisances(variables, fold):
        left = nonlinear if name.startswith(MOTOR) else residual
        for c, share, statistic, smooth in _smooths(left, basis, folding, block if folding is fold else None):
            width = basis.shape[1]
            if name != "time_s" and not (flown and folding is fold):
                # rows at one level share their noise, but it is not there again in the log's other half
                again = float(_shares(left[:, [c]], basis, half)[0][0]) > SHARE
                if not again and share < _by_chance(left[:, c], basis, folding):
                    continue
            size = float(np.quantile(np.abs(smooth), 0.95) / reference[c])
            p_value = min(1.0, looks * float(chi2.sf(statistic, width)))
            rms = float(np.sqrt(np.mean(smooth**2)))
            if name == "time_s" and not (flown and folding is fold) and colours.hold(c, smooth, width):
                continue  # a gust forgets; a cell may drift through the whole log
            if share > SHARE and p_value < ALPHA and size > SIZE and rms > 0.5 * floor[c]:
                out.append(Dependence(c, name, share, size, rms, _where(values, smooth)))
    return sorted(out, key=lambda d: (d.channel, -d.share))


def _less_straight(residual: Array, speeds: list[Array]) -> Array:
    """(rows, C) without what goes straight with motors' speeds: a gust does, for the motors answer it."""
    if not speeds:
        return residual
    columns = np.stack([np.ones(len(residual)), *speeds], axis=1)
    return np.asarray(residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0])


def time_path(residual: Array) -> tuple[Array, int]:
    """A residual (rows,) smoothed over as many hats as a fine look over time has, and their number.

    Of a long log neighbouring rows are averaged first.
    """
    width = max(HATS, min(len(residual) // FINE_ROWS // 2, FINE_HATS))
    few = 1 + len(residual) * width // FINE_MOST
    residual = residual[: len(residual) // few * few].reshape(-1, few).mean(axis=1)
    rows = np.arange(len(residual), dtype=float)
    basis = hats(rows, np.linspace(0.0, rows[-1], width))
    gram = basis.T @ basis + 1e-6 * np.eye(width) * len(rows)
    return np.asarray(basis @ np.linalg.solve(gram, basis.T @ residual)), width


def _nuisances(
    variables: Mapping[str, Array], fold: NDArray[np.intp]
) -> Iterator[tuple[str, Array, Array, NDArray[np.intp]]]:
    """(name, values, basis, folds): smooths of every variable, fine ones of time, the map of both speeds.

    What comes and goes faster than a held-out block can only be found between its neighbours: the folds of
    the fine smooths are every fifth row.
    """
    for name, values in variables.items():
        knots = knots_of(values)
        if knots is not None:
            yield name, values, hats(values, knots), fold
        if name in ANGLES and np.ptp(values) > np.pi:
            waves = [f(k * values) for k in range(1, HARMONICS + 1) for f in (np.sin, np.cos)]
            yield name, values, np.stack([np.ones(len(values)), *waves], axis=1), fold
    near = np.arange(len(fold)) % 5
    on_stand = "upper_speed" in variables
    # a flight is low-passed: neighbours share their noise up to half a second
    seconds = float(np.ptp(variables["time_s"])) if "time_s" in variables else 0.0
    counts = (25, 75) if on_stand else (int(seconds / FINE_S),)
    if "time_s" in variables:
        for count in counts:
            if len(fold) * count > FINE_MOST or count < HATS:
                continue
            if FINE_ROWS * count < len(fold):
                time = np.arange(len(fold), dtype=float)
                yield "time_s", variables["time_s"], hats(time, np.linspace(0, time[-1], count)), near
    if {"upper_speed", "lower_speed"} <= set(variables):
        upper, lower = variables["upper_speed"], variables["lower_speed"]
        # a beat is a thing of the difference, a resonance of the rig one of both
        both_of = {"upper_speed - lower_speed": upper - lower, "upper_speed + lower_speed": upper + lower}
        turning = min(np.ptp(upper), np.ptp(lower)) > TURNING
        for name, values in both_of.items() if turning else ():
            for count in COMBINED:
                if np.ptp(values) > TURNING and len(fold) > FINE_ROWS * count:
                    yield name, values, hats(values, np.linspace(values.min(), values.max(), count)), near
        both = grid_hats(upper, lower)
        if both is not None and both.shape[1] * 2 < len(fold):
            yield "upper_speed x lower_speed", variables["lower_speed"], both, near


def _smooths(
    residual: Array, basis: Array, fold: NDArray[np.intp], block: NDArray[np.intp] | None
) -> Iterator[tuple[int, float, float, Array]]:
    """(channel, held-out share, chi-square, in-sample smooth) of the channels that follow a basis (rows, K).

    With `block` (rows,) neighbours of one block are not independent: what the smooth leaves says how far.
    """
    shares, gram, moment = _shares(residual, basis, fold)
    about = residual - residual.mean(axis=0)
    power = np.sum(about**2, axis=0)
    for c in np.flatnonzero(shares > SHARE):
        smooth = basis @ np.linalg.solve(gram, moment[:, c])
        smooth = smooth - smooth.mean()
        rest = about[:, c] - smooth
        inflation = 1.0 if block is None else float(autocorrelation_time(rest[:, None], block)[0])
        statistic = float((power[c] - np.sum(rest**2)) / (np.mean(rest**2) * inflation))
        yield int(c), float(shares[c]), statistic, smooth


def _shares(residual: Array, basis: Array, fold: NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """(C,) share of the variance that a basis foretells for held-out rows; its Gram matrix, its moments."""
    ridge = 1e-6 * np.eye(basis.shape[1]) * len(residual)
    tests = [fold == f for f in np.unique(fold)]
    sums = [(basis[test].T @ basis[test], basis[test].T @ residual[test]) for test in tests]
    gram, moment = ridge + sum(g for g, _ in sums), sum(m for _, m in sums)
    left = np.zeros(residual.shape[1])
    for test, (own_gram, own_moment) in zip(tests, sums, strict=True):
        others = np.linalg.solve(gram - own_gram, moment - own_moment)
        left += np.sum((residual[test] - basis[test] @ others) ** 2, axis=0)
    power = np.sum((residual - residual.mean(axis=0)) ** 2, axis=0)
    return np.where(power > 0, 1.0 - left / np.where(power > 0, power, 1.0), 0.0), gram, moment


def _by_chance(residual: Array, basis: Array, fold: NDArray[np.intp]) -> float:
    """Share that a basis foretells of noise with the spectrum of a residual (rows,), at most.

    Rows that were held at one level share their noise, and the level takes it for its own. Copies with the
    same spectrum and other phases (Theiler et al. 1992) tell how much.
    """
    half = np.abs(np.fft.rfft(residual - residual.mean()))[:, None]
    turns = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, (len(half), SURROGATES))
    copies = np.fft.irfft(half * np.exp(1j * turns), n=len(residual), axis=0)
    shares = _shares(copies, basis, fold)[0]
    return float(shares.mean() + norm.isf(ALPHA) * shares.std())


def _where(values: Array, smooth: Array) -> str:
    """Where the smooth is largest, in words."""
    peak = int(np.argmax(np.abs(smooth)))
    low, high = float(values.min()), float(values.max())
    place = (values[peak] - low) / max(high - low, 1e-12)
    region = "at the low end" if place < 0.25 else "at the high end" if place > 0.75 else "in the middle"
    return f"{smooth[peak]:+.3g} near {values[peak]:.3g} ({region} of {low:.3g} .. {high:.3g})"
