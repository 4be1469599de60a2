"""The exact law for what is left of the rotors: made when one is called, handed to the loop.

A rotor that lost a share of its thrust has that share in the model from then on, one that stopped
stands still; bounds, and the order in which axes are given up (yaw first), stay. Nothing takes a rotor back:
`coaxlink mix` begins with all of them when it is started again. Making a law takes a millisecond and is done
by whoever watches; the loop changes over between two demands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError
from coaxlink.mixer.exact import ExactLaw

if TYPE_CHECKING:
    from coaxlink.live.in_air import Call, InAir
    from coaxlink.live.mixer import LiveMixer
    from coaxlink.vehicle import Vehicle


class Reallocation:
    """Of one live mixer. Raises InputError where it does not fly the exact law."""

    def __init__(self, live: LiveMixer) -> None:
        law = live.core.law
        if not isinstance(law, ExactLaw):
            raise InputError("`reallocate`", law.name, "only the exact law re-allocates")
        self._live, self._law, self._first = live, law, live.core.vehicle
        self.done: tuple[dict[str, Any], ...] = ()

    def answer(self, call: Call, in_air: InAir) -> None:
        """Of a stop at once; of a loss when its size is settled."""
        if not (call.stopped or call.settled):
            return
        vehicle, stopped = in_air.vehicle, in_air.stopped
        self._live.adopt(law_without(self._law, vehicle, stopped), vehicle)
        left = 0.0 if call.rotor in stopped else self._left(vehicle, call.rotor)
        self.done = (*self.done, {"rotor": call.rotor, "time_s": call.time_s, "thrust_left": left})

    def _left(self, vehicle: Vehicle, number: int) -> float:
        """Share of a rotor's thrust at the start that it still gives, after all of its calls."""
        now, first = (
            next(r.thrust_gain for r in v.declared.rotors if r.number == number)
            for v in (vehicle, self._first)
        )
        return now / first if first else 0.0


def law_without(law: ExactLaw, vehicle: Vehicle, stopped: tuple[int, ...] = ()) -> ExactLaw:
    """`law` for a vehicle some of whose rotors are weak and some stand still, its caches filled."""
    law = law.without(vehicle, stopped)
    law.speeds([GRAVITY_M_S2 * vehicle.airframe.mass_kg, 0.0, 0.0, 0.0])
    return law
