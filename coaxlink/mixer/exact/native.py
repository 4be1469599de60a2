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
from coaxlink.mixer.edge import POWERS, STRAIGHT, Edge
from coaxlink.mixer.exact.arms import standing
from coaxlink.mixer.exact.compiled import function, kept_code
from coaxlink.mixer.exact.law import FAR, STEPS, ExactLaw
from coaxlink.mixer.exact.solver import Arms, State
from coaxlink.vehicle import Vehicle

# the book: the numbers of Arms, terms of a surface and of a power, rotors, shape of a torque; then addresses
# of the arrays of Arms and of State, of the units of a demand, of the slots, of what speeds are told by
FIRST = Arms._fields.index("surface")  # before it stand numbers
SIZES, ARRAYS = 11, len(Arms._fields) - FIRST + len(State._fields)
BOOK = SIZES + ARRAYS + 3


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
        self._edge = _edge_numbers(Edge.of(vehicle))
        self.address = int(_function().address)

    def command(self, roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        """(N,) motor commands, outside of any flight."""
        return self._speeds(roll, pitch, yaw, thrust)

    def book(self) -> NDArray[np.int64]:
        """As new, standing where it hovers; it lives until the next one is made."""
        p = self._law.arms
        self._alive = standing(p)
        numbers, shape = self._edge
        arrays = [*p[FIRST:], *self._alive, self._units, self._slots, numbers]
        tables = [p.surface.shape[2], p.power.shape[1]]
        sizes = [*p[:FIRST], *tables, len(self._slots), *shape]
        return np.array([*sizes, *(a.ctypes.data for a in arrays)], np.int64)


def _edge_numbers(edge: Edge) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """[driven, nominal (POWERS), of both drives: command (POWERS), per torque (2), least, torque], shape."""
    drives = edge.drives or (STRAIGHT, STRAIGHT)
    torques = [np.array(drive.torque.coefficients) for drive in drives]
    rows, columns = (max(t.shape[i] for t in torques) for i in (0, 1))
    numbers = [0.0 if edge.straight else 1.0, *(edge.nominal or STRAIGHT.command)]
    for drive, torque in zip(drives, torques, strict=True):
        dense = np.zeros((rows, columns))
        dense[: torque.shape[0], : torque.shape[1]] = torque
        numbers += [*drive.command, *drive.per_torque, drive.least, *dense.ravel().tolist()]
    return np.array(numbers), (rows, columns)


@cache
def _function() -> Any:
    """Compiled, and kept on disk where only we can write."""
    import numba
    from numba import carray, types
    from numba.extending import intrinsic

    optimum = function()

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
        arms, m, at = book[0], book[1], book[SIZES:]
        n, rotors, rows, columns = 2 * arms, book[8], book[9], book[10]
        p = Arms(
            arms, m, book[2], book[3], book[4], book[5],
            carray(f(at[0]), (arms, m, book[6])), carray(f(at[1]), (arms, book[7])),
            carray(f(at[2]), (arms, m, 4)), carray(f(at[3]), n), carray(f(at[4]), n), carray(f(at[5]), 4),
            carray(f(at[6]), (n, 4)), carray(f(at[7]), (arms, 4)), carray(f(at[8]), n), carray(f(at[9]), 1),
        )  # fmt: skip
        s = State(
            carray(f(at[10]), 4), carray(f(at[11]), n), carray(i(at[12]), n), carray(f(at[13]), 4),
            carray(i(at[14]), 4), carray(f(at[15]), 4), carray(f(at[16]), 1), carray(f(at[17]), n),
            carray(f(at[18]), (n, 4)), carray(f(at[19]), (arms, 3)), carray(f(at[20]), n),
            carray(f(at[21]), (n, 4)), carray(f(at[22]), n), carray(f(at[23]), (4, 4)),
            carray(f(at[24]), (4, 4)), carray(f(at[25]), 4), carray(f(at[26]), 4), carray(f(at[27]), 4),
            carray(f(at[28]), n), carray(f(at[29]), n), carray(f(at[30]), n), carray(f(at[31]), (3, 4)),
            carray(f(at[32]), (3, 4)), carray(i(at[33]), (3, 4)), carray(f(at[34]), (3, n)),
            carray(i(at[35]), (3, n)), carray(f(at[36]), 1), carray(f(at[37]), n), carray(f(at[38]), 5),
            carray(f(at[39]), 1),
        )  # fmt: skip
        units, slots = carray(f(at[ARRAYS]), (2, 4)), carray(i(at[ARRAYS + 1]), rotors)
        drive = POWERS + 3 + rows * columns
        edge = carray(f(at[ARRAYS + 2]), 1 + POWERS + 2 * drive)
        command = carray(command_at, rotors)
        for j in range(4):
            s.mu[j] = min(max(demand[int(units[1, j])] * units[0, j], -FAR), FAR)
        optimum(p, s, STEPS)
        for r in range(rotors):
            k, side = slots[r] // 2, slots[r] % 2
            u, line = s.x[2 * k], p.line[k]
            least = line[0] + line[1] * u
            v = least + (line[2] + line[3] * u - least) * s.x[2 * k + 1]
            if edge[0] == 0.0:
                command[r] = min(max(v if side else u, 0.0), 1.0)
                continue
            nu = nv = 0.0
            for j in range(POWERS, 0, -1):
                nu, nv = nu * u + edge[j], nv * v + edge[j]
            nu, nv = max(nu, 0.0), max(nv, 0.0)
            first = 1 + POWERS + side * drive
            mine = nv if side else nu
            floor = edge[first + POWERS + 2]
            held, c, q = max(mine, floor), 0.0, 0.0
            for j in range(POWERS - 1, -1, -1):
                c = c * held + edge[first + j]
            for a in range(rows - 1, -1, -1):
                inner = 0.0
                for b in range(columns - 1, -1, -1):
                    inner = inner * nv + edge[first + POWERS + 3 + a * columns + b]
                q = q * nu + inner
            c += (edge[first + POWERS] + edge[first + POWERS + 1] * mine) * q
            if mine < floor:
                c *= mine / floor
            command[r] = min(max(c, 0.0), 1.0)

    signature = types.void(types.CPointer(types.int64), *[types.CPointer(types.float64)] * 2)
    with kept_code() as keep:
        return numba.cfunc(signature, cache=keep)(law)
