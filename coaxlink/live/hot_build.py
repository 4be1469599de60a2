# mypy: disallow-untyped-defs=False
"""Compile the hot loop once, keep its object code, load it without numba.

numba costs 200 ms and 40 MB at every start; LLVM alone (llvmlite, which numba brings along) loads an object
file in 10 ms. The object is kept under a name made of the sources, the processor and the versions, so that
neither an upgrade nor a shared home folder ever runs another's code, in a folder that only this user writes.
"""

from __future__ import annotations

import ctypes
import hashlib
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from coaxlink import files

# arguments of hot_serve.serve: arrays (kind, dimensions), then addresses
ARRAYS = (
    ("int64", 1), ("float64", 1), ("float64", 1), ("float64", 2), ("int64", 1), ("uint8", 2), ("uint8", 1),
    ("uint8", 1), ("float32", 1), ("uint8", 1), ("float64", 1), ("float64", 1), ("float64", 1), ("int64", 1),
    ("int64", 1), ("int32", 1), ("int64", 1), ("uint8", 1), ("uint8", 1), ("uint8", 1),
    # of the law
    ("float64", 3), ("float64", 2), ("int64", 1), ("float64", 1), ("float64", 1), ("float64", 1),
    ("int64", 1), ("float64", 1), ("int64", 1), ("float64", 1), ("float64", 1), ("float64", 2),
    ("float64", 1), ("float64", 1), ("float64", 2),
)  # fmt: skip
ADDRESSES = 6
KEEP_ALIVE: list[Any] = []  # engines whose code is in use


def available() -> bool:
    """Whether this system is one the loop is written for."""
    return sys.platform.startswith("linux") and sys.maxsize > 2**32


def object_path() -> Path:
    """Where the object code of these very sources for this very processor is kept."""
    import llvmlite
    import llvmlite.binding as llvm

    from coaxlink.live import hot_kernel, hot_serve
    from coaxlink.mixer.exact import dual, kernel, loads, quadratic, schur, warm

    modules = (hot_kernel, hot_serve, kernel, dual, loads, quadratic, schur, warm)
    about = [Path(str(m.__file__)).read_bytes() for m in modules] + [Path(__file__).read_bytes()]
    about += [x.encode() for x in (*_processor(llvm), llvmlite.__version__)]
    return files.code_folder(f"live-{hashlib.sha256(b''.join(about)).hexdigest()[:16]}") / "loop.o"


def kept() -> bool:
    """Whether the object code is there, and may be run."""
    return _is_there() and not distrusted()


def refused() -> str:
    """Why the object code that is there is not run; "" for no reason, or none there."""
    return distrusted() if _is_there() else ""


def distrusted() -> str:
    """Why nothing that is kept is run; "" for no reason."""
    return files.keep_private(object_path().parent)


def _is_there() -> bool:
    try:
        return available() and object_path().exists()
    except (ImportError, OSError):
        return False


@cache
def load() -> Any:
    """The hot loop as a C function of `arguments`, compiled first if need be (15 s of work).

    It is compiled anew, and not kept, where others could have changed what is kept. Raises ImportError
    without numba when it has to be compiled.
    """
    import llvmlite.binding as llvm

    path = object_path()
    if kept():
        code = path.read_bytes()
    else:
        code = compile_object()
        if not distrusted():
            files.write_atomic(path, code)
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine(llvm))
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    KEEP_ALIVE.append(engine)
    kinds = [ctypes.c_void_p if kind == "ptr" else ctypes.c_int64 for kind in _arguments()]
    kind = ctypes.CFUNCTYPE(ctypes.c_int64, *kinds)
    return kind(engine.get_function_address("coaxlink_serve"))


def _processor(llvm: Any) -> tuple[str, str, str]:
    features = llvm.get_host_cpu_features().flatten()
    return llvm.get_default_triple(), llvm.get_host_cpu_name(), features


def _machine(llvm: Any) -> Any:
    triple, name, features = _processor(llvm)
    target = llvm.Target.from_triple(triple)
    return target.create_target_machine(cpu=name, features=features, opt=3, jit=True)


def compile_object() -> bytes:
    """The object code, with one function `coaxlink_serve`."""
    import llvmlite.binding as llvm
    import numba
    from numba.core import types
    from numba.extending import register_jitable

    from coaxlink.live import hot_kernel, hot_serve
    from coaxlink.mixer.exact import compiled

    compiled.register(inline=False)
    i32, i64, at = types.int32, types.int64, types.int64
    calls = {
        "recvfrom": i64(i32, at, i64, i32, at, at),
        "sendto": i64(i32, at, i64, i32, at, i32),
        "clock_gettime": i32(i32, at),
    }
    for name, signature in calls.items():
        setattr(hot_serve, name, types.ExternalFunction(name, signature))
    for name in (
        "checksum", "find_demand", "unpack", "stamp_of", "acceptable", "ask", "lead", "follow", "command",
        "pack", "same_sender",
    ):  # fmt: skip
        register_jitable(**compiled.OPTIONS)(getattr(hot_kernel, name))
    for name in ("nanoseconds", "receive", "cut_demands", "serve"):
        register_jitable(**compiled.OPTIONS)(getattr(hot_serve, name))
    register_jitable(**compiled.OPTIONS)(compiled.kernel.optimum)
    options = {**compiled.OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    dispatcher = numba.njit(_signature(types), **options)(hot_serve.serve)
    (result,) = dispatcher.overloads.values()
    text = result.library.get_llvm_str() + _plain_name(result.fndesc.mangled_name)
    module = llvm.parse_assembly(text)
    module.verify()
    return bytes(_machine(llvm).emit_object(module))


def _arguments() -> list[str]:
    """LLVM types of the arguments: what numba makes of arrays, then the addresses."""
    found: list[str] = []
    for _, dimensions in ARRAYS:
        found += ["ptr", "ptr", "i64", "i64", "ptr"] + ["i64"] * (2 * dimensions)
    return found + ["i64"] * ADDRESSES


def _plain_name(mangled: str) -> str:
    """A C function around numba's, which takes a place for its result and one for an exception first."""
    named = ", ".join(f"{kind} %a{k}" for k, kind in enumerate(_arguments()))
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
    arrays = [types.Array(getattr(types, kind), dimensions, "C") for kind, dimensions in ARRAYS]
    return types.int64(*arrays, *[types.int64] * ADDRESSES)


def arguments(arrays: Sequence[Any], addresses: Sequence[int]) -> list[Any]:
    """For the function: each array as numba takes one (it owns nothing, so the first two are nothing)."""
    found: list[Any] = []
    for a in arrays:
        found += [None, None, a.size, a.itemsize, a.ctypes.data, *a.shape, *a.strides]
    return found + list(addresses)
