"""The parameter protocol: read one, many or all, set and compare the echo bit for bit.

PX4 sends an int32 bytewise in the float field, ArduPilot sends every value as a float; which of the two is
read from the capability bits, else from the kind of autopilot. Gaps are asked for again. An unknown name is
answered with PARAM_ERROR by new firmware and with silence by older one.
"""

from __future__ import annotations

import math
import queue
import struct
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import CheckFailed, InputError, LinkError
from coaxlink.link.session import Message, Session

Number = float | int
HASH = "_HASH_CHECK"
_NO_INDEX = 65535
_WINDOW = 12  # requests in the air at a time
_FEW_GAPS = 0.12  # of the list; with more missing the whole list is quicker than its parts
_ANSWERS = ("PARAM_VALUE", "PARAM_ERROR")
_INTEGERS = {
    mavlink.MAV_PARAM_TYPE_UINT8: ("B", 0, 255),
    mavlink.MAV_PARAM_TYPE_INT8: ("b", -128, 127),
    mavlink.MAV_PARAM_TYPE_UINT16: ("H", 0, 65535),
    mavlink.MAV_PARAM_TYPE_INT16: ("h", -32768, 32767),
    mavlink.MAV_PARAM_TYPE_UINT32: ("I", 0, 2**32 - 1),
    mavlink.MAV_PARAM_TYPE_INT32: ("i", -(2**31), 2**31 - 1),
}
FLOAT = mavlink.MAV_PARAM_TYPE_REAL32


@dataclass(frozen=True)
class Value:
    """A parameter as the vehicle holds it."""

    name: str
    value: Number
    type: int  # MAV_PARAM_TYPE
    bits: bytes  # the four bytes of the wire's float field, for comparing

    def same(self, other: Value) -> bool:
        """True when type and every bit agree."""
        return self.type == other.type and self.bits == other.bits


@dataclass(frozen=True)
class Snapshot:
    """All parameters of a vehicle, in its order, and its own hash of them (0 when it has none)."""

    values: Mapping[str, Value]
    hash: int = 0


@dataclass
class _Listing:
    """What came of a parameter list so far."""

    by_index: dict[int, Value] = field(default_factory=dict)
    count: int = 0
    hash: int = 0

    @property
    def gaps(self) -> list[int]:
        """Indices that are missing."""
        if len(self.by_index) >= self.count:
            return []
        return [index for index in range(self.count) if index not in self.by_index]


