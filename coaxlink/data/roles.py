"""Which of two rotors is the lower one, by the loads: it works in the other's wake.

Two witnesses. Where both speeds vary apart, each thrust is regressed on its own rotor's speed, then on the
other's as well: the lower rotor's thrust falls with the upper one's speed, the upper one's hardly notices the
lower one's (F-test of the added terms, and the share of the thrust that they carry). Where both rotors run at
about one speed, T^1.25 / (Q n^0.5), which a propeller's size does not change, is a third lower in the wake.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.errors import InputError

Array = NDArray[np.float64]
CHANCE = 1e-6  # an effect that chance shows once in a million logs
TWICE = 2.0  # as much of its load must go with the other's speed on one rotor as on the other
APART = 0.03  # of a speed's squares that the other speed does not explain: less, and nothing is decided
LEAST = 0.02  # of the load: a smaller share is the rig's (a load cell feels its neighbour)
EQUAL = (0.85, 1.18)  # ratio of the speeds in which both rotors count as running alike
FEWEST = 5  # rows at equal speeds
# quality over the other's: a wake leaves 0.55 to 0.7 (Leishman 2006), two propellers are alike within a
# third; less than that is no wake, but a unit or a sensor
SPENT = (0.4, 0.8)


@dataclass(frozen=True)
class Rotor:
    """What one rotor of a log shows; each (rows,), None where not measured."""

    speed: Array  # rpm, or throttle
    thrust: Array | None
    torque: Array | None
    power: Array | None = None


@dataclass(frozen=True)
class Verdict:
    """The lower rotor of two, 0 or 1, or None; what speaks for it, in words with {0} and {1} for names."""

    lower: int | None
    evidence: tuple[str, ...]
    odd: bool = False  # one rotor does far worse than a wake explains

    def said(self, *names: str) -> tuple[str, ...]:
        """The evidence with the rotors' names."""
        return tuple(line.format(*names) for line in self.evidence)


class RotorsUnclear(InputError):
    """Two rotors whose headings do not say which is the upper, and data that do not either."""

    def __init__(self, source: object, labels: tuple[str, str], evidence: tuple[str, ...]) -> None:
        self.labels, self.evidence = labels, evidence
        found = "; ".join(evidence) or "the rows do not show it"
        super().__init__(
            str(source),
            f"rotors {labels[0]} and {labels[1]}",
            f"which is the upper one? Say `upper` {labels[0]} or `upper` {labels[1]} ({found})",
        )


def lower_rotor(first: Rotor, second: Rotor) -> Verdict:
    """Who works in whose wake. Loads need their signs and units, rows are those in which a rotor turns."""
    votes: list[int] = []
    odd = False
    said: list[str] = []
    pair = (first, second)
    shares = [_felt(pair[i].thrust, pair[i].speed, pair[1 - i].speed) for i in (0, 1)]
    for share, lower in ((shares[0], 0), (shares[1], 1)):
        other = shares[1 - lower]
        if share is None or other is None or share >= -LEAST:
            continue
        if abs(share) > TWICE * abs(min(other, 0.0)):
            votes.append(lower)
            said.append(
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
            said.append(
                f"{text} and {100 * worse:.0f} % for its torque: more than a wake takes, is it a unit?"
            )
        elif worse < SPENT[1] and less < 1:
            votes.append(lower)
            said.append(f"{text}, and {100 * (1 - worse):.0f} % less for its torque")
        elif not votes:
            said.append(f"{text}: too near to decide")
    if not votes and all(s is None for s in shares) and quality is None:
        said.append("no rows in which the speeds vary apart, none at equal speeds with torque or power")
    agreed = votes[0] if votes and len(set(votes)) == 1 else None
    if votes and agreed is None:
        said.append("these contradict each other")
    return Verdict(None if odd else agreed, tuple(said), odd)


def _felt(load: Array | None, own: Array, other: Array) -> float | None:
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
    spare = len(y) - base.shape[1] - added.shape[1]
    explained, left = float(gain @ gain), float(np.sum((rest - gain) ** 2))
    from scipy.special import fdtrc

    if fdtrc(2, spare, explained / 2 / max(left / spare, 1e-300)) > CHANCE:
        return 0.0
    share = np.sqrt(explained / apart / len(y)) / max(float(np.sqrt(np.mean(y**2))), 1e-300)
    return float(np.sign(gain @ free[:, 0]) * share)


def _quality(first: Rotor, second: Rotor) -> tuple[float, float] | None:
    """T^1.25 / (Q n^0.5) of the first over the second's and their thrusts' ratio, at about equal speeds."""
    if first.thrust is None or second.thrust is None or np.ptp(first.speed) <= 0:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = first.speed / second.speed
    rows = (ratio > EQUAL[0]) & (ratio < EQUAL[1]) & (first.speed > 0.4 * first.speed.max())
    rows &= (first.thrust > 0) & (second.thrust > 0)
    for name, power in (("torque", 0), ("power", 1)):
        a, b = getattr(first, name), getattr(second, name)
        if a is None or b is None:
            continue
        good = rows & (a > 0) & (b > 0)
        if good.sum() < FEWEST:
            continue
        n = ratio[good]
        thrust = first.thrust[good] / second.thrust[good]
        quality = thrust**1.25 / (a[good] / b[good]) * n ** (power - 0.5)
        q = np.log(quality)
        error = 1.2533 * float(np.std(q)) / np.sqrt(len(q))  # of a median
        middle = float(np.median(q))
        if abs(middle) < 5 * error:
            return None
        return float(np.exp(middle)), float(np.median(thrust / n**2))
    return None
