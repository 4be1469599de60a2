"""A flight that lifts a few per cent more or less than model and mass say: the mass, or the thrust's level?

The force alone cannot tell, for a stand may be off by as much. The torques can: what scales the rotors'
thrust scales the roll and the pitch that they make by the same share, while a mass on the centre leaves both
alone. Only if both declared moments of inertia were off by that very share as well would a level of thrust
look like a mass; drawings err by 5 %, so that both lie within a fifth of a share of 3 % once in a hundred. A
mass that hangs below adds inertia and lies between the two: then the answer stays open.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from coaxlink.channels.flight_corrections import lift_room, lift_share
from coaxlink.effects.tracing import Array
from coaxlink.evidence.held_out import Index
from coaxlink.frames import FlightFrame
from coaxlink.residual.result import Ambiguous
from coaxlink.signals import derivative

DOUBTFUL_LIFT = 0.73  # of what a stand may miss of the lift (2.2 % of 3): less is its own
LIKE = 0.2  # of the lift's share: torques this near to nothing, or to the lift, side with it
SURE = 2.0  # standard deviations
MASS, SAG = "mass_change", "battery_voltage"
MASS_OR_THRUST = (MASS, "thrust_level")
LEAST_SD = 0.0005  # what blocks of one flight do not show


@dataclass(frozen=True)
class Scales:
    """Measured over predicted, less one: of the lift, and (2,) of roll and pitch torque with their sigma."""

    lift: float
    torque: Array
    sigma: Array
    doubt: float  # share of the lift by which the rotor model may be off in hover

    @property
    def verdict(self) -> str:
        """mass, level, or open."""
        if abs(self.lift) < self.doubt:
            return "none"
        reach = SURE * self.sigma
        room = LIKE * abs(self.lift)
        if np.all(np.abs(self.torque) + reach < 1.5 * room) and np.all(np.abs(self.torque) < room):
            return "mass"
        off = np.abs(self.torque - self.lift)
        if np.all(off + reach < 1.5 * room) and np.all(off < room):
            return "level"
        return "open"

    @property
    def turns_too(self) -> bool:
        """Whether both torques are clearly off, and the lift's share is within a factor of two of each (gusts
        that the loops answer scale them by far more).
        """
        clear = np.abs(self.torque) > SURE * self.sigma
        near = np.abs(self.torque - self.lift) < np.minimum(np.abs(self.torque), abs(self.lift))
        return bool(np.all(clear & near))


def scales(
    acting: FlightFrame, corrections: Mapping[str, float], block: Index, reduce: Callable[[Array], Array]
) -> Scales:
    """Of a flight with its effects acting; `block` (kept,): the judged rows'."""
    late = derivative(acting.predicted, acting.rate_hz)
    left, predicted, slope = (
        reduce(values[:, 3:5]) for values in (acting.measured - acting.predicted, acting.predicted, late)
    )
    torque, sigma = np.zeros(2), np.zeros(2)
    for k in range(2):
        columns = np.stack([predicted[:, k], slope[:, k], np.ones(len(left))], axis=1)
        torque[k], sigma[k] = _first(columns, left[:, k], block)
    return Scales(lift_share(acting, corrections), torque, np.hypot(sigma, LEAST_SD), own_doubt(acting))


def _first(columns: Array, values: Array, block: Index) -> tuple[float, float]:
    """First coefficient of a least-squares fit, and its sigma with whole blocks left out in turn."""
    count = int(block.max()) + 1
    grams = np.stack([columns[block == b].T @ columns[block == b] for b in range(count)])
    moments = np.stack([columns[block == b].T @ values[block == b] for b in range(count)])
    gram, moment = grams.sum(axis=0), moments.sum(axis=0)
    ridge = 1e-12 * np.diag(np.diag(gram)) + 1e-30 * np.eye(len(gram))
    whole = float(np.linalg.solve(gram + ridge, moment)[0])
    without = np.array(
        [np.linalg.solve(gram - g + ridge, moment - m)[0] for g, m in zip(grams, moments, strict=True)]
    )
    return whole, float(np.sqrt((count - 1) / count * np.sum((without - without.mean()) ** 2)))


def doubt(frame: FlightFrame, s: Scales, explained: bool) -> list[Ambiguous]:
    """What is reported where the lift is off and the torques, if `explained`, do not side with a mass."""
    if s.verdict == "none" or (s.verdict == "mass" and explained):
        return []
    low, high = 100.0 * (s.torque - SURE * s.sigma), 100.0 * (s.torque + SURE * s.sigma)
    why = f"roll torque {low[0]:+.1f} to {high[0]:+.1f} %, pitch torque {low[1]:+.1f} to {high[1]:+.1f} %"
    if not explained:
        why = f"the torques hold more than that ({why}) and do not tell"
    elif s.verdict == "level":
        why = f"the torques are off alike ({why}): a level of thrust is likelier"
    elif np.any(SURE * s.sigma > LIKE * abs(s.lift)):
        why = f"too calm a flight to see whether the torques are off alike ({why}): roll and pitch it briskly"
    else:
        why = f"the torques side with neither ({why}): inertia differs from the declared one as well"
    return [weighing(frame, s.lift, f"within what a stand may be wrong by; {why}")]


def level_not_mass(frame: FlightFrame, s: Scales, mass_kg: float) -> Ambiguous | None:
    """The doubt about a mass that was found, where roll and pitch are off as the lift is: what scales the
    thrust does that, a mass does not. None where they are not.
    """
    both = replace(s, lift=s.lift + frame.airframe.mass_kg / mass_kg - 1.0)
    if not both.turns_too:
        return None
    roll, pitch = 100.0 * s.torque
    return weighing(frame, both.lift, f"and roll torque by {roll:+.1f}, pitch torque by {pitch:+.1f} %")


def lift_beside(acting: FlightFrame, mass_kg: float) -> float:
    """Share that a flight lifts more than model and declared mass say, beside all that acts but this mass."""
    measured, predicted = (float(np.median(f[acting.keep, 2])) for f in (acting.measured, acting.predicted))
    return measured / predicted * acting.airframe.mass_kg / mass_kg - 1.0


def own_doubt(frame: FlightFrame) -> float:
    """Share of the lift by which a rotor model may be off in hover."""
    return DOUBTFUL_LIFT * lift_room(frame)


def weighing(frame: FlightFrame, lift: float, why: str = "and a stand errs by less") -> Ambiguous:
    """The doubt about a lift that is off by this share."""
    mass, way = frame.airframe.mass_kg, "more" if lift > 0 else "less"
    text = (
        f"the vehicle lifts {100 * abs(lift):.1f} % {way} than model and mass say, {why}. "
        f"To be sure: weigh it. {mass / (1.0 + lift):.2f} kg on the scales instead of {mass:.2f} is "
        f"mass_change, {mass:.2f} kg a level of thrust"
    )
    if lift < 0.0 and frame.voltage is None:  # a level that the log could have shown
        return Ambiguous((*MASS_OR_THRUST, SAG), f"{text}, or a pack that sagged: log voltage_V")
    return Ambiguous(MASS_OR_THRUST, text)
