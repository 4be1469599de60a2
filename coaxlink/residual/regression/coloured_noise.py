"""Noise with a colour (gusts, ringing, a cell's wander): it runs smooth paths over time and is no effect.

Noise is normal at every moment (how large the largest of so many numbers is, and their kurtosis) and has no
line in its spectrum: a burst and a period are found so, a flight's trend by smooths of eight hats. It is as
small as a gust; on a stand as a cell's wander, where it forgets soon or is the cell's own, or a bit larger,
where both hold: what acts on a rotor shows in several loads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f, norm

Array = NDArray[np.float64]

ALPHA = 1e-4  # that the largest of a path's numbers is by chance so large; that two channels go together
# judgement: cycles of a period in the log, fewer are a trend; frequencies to either side that tell what a
# line stands out from; times the noise from row to row, what drift and ringing of cells leave
CYCLES, BESIDE, COLOURED = 3, 16, 1.7
# of the reference load, judgement: gusts of independent simulated flights bring 0.4 to 1.4 % rms; more of a
# cell's own noise is worth being told
MOST = 0.02
LEAST = 20  # independent numbers: with fewer, the test of kurtosis cannot tell whether they are normal


@dataclass(frozen=True)
class Colours:
    """What noise the channels of a residual (rows, C) may have, rows in the order of time.

    `floor` (C,) is the noise between neighbouring rows in the channels' unit, `reference` (C,) the load that
    a size is a share of.
    """

    residual: Array
    floor: Array
    reference: Array
    flown: bool

    def hold(self, channel: int, path: Array, width: int) -> bool:
        """Whether noise of this channel runs such a path over time, of so many hats at equal distances."""
        path = path - np.mean(path)
        spread = float(np.std(path))
        knots = path[np.linspace(0, len(path) - 1, width).astype(int)]
        knots[[0, -1]] *= np.sqrt(0.5)  # half as many rows tell the first and the last
        rows = self.residual[:, channel]
        if not (_no_outlier(knots) and _no_tails(knots)) or period_of(rows, path):
            return False
        if self.flown:
            return spread <= MOST * self.reference[channel]
        forgets, alone = _independent(rows) >= LEAST, self._alone(channel, path)
        if spread <= COLOURED * self.floor[channel]:
            return forgets or alone
        return spread <= MOST * self.reference[channel] and forgets and alone and _no_tails(rows)

    def _alone(self, channel: int, path: Array) -> bool:
        """Whether no other channel goes along with a path of this one.

        What two stationary noises have in common by chance hangs on the spectra of both (Bartlett 1946).
        """
        rows = len(self.residual)
        others = self.residual[:, np.arange(self.residual.shape[1]) != channel]
        if not others.shape[1]:
            return True
        along = np.interp(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, len(path)), path)[:, None]
        own, theirs = _power(along), _power(others)
        both = np.sum(own * theirs, axis=0)
        chance = both / np.where(both > 0, 2.0 * own.sum() * theirs.sum(axis=0), 1.0)  # variance of it
        limit = norm.isf(0.5 * ALPHA / others.shape[1]) * np.sqrt(chance)
        return bool(np.all((np.abs(_correlation(along, others)) < limit) | (both <= 0)))


def _power(values: Array) -> Array:
    """(rows // 2, K) of columns (rows, K)."""
    return np.asarray(np.abs(np.fft.rfft(values, axis=0)[1:]) ** 2)


def _no_outlier(values: Array) -> bool:
    """Whether the largest of some numbers (K,) is by chance so large."""
    spread = float(np.std(values))
    return float(np.max(np.abs(values))) <= norm.isf(0.5 * ALPHA / len(values)) * spread


def _no_tails(values: Array) -> bool:
    """Whether the kurtosis of stationary noise (rows,) is a normal one's, or less.

    The test of Anscombe and Glynn (1983), of as many numbers as the noise has for its kurtosis: rows over the
    sum of its autocorrelations' fourth powers (Lobato and Velasco 2004).
    """
    values = values - np.mean(values)
    rows, power = len(values), float(np.mean(values**2))
    if power <= 0.0:
        return True
    spectrum = np.abs(np.fft.rfft(values, 2 * rows)) ** 2
    correlation = np.fft.irfft(spectrum)[:rows] / (rows * power)
    n = rows / (2.0 * float(np.sum(correlation**4)) - 1.0)
    excess = float(np.mean(values**4)) / power**2 - 3 * (n - 1) / (n + 1)
    if n < LEAST or excess <= 0.0:
        return True
    x = excess / np.sqrt(24 * n * (n - 2) * (n - 3) / ((n + 1) ** 2 * (n + 3) * (n + 5)))
    skew = np.sqrt(6 * (n + 3) * (n + 5) / (n * (n - 2) * (n - 3)))
    skew *= 6 * (n**2 - 5 * n + 2) / ((n + 7) * (n + 9))
    freedom = 6 + 8 / skew * (2 / skew + np.sqrt(1 + 4 / skew**2))
    root = np.cbrt((1 - 2 / freedom) / (1 + x * np.sqrt(2 / (freedom - 4))))
    return bool((1 - 2 / (9 * freedom) - root) / np.sqrt(2 / (9 * freedom)) < norm.isf(ALPHA))


def _independent(values: Array) -> float:
    """How many independent numbers stationary noise (rows,) has run through: the breadth of its spectrum."""
    power = np.abs(np.fft.rfft(values - np.mean(values))) ** 2
    most = float(np.max(power))
    # twice: one reading of a spectrum scatters as much as it is large
    return 2.0 * float(np.sum(power / most)) ** 2 / float(np.sum((power / most) ** 2)) if most > 0 else 0.0


def _correlation(one: Array, others: Array) -> Array:
    """(K,) of one column (rows, 1) with others (rows, K); 0 with what stands still."""
    one, others = one - one.mean(axis=0), others - others.mean(axis=0)
    own, theirs = np.linalg.norm(one), np.linalg.norm(others, axis=0)
    return np.asarray(np.sum(one * others, axis=0) / np.where(own * theirs > 0, own * theirs, np.inf))


def period_of(values: Array, path: Array) -> float | None:
    """Of values (rows,) at equal distances, the period in rows with most of their path's power.

    None where noise holds as much there by chance. A line stands out from its neighbours in the spectrum, as
    ringing does not, and from what a first-order autoregression beside white noise has there (by the first
    two autocorrelations). Each frequency's power is exponential about its mean, the neighbours' mean as
    uncertain as their number says (an F test).

    >>> turns = np.sign(np.sin(np.arange(500) * np.pi / 8.0 + 0.1))
    >>> round(period_of(turns, turns), 1)
    16.1
    """
    power = np.abs(np.fft.rfft(path - np.mean(path))) ** 2
    k = int(np.argmax(power))
    if k < CYCLES:
        return None
    values = values - np.mean(values)
    spectrum = np.abs(np.fft.rfft(values)) ** 2
    k = k - 1 + int(np.argmax(spectrum[k - 1 : k + 2]))
    near = np.r_[spectrum[max(1, k - BESIDE) : k - 1], spectrum[k + 2 : k + 1 + BESIDE]]
    chance = ALPHA / len(power)
    out_of_near = float(f.isf(chance, 2, 2 * len(near)) * np.mean(near)) if len(near) else np.inf
    out_of_red = -np.log(chance) * float(np.sum(values**2)) * _share_of_red(values, k / len(values))
    return len(values) / k if spectrum[k] > max(out_of_near, out_of_red) else None


def _share_of_red(values: Array, frequency: float) -> float:
    """Of centred values' white spectrum, what theirs has at a frequency (of the rate), if they are red."""
    power = float(np.sum(values**2)) or 1.0
    first, second = (float(np.sum(values[k:] * values[:-k])) / power for k in (1, 2))
    keeps = min(max(second / first, 0.0), 0.999) if first > 0.0 else 0.0
    red = min(first / keeps, 1.0) if keeps > 0.0 else 0.0
    rise = (1.0 - keeps**2) / (1.0 + keeps**2 - 2.0 * keeps * np.cos(2.0 * np.pi * frequency))
    return float(1.0 - red + red * rise)
