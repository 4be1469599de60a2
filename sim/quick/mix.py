# mypy: disallow-untyped-defs=False
"""Motor commands of a demand, compiled: what PX4 makes of a table, or a function that someone else compiled.

PX4's mix is that of `firmware_params.px4.realise` (the tests hold the two together to the last bit, float32
as PX4 counts): mixing, sequential desaturation without airmode, clipping, the thrust curve.
A companion's law comes as the address of a C function
`void law(int64 *book, double *demand, double *command)`, demand = (roll, pitch, yaw, thrust), normalised;
what `book` holds is the law's own business.
"""

from __future__ import annotations

import math

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, register_jitable

WEAK_ACTUATOR = 0.2  # an entry below this is not used to get out of saturation
YAW_MARGIN = 0.15
FLT_EPSILON = 1.1920928955078125e-07
ROLL, PITCH, YAW, THRUST_Z = 0, 1, 2, 5

exactly = register_jitable(
    forceinline=True, error_model="numpy"
)  # no reordering: float32 sums decide the last bit


@exactly
def gain_of(sp, column, ceiling):
    """How far along a mix column the worst over- and undershoot lie, added (float32)."""
    low = high = 0.0
    for i in range(len(sp)):
        entry, s = np.float64(column[i]), np.float64(sp[i])
        if abs(entry) < WEAK_ACTUATOR or 0.0 <= s <= ceiling:
            continue
        k = -s / entry if s < 0.0 else (ceiling - s) / entry
        if k < low:
            low = k
        elif k > high:
            high = k
    return np.float32(low) + np.float32(high)


@exactly
def desaturate(sp, column, ceiling, reduce_only):
    """Shift `sp` along a column, a full step and a half one; the thrust column is negative."""
    for share in (1.0, 0.5):
        gain = np.float64(gain_of(sp, column, ceiling))
        if gain == 0.0 or (share == 1.0 and reduce_only and gain < 0.0):
            return
        step = np.float32(share * gain)
        for i in range(len(sp)):
            sp[i] = sp[i] + step * column[i]


@exactly
def px4_command(columns, curve, roll, pitch, yaw, thrust, sp, command):
    """Fill command (N,) from a normalised mix `columns` (6, N) float32; `sp` (N,) float32 is scratch."""
    r, p, y, t = np.float32(roll), np.float32(pitch), np.float32(yaw), np.float32(-thrust)
    for i in range(len(sp)):
        sp[i] = columns[ROLL, i] * r + columns[PITCH, i] * p
        sp[i] = sp[i] + columns[THRUST_Z, i] * t
    desaturate(sp, columns[THRUST_Z], 1.0, True)
    desaturate(sp, columns[ROLL], 1.0, False)
    desaturate(sp, columns[PITCH], 1.0, False)
    for i in range(len(sp)):
        sp[i] = sp[i] + columns[YAW, i] * y
    desaturate(sp, columns[YAW], 1.0 + YAW_MARGIN, False)
    desaturate(sp, columns[THRUST_Z], 1.0, True)
    for i in range(len(sp)):
        s = min(max(np.float64(sp[i]), 0.0), 1.0)
        if s > FLT_EPSILON and 0.0 < curve <= 1.0:
            half = (1.0 - curve) / (2.0 * curve)
            s = math.sqrt(half * half + s / curve) - half
        command[i] = s


@intrinsic
def call_law(typingctx, address, book, demand, command):
    """Call the C function at `address` with the data of three contiguous arrays."""

    def build(context, builder, sig, args):
        datas = [
            context.make_array(kind)(context, builder, value).data
            for kind, value in zip(sig.args[1:], args[1:], strict=True)
        ]
        shape = ir.FunctionType(ir.VoidType(), [d.type for d in datas])
        function = builder.inttoptr(args[0], shape.as_pointer())
        builder.call(function, datas)
        return context.get_dummy_value()

    return types.void(address, book, demand, command), build
