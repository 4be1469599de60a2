# mypy: disallow-untyped-defs=False
"""Compile the hot loop once, keep its object code, load it without numba.

numba costs 200 ms and 40 MB at every start; LLVM alone (llvmlite, which numba brings along) loads an object
file in 10 ms. The object is kept under a name made of the sources, the processor and the versions, so that
neither an upgrade nor a shared home folder ever runs another's code.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from coaxlink import files

POINTERS = 34  # arguments, all addresses: see `_entry`
KEEP_ALIVE: list[Any] = []  # engines whose code is in use


def available() -> bool:
    """Whether this system is one the loop is written for."""
    return sys.platform.startswith("linux") and sys.maxsize > 2**32


def object_path() -> Path:
    """Where the object code of these very sources for this very processor is kept."""
    import llvmlite
    import llvmlite.binding as llvm

    from coaxlink.link import hot_kernel, hot_serve
    from coaxlink.mixer.exact import dual, kernel, loads, quadratic, schur, warm

    modules = (hot_kernel, hot_serve, kernel, dual, loads, quadratic, schur, warm)
    about = [Path(str(m.__file__)).read_bytes() for m in modules] + [Path(__file__).read_bytes()]
    about += [x.encode() for x in (*_processor(llvm), llvmlite.__version__)]
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "coaxlink" / f"live-{hashlib.sha256(b''.join(about)).hexdigest()[:16]}.o"


def kept() -> bool:
    """Whether the object code is there."""
    try:
        return available() and object_path().exists()
    except ImportError:
        return False


@cache
def load() -> Any:
    """The hot loop as a C function of `_entry`'s arguments, compiled first if need be (half a minute).

    Raises ImportError without numba when it has to be compiled.
    """
    import llvmlite.binding as llvm

    path = object_path()
    if not path.exists():
        files.write_atomic(path, compile_object())
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine(llvm))
    engine.add_object_file(llvm.ObjectFileRef.from_data(path.read_bytes()))
    engine.finalize_object()
    KEEP_ALIVE.append(engine)
    kind = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_void_p] * POINTERS)
    return kind(engine.get_function_address("coaxlink_serve"))


def addresses(arrays: Sequence[Any]) -> list[ctypes.c_void_p]:
    """Of numpy arrays, as arguments for the function."""
    return [ctypes.c_void_p(a.ctypes.data) for a in arrays]


def _processor(llvm: Any) -> tuple[str, str, str]:
    features = llvm.get_host_cpu_features().flatten()
    return llvm.get_default_triple(), llvm.get_host_cpu_name(), features


def _machine(llvm: Any) -> Any:
    triple, name, features = _processor(llvm)
    target = llvm.Target.from_triple(triple)
    return target.create_target_machine(cpu=name, features=features, opt=3, jit=True)


def compile_object() -> bytes:
    """The object code, with one function `coaxlink_serve`; see `_entry` for its arguments."""
    import llvmlite.binding as llvm
    import numba
    from numba.core import types
    from numba.extending import register_jitable

    from coaxlink.link import hot_kernel, hot_serve
    from coaxlink.mixer.exact import compiled

    compiled.register()
    i32, i64, at = types.int32, types.int64, types.int64
    calls = {
        "recvfrom": i64(i32, at, i64, i32, at, at),
        "sendto": i64(i32, at, i64, i32, at, i32),
        "clock_gettime": i32(i32, at),
    }
    for name, signature in calls.items():
        setattr(hot_serve, name, types.ExternalFunction(name, signature))
    for name in (
        "checksum", "find_demand", "unpack", "stamp_of", "acceptable", "ask", "lead", "follow", "command", "pack",
    ):  # fmt: skip
        register_jitable(**compiled.OPTIONS)(getattr(hot_kernel, name))
    for name in ("nanoseconds", "receive", "cut_demands", "serve"):
        register_jitable(**compiled.OPTIONS)(getattr(hot_serve, name))
    register_jitable(**compiled.OPTIONS)(compiled.kernel.optimum)
    # addresses become arrays in the outermost function only, and for that numba wants its reference counts;
    # these arrays have none, and nothing is ever allocated
    options = {**compiled.OPTIONS, "_nrt": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    signature = _signature(types)
    dispatcher = numba.njit(signature, **options)(_entry(numba.carray))
    (result,) = dispatcher.overloads.values()
    text = _without_runtime(result.library.get_llvm_str()) + _plain_name(result.fndesc.mangled_name)
    module = llvm.parse_assembly(text)
    module.verify()
    return bytes(_machine(llvm).emit_object(module))


def _without_runtime(text: str) -> str:
    """numba's runtime is not there when the object is loaded; its one call from here frees what is not ours."""
    lines = [
        "define internal void @NRT_MemInfo_call_dtor(ptr %info) { ret void }"
        if line.startswith("declare") and "@NRT_MemInfo_call_dtor(" in line
        else line
        for line in text.splitlines()
    ]
    return "\n".join(lines)


