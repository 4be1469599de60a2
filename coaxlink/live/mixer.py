"""Live mixing: the autopilot's wrench demand in, motor commands out, in the rhythm of the demand.

Demand: ACTUATOR_CONTROL_TARGET (140), group 0, normalised roll, pitch, yaw (-1..1) and thrust (0..1, up).
Answer: SET_ACTUATOR_CONTROL_TARGET (139), controls[n] = normalised speed of rotor n + 1.

Every answer belongs to exactly one demand, and of several that wait only the newest is answered. A demand
that is not finite, absurd, of another group or older than the one before gets none. When the demand ends,
`live_guard` hands the vehicle back to the autopilot's own mixer; outputs are checked on their way out.
The bytes are taken ahead of the session's own parsing (`Session.tap`), by the codec of `codec.py`; on a
signed link what comes in goes through pymavlink, which keeps the books of signatures.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import SafetyRefusal
from coaxlink.live.account import account
from coaxlink.live.counts import Counters
from coaxlink.live.guard import Guard, Timing, timing_for
from coaxlink.live.inbox import Inbox
from coaxlink.live.kernel import LEFT
from coaxlink.live.mixer_core import CONTROLS, Compensation, DemandScale, MixCore
from coaxlink.live.paths import PATHS, path_for, require_path
from coaxlink.live.stall import Stall, backlog
from coaxlink.live.timesync import TimeSync
from coaxlink.live.witness import REPORT_HZ, Witness, flying
from coaxlink.mavlink import codec
from coaxlink.mavlink.transport import Udp
from coaxlink.mixer import Law
from coaxlink.vehicle import Vehicle, require_vehicle

if TYPE_CHECKING:
    from coaxlink.live.attitude_loop import AttitudeLoop
    from coaxlink.live.compiled import Exchange
    from coaxlink.live.record import LiveRecord
    from coaxlink.live.scripts.bridge import BridgeEnd
    from coaxlink.mavlink.session import Session
    from coaxlink.mixer.exact import ExactLaw

__all__ = [
    "CONTROLS", "PATHS", "Counters", "DemandScale", "LiveMixer", "MixCore", "path_for", "require_path",
]  # fmt: skip

DEMAND, ANSWER = codec.ACTUATOR_CONTROL_TARGET, codec.SET_ACTUATOR_CONTROL_TARGET
OUTPUTS = codec.ACTUATOR_OUTPUT_STATUS
STATE, TARGET = codec.ATTITUDE_QUATERNION, codec.ATTITUDE_TARGET
ARDUPILOT = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
TURN_S = 0.1  # of the compiled function; then heartbeats, TIMESYNC, the record's disk have theirs
EFFECTS_TURN_S = 0.02  # how often effects are followed meanwhile


class LiveMixer:
    """Live mixing on a session, in its receiver thread: `start`, `stop`, or as a context manager.

    The effects that `vehicle` leaves to live mixing are compensated from its telemetry, by `compensation` or
    as `LiveEffects` does; `summary` names what is and what is not. A `law` by name is made for this vehicle.
    `dry_run` computes everything and sends no motor command. `failed` is set when it gave up for good; then
    `error` says why. Raises SafetyRefusal on `start` when the autopilot cannot take motor commands.
    """

    def __init__(
        self,
        session: Session,
        vehicle: Vehicle,
        law: str | Law = "exact",
        *,
        rate_hz: float = 250.0,
        timing: Timing | None = None,
        dry_run: bool = False,
        witness: bool = True,
        compensation: Compensation | None = None,
        record: LiveRecord | None = None,
        own_curve: float = 0.0,
        loop: AttitudeLoop | None = None,
        lead_s: tuple[float, float] = (0.0, 0.0),
        native: Any = None,
    ) -> None:
        require_vehicle(vehicle)
        if compensation is None and vehicle.live_effects:
            from coaxlink.live.effects import LiveEffects

            compensation = LiveEffects(session, vehicle, lag_s=lead_s[1] if lead_s[0] else None)
        self.core = MixCore(vehicle, law, compensation, own_curve, lead_s)
        self.guard = Guard(timing or timing_for(rate_hz))
        self.rate_hz, self.dry_run = rate_hz, dry_run
        self.session = session
        self.failed = threading.Event()
        self.error: Exception | None = None
        self.witness = Witness(self.core.count) if witness and not dry_run else None
        self._record = record
        self._loop = loop
        self._native = native
        self.exchange: Exchange | None = None
        self.timesync: TimeSync | None = None
        heard = {ANSWER.number, OUTPUTS.number} | ({STATE.number, TARGET.number} if loop else {DEMAND.number})
        self._scanner = codec.Scanner(heard, codec.known_seeds())
        self._next: deque[tuple[ExactLaw, Vehicle]] = deque(maxlen=1)  # the law to go on with
        self._echoes: deque[bytes] = deque(maxlen=64)
        self.stall = Stall(self.guard.timing.silent_after_s)
        self.inbox = Inbox(self.stall, self.core.counters)
        self._payload: tuple[Any, ...] = ()
        self._target = (0, 0)
        self._own_mixer = False
        self.bridge: BridgeEnd | None = None
        self._unsubscribe: Callable[[], None] | None = None
        self.span_s = (0.0, 0.0)  # when it started and stopped, monotonic; 0 for not yet

    # -- life ----------------------------------------------------------------------------------------------

    @property
    def tick_s(self) -> float:
        """How long the session may wait for bytes before it calls again (Session.tap)."""
        return self.guard.timing.tick_s

    @property
    def state(self) -> str:
        """Of the guard; see `live_guard`."""
        return self.guard.state

    def start(self) -> None:
        """Check the autopilot, ask for the demand, and answer it from now on."""
        identity = self.session.identity
        if identity.autopilot == ARDUPILOT:
            self.bridge = self._find_bridge()
        bridged = self.bridge is not None
        row = require_path(identity.autopilot, identity.version, bridged=bridged)
        self._target, self._own_mixer = (identity.system, identity.component), row.own_mixer
        self.span_s = (time.monotonic(), 0.0)
        if self._native is not None and self._loop is None and not self.dry_run and not self.session.signed:
            from coaxlink.live.compiled import Exchange

            ids = (*self._target, *self.session.source)
            self.exchange = Exchange.of(self._native, self.core, self.session.counter, ids)
        if self.session.signed:
            self._unsubscribe = self.session.subscribe(self._on_message)
        self.timesync = TimeSync(self.session)
        self.session.tap = self
        # a bridge sends its demand unasked, at its own pace
        for message in (STATE, TARGET) if self._loop else () if bridged else (DEMAND,):
            if not self.session.request_stream(message.number, self.rate_hz):
                self._let_go()
                what = "the state and setpoint" if self._loop else "its wrench demand"
                raise SafetyRefusal(f"the autopilot will not send {what} ({message.name})")
        # ArduPilot has no such message and would say so on every ground station's screen
        if self.witness is not None and (
            bridged or not self.session.request_stream(OUTPUTS.number, REPORT_HZ)
        ):
            self.witness = None

    def _find_bridge(self) -> BridgeEnd | None:
        """Our script's end of the line, where it speaks: then its demand is read by the matrix on board."""
        from coaxlink.live.scripts.bridge import BridgeEnd, board_factors

        bridge = BridgeEnd(self.session)
        if not bridge.find():
            return None
        self.core.use_matrix(board_factors(self.session))
        return bridge

    def stop(self, patience_s: float = 0.25) -> None:
        """Fade to the autopilot's own mixer if demands come, then answer no more."""
        if self.session.tap is not self:
            return
        self.guard.leaving = True
        if self.exchange is not None:
            self.exchange.interrupt()
        end = time.monotonic() + patience_s
        while (
            self._own_mixer and self.guard.answering and not self.failed.is_set() and time.monotonic() < end
        ):
            time.sleep(self.tick_s)
        self._let_go()

    def adopt(self, law: ExactLaw, vehicle: Vehicle) -> None:
        """Go on with another law of this airframe, from the next demand on. From any thread."""
        self._next.append((law, vehicle))
        if self.exchange is not None:
            self.exchange.interrupt()

    def _change(self) -> None:
        """Take up the newest law that was handed over; a later one, even one of this moment, has its turn."""
        law, vehicle = self._next.pop()
        try:
            self.core.adopt(law, vehicle)
            if self.exchange is not None:
                self.exchange.use(law)
        except Exception as error:  # half of another law is none
            self.core.counters.failures += 1
            self._give_up(error)

    def _let_go(self) -> None:
        self.session.tap = None
        if self.timesync is not None:
            self.timesync.close()
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None
        self.span_s = (self.span_s[0], time.monotonic())
        if self._record is not None:
            self._record.flush()

    def __enter__(self) -> LiveMixer:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    # -- on the receiver thread ----------------------------------------------------------------------------

    def serve(self, line: Any, peer: Any) -> list[tuple[bytes, Any]] | None:
        """Let the compiled function wait and answer while the law flies alone; see `session.Tap`."""
        if self._next:
            self._change()
        if not isinstance(line, Udp):
            return None
        if self.stall.draining:
            waiting, older = backlog(line, peer, self._alone)
            self.core.counters.superseded += older
            if waiting:
                return waiting
        exchange, to = self.exchange, line.one_target(peer)
        if exchange is None or to is None or not self.guard.steady or not self.inbox.empty:
            return None
        timing, turn_s = self.guard.timing, TURN_S if self.core.compensation is None else EFFECTS_TURN_S
        try:
            self.core.compensate()
            line.arm(self.tick_s)
            done = exchange(line.fileno(), to, self.guard.last, timing.silent_after_s, turn_s)
            self._book(exchange)
        except Exception as error:
            self.core.counters.failures += 1
            self._give_up(error)
            return None
        if done > 0:
            return [(exchange.handed(done), to)]
        return None if done == LEFT else []

    def _book(self, exchange: Exchange) -> None:
        """Keep what the compiled function answered."""
        for stamp, came_ns, sent_ns, held, commands, error, given_up, received, sent in exchange.answered():
            came, latency_s = came_ns * 1e-9, (sent_ns - came_ns) * 1e-9
            self.guard.good(came)
            self.stall.here(came)
            self._echoes.append(sent[10:-2])
            self._sent(commands, came)
            self.core.book(latency_s, error, bool(given_up))
            self._keep(stamp, came, held, commands, error, latency_s)
            self.session.book(received, sent)
            if self.bridge is not None:
                self._outdone(DEMAND.unpack(received[10:-2]))

    def take(self, data: bytes) -> None:
        """Bytes from the line, or none when the wait was over: answer what is to be answered."""
        if self.failed.is_set():
            return
        began = time.perf_counter()
        self.stall.turn(began, self.core.last_us, self.guard.last)
        try:
            if data:
                quick = self._loop is None and self._unsubscribe is None
                alone = self._alone(data) if quick else None
                if alone is not None:
                    self._scanner.drop()  # what waited for its other half was noise
                    self.inbox.put(alone, began)
                else:
                    for frame in self._scanner.feed(data):
                        self._frame(frame, began)
            demand = self.inbox.due(began, self.session.fileno)
            if demand is not None:
                self._answer(demand, began)
            self._tick(time.perf_counter())
        except Exception as error:
            # what fails once must not fail again at 250 Hz, nor take the whole session down in flight:
            # silence hands the vehicle back, and whoever watches `failed` says why
            self.core.counters.failures += 1
            self._give_up(error)

    def _alone(self, data: bytes) -> tuple[Any, ...] | None:
        return DEMAND.alone(data, *self._target)

    def _give_up(self, error: Exception) -> None:
        self.error = error
        self.guard.stop(str(error))
        self.failed.set()

    def _frame(self, frame: codec.Frame, began: float) -> None:
        if frame.signed and self._unsubscribe is not None:
            return  # pymavlink checks the signature and hands it on
        if frame.number in (DEMAND.number, STATE.number, TARGET.number):
            if (frame.system, frame.component) != self._target or self._unsubscribe is not None:
                self.core.counters.foreign += 1
                return
            self._meant(frame.number, codec.HOT[frame.number].unpack(frame.payload), began)
        elif frame.number == ANSWER.number:
            ours = frame.payload in self._echoes or ANSWER.unpack(frame.payload)[9] != 0
            if not ours:  # a router may hand us our own words back
                who = f"system {frame.system} component {frame.component}"
                self._give_up(SafetyRefusal(f"another companion commands the motors ({who})"))
        elif self.witness is not None and (frame.system, frame.component) == self._target:
            self._watch(OUTPUTS.unpack(frame.payload)[2:], began)

    def _meant(self, number: int, f: tuple[Any, ...], began: float) -> None:
        """The fields of a demand, or of a state or setpoint of which our own loop makes one."""
        loop = self._loop
        if loop is None:
            if number == DEMAND.number:
                self.inbox.put(f, began)
        elif number == TARGET.number:
            loop.aim(f[0] * 1000, f[1:5], f[5:8], f[8])
        elif number == STATE.number:
            torque = loop.torque(f[0] * 1000, f[1:5], f[5:8])
            if torque is not None:
                controls = self.core.scale.controls(loop.thrust, torque)
                self.inbox.put((f[0] * 1000, *controls, 0.0, 0.0, 0.0, 0.0, 0), began)

    def _on_message(self, message: Any) -> None:
        """On a signed link: pymavlink has checked the signature."""
        number = message.get_msgId()
        if (
            number not in codec.HOT
            or (message.get_srcSystem(), message.get_srcComponent()) != self._target
            or self.failed.is_set()
        ):
            return
        now = time.perf_counter()
        if number == OUTPUTS.number:
            self._watch(message.actuator, now)
        elif number != ANSWER.number:
            self._meant(number, codec.fields_of(message), now)
            self.take(b"")

    def _answer(self, demand: tuple[Any, ...], began: float) -> None:
        core, guard = self.core, self.guard
        stamp = demand[0]
        if not core.admit(stamp, demand[9], demand[1:5]):
            return
        if self.bridge is not None and self._outdone(demand):
            return
        share = guard.good(began)
        if share is None:
            core.counters.settling += 1
            return
        commands = core.mix(share if self._own_mixer else 1.0)
        if commands is None:
            return
        self._say(stamp, commands, began)
        latency_s = time.perf_counter() - began
        core.account(latency_s)
        self._keep(stamp, began, core.held, commands, core.error, latency_s)

    def _outdone(self, demand: tuple[Any, ...]) -> bool:
        """Whether the bridge says that it follows another companion; then this one is done."""
        rival = self.bridge.hear(demand) if self.bridge and not self.dry_run else None
        if rival:
            self._give_up(SafetyRefusal(f"another companion commands the motors ({rival})"))
        return rival is not None

    def _say(self, stamp: int, commands: list[float], now: float) -> None:
        if not self.dry_run:
            self._payload = (stamp, *commands, 0, *self._target)
            self.session.send_frame(self._pack, ANSWER.seed)
        self._sent(commands, now)

    def _sent(self, commands: list[float], now: float) -> None:
        if self.witness is not None:
            self.witness.sent(now, commands)

    def _keep(
        self,
        stamp: int,
        came: float,
        held: Sequence[float],
        commands: Sequence[float],
        error: Sequence[float],
        latency_s: float,
    ) -> None:
        if self._record is not None:
            self._record.add(stamp, came, held, commands, error, latency_s, self.guard.state)

    def _pack(self, sequence: int, system: int, component: int) -> bytes:
        frame = ANSWER.pack(sequence, system, component, *self._payload)
        self._echoes.append(frame[10:-2])
        return frame

    def _tick(self, now: float) -> None:
        guard, core = self.guard, self.core
        if self.timesync is not None:
            self.timesync.tick(self.guard.answering)
        if self.bridge is not None:
            self.bridge.tick(now)
        before = guard.hand_overs
        share = guard.tick(now)
        if share is not None and self._own_mixer:
            factor = core.compensation.factor if core.compensation is not None else 1.0
            last = [min(max(u / factor, 0.0), 1.0) for u in core.speeds]
            self._say((core.last_us or 0) + 1, core.say(core.blend(last, share)), now)
        if self._record is not None:
            self._record.tick(now, handed_over=guard.hand_overs != before)
        core.counters.hand_overs = guard.hand_overs

    def _watch(self, outputs_us: Sequence[float], now: float) -> None:
        if self.witness is None or not flying(self.session):
            return
        self.witness.reported(now, outputs_us)
        if self.witness.rival:
            self._give_up(SafetyRefusal(self.witness.why))

    # -- account -------------------------------------------------------------------------------------------

    def summary(self) -> dict[str, Any]:
        """Counters, latency and allocation error so far, as `coaxlink mix --json` writes them."""
        return account(self)
