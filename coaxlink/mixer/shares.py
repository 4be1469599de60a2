"""The exact law with another share of the upper rotors: the same wrench, bounds and order of giving up.

What it minimises is the power and `lean` times half of what the upper rotors lift more than the lower ones.
Along the splits of one thrust that is a straight line on top of the power, so every share has its lean; where
a rotor gets to its bound the wrench goes first, as before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.split import upper_share
from coaxlink.vehicle import Vehicle

Array = NDArray[np.float64]
REACH, KNOTS = 0.18, 13  # of the share, to both sides of the law's own: a little further than a split plan
# lean, in full powers for the full thrust: about what thrust costs at full power, beyond which the law would
# be paid for lifting
MOST = 1.5
CLOSE = 1e-4  # of the share
HALVINGS = 30


@dataclass(frozen=True)
class Shares:
    """Shares of the hover thrust from the upper rotors, and the lean that flies each; the law's own has 0."""

    share: Array  # (P,) rising; one where the rotors have no other
    lean: Array  # (P,) falling
    own: float  # the law's

    def lean_of(self, share: float) -> float:
        """On a straight line between two of them; beyond their ends an end's."""
        return float(np.interp(share, self.share, self.lean))


class LeaningLaw(ExactLaw):
    """`ExactLaw` whose lean may be moved between two calls."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self._plain = self.arms.power.copy()

    def lean(self, lean: float) -> None:
        """0 is the exact law."""
        self.arms.power[:] = self._plain + lean * self.units.lean
        for own, row in zip(self._arms.power, self.arms.power.tolist(), strict=True):
            own[:] = row


def shares_of(vehicle: Vehicle) -> Shares:
    """What these rotors have within REACH of the law's own share, in a hover that is delivered whole."""
    law, hover = LeaningLaw(vehicle), [vehicle.airframe.mass_kg * GRAVITY_M_S2, 0.0, 0.0, 0.0]

    def flown(lean: float) -> float | None:
        law.lean(lean)
        return upper_share(vehicle, law.plain(hover)) if law.solve(hover) >= 0 and not law.dropped else None

    own = flown(0.0) if vehicle.airframe.pairs else None
    if own is None:
        return Shares(np.array([0.5]), np.zeros(1), 0.5)
    found = [(own, 0.0)]
    for way in (-1.0, 1.0):
        near = 0.0
        for n in range(1, KNOTS // 2 + 1):
            at = _lean_for(flown, own + way * n * REACH / (KNOTS // 2), near, -way * MOST)
            if at is None:
                break
            near = at[1]
            found.append(at)
    share, lean = np.array(sorted(found)).T
    return Shares(share, lean, own)


def _lean_for(
    flown: Callable[[float], float | None], wanted: float, near: float, far: float
) -> tuple[float, float] | None:
    """(share, lean) between two leans, None where no such lean has that share."""
    for _ in range(HALVINGS):
        middle = 0.5 * (near + far)
        share = flown(middle)
        if share is not None and abs(share - wanted) < CLOSE:
            return share, middle
        if share is not None and (share < wanted) == (far < near):  # not there yet
            near = middle
        else:
            far = middle
    return None
