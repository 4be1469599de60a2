"""A learning curve: the held-out error over how many blocks were fitted. Is more data worth its while?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coaxlink.rotor.fit import Options
from coaxlink.rotor.identification import CHANNELS, COAXIAL, StandData, fit_form

DRAWS = 3  # choices of training blocks a size and held-out block


@dataclass(frozen=True)
class Lesson:
    """One point of the curve."""

    blocks: int  # fitted
    rows: int  # mean number of rows in them
    rmse: dict[str, float]  # channel: N or N m, on blocks left out


def learning_curve(form: str, data: StandData, options: Options, *, seed: int = 0) -> tuple[Lesson, ...]:
    """Errors of a form fitted on 2, 3, ... of the log's blocks, each block left out in turn."""
    random = np.random.default_rng(seed)
    numbers = np.unique(data.fold)
    lessons = []
    for count in _sizes(len(numbers)):
        squares: dict[str, list[float]] = {}
        rows = []
        for out in numbers:
            others = numbers[numbers != out]
            for _ in range(DRAWS if count < len(others) else 1):
                chosen = np.isin(data.fold, random.choice(others, count, replace=False))
                if any(np.isfinite(data.loads[load][chosen]).sum() < 6 for load in data.measured):
                    continue
                rows.append(int(chosen.sum()))
                _score(form, data, chosen, data.fold == out, options, squares)
        if rows:
            rmse = {channel: float(np.sqrt(np.mean(values))) for channel, values in squares.items()}
            lessons.append(Lesson(count, round(float(np.mean(rows))), rmse))
    return tuple(lessons)


def _sizes(blocks: int) -> list[int]:
    return sorted({round(x) for x in np.geomspace(2, blocks - 1, 6)}) if blocks > 2 else []


def _score(
    form: str,
    data: StandData,
    fitted: np.ndarray,
    out: np.ndarray,
    options: Options,
    squares: dict[str, list[float]],
) -> None:
    """Add the squared errors on the rows left out, channel by channel."""
    fits = fit_form(form, data, fitted, options)
    u, v = data.speeds.upper[out], data.speeds.lower[out]
    error = {load: data.loads[load][out] - fit.predict(u, v) for load, fit in fits.items()}
    channels = {CHANNELS[load]: e for load, e in error.items()}
    channels |= {n: error[a] + error[b] for n, (a, b) in COAXIAL.items() if a in error and b in error}
    for channel, e in channels.items():
        squares.setdefault(channel, []).extend(float(x) for x in e[np.isfinite(e)] ** 2)
