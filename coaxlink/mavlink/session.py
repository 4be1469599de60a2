"""A MAVLink session with one vehicle: who it is, what it says, what we tell it.

It is bound to one peer (`bound`): what comes from another address under the same ids is not believed.

One thread receives, calls the subscribers and sends our heartbeat; every other call may come from any thread.
A line in memory (`transport.Driven`) needs no such thread: it calls `turn` as its clock goes.
Messages are pymavlink objects of the `common` dialect, plus ESC_STATUS, ESC_INFO and ESC_TELEMETRY_*.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Self

from pymavlink.dialects.v20 import common as mavlink

import firmware_params.ardupilot.messages  # teaches the dialect ESC_TELEMETRY_*
import firmware_params.px4.messages  # noqa: F401 - and ESC_STATUS and ESC_INFO
from coaxlink.errors import InputError, LinkError, SafetyRefusal
from coaxlink.mavlink.autopilots import ONE_BEAT_S, Autopilots
from coaxlink.mavlink.clock import SYSTEM, Clock
from coaxlink.mavlink.codec import of_others
from coaxlink.mavlink.identity import Identity, is_vehicle, own_heartbeat, version_request, with_version
from coaxlink.mavlink.line import Tap, read_waiting
from coaxlink.mavlink.peer import Bound, Claimant
from coaxlink.mavlink.requests import TICK_S, Requests
from coaxlink.mavlink.transport import Driven, Transport
from coaxlink.mavlink.values import Message

if TYPE_CHECKING:
    from coaxlink.mavlink.signing import Signer

COMPANION_SYSTEM, COMPANION_COMPONENT = 245, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER


class Loss:
    """How much a line loses, from the sequence numbers of one sender's messages."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._sent = self._received = 1

    def heard(self, sequence: int) -> None:
        """A message with this number (0..255) came."""
        step = 1 if self._last is None else (sequence - self._last) % 256
        if 0 < step < 128:  # a step back is a late or doubled message
            self._sent += step
            self._last = sequence
        if step:
            self._received += 1

    @property
    def share(self) -> float:
        """Lost of all that were sent, 0..1."""
        return max(0.0, 1.0 - self._received / self._sent)


