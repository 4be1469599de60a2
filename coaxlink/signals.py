"""Filters that both sides of a residual go through, and its noise floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import SIGMA_PER_MAD

Array = NDArray[np.float64]
SEGMENT_S = 4.0  # of a spectrum
TOP_HZ = 16.0  # the highest frequency that is looked at
PENALTY = 4.0  # of the log-likelihood, a kind of noise more
# standard deviation of the logarithm of what commands do between rows: of a log as it came, and of one that
# was thinned (it has rows that tell)
DOUBT, DOUBT_THINNED = 0.05, 0.15
DOUBTS = tuple(np.linspace(-0.4, 0.4, 17))


def low_pass(values: Array, rate_hz: float, cutoff_hz: float) -> Array:
    """Zero-phase second-order Butterworth run both ways along axis 0; (rows, ...) in and out."""
    if cutoff_hz >= 0.45 * rate_hz:
        return np.asarray(values, float)
    from scipy.signal import sosfiltfilt

    pad = min(len(values) - 1, int(2 * rate_hz / cutoff_hz))
    out: Array = sosfiltfilt(_butterworth(rate_hz, cutoff_hz), values, axis=0, padlen=max(pad, 0))
    return out


@cache
def _butterworth(rate_hz: float, cutoff_hz: float) -> Array:
    """Second-order sections; designing them takes longer than running them over a short log."""
    from scipy.signal import butter

    return np.asarray(butter(2, cutoff_hz, fs=rate_hz, output="sos"))


def derivative(values: Array, rate_hz: float) -> Array:
    """Time derivative along axis 0 by seven-point central differences.

    Exact to 0.01 % at a tenth of the rate, where the usual two-point difference already loses 6 %.
    """
    out: Array = np.gradient(values, 1.0 / rate_hz, axis=0)
    if len(values) < 7:
        return out
    inner = 45.0 * (values[4:-2] - values[2:-4]) - 9.0 * (values[5:-1] - values[1:-5])
    out[3:-3] = (inner + values[6:] - values[:-6]) * (rate_hz / 60.0)
    return out


def lagged(command: Array, step_s: float, lag_s: float) -> Array:
    """First-order lag of commands (rows, N) that run smoothly between samples; starts settled.

    x' = (u - x) / lag, solved exactly for the cubic through the four samples around each step. A straight
    line would lose sinc^2: 5 % at 4 Hz of a log of 31 Hz.
    """
    if lag_s <= 0:
        return np.asarray(command, float)
    from scipy.signal import lfilter

    h = step_s / lag_s
    decay = float(np.exp(-h))
    driven = np.zeros(command.shape)
    padded = np.concatenate([command[:1], command, command[-1:]])
    for j, weight in enumerate(_cubic_weights(h)):  # samples k - 2 .. k + 1 drive the step that ends at k
        driven[1:] += weight * padded[j : j + len(command) - 1]
    driven[0] = (1.0 - decay) * command[0]
    out, _ = lfilter([1.0], [1.0, -decay], driven, axis=0, zi=decay * command[:1])
    return np.asarray(out, float)


@cache
def _gauss() -> tuple[Array, Array]:
    nodes, shares = np.polynomial.legendre.leggauss(24)
    return nodes, shares


@lru_cache(maxsize=256)
def _cubic_weights(h: float) -> Array:
    """(4,) shares of four samples at -1, 0, 1, 2 in what a lag of 1 / h steps takes up from 0 to 1."""
    nodes, shares = _gauss()
    s, w = 0.5 * (nodes + 1.0), 0.5 * shares
    if h > 12.0:  # only the end of the step still counts
        s, w = 1.0 - (1.0 - s) * 12.0 / h, w * 12.0 / h
    basis = np.stack(
        [
            -s * (s - 1.0) * (s - 2.0) / 6.0,
            (s + 1.0) * (s - 1.0) * (s - 2.0) / 2.0,
            -(s + 1.0) * s * (s - 2.0) / 2.0,
            (s + 1.0) * s * (s - 1.0) / 6.0,
        ]
    )
    weights = basis @ (w * h * np.exp(-(1.0 - s) * h))
    return np.asarray(weights * (1.0 - np.exp(-h)) / weights.sum())


def difference_gain(rate_hz: float, cutoff_hz: float, keep: int, *, differentiated: bool = False) -> float:
    """Variance of second differences over variance, for low-passed white noise kept every `keep` rows.

    `differentiated`: the white noise was on a rate whose derivative is the signal (torque from a gyro).
    """
    from scipy.signal import butter, freqz_sos

    sos = butter(2, cutoff_hz, fs=rate_hz, output="sos")
    omega, response = freqz_sos(sos, worN=4096, fs=2 * np.pi)
    power = np.abs(response) ** 4  # run both ways
    if differentiated:
        power = power * np.sin(omega) ** 2
    lags = np.array([np.sum(power * np.cos(omega * keep * k)) for k in range(3)]) / np.sum(power)
    return float(6.0 * lags[0] - 8.0 * lags[1] + 2.0 * lags[2])


def without_row_noise(values: Array) -> Array:
    """(rows,) of what moves slower than rows come: a running mean as wide as predicts a row best.

    Each row is predicted from its neighbours alone (leave-one-out, Stone 1974) over windows
    of 3 to a quarter of the rows; near the ends they shrink, so a ramp stays a ramp. Where the narrowest
    window is the best the values move from row to row: they come back as they are. A reading's own noise
    would otherwise be a part of every prediction that is made from it (errors in variables).
    """
    rows = len(values)
    if rows < 12 or not np.all(np.isfinite(values)):
        return values
    total = np.concatenate([[0.0], np.cumsum(values - values[0])])
    row = np.arange(rows)
    best, least, reach = values, np.inf, 1
    while 2 * reach + 1 <= rows // 4:
        near = np.minimum(reach, np.minimum(row, rows - 1 - row))
        count = 2 * near + 1
        mean = (total[row + near + 1] - total[row - near]) / count + values[0]
        inner = near > 0
        others = (mean * count - values)[inner] / (count - 1)[inner]
        missed = float(np.mean((values[inner] - others) ** 2))
        if missed < least:
            best, least = (values if reach == 1 else mean), missed
        reach *= 2
    return np.asarray(best)


def noise_floor(residual: Array, runs: Array, gain: Array) -> Array:
    """Noise of each channel (C,) from second differences of (rows, C) inside runs of neighbours.

    `runs` (rows,) numbers contiguous stretches; `gain` (C,) is what noise alone gives (`difference_gain`).
    Slow errors of the model cancel; robust against a few large jumps.
    """
    second = residual[2:] - 2.0 * residual[1:-1] + residual[:-2]
    inside = (runs[2:] == runs[:-2]) & (runs[1:-1] == runs[:-2])
    second = second[inside]
    if len(second) < 8:
        return np.asarray(np.std(residual, axis=0))
    limit = 4.0 * SIGMA_PER_MAD * np.median(np.abs(second), axis=0)
    clipped = np.clip(second, -limit, limit)
    return np.asarray(np.sqrt(np.mean(clipped**2, axis=0) / gain))


def spectral_floor(
    pieces: Sequence[Array],
    rate_hz: float,
    cutoff_hz: float,
    *,
    lag_s: float,
    raw_rate_hz: float,
    differentiated: Sequence[bool],
    sampling: Array | None = None,
    declared_lag_s: float = 0.0,
    alike: Array | None = None,
) -> Array | None:
    """Noise (C,) that the low-pass leaves of unfiltered residuals `pieces` [(rows, C)]; None if too short.

    Above the judged band a residual is noise. Its spectrum there, fitted by what noise can be, is continued
    below: white (accelerometer, vibration), white commands that alias between the rows of the log and reach
    the loads through the motors' lag, and for torques the gyro's white noise, differentiated. `sampling` (C,)
    is what of the second kind is known already, low-passed, behind the declared lag. `alike` (C,) is what
    one unit of a sensor's noise makes in each channel (mass, inertia): three axes of one sensor are held to
    one level, unless their spectra speak against it.
    """
    from scipy.signal import welch

    length = int(SEGMENT_S * rate_hz)
    top = min(TOP_HZ, 0.38 * rate_hz)
    if top < 1.8 * cutoff_hz:
        return None
    total, count = 0.0, 0.0
    frequency = np.zeros(0)
    for piece in pieces:
        if len(piece) >= length:
            frequency, power = welch(piece, fs=rate_hz, nperseg=length, detrend="linear", axis=0)
            total = total + power * len(piece)
            count += len(piece)
    if count == 0:
        return None
    spectrum = np.asarray(total / count)  # (F, C)
    fine = np.linspace(0.0, 0.5, 2001) * rate_hz
    kernel = _passed(fine, rate_hz, cutoff_hz) * (fine[1] - fine[0])
    band = (frequency >= 1.2 * cutoff_hz) & (frequency <= top)
    thinned = _passed(frequency[band], raw_rate_hz, 0.4 * rate_hz) if raw_rate_hz > 1.5 * rate_hz else 1.0
    behind = float(np.sum(_noises(fine, rate_hz, declared_lag_s)[:, 1] * kernel))
    given = np.zeros(spectrum.shape[1]) if sampling is None else sampling**2 / behind
    above = _Above(
        spectrum[band] / np.reshape(thinned, (-1, 1)),
        given,
        _noises(frequency[band], rate_hz, lag_s),
        kernel @ _noises(fine, rate_hz, lag_s),
        max(1.0, count / length),
        DOUBT_THINNED if raw_rate_hz > 1.5 * rate_hz else DOUBT,
    )
    out = np.zeros(spectrum.shape[1])
    turned = np.asarray(differentiated)
    for kind in (False, True):
        group = np.flatnonzero(turned == kind)
        each = [_continued(above, group[k : k + 1], np.ones(1), turned=kind) for k in range(len(group))]
        miss, power = sum(m for m, _ in each), np.array([p[0] for _, p in each])
        if alike is not None and len(group) > 1:
            together, held = _continued(above, group, alike[group] ** 2, turned=kind)
            power = held if together <= miss else power
        out[group] = np.sqrt(power)
    return out


@dataclass(frozen=True)
class _Above:
    """What is seen above the judged band, and what noise looks like there and passes below."""

    spectrum: Array  # (F, C)
    given: Array  # (C,) white commands behind the lag that are known of
    shapes: Array  # (F, 3) spectra of unit noise
    passes: Array  # (3,) their power after the low-pass
    segments: float
    doubt: float  # of the logarithm of what is given


def _continued(
    above: _Above, channels: NDArray[np.intp], scale: Array, *, turned: bool
) -> tuple[float, Array]:
    """-log L of the best mixture that channels share but for their scale (k,), and their power (k,) below."""
    level = above.spectrum[:, channels]
    given = above.given[channels]
    # the plainest mixture that the spectrum asks for: a needless kind adds to the noise, never takes away
    # sensors' axes are alike, but neither vibration nor commands are: channels share their own kind alone
    choices = [[2], [2, 1], [2, 0], [2, 1, 0]] if turned else [[0], [0, 1]]
    choices = choices[:1] if len(channels) > 1 else choices
    command_known = turned and bool(np.any(given > 0.0))
    misses, powers = [], []
    for doubt in DOUBTS if command_known else (0.0,):
        known = given * np.exp(2.0 * doubt)
        beside = above.shapes[:, 1:2] * known
        for kinds in choices:
            if command_known and 1 in kinds and doubt < 0.0:
                continue  # less of it and more of it
            shapes = (above.shapes[:, None, kinds] * scale[:, None]).reshape(-1, len(kinds))
            amounts, miss = _mixture(level.ravel(), shapes, above.segments, beside.ravel())
            misses.append(miss + PENALTY * len(kinds) + 0.5 * (doubt / above.doubt) ** 2)
            powers.append(scale * (above.passes[kinds] @ amounts) + above.passes[1] * known)
    # the middle of what the spectrum leaves open, each weighed by its likelihood
    best = min(misses)
    weights = np.exp(best - np.array(misses))
    logs = np.log(np.maximum(np.array(powers), 1e-300))
    return best, np.asarray(np.exp(weights @ logs / weights.sum()))


def _passed(frequency: Array, rate_hz: float, cutoff_hz: float) -> Array:
    """Power that `low_pass` leaves at frequencies (F,)."""
    from scipy.signal import butter, freqz_sos

    sos = butter(2, cutoff_hz, fs=rate_hz, output="sos")
    _, response = freqz_sos(sos, worN=2 * np.pi * frequency / rate_hz)
    return np.asarray(np.abs(response) ** 4)


def _noises(frequency: Array, rate_hz: float, lag_s: float) -> Array:
    """(F, 3) spectra of unit noise: white, white behind the lag, white differentiated."""
    w = 2 * np.pi * frequency
    turn = w / rate_hz
    slope = rate_hz * (90.0 * np.sin(turn) - 18.0 * np.sin(2 * turn) + 2.0 * np.sin(3 * turn)) / 60.0
    return np.stack([np.ones_like(w), 1.0 / (1.0 + (w * lag_s) ** 2), slope**2], axis=1)


def _mixture(spectrum: Array, shapes: Array, segments: float, known: Array) -> tuple[Array, float]:
    """(K,) amounts >= 0 of shapes (F, K) beside what is `known` (F,) of a spectrum averaged over segments,
    and its -log L."""
    if not np.any(spectrum):  # a channel that was never measured
        return np.zeros(shapes.shape[1]), 0.0
    from scipy.optimize import nnls

    level = np.full(len(spectrum), float(np.mean(spectrum)))
    scale = shapes.mean(axis=0)
    amounts = np.zeros(shapes.shape[1])
    for _ in range(8):
        amounts, _ = nnls(shapes / scale / level[:, None], (spectrum - known) / level)
        level = np.maximum(shapes / scale @ amounts + known, 1e-3 * float(np.mean(spectrum)))
    return np.asarray(amounts / scale), float(segments * np.sum(np.log(level) + spectrum / level))
