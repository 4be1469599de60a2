"""The effects of the rotor file ([[effects]]), compensated live from the vehicle's own telemetry.

Battery voltage divides every command by the speed it loses, u = u_cmd (V / V_ref)^k; the others are what
they add to the wrench at the last speeds, taken off the demand before the law. The formulas are those of
`coaxlink.residual.effects`, whose sources they share, and of `coaxlink.mixer.physics`. An input that is
missing or older than STALE_S compensates nothing (voltage: holds its last factor), so that telemetry cannot
throw the vehicle.

What is taken off now acts when the motors have followed: speed, turning and height are carried forward by the
telemetry's age and the motors' lag, with the acceleration that the wrench of now makes (rigid body, the
airframe's own mass and inertia; no difference of noisy readings).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.link.live_telemetry import Telemetry, body_axes, wanted_streams
from coaxlink.mixer.fitted import GRAVITY
from coaxlink.mixer.physics import climb_loss, ground_gain, speed_factor
from coaxlink.mixer.plain import PlainRotors
from coaxlink.mixer.seen import usual_lift
from coaxlink.rotor import RotorModel
from coaxlink.rotor.model import Effect

if TYPE_CHECKING:
    from coaxlink.link.session import Session

VOLTAGE_TAU_S = 0.5
FACTOR = (0.75, 1.15)  # of speed; a voltage that asks for more is taken for a broken sensor
MOST = 0.3  # of the thrust that one effect may be said to add
MOST_AHEAD_S = 0.15
GAS_CONSTANT = 287.05  # J/(kg K), dry air
PRESSURE_PA, AIR_C = (30e3, 115e3), (-60.0, 60.0)  # beyond, a sensor is broken
LEFT_OUT = {
    "rotor_drag": "a force in the rotors' plane, which no rotor speed can take back",
    "wind": "a force of the air on the body, which the position loop has to hold against",
    "mass_change": "no change of the rotors; the autopilot's hover thrust has to follow",
    "rotor_lag": "declare motor_lag_s and fly with --lead, which amplifies noise, or tune the loops to it",
    "rotor_inertia_torque": "needs the rotors' acceleration before it happens",
}
NUMBERS = {  # that an effect cannot do without
    "battery_voltage": ("speed_exponent", "reference_voltage_V"),
    "axial_inflow": ("thrust_per_climb_N_s_m",),
    "cg_offset": ("offset_x_m", "offset_y_m"),
    "degraded_rotor": ("rotor", "thrust_loss"),
    "air_density": ("density_exponent", "reference_density_kg_m3"),
}
Wrench = NDArray[np.float64]
Part = Callable[[Sequence[float]], Wrench]


class LiveEffects:
    """`command` and `wrench` for `MixCore`; `left_out` names the effects nothing is done about, and why.

    `lag_s` is what the motors take to follow, the airframe's own if not given; `air_temperature_C` is the
    air's, which a barometer does not know.
    """

    def __init__(
        self,
        session: Session | None,
        airframe: Airframe,
        model: RotorModel,
        telemetry: Telemetry | None = None,
        *,
        lag_s: float | None = None,
        air_temperature_C: float | None = None,
    ) -> None:
        self.telemetry = telemetry or Telemetry()
        self.left_out: dict[str, str] = {}
        self.names: list[str] = []
        self._rotors = PlainRotors.of(airframe, model)
        self._airframe, self._model = airframe, model
        self._lag_s = airframe.motor_lag_s if lag_s is None else lag_s
        self._air_C = air_temperature_C
        self._mass = airframe.mass_kg
        self._inertia = airframe.inertia_kg_m2
        self._total = [0.0] * 4  # delivered at the last speeds, effects and all
        self._voltage: Mapping[str, float] | None = None
        self._volts: float | None = None
        self._volts_at = 0.0
        self.factor = 1.0  # speed per command
        self._parts: list[Part] = []
        makers = {
            "ground_effect": self._ground, "axial_inflow": self._inflow, "cg_offset": self._offset,
            "degraded_rotor": self._degraded, "air_density": self._air,
        }  # fmt: skip
        for effect in model.effects:
            if effect.name == "mass_change":
                self._mass = effect.parameters.get("mass_kg", self._mass)
            reason = LEFT_OUT.get(effect.name) or missing_number(effect)
            if effect.name == "battery_voltage" and not reason:
                self._voltage = effect.parameters
            elif effect.name in makers and not reason:
                self._parts.append(makers[effect.name](effect.parameters))
            else:
                self.left_out[effect.name] = reason or "not known here"
                continue
            self.names.append(effect.name)
        if session is not None:
            session.subscribe(self.telemetry.hear)
            for message_id, rate_hz in wanted_streams(self.names).items():
                session.request_stream(message_id, rate_hz)

    def wrench(self, speeds: Sequence[float]) -> Wrench:
        """(4,) what the effects add at these normalised speeds (N,), N and N m."""
        self._refresh()
        total = np.zeros(4)
        for part in self._parts:
            total += part(speeds)
        self._total = [m + e for m, e in zip(self._rotors.plain_wrench(speeds), total.tolist(), strict=True)]
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

    def _ahead(self, name: str) -> float:
        """From the time of a reading to when the motors have followed what is told them now (s)."""
        return min(self.telemetry.age(name) + self._lag_s, MOST_AHEAD_S)

    def _rates(self) -> list[float] | None:
        """(3,) body rates then, rad/s."""
        known = self.telemetry.get("rates")
        if known is None:
            return None
        (p, q, r), (ix, iy, iz), ahead = known, self._inertia, self._ahead("rates")
        _, roll, pitch, yaw = self._total
        return [  # Euler's equations
            p + ahead * (roll - (iz - iy) * q * r) / ix,
            q + ahead * (pitch - (ix - iz) * r * p) / iy,
            r + ahead * (yaw - (iy - ix) * p * q) / iz,
        ]

    def _velocity(self) -> list[float] | None:
        """(3,) speed over ground then, in body axes, m/s; air that moves is not known here."""
        velocity, attitude = self.telemetry.get("velocity"), self.telemetry.get("attitude")
        if velocity is None or attitude is None:
            return None
        rows = body_axes(*attitude)
        ahead, pull = self._ahead("velocity"), self._total[0] / self._mass
        if pull > 0.0:  # something has been answered
            weight = (0.0, 0.0, GRAVITY)
            velocity = [v + ahead * (g - pull * z) for v, g, z in zip(velocity, weight, rows[2], strict=True)]
        return [sum(a * v for a, v in zip(row, velocity, strict=True)) for row in rows]

    # -- parts, each (speeds) -> wrench (4,) ---------------------------------------------------------------

    def _ground(self, p: Mapping[str, float]) -> Part:
        place = [r.position_m for r in self._airframe.rotors]

        def part(speeds: Sequence[float]) -> Wrench:
            height = self.telemetry.get("height")
            if height is None:
                return np.zeros(4)
            roll, pitch, _ = self.telemetry.get("attitude") or (0.0, 0.0, 0.0)
            velocity = self.telemetry.get("velocity")
            if velocity is not None:
                height -= self._ahead("height") * velocity[2]
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
        by_rate = np.cross(place, axis)  # (w x r) . a = w . (r x a)
        usual = usual_lift(self._airframe, self._model)

        def part(speeds: Sequence[float]) -> Wrench:
            velocity, rates = self._velocity(), self._rates()
            if velocity is None or rates is None:
                return np.zeros(4)
            climb = axis @ velocity + by_rate @ rates
            thrust, _ = self._loads(speeds)
            most = MOST * float(thrust.sum()) / len(thrust)
            lost = climb_loss(p, climb, speeds, thrust, usual)
            return self._of(-np.minimum(np.maximum(lost, -most), most))

        return part

    def _air(self, p: Mapping[str, float]) -> Part:
        reference, power = p["reference_density_kg_m3"], p["density_exponent"]

        def part(speeds: Sequence[float]) -> Wrench:
            pressure = self.telemetry.get("pressure")
            heard = self.telemetry.get("air")
            celsius = self._air_C if heard is None else heard
            if pressure is None or celsius is None:
                return np.zeros(4)
            if not (PRESSURE_PA[0] < pressure < PRESSURE_PA[1] and AIR_C[0] < celsius < AIR_C[1]):
                return np.zeros(4)
            rho = pressure / (GAS_CONSTANT * (celsius + 273.15))
            gain = min(max((rho / reference) ** power - 1.0, -MOST), MOST)
            thrust, torque = self._loads(speeds)
            return self._of(gain * thrust, gain * torque)

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


def missing_number(effect: Effect) -> str | None:
    """Why an effect's numbers do not do for live mixing; None when they do."""
    lacks = [name for name in NUMBERS.get(effect.name, ()) if name not in effect.parameters]
    if lacks and effect.name == "air_density":
        return "the file does not say at which density its base holds"
    return f"its {' and '.join(lacks)} is missing in the rotor file" if lacks else None
