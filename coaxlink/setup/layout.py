"""Where rotors sit and which way they turn, as far as a source tells."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from coaxlink.airframe import FURTHEST_M
from coaxlink.errors import InputError

WIDEST_M = 5.0  # an arm longer than this is millimetres or centimetres taken for metres
UP = (0.0, 0.0, -1.0)
_SAME_AXIS = 0.1  # of the longest arm: two rotors of a pair stand one above the other within this


@dataclass(frozen=True)
class Mount:
    """One rotor, in the firmware's order."""

    x: float  # forward, m; or of the unit circle where the layout has no scale
    y: float  # right
    z: float | None  # down, m; None where the source does not tell
    spin: str  # "ccw" or "cw", seen from above
    level: str | None = None  # upper, lower; None where the source does not tell
    output: str = ""  # the connector it is assigned to, "MAIN 1"
    axis: tuple[float, float, float] = UP  # of its thrust, FRD
    order: int = 0  # in the firmware's motor test, which turns an arm's upper rotor first; 0: not known


def refuse_far(source: str, number: int, place: tuple[float, ...]) -> None:
    """Raise InputError for a rotor where no vehicle reaches, m."""
    if not all(abs(p) <= FURTHEST_M for p in place):
        problem = f"{max(map(abs, place)):.3g} m from the centre: {FURTHEST_M:g} at most"
        raise InputError(source, f"rotor {number}", problem)


@dataclass(frozen=True)
class Layout:
    """Rotors in the order of the firmware's motor numbers."""

    source: str  # in words, for the file and the screen
    mounts: tuple[Mount, ...]
    metres: bool  # False: directions only, an arm length is still to come
    notes: tuple[str, ...] = field(default=())
    idle: tuple[int, ...] = ()  # numbers of rotors that no output drives, where the source has all outputs

    @property
    def arm(self) -> float:
        """The longest distance of a rotor from the centre, m (1 where the layout has no scale)."""
        return max(math.hypot(p.x, p.y) for p in self.mounts)

    def stacks(self) -> list[tuple[int, ...]]:
        """Indices of rotors that stand one above the other, (1 or 2 each), in the order of the first.

        Raises InputError where three or more share a place.
        """
        reach, left, found = _SAME_AXIS * self.arm, list(range(len(self.mounts))), []
        while left:
            first = left[0]
            a = self.mounts[first]
            stack = tuple(
                n for n in left if math.hypot(self.mounts[n].x - a.x, self.mounts[n].y - a.y) <= reach
            )
            if len(stack) > 2:
                numbers = ", ".join(str(n + 1) for n in stack)
                raise InputError(
                    self.source, "", f"rotors {numbers} share one position: one or two are expected"
                )
            found.append(stack)
            left = [n for n in left if n not in stack]
        return found
