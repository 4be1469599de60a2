# mypy: disallow-untyped-defs=False
"""The exact law as a C function, for flights that are compiled as a whole: demand in, motor commands out.

`void law(int64 *book, double *demand, double *command)`: demand = (roll, pitch, yaw, thrust) normalised, as
`mixer.demands.law_commands` has them. The book holds the addresses of the solver's arrays, so that every
flight has a memory of its own.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coaxlink.mixer.demands import demand_units, law_commands
from coaxlink.mixer.edge import POWERS, STRAIGHT, Edge
from coaxlink.mixer.exact.arms import standing
from coaxlink.mixer.exact.compiled import function, kept_code
from coaxlink.mixer.exact.law import FAR, STEPS, ExactLaw
from coaxlink.mixer.exact.solver import Arms, State
from coaxlink.vehicle import Vehicle


class Own(NamedTuple):
    """What the book has beside Arms and State: sizes, then arrays."""

    surface_terms: Any
    power_terms: Any
    rotors: Any
    torque_rows: Any
    torque_columns: Any
    driven: Any  # whether the numbers of a drive bend commands
    units: Any  # (4,) wrench of a unit of demand by rank, in the solver's unit
    demands: Any  # (4,) where that demand stands
    slots: Any  # (rotors,) which of the 2K coordinates is rotor n's
    nominal: Any  # (POWERS,) of the nominal speed over the true one
    command: Any  # (2, POWERS) of an upper and of a lower rotor: command over speed
    per_torque: Any  # (2, 2)
    least: Any  # (2,) least speed that was measured
    torque: Any  # (2, rows, columns)


# the book: these one after the other, every array as its address
ARMS, STATE, OWN = len(Arms._fields), len(State._fields), len(Own._fields)


class NativeExact:
    """The exact law of a vehicle, callable from compiled code; see the module."""

    name = "exact"

    def __init__(self, vehicle: Vehicle) -> None:
        frame = vehicle.airframe
        full = float(frame.wrench(*frame.loads(vehicle.model, vehicle.full))[0])
        self._law = ExactLaw(vehicle, compiled=True)
        self._speeds = law_commands(self._law, vehicle, full)
        order, scale = self._law.units.order, self._law.units.scale
        self._own = _own(Edge.of(vehicle), self._law, demand_units(frame, full)[order] / scale)
        self._alive: State | None = None
        self.address = int(_function().address)

    def command(self, roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        """(N,) motor commands, outside of any flight."""
        return self._speeds(roll, pitch, yaw, thrust)

    def book(self) -> NDArray[np.int64]:
        """As new, standing where it hovers; it lives until the next one is made."""
        p = self._law.arms
        self._alive = standing(p)
        entries = (*p, *self._alive, *self._own)
        return np.array([e.ctypes.data if isinstance(e, np.ndarray) else e for e in entries], np.int64)


def _own(edge: Edge, law: ExactLaw, units: NDArray[np.float64]) -> Own:
    drives = edge.drives or (STRAIGHT, STRAIGHT)
    torques = [np.array(drive.torque.coefficients) for drive in drives]
    rows, columns = (max(t.shape[i] for t in torques) for i in (0, 1))
    dense = np.zeros((2, rows, columns))
    for side, torque in enumerate(torques):
        dense[side, : torque.shape[0], : torque.shape[1]] = torque
    return Own(
        surface_terms=law.arms.surface.shape[2],
        power_terms=law.arms.power.shape[1],
        rotors=len(law.units.slots),
        torque_rows=rows,
        torque_columns=columns,
        driven=int(not edge.straight),
        units=np.ascontiguousarray(units, float),
        demands=np.array([3, 0, 1, 2], np.int64)[law.units.order],
        slots=np.ascontiguousarray(law.units.slots, np.int64),
        nominal=np.array(edge.nominal or STRAIGHT.command),
        command=np.array([drive.command for drive in drives]),
        per_torque=np.array([drive.per_torque for drive in drives]),
        least=np.array([drive.least for drive in drives]),
        torque=dense,
    )


# what `law` calls, loaded by `_function`: of this module, for numba keys code on disk by a closure's pickled
# contents, which differ in every process
carray: Any = None
to_fixed_tuple: Any = None
optimum: Any = None
f: Any = None  # arrays of float64 at an address
i: Any = None  # of int64


def law(book_at, demand_at, command_at):
    """The law as the module says, for numba alone: its names are there once `_function` has loaded them."""
    book, demand = carray(book_at, ARMS + STATE + OWN), carray(demand_at, 4)
    a = Arms(*to_fixed_tuple(book[:ARMS], ARMS))  # of addresses, as are the next two
    t = State(*to_fixed_tuple(book[ARMS : ARMS + STATE], STATE))
    o = Own(*to_fixed_tuple(book[ARMS + STATE :], OWN))
    arms, m, n = a.size, a.surfaces, 2 * a.size
    p = Arms(
        size=arms, surfaces=m, order_u=a.order_u, order_s=a.order_s, power_u=a.power_u,
        power_s=a.power_s, surface=carray(f(a.surface), (arms, m, o.surface_terms)),
        power=carray(f(a.power), (arms, o.power_terms)), gain=carray(f(a.gain), (arms, m, 4)),
        lo=carray(f(a.lo), n), hi=carray(f(a.hi), n), cap=carray(f(a.cap), 4),
        squares=carray(f(a.squares), (n, 4)), line=carray(f(a.line), (arms, 4)),
        home=carray(f(a.home), n), within=carray(f(a.within), 1),
    )  # fmt: skip
    s = State(
        mu=carray(f(t.mu), 4), x=carray(f(t.x), n), act=carray(i(t.act), n), price=carray(f(t.price), 4),
        gone=carray(i(t.gone), 4), miss=carray(f(t.miss), 4), power=carray(f(t.power), 1),
        slope=carray(f(t.slope), n), jacobian=carray(f(t.jacobian), (n, 4)),
        hessian=carray(f(t.hessian), (arms, 3)), own=carray(f(t.own), n),
        reply=carray(f(t.reply), (n, 4)), step=carray(f(t.step), n), schur=carray(f(t.schur), (4, 4)),
        factor=carray(f(t.factor), (4, 4)), right=carray(f(t.right), 4), dual=carray(f(t.dual), 4),
        before=carray(f(t.before), 4), low=carray(f(t.low), n), high=carray(f(t.high), n),
        kept=carray(f(t.kept), n), old_mu=carray(f(t.old_mu), (3, 4)),
        old_price=carray(f(t.old_price), (3, 4)), old_gone=carray(i(t.old_gone), (3, 4)),
        old_x=carray(f(t.old_x), (3, n)), old_act=carray(i(t.old_act), (3, n)),
        smooth=carray(f(t.smooth), 1), best=carray(f(t.best), n), looked=carray(f(t.looked), 9),
        looks=carray(f(t.looks), 1),
    )  # fmt: skip
    units, demands, slots = carray(f(o.units), 4), carray(i(o.demands), 4), carray(i(o.slots), o.rotors)
    nominal, straight = carray(f(o.nominal), POWERS), carray(f(o.command), (2, POWERS))
    per_torque, least = carray(f(o.per_torque), (2, 2)), carray(f(o.least), 2)
    torque = carray(f(o.torque), (2, o.torque_rows, o.torque_columns))
    command = carray(command_at, o.rotors)
    for j in range(4):
        s.mu[j] = min(max(demand[demands[j]] * units[j], -FAR), FAR)
    optimum(p, s, np.int64(STEPS))  # of a literal there would be another to compile
    for r in range(o.rotors):
        k, side = slots[r] // 2, slots[r] % 2
        u, line = s.x[2 * k], p.line[k]
        low = line[0] + line[1] * u
        v = low + (line[2] + line[3] * u - low) * s.x[2 * k + 1]
        if o.driven == 0:
            command[r] = min(max(v if side else u, 0.0), 1.0)
            continue
        nu = nv = 0.0
        for j in range(POWERS - 1, -1, -1):
            nu, nv = nu * u + nominal[j], nv * v + nominal[j]
        nu, nv = max(nu, 0.0), max(nv, 0.0)
        mine = nv if side else nu
        held, c, q = max(mine, least[side]), 0.0, 0.0
        for j in range(POWERS - 1, -1, -1):
            c = c * held + straight[side, j]
        for row in range(o.torque_rows - 1, -1, -1):
            inner = 0.0
            for column in range(o.torque_columns - 1, -1, -1):
                inner = inner * nv + torque[side, row, column]
            q = q * nu + inner
        c += (per_torque[side, 0] + per_torque[side, 1] * mine) * q
        if mine < least[side]:
            c *= mine / least[side]
        command[r] = min(max(c, 0.0), 1.0)


@cache
def _function() -> Any:
    """Compiled, and kept on disk where only we can write."""
    global carray, to_fixed_tuple, optimum, f, i
    import numba
    from numba import types
    from numba.extending import intrinsic
    from numba.np.unsafe import ndarray

    def pointer_to(kind):
        @intrinsic
        def pointer(typingctx, address):
            def build(context, builder, sig, args):
                return builder.inttoptr(args[0], context.get_value_type(sig.return_type))

            return types.CPointer(kind)(address), build

        return pointer

    carray, to_fixed_tuple, optimum = numba.carray, ndarray.to_fixed_tuple, function()
    f, i = pointer_to(types.float64), pointer_to(types.int64)
    signature = types.void(types.CPointer(types.int64), *[types.CPointer(types.float64)] * 2)
    with kept_code() as keep:
        return numba.cfunc(signature, cache=keep)(law)
