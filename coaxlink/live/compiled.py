"""`kernel.exchange` through numba, compiled once and kept; and what it needs of a socket.

Kept under a name made of the sources, the processor and the versions, so that neither an upgrade nor a shared
home folder ever runs another's code, in a folder that only this user writes.
"""

from __future__ import annotations

import hashlib
import socket
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coaxlink import files
from coaxlink.live import kernel as k
from coaxlink.live import state as live_state
from coaxlink.mavlink.locks import lock
from coaxlink.mixer.exact import ExactLaw, dual, loads, quadratic, schur, warm
from coaxlink.mixer.exact import kernel as law_kernel

if TYPE_CHECKING:
    from coaxlink.live.mixer_core import MixCore

# callees before callers
HELPERS = (
    "checksum", "alone", "unpack", "stamp_of", "acceptable", "lead", "follow", "command", "pack",
    "same_sender", "nanoseconds", "look", "solve",
)  # fmt: skip


def available() -> bool:
    """Whether this system is one the function is written for: its socket calls are 64-bit Linux's."""
    return sys.platform.startswith("linux") and sys.maxsize > 2**32


def code_folder() -> Path:
    """Where the code of these very sources for this very processor is kept. Raises ImportError."""
    import llvmlite.binding as llvm

    modules = (k, live_state, law_kernel, dual, loads, quadratic, schur, warm)
    about = [Path(str(m.__file__)).read_bytes() for m in modules] + [Path(__file__).read_bytes()]
    source = Path(k.__file__)  # numba keeps code for one place and time of its source
    about.append(f"{source} {source.stat().st_mtime_ns}".encode())
    processor = (llvm.get_default_triple(), llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten())
    about += [x.encode() for x in (*processor, version("numba"), version("llvmlite"), np.__version__)]
    return files.code_folder(f"live-{hashlib.sha256(b''.join(about)).hexdigest()[:16]}")


def cached() -> bool:
    """Whether the code is there, and may be run."""
    return _is_there() and not distrusted()


def refused() -> str:
    """Why the code that is there is not run; "" for no reason, or none there."""
    return distrusted() if _is_there() else ""


def distrusted() -> str:
    """Why nothing that is kept is run; "" for no reason."""
    return files.keep_private(code_folder())


def _is_there() -> bool:
    try:
        return available() and any(code_folder().rglob("*.nbc"))
    except (ImportError, OSError):
        return False


@cache
def load() -> Any:
    """`kernel.exchange`, compiled first if need be (12 s of work).

    It is compiled anew, and not kept, where others could have changed what is kept. Raises ImportError
    without numba.
    """
    import numba
    from numba.core import types
    from numba.extending import register_jitable

    from coaxlink.mixer.exact import compiled

    i32, i64, at = types.int32, types.int64, types.voidptr
    k.recvfrom = types.ExternalFunction("recvfrom", i64(i32, at, i64, i32, at, at))
    k.sendto = types.ExternalFunction("sendto", i64(i32, at, i64, i32, at, i32))
    k.clock_gettime = types.ExternalFunction("clock_gettime", i32(i32, at))
    compiled.register(inline=False)
    register_jitable(**compiled.OPTIONS)(law_kernel.optimum)
    for name in HELPERS:
        register_jitable(**compiled.OPTIONS)(getattr(k, name))
    keep = not distrusted()
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(code_folder())
    try:
        with (code_folder() / "lock").open("w") if keep else nullcontext() as held:
            if held:
                lock(held.fileno())  # of two that start together one compiles
            return numba.njit(_signature(), cache=keep, nogil=True, **compiled.OPTIONS)(k.exchange)
    finally:
        numba.config.CACHE_DIR = before


def _signature() -> Any:
    import numba
    from numba.core import types

    def array(kind: Any, dimensions: int = 1) -> Any:
        return types.Array(kind, dimensions, "C")

    f8, i8, u1 = types.float64, types.int64, types.uint8
    law = [
        array(f8, 3), array(f8, 2), array(i8), array(f8), array(f8), array(f8), array(i8), array(f8),
        array(i8), array(f8), array(f8), array(f8, 2), array(f8), array(f8), array(f8, 2),
    ]  # fmt: skip
    record, log = (array(numba.from_dtype(kind)) for kind in (live_state.RECORD, live_state.LOG))
    scratch = (array(i8), array(u1), array(u1), array(types.float32), array(u1), array(u1))
    return i8(i8, record, *scratch, log, types.Tuple(law))  # type: ignore[attr-defined]


