"""The effects of the rotor file ([[effects]]), compensated live from the vehicle's own telemetry.

Battery voltage divides every command by the speed it loses, u = u_cmd (V / V_ref)^k; the others are what
they add to the wrench at the last speeds, taken off the demand before the law. The formulas are those of
`coaxlink.residual.effects`, whose sources they share, and of `coaxlink.mixer.physics`. An input that is
missing or older than STALE_S compensates nothing (voltage: holds its last factor), so that telemetry cannot
throw the vehicle.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.mixer.physics import climb_loss, ground_gain, speed_factor
from coaxlink.mixer.plain import PlainRotors
from coaxlink.mixer.seen import usual_lift
from coaxlink.rotor import RotorModel

if TYPE_CHECKING:
    from coaxlink.link.session import Session

STALE_S = 2.0
VOLTAGE_TAU_S = 0.5
FACTOR = (0.75, 1.15)  # of speed; a voltage that asks for more is taken for a broken sensor
MOST = 0.3  # of the thrust that one effect may be said to add
LEFT_OUT = {
    "rotor_drag": "a force in the rotors' plane, which no rotor speed can take back",
    "wind": "a force of the air on the body, which the position loop has to hold against",
    "mass_change": "no change of the rotors; the autopilot's hover thrust has to follow",
    "rotor_lag": "declare motor_lag_s and fly with --lead, which amplifies noise, or tune the loops to it",
    "rotor_inertia_torque": "needs the rotors' acceleration before it happens",
}
Wrench = NDArray[np.float64]
Part = Callable[[Sequence[float]], Wrench]


class Telemetry:
    """The newest of what effects read, with the (monotonic) time it came; fed by a session."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self._values: dict[str, tuple[float, Any]] = {}

    def hear(self, message: Any) -> None:
        """Session subscriber."""
        name = message.get_type()
        if name == "BATTERY_STATUS" and message.id == 0:
            cells = [v for v in message.voltages if 0 < v < 0xFFFF]
            self._put("voltage", sum(cells) / 1e3 if cells else math.nan)
        elif name == "SYS_STATUS" and 0 < message.voltage_battery < 0xFFFF:
            self._put("voltage", message.voltage_battery / 1e3)
        elif name == "DISTANCE_SENSOR" and message.orientation == 25:
            self._put("height", message.current_distance / 100.0)
        elif name == "LOCAL_POSITION_NED":
            self._put("velocity", (message.vx, message.vy, message.vz))
        elif name == "ATTITUDE":
            self._put("tilt", (message.roll, message.pitch))
            self._put("rates", (message.rollspeed, message.pitchspeed))

    def _put(self, name: str, value: Any) -> None:
        numbers = value if isinstance(value, tuple) else (value,)
        if all(math.isfinite(v) for v in numbers):
            self._values[name] = (self.clock(), value)

    def get(self, name: str) -> Any:
        """The value, None when there is none or it is stale."""
        found = self._values.get(name)
        return found[1] if found and self.clock() - found[0] <= STALE_S else None


