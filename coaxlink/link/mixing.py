"""Live mixing: the autopilot's wrench demand in, motor commands out, in the rhythm of the demand.

Demand: ACTUATOR_CONTROL_TARGET (140), group 0, normalised roll, pitch, yaw (-1..1) and thrust (0..1, up).
Answer: SET_ACTUATOR_CONTROL_TARGET (139), controls[n] = normalised speed of rotor n + 1.

Every answer belongs to exactly one demand. A demand that is not finite, is not group 0 or is older than the
one before gets no answer, so when the demand stops or turns to rubbish the answers stop with it, and the
autopilot flies on its own mixer. Outputs are checked once more on their way out.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.airframe import Airframe
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.mixer import Law, StandardCoefficients, standard_coefficients
from coaxlink.mixer.plain import PlainRotors
from coaxlink.rotor import RotorModel
from firmware_params.px4 import Px4Table, RotorEntry, realise

if TYPE_CHECKING:
    from coaxlink.link.session import Session

CONTROLS = 8  # what the messages carry
LATENCIES = 65536  # the newest ones are kept for the percentiles
RESTART_US = (
    1_000_000  # a demand older than the last by more than this is a rebooted clock, not a late packet
)

# Which autopilot takes motor commands by message 139, and where that was read or flown.
PATHS = (
    (mavlink.MAV_AUTOPILOT_PX4, (1, 13), "legacy mixer only (SYS_CTRL_ALLOC = 0); flown on the stand-in"),
)
NO_PATH = {
    mavlink.MAV_AUTOPILOT_PX4: (
        "PX4 {version} ignores SET_ACTUATOR_CONTROL_TARGET (139): removed in 1.14, and no other MAVLink "
        "message flies eight motors; upload a table instead (coaxlink table, coaxlink upload)"
    ),
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: (
        "ArduPilot has no handler for SET_ACTUATOR_CONTROL_TARGET (139): it needs a Lua bridge on board"
    ),
}


def require_path(autopilot: int, version: tuple[int, ...] | None) -> None:
    """Raise SafetyRefusal, with the reason, unless this autopilot takes motor commands by message 139."""
    for known, newest, _ in PATHS:
        if autopilot == known and version is not None and tuple(version[:2]) <= newest:
            return
    name = ".".join(str(v) for v in version) if version else "of unknown version"
    text = NO_PATH.get(autopilot, f"no way is known to command the motors of autopilot type {autopilot} live")
    raise SafetyRefusal(text.format(version=name))


class DemandScale:
    """The wrench that a normalised demand means: W = E (mix s) of a reference table.

    E is the table's effectiveness in N and N m per unit setpoint and `mix` PX4's normalised mix of it. For
    the legacy mixers (<= 1.13) the reference is the standard table of the airframe.
    """

    def __init__(self, airframe: Airframe, standard: StandardCoefficients) -> None:
        table = Px4Table(
            tuple(RotorEntry(r.position_m, r.axis, standard.p, r.yaw_sign * standard.q / standard.p)
                  for r in airframe.rotors),
            thr_mdl_fac=0.0,
        )  # fmt: skip
        mix = realise(table)
        body = mix.effectiveness @ mix.mix  # (6, 6): roll, pitch, yaw, x, y, z of each normalised control
        per_control = body[:, [0, 1, 2, 5]] * np.array([1.0, 1.0, 1.0, -1.0])  # thrust counts upward
        self.matrix: NDArray[np.float64] = np.stack([-per_control[5], *per_control[:3]])  # (4, 4)

    def wrench(self, controls: Sequence[float]) -> NDArray[np.float64]:
        """(4,) wrench, N and N m, of controls [roll, pitch, yaw, thrust]."""
        return self.matrix @ np.asarray(controls[:4], float)


@dataclass
class Counters:
    """What the loop did, from the start of it."""

    cycles: int = 0
    not_finite: int = 0
    other_group: int = 0
    late: int = 0
    clamped: int = 0
    refused_outputs: int = 0
    failures: int = 0
    latency_s: deque[float] = field(default_factory=lambda: deque(maxlen=LATENCIES))
    error_sum: NDArray[np.float64] = field(default_factory=lambda: np.zeros(4))  # |delivered - demand|
    error_max: NDArray[np.float64] = field(default_factory=lambda: np.zeros(4))


class MixCore:
    """Demand in, commands out; no clock, no link: what `LiveMixer` runs and tests drive by hand."""

    def __init__(self, airframe: Airframe, law: Law, model: RotorModel) -> None:
        if len(airframe.rotors) > CONTROLS:
            raise InputError(
                airframe.source or airframe.name, "rotors", f"live mixing carries {CONTROLS} motors at most"
            )
        self.law = law
        self.scale = DemandScale(airframe, standard_coefficients(model))
        self.counters = Counters()
        self._rotors = PlainRotors.of(airframe, model)
        self._count = len(airframe.rotors)
        self._last_us: int | None = None
        self.wrench = np.zeros(4)
        self.speeds = np.zeros(self._count)

    def step(self, time_usec: int, group: int, controls: Sequence[float]) -> list[float] | None:
        """Eight commands in [0, 1] for one demand, or None when it deserves no answer."""
        c = self.counters
        if group != 0:
            c.other_group += 1
            return None
        if not all(math.isfinite(v) for v in controls[:4]):
            c.not_finite += 1
            return None
        if self._last_us is not None and self._last_us - RESTART_US < time_usec <= self._last_us:
            c.late += 1
            return None
        self._last_us = time_usec
        held = [min(max(v, -1.0), 1.0) for v in controls[:3]] + [min(max(controls[3], 0.0), 1.0)]
        c.clamped += held != list(controls[:4])
        self.wrench = self.scale.wrench(held)
        self.speeds = self.law.speeds(self.wrench)
        commands = [float(u) for u in self.speeds]
        if not all(0.0 <= u <= 1.0 for u in commands):  # also false for NaN
            c.refused_outputs += 1
            return None
        return commands + [0.0] * (CONTROLS - self._count)

    def account(self, latency_s: float) -> None:
        """Book the last step: its latency and what the rotor model says its speeds miss of the demand."""
        c = self.counters
        c.cycles += 1
        c.latency_s.append(latency_s)
        miss = np.abs(self._rotors.wrench(self.speeds) - self.wrench)
        c.error_sum += miss
        np.maximum(c.error_max, miss, out=c.error_max)


class LiveMixer:
    """Live mixing on a session, in its receiver thread: `start`, `stop`, or as a context manager.

    Raises SafetyRefusal on `start` when the autopilot cannot take motor commands.
    """

    def __init__(
        self, session: Session, airframe: Airframe, law: Law, model: RotorModel, *, rate_hz: float = 250.0
    ) -> None:
        self.core = MixCore(airframe, law, model)
        self.rate_hz = rate_hz
        self.session = session
        self.failed = threading.Event()
        self.error: Exception | None = None
        self._unsubscribe: Callable[[], None] | None = None
        self._started = self._stopped = 0.0

    def start(self) -> None:
        """Check the autopilot, ask for the demand, and answer it from now on."""
        identity = self.session.identity
        require_path(identity.autopilot, identity.version)
        self._started = time.monotonic()
        self._unsubscribe = self.session.subscribe(self._on_message)
        if not self.session.request_stream(mavlink.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET, self.rate_hz):
            self.stop()
            raise SafetyRefusal("the autopilot will not send its wrench demand (ACTUATOR_CONTROL_TARGET)")

    def stop(self) -> None:
        """Answer no more; the autopilot notices and flies its own mixer."""
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None
            self._stopped = time.monotonic()

    def __enter__(self) -> LiveMixer:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _on_message(self, message: Any) -> None:
        if message.get_type() != "ACTUATOR_CONTROL_TARGET" or self.failed.is_set():
            return
        began = time.perf_counter()
        try:
            commands = self.core.step(message.time_usec, message.group_mlx, message.controls)
            if commands is not None:
                identity = self.session.identity
                self.session.send(
                    mavlink.MAVLink_set_actuator_control_target_message(
                        message.time_usec, 0, identity.system, identity.component, commands
                    )
                )
                self.core.account(time.perf_counter() - began)
        except Exception as error:
            # what fails once must not fail again at 250 Hz, nor take the whole session down in flight:
            # silence hands the vehicle back, and whoever watches `failed` says why
            self.core.counters.failures += 1
            self.error = error
            self.failed.set()

    def summary(self) -> dict[str, Any]:
        """Counters, latency and allocation error so far, as `coaxlink mix --json` writes them."""
        c = self.core.counters
        seconds = (self._stopped or time.monotonic()) - self._started if self._started else 0.0
        p50, p99 = np.percentile(c.latency_s, [50, 99]) * 1e6 if c.latency_s else (0.0, 0.0)
        mean = c.error_sum / max(c.cycles, 1)
        return {
            "law": self.core.law.name,
            "cycles": c.cycles,
            "seconds": seconds,
            "rate_hz": c.cycles / seconds if seconds > 0 else 0.0,
            "latency_us": {"p50": float(p50), "p99": float(p99)},
            "allocation_error": {"mean": mean.tolist(), "max": c.error_max.tolist()},
            "clamped_demands": c.clamped,
            "unanswered": {
                "not_finite": c.not_finite,
                "late": c.late,
                "other_group": c.other_group,
                "refused_outputs": c.refused_outputs,
                "failures": c.failures,
            },
        }
