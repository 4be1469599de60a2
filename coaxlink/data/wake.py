"""Which of two rotors is the lower one, by the loads: it works in the other's wake.

Two kinds of evidence. Where both speeds vary apart, each thrust is regressed on its own rotor's speed, then
on the other's as well: the lower rotor's thrust falls with the upper one's speed, the upper one's hardly
notices the lower one's (F-test of the added terms, and the share of the thrust that they carry). Where both
rotors run at about one speed, T^1.25 / (Q n^0.5), which a propeller's size does not change, is a third lower
in the wake.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CHANCE = 1e-6  # an effect that chance shows once in a million logs
TWICE = 2.0  # as much of its load must go with the other's speed on one rotor as on the other
APART = 0.03  # of a speed's squares that the other speed does not explain: less, and nothing is decided
LEAST_SHARE = 0.02  # of the load: a smaller share is the rig's (a load cell feels its neighbour)
EQUAL = (0.85, 1.18)  # ratio of the speeds in which both rotors count as running alike
ALIKE_ROWS = 5  # rows at equal speeds
# quality over the other's: a wake leaves 0.55 to 0.7 (Leishman 2006), two propellers are alike within a
# third; less than that is no wake, but a unit or a sensor
SPENT = (0.4, 0.8)


@dataclass(frozen=True)
class RotorLog:
    """What a log shows of one rotor; each (rows,), None where not measured."""

    speed: Array  # rpm, or throttle
    thrust: Array | None
    torque: Array | None
    power: Array | None = None


@dataclass(frozen=True)
class WakeEvidence:
    """The lower rotor of two, 0 or 1, or None; the evidence in words with {0} and {1} for names."""

    lower: int | None
    lines: tuple[str, ...]
    odd: bool = False  # one rotor does far worse than a wake explains

    def words(self, *names: str) -> tuple[str, ...]:
        """The evidence with the rotors' names."""
        return tuple(line.format(*names) for line in self.lines)


def lower_rotor(first: RotorLog, second: RotorLog) -> WakeEvidence:
    """Who works in whose wake. Loads need their signs and units, rows are those in which a rotor turns."""
    found: list[int] = []
    odd = False
    lines: list[str] = []
    shares = (
        _share_of_other(first.thrust, first.speed, second.speed),
        _share_of_other(second.thrust, second.speed, first.speed),
    )
    for lower, (share, other) in enumerate((shares, shares[::-1])):
        if share is None or other is None or share >= -LEAST_SHARE:
            continue
        if abs(share) > TWICE * abs(min(other, 0.0)):
            found.append(lower)
            lines.append(
                f"thrust of {{{lower}}} falls with the speed of {{{1 - lower}}} by {-100 * share:.0f} % "
                f"of itself, the other way by {max(0.0, -100 * other):.0f} %"
            )
    quality = _quality(first, second)
    if quality is not None:
        ratio, thrust = quality
        lower = 0 if ratio < 1 else 1
        worse = min(ratio, 1 / ratio)
        less = thrust if lower == 0 else 1 / thrust
        text = f"at equal speeds {{{lower}}} gives {100 * less:.0f} % of the thrust of {{{1 - lower}}}"
        if worse < SPENT[0]:
            odd = True
            lines.append(
                f"{text} and {100 * worse:.0f} % for its torque: more than a wake takes, is it a unit?"
            )
        elif worse < SPENT[1] and less < 1:
            found.append(lower)
            lines.append(f"{text}, and {100 * (1 - worse):.0f} % less for its torque")
        elif not found:
            lines.append(f"{text}: too near to decide")
    if not found and quality is None and shares == (None, None):
        lines.append("no rows in which the speeds vary apart, none at equal speeds with torque or power")
    if len(set(found)) > 1:
        lines.append("these contradict each other")
    agreed = found[0] if len(set(found)) == 1 and not odd else None
    return WakeEvidence(agreed, tuple(lines), odd)


def _share_of_other(load: Array | None, own: Array, other: Array) -> float | None:
    """Share of a load that goes with the other rotor's speed, negative where it falls; 0 by chance.

    None where the rows cannot tell.
    """
    if load is None or np.ptp(own) <= 0 or np.ptp(other) <= 0:
        return None
    u, v = own / own.max(), other / other.max()
    rows = u > 0.2  # a rotor that stands tells its cell's zero, not its thrust
    u, v, y = u[rows], v[rows], load[rows]
    if len(y) < 12:
        return None
    base = np.stack([np.ones_like(u), u, u**2, u**3], axis=1)
    added = np.stack([v**2, u * v], axis=1)
    free = added - base @ np.linalg.lstsq(base, added, rcond=None)[0]
    apart = np.mean(free[:, 0] ** 2) / max(float(np.var(v**2)), 1e-300)
    if apart < APART:
        return None
    rest = y - base @ np.linalg.lstsq(base, y, rcond=None)[0]
    gain = free @ np.linalg.lstsq(free, rest, rcond=None)[0]
    freedom = len(y) - base.shape[1] - added.shape[1]
    explained, left = float(gain @ gain), float(np.sum((rest - gain) ** 2))
    from scipy.special import fdtrc  # scipy is for foreign headings alone: not at every start

    if fdtrc(2, freedom, explained / 2 / max(left / freedom, 1e-300)) > CHANCE:
        return 0.0
    share = np.sqrt(explained / apart / len(y)) / max(float(np.sqrt(np.mean(y**2))), 1e-300)
    return float(np.sign(gain @ free[:, 0]) * share)


def _quality(first: RotorLog, second: RotorLog) -> tuple[float, float] | None:
    """T^1.25 / (Q n^0.5) of the first over the second's and their thrusts' ratio, at about equal speeds."""
    if first.thrust is None or second.thrust is None or np.ptp(first.speed) <= 0:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = first.speed / second.speed
    rows = (ratio > EQUAL[0]) & (ratio < EQUAL[1]) & (first.speed > 0.4 * first.speed.max())
    rows &= (first.thrust > 0) & (second.thrust > 0)
    for power, (a, b) in enumerate(((first.torque, second.torque), (first.power, second.power))):
        if a is None or b is None:
            continue
        good = rows & (a > 0) & (b > 0)
        if good.sum() < ALIKE_ROWS:
            continue
        n = ratio[good]
        thrust = first.thrust[good] / second.thrust[good]
        q = np.log(thrust**1.25 / (a[good] / b[good]) * n ** (power - 0.5))
        error = 1.2533 * float(np.std(q)) / np.sqrt(len(q))  # of a median
        middle = float(np.median(q))
        if abs(middle) < 5 * error:
            return None
        return float(np.exp(middle)), float(np.median(thrust / n**2))
    return None