class Session(Requests):
    """See the module; make one with `opening.connect` and use it as a context manager."""

    def __init__(
        self,
        transport: Transport,
        address: str,
        source_system: int = COMPANION_SYSTEM,
        source_component: int = COMPANION_COMPONENT,
        target_system: int | None = None,
        record: Path | None = None,
        signer: Signer | None = None,
        clock: Clock = SYSTEM,
        station: bool = False,
    ) -> None:
        super().__init__(clock)
        self.address = address
        self.armed = False
        self.answer_s = 0.0  # how long the first answer took, 0 when its request had to be repeated
        self.reopen: Callable[[], Transport] | None = None  # a line that broke is opened again with it
        self.tap: Tap | None = None  # gets the bytes ahead of the parser: live mixing
        self._transport = transport
        self._target = target_system
        self.station = station  # beats as one, while the vehicle is disarmed
        self._out = mavlink.MAVLink(None, source_system, source_component)
        self._signer = signer
        if signer:
            signer.attach(self._out)
        genuine = signer.genuine if signer else None
        self.bound = Bound(address, self._new_parser, genuine, clock)
        self.autopilots = Autopilots(genuine)
        self._loss = Loss()
        self._stopping = threading.Event()
        self._log = _open_tlog(record) if record else None
        self._beat_s = 0.0  # when our next heartbeat is due
        self._thread = threading.Thread(target=self._run, name="coaxlink-link", daemon=True)

    # -- life ----------------------------------------------------------------------------------------------

    def start(self, timeout_s: float) -> None:
        """Start receiving; return once an autopilot is known. Raises LinkError."""
        with self.listen(("HEARTBEAT",)) as inbox:
            if isinstance(self._transport, Driven):
                self._transport.drive(self.turn)
            else:
                self._thread.start()
            end = self.clock.monotonic() + timeout_s
            while self.bound.identity is None:
                self.take(inbox, TICK_S)
                # who was heard is given the time to answer
                lost = self.clock.monotonic() > end and not self.bound.claimants
                if lost and self.bound.identity is None:
                    if self._signer and self._signer.refused:
                        raise SafetyRefusal("the vehicle is heard, but does not sign with this key")
                    who = f"system {self._target}" if self._target else "autopilot"
                    raise LinkError(self.address, f"no {who} heard within {timeout_s:g} s")
        if self.bound.peer is None:
            self.ask_version()

    def refuse_several(self, heard_s: float = ONE_BEAT_S) -> None:
        """Raises SafetyRefusal when none was named and others are heard, `heard_s` after the first answer."""
        if self._target is None:
            self.clock.sleep(max(0.0, self.bound.bound_s + heard_s - self.clock.monotonic()))
            self.autopilots.refuse_several()

    def refuse_unheard(self) -> None:
        """Raises SafetyRefusal when the vehicle signs, we do not, and it has not answered."""
        if self.bound.signs and not self.signed and self.identity.version is None:
            raise SafetyRefusal(
                f"{self.identity.name} at {self.address} signs its messages and answers none that are not "
                "signed: `signing_key`, the file with its key, is needed"
            )

    def close(self) -> None:
        """Stop receiving and let the line go; may be called twice."""
        self._stopping.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(2.0)
        self._transport.close()
        if self._signer:
            self._signer.close()
        with self._lock:
            if self._log:
                self._log.close()
                self._log = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # -- what is known -------------------------------------------------------------------------------------

    @property
    def identity(self) -> Identity:
        """Who answers. Raises LinkError before an autopilot was heard."""
        if self.bound.identity is None:
            raise LinkError(self.address, "no autopilot heard yet")
        return self.bound.identity

    @property
    def source(self) -> tuple[int, int]:
        """Our own system and component."""
        return self._out.srcSystem, self._out.srcComponent

    @property
    def signed(self) -> bool:
        """Whether this side signs and asks for signatures."""
        return self._signer is not None

    @property
    def trouble(self) -> str:
        """Why signing's timestamps cannot be kept just now, "" while all is well."""
        return self._signer.trouble if self._signer else ""

    def genuine(self, frame: bytes) -> bool:
        """Whether a frame may be believed: on a signed link, if it is signed with our key and new."""
        return self._signer is None or self._signer.genuine(frame)

    @property
    def silence_s(self) -> float:
        """Seconds since the autopilot's last heartbeat."""
        return self.clock.monotonic() - self.bound.heard_s

    @property
    def loss(self) -> float:
        """Share of the autopilot's messages that did not arrive, from their sequence numbers."""
        return self._loss.share

    # -- talking -------------------------------------------------------------------------------------------

    def send(self, message: Message) -> None:
        """Send a message; thread-safe. What a link loses is not sent again here."""
        self._send(message, None)

    def _send(self, message: Message, peer: Any) -> None:
        with self._lock:
            if self._signer:
                self._signer.tick()
            frame = bytes(message.pack(self._out))
            self._out.seq = (self._out.seq + 1) % 256
            self._record(frame)
            self._transport.write(frame, peer or self.bound.peer)

    def send_frame(self, pack: Callable[[int, int, int], bytes], seed: bytes) -> None:
        """Send what `pack(sequence, system, component)` makes; for those who have a codec of their own.

        `pack` makes an unsigned MAVLink 2 frame of a message with that CRC seed; it is signed if the link is.
        """
        with self._lock:
            frame = pack(self._out.seq, self._out.srcSystem, self._out.srcComponent)
            if self._signer:
                frame = self._signer.seal(frame, seed)
            self._out.seq = (self._out.seq + 1) % 256
            self._record(frame)
            self._transport.write(frame, self.bound.peer)

    def send_bytes(self, frames: bytes) -> None:
        """Pass on frames that someone else packed."""
        with self._lock:
            self._record(frames)
            self._transport.write(frames, self.bound.peer)

    # -- inside --------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while self.turn(TICK_S):
            pass

    def turn(self, wait_s: float) -> bool:
        """Beat, ask, and receive for `wait_s` at most; False once there is nothing more to receive."""
        try:
            self._receive(wait_s)
        except BaseException as error:
            if self._stopping.is_set():
                return False
            self._failure = error
            return isinstance(error, LinkError) and self._reopened()
        return not self._stopping.is_set()

    def _receive(self, wait_s: float) -> None:
        if self.clock.monotonic() >= self._beat_s:
            self._beat_s = self.clock.monotonic() + 1.0
            self.send(own_heartbeat(self.station and not self.armed))
        if self.bound.claimants:
            self._choose()
        for data, peer in self._chunks(wait_s):
            for message in self.bound.parser(peer).parse_buffer(data) or ():
                self._received(message, peer)

    def _chunks(self, wait_s: float) -> Iterator[tuple[bytes, Any]]:
        """What came from the vehicle and is still to be parsed, after the tap had its look at it."""
        tap = self.tap
        if tap is None:
            data, peer = self._transport.read(wait_s)
            if data and not self._strange(data, peer):
                yield data, peer
            return
        waiting = read_waiting(self._transport, min(wait_s, tap.tick_s))
        meant = [(data, peer) for data, peer in waiting if not self._strange(data, peer)]
        tap.take([data for data, _ in meant])
        yield from meant

    def _reopened(self) -> bool:
        """Try to open the line again until it works or the session ends; waits raise LinkError meanwhile."""
        while self.reopen and not self.clock.wait(self._stopping, 0.5):
            try:
                transport = self.reopen()
            except LinkError:
                continue
            with self._lock:
                self._transport.close()
                self._transport, self._failure = transport, None
            return True
        return False

    def _new_parser(self) -> mavlink.MAVLink:
        parser = mavlink.MAVLink(None, *self.source)
        parser.robust_parsing = True
        if self._signer:
            self._signer.attach(parser)
        return parser

    def _strange(self, data: bytes, peer: Any) -> bool:
        """Whether a datagram is none of our vehicle's.

        From another address it is counted and its sender asked; from the vehicle's own, where a router may
        bring everybody's, it is passed over when all of it is other systems'.
        """
        if not self.bound.elsewhere(peer):
            known = self.bound.identity
            if peer is None or known is None or not of_others(data, known.system):
                return False
            self.autopilots.look(data, peer)
            return True
        self.autopilots.look(data, peer)
        if self.bound.look(data, peer):
            self._send(version_request(self.identity), peer)
        return True

    def _received(self, message: Message, peer: Any) -> None:
        name = message.get_type()
        known = self.bound.identity
        if name == "BAD_DATA" or name.startswith("UNKNOWN"):
            if known is not None and name != "BAD_DATA":  # of another dialect, but it was not lost
                sequence, *sender = _raw_header(bytes(message.get_msgbuf()))
                if sender == [known.system, known.component]:
                    self._loss.heard(sequence)
                if sender[0] == known.system:  # pymavlink leaves its header empty
                    message._header = mavlink.MAVLink_header(0, 0, 0, 0, sequence, *sender)
                    self._tell(name, message, False)
            return
        system, component = _sender(message)
        if known is None or (system, component) != (known.system, known.component):
            self.autopilots.note(message, peer)
        if known is None:
            if name == "AUTOPILOT_VERSION" and (claimant := self.bound.claimant(peer)):
                self._answered(claimant, message, peer)
            if name != "HEARTBEAT" or not is_vehicle(message, self._target):
                return
            known = Identity(system, component, message.autopilot, message.type)
            if peer is not None:  # a datagram is easily forged: bound is who answers
                self.bound.suggest(known, message, peer)
                return
            self.bound.bind(known, None)
        elif system != known.system:
            return
        ours = component == known.component
        if ours:
            self._loss.heard(message.get_seq())
        self._believe(name, message, ours)

    def _believe(self, name: str, message: Message, ours: bool) -> None:
        if ours:
            if name in ("HEARTBEAT", "AUTOPILOT_VERSION") and not self.bound.same(message):
                return
            if name == "HEARTBEAT":
                self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        with self._lock:
            self._record(bytes(message.get_msgbuf()))
        self._tell(name, message, ours)

    def _choose(self) -> None:
        """Before the session is bound: ask who was heard; where nobody answers, the first is taken."""
        for identity, peer in self.bound.to_ask():
            self._send(version_request(identity), peer)
        choice = self.bound.silent_choice()
        if choice is not None:
            claimant, peer = choice
            self.bound.bind(claimant.identity, peer)
            self._believe("HEARTBEAT", claimant.heartbeat, True)

    def _answered(self, claimant: Claimant, message: Message, peer: Any) -> None:
        known = claimant.identity
        if not claimant.requests or (known.system, known.component) != _sender(message):
            return
        self.answer_s = self.clock.monotonic() - claimant.requested_s if claimant.requests == 1 else 0.0
        self.bound.bind(with_version(known, message), peer)
        self._believe("HEARTBEAT", claimant.heartbeat, True)
        self._loss.heard(message.get_seq())
        self._believe("AUTOPILOT_VERSION", message, True)

    def ask_version(self, tries: int = 6) -> None:
        """Ask which board it is, if that is not known yet."""
        if self.identity.uid:
            return
        request = version_request(self.identity)
        started = self.clock.monotonic()
        answer, again = self.exchange(request, "AUTOPILOT_VERSION", timeout_s=0.35, tries=tries)
        if answer is not None:
            self.answer_s = 0.0 if again else self.clock.monotonic() - started
            self.bound.identity = with_version(self.identity, answer)

    def _record(self, frame: bytes) -> None:
        """A row of a tlog: time of day (us, big endian), then the frame."""
        if self._log:
            self._log.write(struct.pack(">Q", time.time_ns() // 1000) + frame)


def _open_tlog(path: Path) -> BinaryIO:
    """Raises InputError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("wb")
    except OSError as error:
        raise InputError(path, "", f"cannot be written ({error.strerror})") from error


def _sender(message: Message) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _raw_header(frame: bytes) -> tuple[int, int, int]:
    """(sequence, system, component) of a frame whose message pymavlink does not know."""
    at = 4 if frame[0] == mavlink.PROTOCOL_MARKER_V2 else 2
    return frame[at], frame[at + 1], frame[at + 2]
