"""Live mixing: the autopilot's wrench demand in, motor commands out, in the rhythm of the demand.

Demand: normalised roll, pitch, yaw (-1..1) and thrust (0..1, up). Answer: controls[n] = normalised speed of
rotor n + 1. How they travel is the `wire`'s: ACTUATOR_CONTROL_TARGET (140) and SET_ACTUATOR_CONTROL_TARGET
(139), or what PX4's module sends and takes (`module_end`).

The walk of a demand, on the session's receiver thread:

    take        everything that waited on the line, ahead of the session's own parsing (`Session.tap`)
    _hear       the newest demand of the vehicle in it; on a signed link only what is signed with our key
    _answer     newer than the last, and young enough by the vehicle's clock (`age`);
                admission: group, finite, in range (`MixCore.admit`);
                what `bridge` wrote on board may follow another companion: then we are done (`bridge`);
                whether to answer, and how much of the law in it (`guard`);
                wrench, effects, law, bounds (`MixCore.mix`)
    _send       one frame, with the demand's own stamp
    _tick       between demands: hold, ramp to the autopilot's own mixer, silence (`guard`)
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from coaxlink.errors import SafetyRefusal
from coaxlink.live.age import DemandAge
from coaxlink.live.arrival import Arrival, by_bridge, by_vehicle
from coaxlink.live.guard import Guard, Timing, timing_for
from coaxlink.live.mixer_core import Compensation, MixCore, ToldScale
from coaxlink.live.paths import may_be_bridged, require_path
from coaxlink.live.stall import Stall
from coaxlink.live.timesync import TimeSync
from coaxlink.live.wire import ActuatorWire, Demand, Wire
from coaxlink.live.witness import REPORT_HZ, Witness, flying
from coaxlink.mavlink import codec
from coaxlink.mixer import Law
from coaxlink.vehicle import Vehicle, require_vehicle

if TYPE_CHECKING:
    from coaxlink.live.bridge import BridgeEnd
    from coaxlink.live.module_end import ModuleEnd
    from coaxlink.live.record import LiveRecord
    from coaxlink.mavlink.session import Session

OUTPUTS = codec.ACTUATOR_OUTPUT_STATUS


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
    ) -> None:
        require_vehicle(vehicle)
        if compensation is None and vehicle.live_effects:
            from coaxlink.live.effects import LiveEffects

            compensation = LiveEffects(session, vehicle)
        self.session, self._clock = session, session.clock
        self.core = MixCore(vehicle, law, compensation, own_curve)
        self.guard = Guard(timing or timing_for(rate_hz))
        self.rate_hz, self.dry_run = rate_hz, dry_run
        self.failed = threading.Event()
        self.error: Exception | None = None
        self.witness = Witness(self.core.count) if witness and not dry_run else None
        self.stall = Stall(self.guard.timing.silent_after_s)
        self.timesync: TimeSync | None = None
        self.age: DemandAge | None = None
        self.bridge: BridgeEnd | ModuleEnd | None = None  # its end of the line, with ours on board
        self.span_s = (0.0, 0.0)  # when it started and stopped, monotonic; 0 for not yet
        self._record = record
        self.wire: Wire = ActuatorWire()
        self._echoes: deque[bytes] = deque(maxlen=64)  # payloads sent: a router may hand them back
        self._target = (0, 0)  # the autopilot's system and component
        self._own_mixer = False  # whether its own mixer is known, so that a hand-over can be ramped to it

    # -- life ----------------------------------------------------------------------------------------------

    @property
    def tick_s(self) -> float:
        """How long the session may wait for bytes before it calls again (Session.tap)."""
        return self.guard.timing.tick_s

    @property
    def state(self) -> str:
        """Of the guard; see `live.guard`."""
        return self.guard.state

    def start(self) -> None:
        """Check the autopilot, ask for the demand, and answer it from now on."""
        session, identity = self.session, self.session.identity
        if may_be_bridged(identity.autopilot, identity.version):
            self.bridge = self._find_script() if identity.is_ardupilot else self._find_module()
        bridged = self.bridge is not None
        row = require_path(identity.autopilot, identity.version, bridged=bridged)
        self._target, self._own_mixer = (identity.system, identity.component), row.own_mixer
        self.span_s = (self._clock.monotonic(), 0.0)
        self.timesync = TimeSync(session)
        self.age = DemandAge(self.timesync, self.guard.timing)
        wanted = {self.wire.demand.number, self.wire.answer.number, OUTPUTS.number}
        self._scanner = codec.Scanner(wanted, codec.known_seeds())
        session.tap = self
        # a bridge sends its demand unasked, at its own pace
        if not bridged and not session.request_stream(self.wire.demand.number, self.rate_hz):
            self._let_go()
            raise SafetyRefusal(f"the autopilot will not send its wrench demand ({self.wire.demand.name})")
        # a bridge counts what it takes; ArduPilot has no such message and would say so on every screen
        if bridged or (self.witness and not session.request_stream(OUTPUTS.number, REPORT_HZ)):
            self.witness = None

    def _find_module(self) -> ModuleEnd | None:
        """Our module's end of the line, where it speaks: then its demand is read by what it says it means."""
        from coaxlink.live.module_end import ModuleEnd

        module = ModuleEnd(self.session, self.core.vehicle, self.rate_hz)
        if not module.find():
            return None
        self.core.scale = ToldScale(module.wrench)
        self.wire = module
        self.core.board_turns = True
        return module

    def _find_script(self) -> BridgeEnd | None:
        """Our script's end of the line, where it speaks: then its demand is read by the matrix on board."""
        from coaxlink.live.bridge import BridgeEnd, board_factors

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
        end = self._clock.monotonic() + patience_s
        while (
            self._own_mixer
            and self.guard.answering
            and not self.failed.is_set()
            and self._clock.monotonic() < end
        ):
            self._clock.sleep(self.tick_s)
        self._let_go()

    def _let_go(self) -> None:
        self.session.tap = None
        if self.timesync is not None:
            self.timesync.close()
        self.span_s = (self.span_s[0], self._clock.monotonic())
        if self._record is not None:
            self._record.flush()

    def __enter__(self) -> LiveMixer:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    # -- the walk of a demand, on the receiver thread --------------------------------------------------------

    def take(self, chunks: Sequence[bytes]) -> None:
        """All that waited on the line, in order; nothing when the wait was over."""
        if self.failed.is_set():
            return
        came = self._clock.monotonic()
        try:
            self.stall.turn(came)
            demand = self._hear(chunks, came)
            if demand is not None:
                self._answer(demand, came)
            self._tick(self._clock.monotonic())
        except Exception as error:
            # what fails once must not fail again at 250 Hz, nor take the whole session down in flight:
            # silence hands the vehicle back, and whoever watches `failed` says why
            self.core.counters.failures += 1
            self._give_up(error)

    def _hear(self, chunks: Sequence[bytes], now: float) -> Demand | None:
        """The newest demand; outputs and others' motor commands are judged on the way."""
        newest: Demand | None = None
        counters, wire = self.core.counters, self.wire
        for frame in (frame for data in chunks for frame in self._scanner.feed(data)):
            believed = self.session.genuine(frame.raw)
            ours = believed and (frame.system, frame.component) == self._target
            if frame.number == wire.demand.number:
                counters.foreign += not ours
                if ours and (demand := wire.read(frame.payload)) is not None:
                    counters.superseded += newest is not None
                    newest = demand
            elif frame.number == wire.answer.number and believed:
                if wire.is_command(frame.payload) and frame.payload not in self._echoes:
                    self._yield_to(f"system {frame.system} component {frame.component}")
            elif frame.number == OUTPUTS.number and ours:
                self._watch(OUTPUTS.unpack(frame.payload)[2:], now)
        return newest

    def _answer(self, demand: Demand, came: float) -> None:
        core, guard = self.core, self.guard
        stamp, *controls, group = demand
        if self.age is not None and (why := self.age.judge(stamp, came)):
            setattr(core.counters, why, getattr(core.counters, why) + 1)
            return
        if not core.admit(stamp, group, controls):
            return
        if self.bridge is not None and not self.dry_run and (rival := self.bridge.hear(demand)):
            self._yield_to(rival)
            return
        share = guard.good(came)
        if share is None:
            core.counters.settling += 1
            return
        commands = core.mix(share if self._own_mixer else 1.0)
        if commands is None:
            return
        self._send(stamp, commands, came)
        latency_s = self._clock.monotonic() - came
        core.account(latency_s)
        if self._record is not None:
            self._record.add(stamp, came, core.held, commands, core.error, latency_s, guard.state)

    def _send(self, stamp: int, commands: Sequence[float], now: float) -> None:
        def frame(sequence: int, system: int, component: int) -> bytes:
            packed = self.wire.pack((sequence, system, component), stamp, commands, self._target)
            self._echoes.append(packed[10:-2])
            return packed

        if not self.dry_run:
            self.session.send_frame(frame, self.wire.answer.seed)
        if self.witness is not None:
            self.witness.sent(now, commands)

    def _tick(self, now: float) -> None:
        guard, core = self.guard, self.core
        if self.timesync is not None:
            self.timesync.tick(guard.answering)
        if self.bridge is not None:
            self.bridge.tick(now)
        share = guard.tick(now)
        if share is not None and self._own_mixer:
            self._send((core.last_us or 0) + 1, core.blend(share), now)
        if self._record is not None:
            self._record.tick(now, handed_over=guard.hand_overs != core.counters.hand_overs)
        core.counters.hand_overs = guard.hand_overs

    def _watch(self, outputs_us: Sequence[float], now: float) -> None:
        if self.witness is None or not flying(self.session):
            return
        self.witness.reported(now, outputs_us)
        if self.witness.rival:
            self._give_up(SafetyRefusal(self.witness.why))

    def _yield_to(self, rival: str) -> None:
        self._give_up(SafetyRefusal(f"another companion commands the motors ({rival})"))

    def _give_up(self, error: Exception) -> None:
        self.error = error
        self.guard.stop(str(error))
        self.failed.set()

    # -- account -------------------------------------------------------------------------------------------

    @property
    def arrival(self) -> Arrival | None:
        """What became of the commands sent; None where the vehicle says too little."""
        sent = 0 if self.dry_run else self.core.counters.cycles
        if not sent:
            return None
        if self.bridge is not None:
            return by_bridge(sent, self.bridge.taken, self.bridge.acknowledged)
        return by_vehicle(sent, self.witness, self.timesync, self.session.loss)

    def summary(self) -> dict[str, Any]:
        """Counters, latency and allocation error so far, as `coaxlink mix --json` writes them."""
        started, stopped = self.span_s
        core, guard, sync, extra = self.core, self.guard, self.timesync, self.core.compensation
        trip = sync.round_trip_s if sync else None
        age = sync.age_s(core.last_us, guard.last) if sync and core.last_us is not None else None
        arrival = self.arrival
        return {
            "law": core.law.name,
            "state": guard.state,
            "why": guard.why,
            "dry_run": self.dry_run,
            "round_trip_us": trip * 1e6 if trip is not None else None,
            "demand_age_us": age * 1e6 if age is not None else None,
            "stalls": {"count": self.stall.count, "longest_s": self.stall.longest_s},
            "not_believed": self.session.bound.strangers.datagrams,
            "outputs_confirmed": self.witness.confirmed if self.witness else None,
            "arrival": arrival.to_json() if arrival else None,
            "board": self.bridge.account() if self.bridge else None,
            **core.counters.account((stopped or self._clock.monotonic()) - started if started else 0.0),
            "compensated": dict(core.vehicle.compensated)
            | dict.fromkeys(extra.names if extra else (), "live, from telemetry"),
            "not_compensated": dict(core.vehicle.left_out) | dict(extra.left_out if extra else {}),
        }