class Exchange:
    """The compiled function with the buffers of one socket; `state` is the record that it keeps."""

    def __init__(
        self, function: Any, core: MixCore, law: ExactLaw, counter: bytearray, ids: tuple[int, ...]
    ) -> None:
        """Take over the books of `core`; `counter` (1,) is the session's, `ids` the vehicle's and ours."""
        self._function = function
        self._state = state = live_state.shared_state()
        state.system, state.component, state.own_system, state.own_component = ids
        state.scale[:] = core.scale.matrix
        core.use(state)
        self.use(law)
        self._log = np.zeros(live_state.ROWS, live_state.LOG)
        self._data, out = np.zeros(k.CHUNK + 8, np.uint8), np.zeros(64, np.uint8)
        body = np.zeros(48, np.uint8)
        self._rest = (
            np.zeros(k.WORDS, np.int64), self._data, body, body.view(np.float32), out,
            np.frombuffer(counter, np.uint8),
        )  # fmt: skip
        self._peer: Any = None
        self._interrupted = False
        self.answers = 0

    def use(self, law: ExactLaw) -> None:
        """Fly this law of the same airframe from the next call on."""
        p, state = law.problem, self._state
        state.inverse[:], state.order[:] = 1.0 / p.scale, p.order
        state.slots[: len(p.slots)] = p.slots
        self.law = tuple(law.arrays())  # as new: what the law in Python stands at is its own

    @classmethod
    def of(cls, function: Any, core: MixCore, counter: bytearray, ids: tuple[int, ...]) -> Exchange | None:
        """None for a law that is not the exact one."""
        law = core.law
        if not isinstance(law, ExactLaw) or law.slew is not None:
            return None
        return cls(function, core, law, counter, ids)

    def __call__(self, number: int, peer: Any, last_s: float, quiet_s: float, turn_s: float) -> int:
        """A turn on the socket of that number, answering `peer` until it is quiet; `kernel.exchange`."""
        state = self._state
        if peer != self._peer:
            packed = packed_address(peer)
            state.peer[:] = np.frombuffer(packed.ljust(32, b"\0"), np.int64)
            state.peer_size, self._peer = len(packed), peer
        quiet_ns = round(quiet_s * 1e9)
        state.quiet_ns, state.deadline_ns = quiet_ns, round(last_s * 1e9) + quiet_ns
        state.until_ns = time.monotonic_ns() + round(turn_s * 1e9)
        if self._interrupted:  # before this turn began
            state.until_ns = 0
        done = int(self._function(number, state.array, *self._rest, self._log, self.law))
        self._interrupted = False
        self.answers += state.answers
        return done

    def interrupt(self) -> None:
        """From another thread: let Python have its turn after the next answer."""
        self._interrupted = True
        self._state.until_ns = 0

    def handed(self, size: int) -> bytes:
        """The datagram that was read and not answered."""
        return self._data[:size].tobytes()

    def answered(self) -> Iterator[live_state.ANSWER]:
        """Of the last call, as `state.LOG` has it."""
        rows, (*numbers, received, sent) = self._log[: self._state.answers], live_state.LOG.names or ()
        columns = [rows[name].tolist() for name in numbers]
        return zip(*columns, _frames(rows[received]), _frames(rows[sent]), strict=True)


def _frames(slots: Any) -> list[bytes]:
    """Of fixed places (n, size), each as long as it says itself."""
    data, size = slots.tobytes(), slots.shape[1]
    return [data[at : at + 12 + data[at + 1]] for at in range(0, len(data), size)]


def packed_address(to: Any) -> bytes:
    """Linux's sockaddr of a Python UDP address."""
    if len(to) == 2:
        head = struct.pack("=H", socket.AF_INET) + struct.pack("!H", to[1])
        return head + socket.inet_aton(to[0]) + bytes(8)
    host, port, flow, scope = to
    head = struct.pack("=H", socket.AF_INET6) + struct.pack("!HI", port, flow)
    return head + socket.inet_pton(socket.AF_INET6, host) + struct.pack("=I", scope)
