# mypy: disallow-untyped-defs=False
"""The exact law as a C function, for loops that someone else compiled: demand in, motor commands out.

`void law(int64 *book, double *demand, double *command)`: demand = (roll, pitch, yaw, thrust) normalised, as
`mixer.worth.law_speeds` has them: thrust 1 is the ceiling, a turn of 1 as much as weight x arm. The book
holds the addresses of `exact.kernel`'s arrays, so that every flight has a memory of its own.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink import files
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.mixer.exact.compiled import cache_folder, compiled
from coaxlink.mixer.exact.law import FAR, STEPS, ExactLaw
from coaxlink.mixer.exact.warm import ROWS
from coaxlink.mixer.worth import law_speeds
from coaxlink.vehicle import Vehicle

# the book: sizes, then addresses of the kernel's arrays in its own order, then of the units and slots
ARMS, TERMS, ROTORS, WORK, SUMS, PAST, FIRST = range(7)
ARRAYS = 15  # of `kernel.optimum`, up to its limit
UNITS, SLOTS, BOOK = FIRST + ARRAYS, FIRST + ARRAYS + 1, FIRST + ARRAYS + 2


class NativeExact:
    """The exact law of a vehicle, callable from compiled code; see the module."""

    name = "exact"

    def __init__(self, vehicle: Vehicle) -> None:
        frame, model = vehicle.airframe, vehicle.model
        self._law = ExactLaw(vehicle, compiled=True)
        full = float(frame.wrench(*frame.loads(model, np.ones(len(frame.rotors))))[0])
        arm = max(float(np.hypot(*r.position_m[:2])) for r in frame.rotors)
        turn = frame.mass_kg * GRAVITY_M_S2 * arm
        self._speeds = law_speeds(self._law, frame, full)
        p = self._law.problem
        units = np.array([full, turn, turn, 0.25 * turn])[p.order] / p.scale
        # (2, 4): wrench of a unit of demand by rank, in the kernel's unit; where that demand stands
        self._units = np.stack([units, np.array([3.0, 0.0, 1.0, 2.0])[p.order]])
        self._slots = np.ascontiguousarray(p.slots, np.int64)
        self._alive: list[Any] = []
        self.address = int(_function().address)

    def command(self, roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        """(N,) motor commands, outside of any flight."""
        return self._speeds(roll, pitch, yaw, thrust)

    def book(self) -> NDArray[np.int64]:
        """As new, standing in the middle of the bounds; it lives until the next one is made."""
        p = self._law.problem
        arrays = self._law.arrays()
        self._alive = arrays
        book = np.zeros(BOOK, np.int64)
        book[:FIRST] = (
            p.arms,
            p.c.shape[2],
            len(p.slots),
            arrays[11].shape[1],
            len(arrays[12]),
            arrays[14].shape[1],
        )
        book[FIRST:UNITS] = [a.ctypes.data for a in arrays]
        book[UNITS], book[SLOTS] = self._units.ctypes.data, self._slots.ctypes.data
        return book


@cache
def _function() -> Any:
    """Compiled, and kept on disk where only we can write."""
    import numba
    from numba import carray, types
    from numba.extending import intrinsic

    optimum, _ = compiled()

    def pointer_to(kind):
        @intrinsic
        def pointer(typingctx, address):
            def build(context, builder, sig, args):
                return builder.inttoptr(args[0], context.get_value_type(sig.return_type))

            return types.CPointer(kind)(address), build

        return pointer

    floats, integers = pointer_to(types.float64), pointer_to(types.int64)

    def law(book_at, demand_at, command_at):
        book, demand = carray(book_at, BOOK), carray(demand_at, 4)
        arms, terms, rotors = book[ARMS], book[TERMS], book[ROTORS]
        at = book[FIRST:]
        n = 2 * arms
        c, g = carray(floats(at[0]), (arms, 4, terms)), carray(floats(at[1]), (arms, 16))
        shape = carray(integers(at[2]), 4)
        lo, hi, x = carray(floats(at[3]), n), carray(floats(at[4]), n), carray(floats(at[5]), n)
        act, lam, el = carray(integers(at[6]), n), carray(floats(at[7]), 4), carray(integers(at[8]), 4)
        cap, mu = carray(floats(at[9]), 4), carray(floats(at[10]), 4)
        work, sums = carray(floats(at[11]), (arms, book[WORK])), carray(floats(at[12]), book[SUMS])
        box, past = carray(floats(at[13]), 3 * n), carray(floats(at[14]), (ROWS, book[PAST]))
        units = carray(floats(book[UNITS]), (2, 4))
        slots, command = carray(integers(book[SLOTS]), rotors), carray(command_at, rotors)
        for j in range(4):
            mu[j] = min(max(demand[int(units[1, j])] * units[0, j], -FAR), FAR)
        optimum(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box, past, STEPS)
        for i in range(rotors):
            command[i] = x[slots[i]]

    folder = cache_folder()
    keep = not files.keep_private(folder)
    pointers = (types.CPointer(types.int64), types.CPointer(types.float64), types.CPointer(types.float64))
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder)
    try:
        return numba.cfunc(types.void(*pointers), cache=keep)(law)
    finally:
        numba.config.CACHE_DIR = before
