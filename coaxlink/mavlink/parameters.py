"""The parameter protocol: read one, many or all, set and compare the echo bit for bit.

Gaps are requested again. An unknown name is answered with PARAM_ERROR by new firmware and with silence by
older one.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import CheckFailed, InputError, LinkError
from coaxlink.mavlink.identity import version_request
from coaxlink.mavlink.request_window import Asker
from coaxlink.mavlink.requests import Inbox
from coaxlink.mavlink.session import Message, Session
from coaxlink.mavlink.strangers import LOST_S
from coaxlink.mavlink.values import FLOAT, Number, ParamSet, Value, decode, encode, is_bytewise, raw_bits
from firmware_params.plain import is_parameter_name

__all__ = ["FLOAT", "Number", "Parameters", "Snapshot", "Value"]
HASH = "_HASH_CHECK"
_NO_INDEX = 65535
_WINDOW = 20  # requests in the air at a time
_ROUND = 10  # names a round: ArduPilot keeps 20 requests, and drops what comes on top (GCS_Param.cpp)
_FEW_GAPS = 0.12  # of the list; with more missing the whole list is quicker than its parts
_BEAT_S = 1.5  # autopilots send their heartbeat every second
_ANSWERS = ("PARAM_VALUE", "PARAM_ERROR")


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
    """The parameters of a session's vehicle; `retries` counts requests that were repeated."""

    def __init__(self, session: Session, *, timeout_s: float = 0.6) -> None:
        self._session = session
        self._timeout_s = timeout_s
        self._asker = Asker(session, timeout_s=timeout_s, window=_WINDOW)
        self.bytewise = is_bytewise(session.identity.autopilot, session.identity.capabilities)
        self._listed: frozenset[str] | None = None  # the names in the board's whole list, once it was read
        self.again = 0  # asked or written again for another reason than silence

    @property
    def retries(self) -> int:
        """Requests and writes that were repeated."""
        return self._asker.retries + self.again

    def encode(self, name: str, value: Number, kind: int) -> Value:
        """`values.encode` as this vehicle has it."""
        return encode(name, value, kind, self.bytewise)

    def decode(self, message: Message) -> Value:
        """`values.decode` as this vehicle has it."""
        return decode(message, self.bytewise)

    # -- reading -------------------------------------------------------------------------------------------

    def read(self, name: str) -> Value:
        """One parameter. Raises InputError when the vehicle has none of this name, LinkError on silence."""
        return self.read_many([name])[name]

    def read_many(self, names: Iterable[str], *, missing_ok: bool = False) -> dict[str, Value]:
        """Several parameters, a window of requests at a time; gaps are requested again.

        Unknown names raise InputError, or are left out with `missing_ok`. That a name is unknown is the
        board's own word: PARAM_ERROR, or the end of its whole list and silence between answers. Raises
        LinkError when the vehicle falls silent altogether.
        """
        wanted = list(dict.fromkeys(names))
        found, silent = self._asked(wanted)
        if silent:
            found |= self._listed_or_hidden(silent)
        unknown = next((name for name in wanted if name not in found), None)
        if unknown is not None and not missing_ok:
            why = "it is not in its list" if unknown in silent else "it does not exist"
            raise InputError(unknown, "", f"the vehicle has no such parameter ({why})")
        return {name: found[name] for name in wanted if name in found}

    def answering(self, names: Iterable[str]) -> dict[str, Value]:
        """Those that answer within an ordinary time; of the others nothing is known. Raises LinkError."""
        return self._asked(list(dict.fromkeys(names)))[0]

    def forget_list(self) -> None:
        """After a restart other parameters may be there."""
        self._listed = None

    def _asked(self, wanted: Sequence[str]) -> tuple[dict[str, Value], list[str]]:
        """Values by name, and the names that got no answer. Raises LinkError when all is silent."""
        found: dict[str, Value] = {}
        absent: set[str] = set()
        requests = {name: lambda name=name: self._request(name) for name in wanted}
        left = self._asker.gather(requests, _ANSWERS, self._take_into(found, absent), patience=2.0)
        silent = [name for name in left if name not in found and name not in absent]
        if silent:
            self._require_link(f"no answer for {silent[0]}")
            if not found and not absent:
                self._require_answers()
        return found, silent

    def _listed_or_hidden(self, silent: Sequence[str]) -> dict[str, Value]:
        """Of names that were not answered those that the board has: in its list, or hidden from it.

        What is hidden answers to its name. It is asked in rounds, each with a request behind it that every
        board answers, and boards answer in order: so slow a board or a line is no silence. Raises LinkError.
        """
        found: dict[str, Value] = {}
        absent: set[str] = set()
        if self._listed is None:
            values = self.read_all().values
            found |= {name: values[name] for name in silent if name in values}
        for _ in range(self._asker.tries()):
            left = [name for name in silent if name not in found and name not in absent]
            for at in range(0, len(left), _ROUND):
                self._round(left[at : at + _ROUND], found, absent)
        unheard = [name for name in silent if name in (self._listed or ()) and name not in found]
        if unheard:
            raise LinkError(self._session.address, f"no answer for {unheard[0]}, which the vehicle has")
        return found

    def _round(self, names: Sequence[str], found: dict[str, Value], absent: set[str]) -> None:
        take = self._take_into(found, absent)

        def request() -> Message:
            for name in names:
                self._session.send(self._request(name))
            return self._request_index(0)

        def settle(message: Message) -> int | None:
            take(message)
            return 0 if message.get_type() == "PARAM_VALUE" and message.param_index == 0 else None

        if self._asker.gather({0: request}, _ANSWERS, settle):
            raise LinkError(self._session.address, f"no answer for {names[0]}, nor for what every board has")

    def _take_into(self, found: dict[str, Value], absent: set[str]) -> Callable[[Message], str | None]:
        """What sorts answers to names: the name that one settles, None for one that says neither."""

        def settle(message: Message) -> str | None:
            name = str(message.param_id)
            if message.get_type() == "PARAM_VALUE":
                found[name] = self.decode(message)
            elif message.error == mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST:
                absent.add(name)
            else:  # it is there and cannot be read just now
                return None
            return name

        return settle

    def read_all(self, *, progress: Callable[[int, int], None] | None = None) -> Snapshot:
        """Every parameter; what the list lost is read again. Raises LinkError when gaps remain.

        The list is requested again while a good part of it is missing, then single parameters by index.
        """
        listing = _Listing()
        with self._session.listen(("PARAM_VALUE",)) as inbox:
            clock = self._session.clock
            tries, end = self._asker.tries(), clock.monotonic() + LOST_S
            while tries > 0 or (not listing.count and clock.monotonic() < end):  # a busy board begins late
                tries -= 1
                self._list_once(inbox, listing, progress)
                if not listing.count:
                    self.again += 1
                    self._require_link("no answer to the request for all parameters")
                elif len(listing.gaps) <= _FEW_GAPS * listing.count:
                    break
        if not listing.count:
            raise LinkError(self._session.address, "no answer to the request for all parameters")
        if len(listing.gaps) > _FEW_GAPS * listing.count:
            came = f"of the {listing.count} parameters that it says it has {len(listing.by_index)} came"
            raise LinkError(self._session.address, f"{came}, however often the list was requested")
        if gaps := listing.gaps:
            self.again += len(gaps)
            self._read_indices(gaps, listing.by_index)
        values = {v.name: v for _, v in sorted(listing.by_index.items())}
        strange = next((name for name in values if not is_parameter_name(name)), None)
        if strange is not None:  # no file holds it, and no autopilot has it
            raise CheckFailed(
                f"{self._session.address}: a parameter on board is called '{strange}', which is no name"
            )
        if len(values) != listing.count:
            raise LinkError(
                self._session.address, "the parameters changed places while they were read: try again"
            )
        self._listed = frozenset(values)
        return Snapshot(values, listing.hash)

    def _list_once(
        self,
        inbox: Inbox,
        listing: _Listing,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        """One request for the list, heard until it falls quiet for much longer than its own pace."""
        target = self._session.identity
        self._session.send(mavlink.MAVLink_param_request_list_message(target.system, target.component))
        # the list may begin later than a single answer would come, and is long
        quiet_s = min(3.0 * self._asker.pace.wait_s(0) + 0.1, self._timeout_s + 0.3)
        clock = self._session.clock
        heard, started = 0, clock.monotonic()
        while (message := self._session.take(inbox, quiet_s)) is not None:
            if message.param_id == HASH:
                listing.hash = struct.unpack("<I", raw_bits(message))[0]
            elif message.param_index != _NO_INDEX:
                listing.count = message.param_count
                listing.by_index[message.param_index] = self.decode(message)
                heard += 1
                quiet_s = min(max(40.0 * (clock.monotonic() - started) / heard, 0.15), self._timeout_s + 0.3)
                if progress:
                    progress(len(listing.by_index), listing.count)
            if 0 < listing.count <= len(listing.by_index):
                return

    def read_hash(self) -> int:
        """The board's own hash of all its parameters, 0 when it has none."""
        if not self._session.identity.is_px4:
            return 0
        found = self.answering([HASH])
        return struct.unpack("<I", found[HASH].bits)[0] if HASH in found else 0

    def _read_indices(self, gaps: Sequence[int], by_index: dict[int, Value]) -> None:
        def request(index: int) -> Callable[[], Message]:
            return lambda: self._request_index(index)

        def settle(message: Message) -> str | None:
            if message.get_type() != "PARAM_VALUE" or message.param_index == _NO_INDEX:
                return None
            by_index[message.param_index] = self.decode(message)
            return str(message.param_index)

        left = self._asker.gather({str(i): request(i) for i in gaps}, _ANSWERS, settle)
        if left:
            raise LinkError(
                self._session.address, f"{len(left)} parameters could not be read (index {left[0]})"
            )

    # -- writing -------------------------------------------------------------------------------------------

    def write(self, name: str, value: Number, kind: int) -> Value:
        """Set one parameter until its echo agrees bit for bit; the echo. Raises as `write_many`."""
        return self.write_many([self.encode(name, value, kind)])[name]

    def write_many(
        self,
        wanted: Sequence[Value],
        *,
        before_each: Callable[[], None] = lambda: None,
        refused: Callable[[str, str], bool] = lambda name, how: False,
    ) -> dict[str, Value]:
        """Set parameters until every echo agrees bit for bit, a window of requests at a time; the echoes.

        `before_each` is called before every request and may raise to stop. Raises CheckFailed when the
        vehicle refuses or keeps another value, unless `refused(name, how)` passes that over; LinkError on
        silence.
        """
        target = self._session.identity
        received: dict[str, Value] = {}
        by_name = {value.name: value for value in wanted}
        requests = {}
        for value in wanted:
            message = ParamSet(target.system, target.component, value)
            requests[value.name] = _guarded(before_each, message)

        def settle(message: Message) -> str | None:
            name = str(message.param_id)
            if name not in by_name:
                return None
            if message.get_type() == "PARAM_ERROR":
                if refused(name, _error_text(message.error)):
                    return name
                raise CheckFailed(f"{name}: the vehicle refused it ({_error_text(message.error)})")
            received[name] = self.decode(message)
            return name if received[name].same(by_name[name]) else None

        left = self._asker.gather(requests, _ANSWERS, settle)
        for name in left:
            if name in received:
                if refused(name, f"keeps {received[name].value:.7g}"):
                    continue
                raise CheckFailed(
                    f"{name}: {by_name[name].value} was sent, the vehicle holds {received[name].value}"
                )
            self._require_link(f"no answer when {name} was set")
            if refused(name, "no answer"):
                continue
            raise CheckFailed(f"{name}: no answer when it was set, though the vehicle is alive")
        return received

    # -- inside --------------------------------------------------------------------------------------------

    def _request(self, name: str) -> Message:
        target = self._session.identity
        return mavlink.MAVLink_param_request_read_message(
            target.system, target.component, name.encode("ascii"), -1
        )

    def _request_index(self, index: int) -> Message:
        target = self._session.identity
        return mavlink.MAVLink_param_request_read_message(target.system, target.component, b"", index)

    def _require_answers(self) -> None:
        """Raise LinkError where silence is no answer: the vehicle answers not even who it is."""
        session = self._session
        request = version_request(session.identity)
        answer, _ = session.exchange(request, "AUTOPILOT_VERSION", tries=self._asker.tries())
        if answer is None:
            what = "it is heard, but answers nothing"
            raise LinkError(session.address, f"{what} (does it take signed messages only? `signing_key`)")

    def _require_link(self, what: str) -> None:
        """Raise LinkError when the vehicle is gone; one that beats is only silent about this."""
        silent_s = self._session.silence_s
        if silent_s > _BEAT_S and self._session.wait("HEARTBEAT", max(0.0, LOST_S - silent_s)) is None:
            raise LinkError(
                self._session.address, f"{what}, and no heartbeat for {self._session.silence_s:.1f} s"
            )


def _guarded(before: Callable[[], None], message: Message) -> Callable[[], Message]:
    def request() -> Message:
        before()
        return message

    return request


def _error_text(code: int) -> str:
    known = mavlink.enums.get("MAV_PARAM_ERROR", {}).get(code)
    return known.name.removeprefix("MAV_PARAM_ERROR_").lower().replace("_", " ") if known else f"error {code}"
