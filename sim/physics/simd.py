"""A compiled type of its own: a few floats side by side in vector registers, with arithmetic.

Eight rotors are too few for a compiler to make vectors of a loop over them; written with `Lanes`, the physics
of one rotor is that of all. The first half of the lanes are upper (and single) rotors, the second half the
lower ones below them.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin
from numba.extending import intrinsic, models, register_model, type_callable

DOUBLE = ir.DoubleType()


class Lanes(types.Type):
    """`n` floats."""

    def __init__(self, n: int) -> None:
        self.n = n
        super().__init__(name=f"Lanes({n})")


@register_model(Lanes)
class _Model(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Lanes) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(DOUBLE, fe_type.n))


def _spread(builder: Any, value: Any, n: int) -> Any:
    kind = ir.VectorType(DOUBLE, n)
    first = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), n), [0] * n)
    return builder.shuffle_vector(first, ir.Constant(kind, ir.Undefined), zeros)


def _operator(op: Any, instruction: str) -> None:
    @type_callable(op)
    def typing(context: Any) -> Any:
        def typer(a: Any, b: Any) -> Any:
            numbers = (types.Integer, types.Float)
            if isinstance(a, types.Literal) or isinstance(b, types.Literal):
                return None
            if isinstance(a, Lanes) and (a == b or isinstance(b, numbers)):
                return a
            return b if isinstance(b, Lanes) and isinstance(a, numbers) else None

        return typer

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        n = sig.return_type.n
        values = []
        for kind, value in zip(sig.args, args, strict=True):
            if not isinstance(kind, Lanes):
                value = _spread(builder, context.cast(builder, value, kind, types.float64), n)
            values.append(value)
        return getattr(builder, instruction)(*values)

    for kinds in ((Lanes, Lanes), (Lanes, types.Number), (types.Number, Lanes)):
        lower_builtin(op, *kinds)(lower)


for _op, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _operator(_op, _instruction)


def _each(kind: Lanes) -> str:
    return f"v{kind.n}f64"


@intrinsic
def root(typingctx, x):  # type: ignore[no-untyped-def]
    """Square roots."""

    def build(context, builder, sig, args):  # type: ignore[no-untyped-def]
        kind = args[0].type
        name = f"llvm.sqrt.{_each(sig.return_type)}"
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), name)
        return builder.call(function, args)

    return x(x), build


def _chosen(builder: Any, sig: Any, args: Any, test: str) -> Any:
    a, b = args
    if not isinstance(sig.args[1], Lanes):
        b = _spread(builder, b, sig.return_type.n)
    return builder.select(builder.fcmp_ordered(test, a, b), a, b)


@intrinsic
def above(typingctx, a, b):  # type: ignore[no-untyped-def]
    """The larger of each, b lanes or a float."""
    return a(a, b), lambda context, builder, sig, args: _chosen(builder, sig, args, ">")


@intrinsic
def below(typingctx, a, b):  # type: ignore[no-untyped-def]
    """The smaller of each, b lanes or a float."""
    return a(a, b), lambda context, builder, sig, args: _chosen(builder, sig, args, "<")


@intrinsic
def rising(typingctx, way, up, down):  # type: ignore[no-untyped-def]
    """The float `up` where `way` is above zero, else the float `down`."""

    def build(context, builder, sig, args):  # type: ignore[no-untyped-def]
        n = sig.return_type.n
        zero = ir.Constant(args[0].type, [0.0] * n)
        test = builder.fcmp_ordered(">", args[0], zero)
        return builder.select(test, _spread(builder, args[1], n), _spread(builder, args[2], n))

    return way(way, types.float64, types.float64), build


def _shuffled(builder: Any, a: Any, b: Any, order: list[int]) -> Any:
    mask = ir.Constant(ir.VectorType(ir.IntType(32), len(order)), order)
    return builder.shuffle_vector(a, b, mask)


@intrinsic
def upper(typingctx, x):  # type: ignore[no-untyped-def]
    """The first half."""
    half = x.n // 2
    return Lanes(half)(x), lambda c, builder, sig, args: _shuffled(
        builder, args[0], args[0], list(range(half))
    )


@intrinsic
def lower(typingctx, x):  # type: ignore[no-untyped-def]
    """The second half."""
    half = x.n // 2
    order = list(range(half, 2 * half))
    return Lanes(half)(x), lambda c, builder, sig, args: _shuffled(builder, args[0], args[0], order)


@intrinsic
def both(typingctx, a, b):  # type: ignore[no-untyped-def]
    """Two halves side by side."""
    order = list(range(2 * a.n))
    return Lanes(2 * a.n)(a, b), lambda c, builder, sig, args: _shuffled(builder, args[0], args[1], order)


@intrinsic
def total(typingctx, x):  # type: ignore[no-untyped-def]
    """Sum over the lanes, halves upon halves."""

    def build(context, builder, sig, args):  # type: ignore[no-untyped-def]
        value, n = args[0], sig.args[0].n
        while n > 1:
            n //= 2
            low = _shuffled(builder, value, value, list(range(n)))
            value = builder.fadd(low, _shuffled(builder, value, value, list(range(n, 2 * n))))
        return builder.extract_element(value, ir.Constant(ir.IntType(32), 0))

    return types.float64(x), build


def _address(context: Any, builder: Any, kind: Any, array: Any, row: Any, n: int) -> Any:
    view = context.make_array(kind)(context, builder, array)
    at = builder.gep(view.data, [builder.mul(row, ir.Constant(row.type, n))])
    return builder.bitcast(at, ir.VectorType(DOUBLE, n).as_pointer())


@intrinsic
def read(typingctx, array, row, lanes):  # type: ignore[no-untyped-def]
    """Row `row` of a flat array whose rows are twice as long as the tuple `lanes`."""
    kind = Lanes(2 * len(lanes))

    def build(context, builder, sig, args):  # type: ignore[no-untyped-def]
        loaded = builder.load(_address(context, builder, sig.args[0], args[0], args[1], kind.n))
        loaded.align = 8
        return loaded

    return kind(array, types.intp, lanes), build


@intrinsic
def write(typingctx, array, row, value):  # type: ignore[no-untyped-def]
    """Store lanes as row `row` of a flat array."""

    def build(context, builder, sig, args):  # type: ignore[no-untyped-def]
        address = _address(context, builder, sig.args[0], args[0], args[1], sig.args[2].n)
        builder.store(args[2], address).align = 8
        return context.get_dummy_value()

    return types.void(array, types.intp, value), build