class LiveEffects:
    """`command` and `wrench` for `MixCore`; `left_out` names the effects nothing is done about, and why."""

    def __init__(
        self,
        session: Session | None,
        airframe: Airframe,
        model: RotorModel,
        telemetry: Telemetry | None = None,
    ) -> None:
        self.telemetry = telemetry or Telemetry()
        self.left_out: dict[str, str] = {}
        self.names: list[str] = []
        self._rotors = PlainRotors.of(airframe, model)
        self._airframe, self._model = airframe, model
        self._voltage: Mapping[str, float] | None = None
        self._volts: float | None = None
        self._volts_at = 0.0
        self.factor = 1.0  # speed per command
        self._parts: list[Part] = []
        makers = {
            "ground_effect": self._ground, "axial_inflow": self._inflow, "cg_offset": self._offset,
            "degraded_rotor": self._degraded,
        }  # fmt: skip
        for effect in model.effects:
            if effect.name == "battery_voltage":
                self._voltage = effect.parameters
            elif effect.name in makers:
                self._parts.append(makers[effect.name](effect.parameters))
            else:
                self.left_out[effect.name] = LEFT_OUT.get(effect.name, "not known here")
                continue
            self.names.append(effect.name)
        if session is not None:
            session.subscribe(self.telemetry.hear)

    def wrench(self, speeds: Sequence[float]) -> Wrench:
        """(4,) what the effects add at these normalised speeds (N,), N and N m."""
        self._refresh()
        total = np.zeros(4)
        for part in self._parts:
            total += part(speeds)
        return total

    def _refresh(self) -> None:
        p = self._voltage
        volts = self.telemetry.get("voltage") if p else None
        if p is None or volts is None:
            return
        now = self.telemetry.clock()
        before = self._volts if self._volts is not None else volts
        share = 1.0 - math.exp(-(now - self._volts_at) / VOLTAGE_TAU_S) if self._volts is not None else 1.0
        self._volts, self._volts_at = before + share * (volts - before), now
        factor = speed_factor(p, self._volts)
        self.factor = min(max(factor, FACTOR[0]), FACTOR[1])

    # -- parts, each (speeds) -> wrench (4,) ---------------------------------------------------------------

    def _ground(self, p: Mapping[str, float]) -> Part:
        place = [r.position_m for r in self._airframe.rotors]

        def part(speeds: Sequence[float]) -> Wrench:
            height = self.telemetry.get("height")
            if height is None:
                return np.zeros(4)
            roll, pitch = self.telemetry.get("tilt") or (0.0, 0.0)
            # the body's downward direction: every disc has a height of its own
            down = (-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch))
            gains = [
                ground_gain(p, height - sum(d * x for d, x in zip(down, at, strict=True))) for at in place
            ]
            thrust, _ = self._loads(speeds)
            return self._of(np.array([min(max(g, -MOST), MOST) for g in gains]) * thrust)

        return part

    def _inflow(self, p: Mapping[str, float]) -> Part:
        place = np.array([r.position_m for r in self._airframe.rotors])
        axis = np.array([r.axis for r in self._airframe.rotors])
        by_rate = np.cross(place, axis)[:, :2]  # (w x r) . a = w . (r x a)
        usual = usual_lift(self._airframe, self._model)

        def part(speeds: Sequence[float]) -> Wrench:
            get = self.telemetry.get
            velocity, tilt, rates = get("velocity"), get("tilt"), get("rates")
            if velocity is None or tilt is None or rates is None:
                return np.zeros(4)
            # level flight's main part: the climb along a tilted axis, the body's own turning at each hub
            up = -velocity[2] * math.cos(tilt[0]) * math.cos(tilt[1])
            climb = up + by_rate @ rates
            thrust, _ = self._loads(speeds)
            most = MOST * float(thrust.sum()) / len(thrust)
            lost = climb_loss(p, climb, speeds, thrust, usual)
            return self._of(-np.minimum(np.maximum(lost, -most), most))

        return part

    def _offset(self, p: Mapping[str, float]) -> Part:
        x, y = p["offset_x_m"], p["offset_y_m"]

        def part(speeds: Sequence[float]) -> Wrench:
            total = float(self._rotors.wrench(speeds)[0])
            return np.array([0.0, y * total, -x * total, 0.0])

        return part

    def _degraded(self, p: Mapping[str, float]) -> Part:
        rotor = int(p["rotor"]) - 1

        def part(speeds: Sequence[float]) -> Wrench:
            thrust, torque = self._loads(speeds)
            only = np.zeros(len(thrust))
            only[rotor] = 1.0
            return self._of(-p["thrust_loss"] * thrust * only, -p.get("torque_loss", 0.0) * torque * only)

        return part

    def _loads(self, speeds: Sequence[float]) -> tuple[Wrench, Wrench]:
        r, n = self._rotors, len(speeds)
        thrust, torque = np.zeros(n), np.zeros(n)
        for a, b in r.pairs:
            u, v = float(speeds[a]), float(speeds[b])
            thrust[a], torque[a] = r.upper_thrust.value(u, v), r.upper_torque.value(u, v)
            thrust[b], torque[b] = r.lower_thrust.value(u, v), r.lower_torque.value(u, v)
        for i in r.singles:
            u = float(speeds[i])
            thrust[i], torque[i] = r.upper_thrust.value(u, 0.0), r.upper_torque.value(u, 0.0)
        return thrust, torque

    def _of(self, thrust: Wrench, torque: Wrench | None = None) -> Wrench:
        n = len(thrust)
        out = self._rotors.per_load[:, :n] @ thrust
        return out if torque is None else out + self._rotors.per_load[:, n:] @ torque
