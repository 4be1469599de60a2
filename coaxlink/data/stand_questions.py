"""What to look at on a stand whose readings no propeller gives, before any unit: a heading says its own.

Did it turn, does a load follow its rotor's speed squared, is the speed counted twice, half, or in turns of
the field. Where none of these explains it, what a quantity would have to be multiplied by.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from coaxlink.data.aliases import LOADS_AND_SPEED, QUANTITIES
from coaxlink.data.cleaning import drive_of
from coaxlink.data.propeller import DIAMETER, TIP_SPEED, Reading, possible
from coaxlink.data.samples import Samples

MOVED = 0.3  # of the greatest speed squared, between rows: less does not show what follows it
FOLLOWS = 0.5  # of a load's variation by the speeds squared: a sound one has 0.9 and more
USUAL_POLES = 14
FACTORS = np.geomspace(1e-4, 1e4, 321)  # of a reading: units differ by less
COUNTED = {  # what a speed would be multiplied by: why
    0.5: "counted twice (two marks on an optical sensor)",
    2.0: "counted half (one of two marks, every second pulse)",
    2.0 / USUAL_POLES: "in electrical turns (`poles`)",
}


@dataclass(frozen=True)
class Question:
    """What to look at, and at which of our columns."""

    column: str
    text: str
    scales: Mapping[str, float] = field(default_factory=dict)  # of our columns, where those would mend it


def questions(
    samples: Samples, found: Mapping[str, Reading], diameter_m: float | None, stated: frozenset[str]
) -> Iterator[Question]:
    """Of readings that are no propeller's, the plainest first; columns that somebody `stated` are right."""
    for side in found:
        effort = f"{side}_rpm"
        if samples.has(effort):
            top = float(samples[effort].max())
            if math.pi * DIAMETER[1] * top / 60.0 < TIP_SPEED[0]:
                yield Question(effort, f"did the {side} rotor turn? It reaches {top:.3g}")
    for side in found:
        for name in (f"{side}_thrust_N", f"{side}_torque_Nm"):
            share = _followed(samples, name)
            if share is not None and share < FOLLOWS:
                value = float(np.median(samples[name]))
                reported = (
                    f"it reads about {value:.3g} whatever the speed; {100 * share:.0f} % of it goes with"
                )
                yield Question(name, f"is the cell dead, or another's? {reported} the speeds squared")
    for factor, why in COUNTED.items():
        for sides in (tuple(found), *((s,) for s in found if len(found) > 1)):
            names = [f"{s}_rpm" for s in sides]
            if stated & set(names) or not all(found[s].rpm for s in sides):
                continue
            if possible(_times(found, sides, "speed", factor), diameter_m):
                whose = f"{sides[0]} rotor's speed" if len(sides) < len(found) else "speed"
                known = factor != 2.0 / USUAL_POLES  # how many magnets, nobody reported
                yield Question(
                    names[0], f"is the {whose} {why}?", dict.fromkeys(names, factor) if known else {}
                )
                break


def factors(found: Mapping[str, Reading], diameter_m: float | None) -> Iterator[str]:
    """In words: what one quantity, of all rotors or of one, would have to be multiplied by."""
    for sides in (tuple(found), *((s,) for s in found if len(found) > 1)):
        whose = f" of the {sides[0]} rotor" if len(sides) < len(found) else ""
        for quantity in LOADS_AND_SPEED:
            fit = [f for f in FACTORS.tolist() if possible(_times(found, sides, quantity, f), diameter_m)]
            if fit:
                yield f"the {quantity}{whose} times {fit[0]:.2g} to {fit[-1]:.2g}"


def _times(
    found: Mapping[str, Reading], sides: tuple[str, ...], quantity: str, by: float
) -> dict[str, Reading]:
    """The readings with a quantity of these sides multiplied."""
    return {s: r.scaled(**{quantity: by}) if s in sides else r for s, r in found.items()}


def _followed(samples: Samples, load: str) -> float | None:
    """Share of a load's variation that goes with both speeds squared, None where its own hardly varies."""
    side = load.partition("_")[0]
    efforts = [drive_of(samples, s) for s in (side, "lower" if side == "upper" else "upper")]
    if not samples.has(load) or efforts[0] is None:
        return None
    squares = [(samples[e] / max(float(samples[e].max()), 1e-300)) ** 2 for e in efforts if e is not None]
    if np.ptp(squares[0]) < MOVED or samples.rows < 2 * len(QUANTITIES):
        return None
    X = np.stack([np.ones(samples.rows), *squares], axis=1)
    y = samples[load]
    left = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    return 1.0 - float(left @ left) / max(float(np.sum((y - y.mean()) ** 2)), 1e-300)