class Parameters:
    """The parameters of a session's vehicle; `retries` counts what had to be asked again."""

    def __init__(self, session: Session, *, timeout_s: float = 0.6) -> None:
        self._session = session
        self._timeout_s = timeout_s
        self._answer_s = 0.0  # how long an answer takes, smoothed; 0 until one came
        self.retries = 0
        identity = session.identity
        bytewise = identity.is_px4
        if identity.capabilities is not None:
            bit = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
            bytewise = bool(identity.capabilities & bit) or (bytewise and not identity.capabilities)
        self.bytewise = bytewise

    # -- encoding ------------------------------------------------------------------------------------------

    def encode(self, name: str, value: Number, kind: int) -> Value:
        """The wire's bits of a value, and the value as the vehicle will store it.

        Raises InputError for what the type cannot hold.
        """
        if kind not in _INTEGERS:
            if not math.isfinite(value):
                raise InputError(name, "", f"a finite number is expected, found {value}")
            bits = struct.pack("<f", value)
            return Value(name, struct.unpack("<f", bits)[0], kind, bits)
        code, low, high = _INTEGERS[kind]
        if not math.isfinite(value) or value != int(value) or not low <= value <= high:
            raise InputError(name, "", f"an integer in {low}..{high} is expected, found {value}")
        if self.bytewise:
            return Value(name, int(value), kind, struct.pack(f"<{code}", int(value)).ljust(4, b"\0"))
        return Value(name, int(value), kind, struct.pack("<f", float(value)))

    def decode(self, message: Message) -> Value:
        """The value in a PARAM_VALUE."""
        bits, kind = raw_bits(message), int(message.param_type)
        if kind not in _INTEGERS:
            return Value(message.param_id, struct.unpack("<f", bits)[0], kind, bits)
        code = _INTEGERS[kind][0]
        if self.bytewise:
            size = struct.calcsize(code)
            value = struct.unpack(f"<{code}", bits[:size])[0]
            return Value(message.param_id, value, kind, bits[:size].ljust(4, b"\0"))
        return Value(message.param_id, int(message.param_value), kind, bits)

    # -- reading -------------------------------------------------------------------------------------------

    def read(self, name: str) -> Value:
        """One parameter. Raises InputError when the vehicle has none of this name, LinkError on silence."""
        return self.read_many([name])[name]

    def read_many(self, names: Iterable[str], *, missing_ok: bool = False) -> dict[str, Value]:
        """Several parameters, a window of requests at a time; gaps are asked for again.

        Unknown names raise InputError, or are left out with `missing_ok`. Raises LinkError when the
        vehicle falls silent altogether.
        """
        wanted = list(dict.fromkeys(names))
        found: dict[str, Value] = {}
        refused: dict[str, str] = {}
        requests = {name: lambda name=name: self._request(name) for name in wanted}

        def settle(message: Message) -> str | None:
            name = str(message.param_id)
            if message.get_type() == "PARAM_ERROR":
                refused[name] = _error_text(message.error)
            else:
                found[name] = self.decode(message)
            return name

        left = self._gather(requests, settle)
        unknown = [name for name in wanted if name not in found]
        if unknown and left:
            self._require_link(f"no answer for {unknown[0]}")
        if unknown and not missing_ok:
            why = refused.get(unknown[0], "it does not answer for this name, though it is alive")
            raise InputError(unknown[0], "", f"the vehicle has no such parameter ({why})")
        return {name: found[name] for name in wanted if name in found}

    def read_all(self, *, progress: Callable[[int, int], None] | None = None) -> Snapshot:
        """Every parameter; what the list lost is read again. Raises LinkError when gaps remain.

        The list is asked for again while a good part of it is missing, then single parameters by index.
        """
        listing = _Listing()
        with self._session.listen(("PARAM_VALUE",)) as inbox:
            for _ in range(self._tries()):
                self._list_once(inbox, listing, progress)
                if not listing.count:
                    self.retries += 1
                    self._require_link("no answer to the request for all parameters")
                elif len(listing.gaps) <= _FEW_GAPS * listing.count:
                    break
        if not listing.count:
            raise LinkError(self._session.address, "no answer to the request for all parameters")
        if gaps := listing.gaps:
            self.retries += len(gaps)
            self._read_indices(gaps, listing.by_index)
        values = {v.name: v for _, v in sorted(listing.by_index.items())}
        if len(values) != listing.count:
            raise LinkError(
                self._session.address, "the parameters changed places while they were read: try again"
            )
        return Snapshot(values, listing.hash)

    def _list_once(
        self,
        inbox: queue.SimpleQueue[Message],
        listing: _Listing,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        """One request for the list, heard until it falls quiet for much longer than its own pace."""
        target = self._session.identity
        self._session.send(mavlink.MAVLink_param_request_list_message(target.system, target.component))
        quiet_s, heard, started = self._timeout_s + 0.3, 0, time.monotonic()
        while (message := self._session.take(inbox, quiet_s)) is not None:
            if message.param_id == HASH:
                listing.hash = struct.unpack("<I", raw_bits(message))[0]
            elif message.param_index != _NO_INDEX:
                listing.count = message.param_count
                listing.by_index[message.param_index] = self.decode(message)
                heard += 1
                quiet_s = min(max(40.0 * (time.monotonic() - started) / heard, 0.15), self._timeout_s + 0.3)
                if progress:
                    progress(len(listing.by_index), listing.count)
            if listing.count and not listing.gaps:
                return

    def read_hash(self) -> int:
        """The board's own hash of all its parameters, 0 when it has none."""
        if not self._session.identity.is_px4:
            return 0
        found = self.read_many([HASH], missing_ok=True)
        return struct.unpack("<I", found[HASH].bits)[0] if HASH in found else 0

    def _read_indices(self, gaps: Sequence[int], by_index: dict[int, Value]) -> None:
        target = self._session.identity

        def request(index: int) -> Callable[[], Message]:
            return lambda: mavlink.MAVLink_param_request_read_message(
                target.system, target.component, b"", index
            )

        def settle(message: Message) -> str | None:
            if message.get_type() != "PARAM_VALUE" or message.param_index == _NO_INDEX:
                return None
            by_index[message.param_index] = self.decode(message)
            return str(message.param_index)

        left = self._gather({str(index): request(index) for index in gaps}, settle)
        if left:
            raise LinkError(
                self._session.address, f"{len(left)} parameters could not be read (index {left[0]})"
            )

    # -- writing -------------------------------------------------------------------------------------------

    def write(self, name: str, value: Number, kind: int) -> Value:
        """Set one parameter until its echo agrees bit for bit; the echo. Raises as `write_many`."""
        return self.write_many([self.encode(name, value, kind)])[name]

    def write_many(
        self, wanted: Sequence[Value], *, before_each: Callable[[], None] = lambda: None
    ) -> dict[str, Value]:
        """Set parameters until every echo agrees bit for bit, a window of requests at a time; the echoes.

        `before_each` is called before every request and may raise to stop. Raises CheckFailed when the
        vehicle refuses or keeps another value, LinkError on silence.
        """
        target = self._session.identity
        seen: dict[str, Value] = {}
        by_name = {value.name: value for value in wanted}
        requests = {}
        for value in wanted:
            message = _ParamSet(target.system, target.component, value)
            requests[value.name] = _guarded(before_each, message)

        def settle(message: Message) -> str | None:
            name = str(message.param_id)
            if name not in by_name:
                return None
            if message.get_type() == "PARAM_ERROR":
                raise CheckFailed(f"{name}: the vehicle refused it ({_error_text(message.error)})")
            seen[name] = self.decode(message)
            return name if seen[name].same(by_name[name]) else None

        left = self._gather(requests, settle)
        for name in left:
            if name in seen:
                raise CheckFailed(
                    f"{name}: {by_name[name].value} was sent, the vehicle holds {seen[name].value}"
                )
            self._require_link(f"no answer when {name} was set")
            raise CheckFailed(f"{name}: no answer when it was set, though the vehicle is alive")
        return seen

    # -- inside --------------------------------------------------------------------------------------------

    def _request(self, name: str) -> Message:
        target = self._session.identity
        return mavlink.MAVLink_param_request_read_message(
            target.system, target.component, name.encode("ascii"), -1
        )

    def _gather(
        self, requests: Mapping[str, Callable[[], Message]], settle: Callable[[Message], str | None]
    ) -> list[str]:
        """Send requests, a window at a time, until each is settled or out of tries; the keys left over."""
        waiting = list(requests)
        due: dict[str, _Due] = {}
        given_up: list[str] = []
        with self._session.listen(_ANSWERS) as inbox:
            while waiting or due:
                now = time.monotonic()
                for key, request in list(due.items()):
                    if now < request.when:
                        continue
                    if request.tries >= self._tries():
                        given_up.append(key)
                        del due[key]
                        continue
                    self.retries += 1
                    self._session.send(requests[key]())
                    due[key] = _Due(now, now + self._wait_s(request.tries), request.tries + 1)
                while waiting and len(due) < _WINDOW:
                    key = waiting.pop(0)
                    self._session.send(requests[key]())
                    due[key] = _Due(now, now + self._wait_s(0), 1)
                if due:
                    self._drain(inbox, due, settle)
        return given_up

    def _drain(
        self,
        inbox: queue.SimpleQueue[Message],
        due: dict[str, _Due],
        settle: Callable[[Message], str | None],
    ) -> None:
        soonest = min(request.when for request in due.values())
        message = self._session.take(inbox, max(0.0, soonest - time.monotonic()))
        while message is not None:
            key = settle(message)
            request = due.pop(key, None) if key is not None else None
            if request and request.tries == 1:  # an answer to a repeated request has no known start
                took = time.monotonic() - request.sent
                self._answer_s = 0.8 * self._answer_s + 0.2 * took if self._answer_s else took
            message = self._session.take(inbox, 0.0) if due else None

    def _tries(self) -> int:
        """Requests after which silence means something, at the loss the link shows (1e-6 by chance)."""
        both_ways = 1.0 - (1.0 - self._session.loss) ** 2
        return math.ceil(math.log(1e-6) / math.log(min(max(both_ways, 0.06), 0.75)))

    def _wait_s(self, attempt: int) -> float:
        first = (
            min(max(4.0 * self._answer_s + 0.1, 0.15), self._timeout_s) if self._answer_s else self._timeout_s
        )
        return min(first * (1.0 + 0.5 * attempt), 2.5 * self._timeout_s)

    def _require_link(self, what: str) -> None:
        if self._session.silence_s > 3.0:
            raise LinkError(
                self._session.address, f"{what}, and no heartbeat for {self._session.silence_s:.1f} s"
            )


@dataclass(frozen=True)
class _Due:
    """A request in the air."""

    sent: float
    when: float  # to be asked again
    tries: int


class _ParamSet(mavlink.MAVLink_param_set_message):
    """PARAM_SET whose value travels as bits: some int32 patterns would not survive being a Python float."""

    def __init__(self, system: int, component: int, value: Value) -> None:
        super().__init__(system, component, value.name.encode("ascii"), 0.0, value.type)
        self._bits = value.bits

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        rest = self.unpacker.pack(
            0.0, self.target_system, self.target_component, self._param_id_raw, self.param_type
        )
        frame = self._pack(mav, self.crc_extra, self._bits + rest[4:], force_mavlink1=force_mavlink1)
        return bytes(frame)


def _guarded(before: Callable[[], None], message: Message) -> Callable[[], Message]:
    def request() -> Message:
        before()
        return message

    return request


def raw_bits(message: Message) -> bytes:
    """The four bytes of PARAM_VALUE's value as they came."""
    frame = message.get_msgbuf()
    start = 10 if frame[0] == mavlink.PROTOCOL_MARKER_V2 else 6
    return bytes(frame[start : start + 4])


def _error_text(code: int) -> str:
    known = mavlink.enums.get("MAV_PARAM_ERROR", {}).get(code)
    return known.name.removeprefix("MAV_PARAM_ERROR_").lower().replace("_", " ") if known else f"error {code}"
