# mypy: disallow-untyped-defs=False
"""The exact law as a C function, for flights that are compiled as a whole: demand in, motor commands out.

`void law(int64 *book, double *demand, double *command)`: demand = (roll, pitch, yaw, thrust) normalised, as
`mixer.demands.law_commands` has them. The book holds the addresses of the solver's arrays, so that every
flight has a memory of its own.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.mixer.demands import demand_units, law_commands
from coaxlink.mixer.exact.compiled import functions, kept_code
from coaxlink.mixer.exact.law import FAR, STEPS, ExactLaw, standing
from coaxlink.mixer.exact.solver import Arms, State
from coaxlink.vehicle import Vehicle

# the book: arms, orders, terms of a load, rotors; then addresses of the arrays of Arms and of State, of the
# units of a demand and of the slots
SIZES, ARRAYS = 5, len(Arms._fields) - 3 + len(State._fields)
BOOK = SIZES + ARRAYS + 2


class NativeExact:
    """The exact law of a vehicle, callable from compiled code; see the module."""

    name = "exact"

    def __init__(self, vehicle: Vehicle) -> None:
        frame = vehicle.airframe
        full = float(frame.wrench(*frame.loads(vehicle.model, vehicle.full))[0])
        self._law = ExactLaw(vehicle, compiled=True)
        self._speeds = law_commands(self._law, vehicle, full)
        order, scale = self._law.units.order, self._law.units.scale
        units = demand_units(frame, full)[order] / scale
        # (2, 4): wrench of a unit of demand by rank, in the solver's unit; where that demand stands
        self._units = np.stack([units, np.array([3.0, 0.0, 1.0, 2.0])[order]])
        self._slots = np.ascontiguousarray(self._law.units.slots, np.int64)
        self._alive: State | None = None
        self.address = int(_function().address)

    def command(self, roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        """(N,) motor commands, outside of any flight."""
        return self._speeds(roll, pitch, yaw, thrust)

    def book(self) -> NDArray[np.int64]:
        """As new, standing in the middle of the bounds; it lives until the next one is made."""
        p = self._law.arms
        self._alive = standing(p)
        arrays = [*p[3:], *self._alive, self._units, self._slots]
        sizes = [p.size, p.upper_order, p.lower_order, p.load.shape[2], len(self._slots)]
        return np.array([*sizes, *(a.ctypes.data for a in arrays)], np.int64)


@cache
def _function() -> Any:
    """Compiled, and kept on disk where only we can write."""
    import numba
    from numba import carray, types
    from numba.extending import intrinsic

    optimum, _ = functions()

    def pointer_to(kind):
        @intrinsic
        def pointer(typingctx, address):
            def build(context, builder, sig, args):
                return builder.inttoptr(args[0], context.get_value_type(sig.return_type))

            return types.CPointer(kind)(address), build

        return pointer

    f, i = pointer_to(types.float64), pointer_to(types.int64)

    def law(book_at, demand_at, command_at):
        book, demand = carray(book_at, BOOK), carray(demand_at, 4)
        arms, rotors, at = book[0], book[4], book[SIZES:]
        n = 2 * arms
        p = Arms(
            arms, book[1], book[2], carray(f(at[0]), (arms, 4, book[3])), carray(f(at[1]), (arms, 4, 4)),
            carray(f(at[2]), n), carray(f(at[3]), n), carray(f(at[4]), 4),
        )  # fmt: skip
        s = State(
            carray(f(at[5]), 4), carray(f(at[6]), n), carray(i(at[7]), n), carray(f(at[8]), 4),
            carray(i(at[9]), 4), carray(f(at[10]), 4), carray(f(at[11]), 1), carray(f(at[12]), n),
            carray(f(at[13]), (n, 4)), carray(f(at[14]), (arms, 3)), carray(f(at[15]), n),
            carray(f(at[16]), (n, 4)), carray(f(at[17]), n), carray(f(at[18]), (4, 4)),
            carray(f(at[19]), (4, 4)), carray(f(at[20]), 4), carray(f(at[21]), 4), carray(f(at[22]), 4),
            carray(f(at[23]), n), carray(f(at[24]), n), carray(f(at[25]), n), carray(f(at[26]), (3, 4)),
            carray(f(at[27]), (3, 4)), carray(i(at[28]), (3, 4)), carray(f(at[29]), (3, n)),
            carray(i(at[30]), (3, n)), carray(f(at[31]), 1),
        )  # fmt: skip
        units, slots = carray(f(at[ARRAYS]), (2, 4)), carray(i(at[ARRAYS + 1]), rotors)
        command = carray(command_at, rotors)
        for j in range(4):
            s.mu[j] = min(max(demand[int(units[1, j])] * units[0, j], -FAR), FAR)
        optimum(p, s, STEPS)
        for r in range(rotors):
            command[r] = s.x[slots[r]]

    signature = types.void(types.CPointer(types.int64), *[types.CPointer(types.float64)] * 2)
    with kept_code() as keep:
        return numba.cfunc(signature, cache=keep)(law)