def _plain_name(mangled: str) -> str:
    """numba's function takes a place for its result and one for an exception first: a C function around it."""
    named = ", ".join(f"ptr %a{k}" for k in range(POINTERS))
    return f"""
define i64 @coaxlink_serve({named}) {{
  %result = alloca i64
  %wrong = alloca ptr
  store i64 -1, ptr %result
  %status = call i32 @"{mangled}"(ptr %result, ptr %wrong, {named})
  %value = load i64, ptr %result
  ret i64 %value
}}
"""


def _signature(types: Any) -> Any:
    i64, f64, u8, f32, i32 = types.int64, types.float64, types.uint8, types.float32, types.int32
    own = [i64, f64, f64, f64, i64, u8, u8, u8, f32, u8, f64, f64, f64, i64, i64, i32, i64, u8, i64]
    law = [f64, f64, i64, f64, f64, f64, i64, f64, i64, f64, f64, f64, f64, f64, f64]
    return i64(*[types.CPointer(kind) for kind in own + law])


def _entry(carray: Any) -> Any:
    """`hot_serve.serve` on bare addresses."""
    from coaxlink.link.hot_kernel import FLOATS, INTS, MOST_LEFT, MOTORS, RING, ROW
    from coaxlink.link.hot_serve import CHUNK, SLOT, serve
    from coaxlink.mixer.exact.loads import ARM, SUMS
    from coaxlink.mixer.exact.warm import ROWS, SPEEDS

    def entry(
        ints, floats, motors, ring, stamps, frames, data, body, singles, out, held, told, speeds, order, slots,
        lengths, clock, sequence, where,
        c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box, past,
    ):  # fmt: skip
        sizes = carray(shape, (4,))
        k, terms = sizes[0], (sizes[1] + 1) * (sizes[2] + 1)
        law = (
            carray(c, (k, 4, terms)), carray(g, (k, 16)), sizes, carray(lo, (2 * k,)), carray(hi, (2 * k,)),
            carray(x, (2 * k,)), carray(act, (2 * k,)), carray(lam, (4,)), carray(el, (4,)),
            carray(cap, (4,)), carray(mu, (4,)), carray(work, (k, ARM)), carray(sums, (SUMS,)),
            carray(box, (6 * k,)), carray(past, (ROWS, SPEEDS + 4 * k)),
        )  # fmt: skip
        at = carray(where, (6,))
        return serve(
            carray(ints, (INTS,)), carray(floats, (FLOATS,)), carray(motors, (MOTORS,)),
            carray(ring, (RING, ROW)), carray(stamps, (RING,)), carray(frames, (RING, 2 * SLOT)),
            carray(data, (2 * CHUNK,)), carray(body, (48,)), carray(singles, (MOTORS,)),
            carray(out, (SLOT,)), carray(held, (4,)), carray(told, (MOTORS,)), carray(speeds, (MOTORS,)),
            carray(order, (4,)), carray(slots, (MOTORS,)), carray(lengths, (MOST_LEFT,)),
            carray(clock, (2,)), carray(sequence, (1,)), law, at[0], at[1], at[2], at[3], at[4], at[5],
        )  # fmt: skip

    return entry
