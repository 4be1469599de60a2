"""Which form of the ladder held-out blocks support, and what a reader must know of the others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from coaxlink.rotor.metrics import ChannelError

if TYPE_CHECKING:
    from coaxlink.rotor.identification import StandData, Values

EXACT = 1e-9  # of the largest load: what rounding of a fit leaves is no error
SURE = 2.0  # standard errors: one in forty by chance
Comparison = Mapping[str, Mapping[str, ChannelError]]


def simplest(data: StandData, predicted: Mapping[str, Values]) -> str:
    """The first form of the ladder whose held-out error is within one standard error of the best."""
    loss = _losses(data, predicted)
    best = min(loss, key=lambda name: float(loss[name].sum()))
    return next(name for name in predicted if name == best or _above(loss[name], loss[best]) <= 1.0)


def beyond(
    chosen: str, predicted: Mapping[str, Values], comparison: Comparison, data: StandData
) -> Iterator[str]:
    """What a surface follows and polynomials do not: as sure as auto is of it, else two standard errors."""
    polynomial = "crm" if chosen == "surface" else chosen
    if not {polynomial, "surface"} <= set(predicted) or not comparison[chosen]:
        return
    loss = _losses(data, {name: predicted[name] for name in (polynomial, "surface")})
    if _above(loss[polynomial], loss["surface"]) <= (1.0 if chosen == "surface" else SURE):
        return
    channel = _clearest(comparison, polynomial, "surface")
    unit = "N" if channel.endswith("thrust") else "N m"
    mine, smooth = (f"{comparison[form][channel].rmse:.3g} {unit}" for form in (polynomial, "surface"))
    errors = f"({channel} held out: {mine}, a smooth surface {smooth})"
    ending = "the model is a smooth surface over both speeds" if chosen == "surface" else "see `form` surface"
    yield f"{polynomial} does not follow this pair everywhere {errors}: {ending}"


def _clearest(comparison: Comparison, worse: str, better: str) -> str:
    """The channel in which the one form's held-out error is most above the other's."""
    least = {c: max(error.rmse, 1e-300) for c, error in comparison[better].items()}
    return max(least, key=lambda c: comparison[worse][c].rmse / least[c])


def reason(chosen: str, comparison: Comparison) -> str:
    """Why auto took a form: its held-out error beside that of the next simpler and the next richer one."""
    said = f"auto: {chosen} is the simplest form within one standard error of the best"
    tried = list(comparison)
    index = tried.index(chosen)
    beside = [tried[i] for i in (index - 1, index, index + 1) if 0 <= i < len(tried)]
    if not comparison[chosen] or len(beside) < 2:
        return said
    channel = _clearest(comparison, *beside[:2])
    unit = "N" if channel.endswith("thrust") else "N m"
    errors = ", ".join(f"{form} {comparison[form][channel].rmse:.3g} {unit}" for form in beside)
    return f"{said} ({channel} held out: {errors})"


def _losses(data: StandData, predicted: Mapping[str, Values]) -> Values:
    """{form: (folds,)} squared errors of every fold, each load in units of its best form's."""
    loss = {}
    for name, values in predicted.items():
        squared = np.zeros(data.samples.rows)
        for load in data.measured:
            least = min(float(np.nanmean((data.loads[load] - p[load]) ** 2)) for p in predicted.values())
            exact = (EXACT * float(np.nanmax(np.abs(data.loads[load])))) ** 2
            squared += np.nan_to_num((data.loads[load] - values[load]) ** 2) / max(least, exact, 1e-300)
        loss[name] = np.array([squared[data.fold == k].sum() for k in np.unique(data.fold)])
    return loss


def _above(loss: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """By how many standard errors of the paired difference over folds one loss is above another."""
    difference = loss - other
    total = float(difference.sum())
    spread = float(difference.std(ddof=1) * np.sqrt(len(difference))) if len(difference) > 1 else 0.0
    return total / spread if spread > 0 else float(np.copysign(np.inf, total)) if total else 0.0
