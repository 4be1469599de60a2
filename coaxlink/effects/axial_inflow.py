"""Axial inflow: climbing, the blades meet the air at a smaller angle and pull less; sinking, more.

Source: blade element theory, dT = -c Omega V_axial for small climb (Leishman, Principles of Helicopter
Aerodynamics, 2006, ch. 2-3). V is the rotor hub's own: body rates add to it, which damps roll and pitch. With
the climb's share of the inflow the slope changes (momentum theory, the same book): with r = V / Omega,
r / (1 + a |r|) + b r^2 is that, to second order, for climb and descent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.live import MOST_OF_THRUST, LiveView, Part, nothing
from coaxlink.effects.static import LeftOut, Loads, StaticVehicle
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import FlightFrame
from coaxlink.load import Load
from coaxlink.rotor import RotorModel

LEAST_SPEED = 0.1  # of full speed: below, what goes with one over the speed is held


def hub_climb(frame: FlightFrame) -> Array:
    """(rows, N) speed of every hub along its own thrust axis, m/s."""
    axis = np.array([r.axis for r in frame.airframe.rotors])
    position = np.array([r.position_m for r in frame.airframe.rotors])
    turning = np.cross(frame.rates[:, None, :], position[None, :, :])
    return np.einsum("rni,ni->rn", frame.velocity[:, None, :] + turning, axis)


def _missing(frame: FlightFrame) -> str | None:
    climb = float(np.quantile(np.abs(hub_climb(frame)[frame.keep].mean(axis=1)), 0.98))
    return None if climb > 0.15 else f"never climbs or sinks faster than {climb:.2f} m/s"


def slopes(p: Numbers, climb_m_s: ArrayLike, speed: ArrayLike, share: ArrayLike) -> tuple[Array, Array]:
    """Thrust lost by unit coefficients, in proportion to the climb along the axis and to its square.

    T = u^2 f(V / u): what bends does so with the inflow's ratio. All arguments broadcast; `share` is a
    rotor's thrust over speed squared over the usual rotor's, where the loss goes by thrust, else 1.
    """
    climb, u = np.asarray(climb_m_s, float), np.maximum(np.asarray(speed, float), LEAST_SPEED)
    first = share * u * climb / (1.0 + p.get("levelling_s_m", 0.0) * np.abs(climb) / u)
    return np.asarray(first), np.asarray(share * climb**2)


def climb_loss(p: Numbers, climb_m_s: ArrayLike, speed: ArrayLike, lift: ArrayLike, usual: float) -> Array:
    """Thrust (N) that rotors lose, climbing along their axes; all arguments broadcast.

    `speed` normalised, `lift` their thrust in N; `usual` is thrust over speed squared of a usual rotor in
    hover, which counts only where the effect goes by thrust.
    """
    u = np.maximum(np.asarray(speed, float), LEAST_SPEED)
    share = np.asarray(lift, float) / u**2 / usual if "by_thrust" in p else 1.0
    first, second = slopes(p, climb_m_s, u, share)
    return np.asarray(
        p["thrust_per_climb_N_s_m"] * first + p.get("thrust_per_climb_squared_N_s2_m2", 0.0) * second
    )


def _starts(frame: FlightFrame) -> Sequence[Numbers]:
    if why := _missing(frame):
        raise NotShown(why)
    return [{"thrust_per_climb_N_s_m": 1.0}, {"thrust_per_climb_N_s_m": 1.0, "by_thrust": 1.0}]


def _changes(frame: FlightFrame, p: Numbers) -> FlightFrame:
    lift = frame.thrust / np.maximum(frame.speeds, LEAST_SPEED) ** 2
    usual = max(float(np.median(lift[frame.keep])), 1e-9) if "by_thrust" in p else 1.0
    lost = climb_loss(p, hub_climb(frame), frame.speeds, frame.thrust, usual)
    return frame.pulling(frame.thrust - lost, frame.torque)


def _further(_: FlightFrame, p: Numbers) -> Sequence[Numbers]:
    """By speed or by thrust, whichever it is not; either with a bend."""
    plain = {"thrust_per_climb_N_s_m": p["thrust_per_climb_N_s_m"]}
    other = {**plain, "by_thrust": 1.0}
    forms = (other, plain) if "by_thrust" in p else (plain, other)
    bends = ({"thrust_per_climb_squared_N_s2_m2": 0.0}, {"levelling_s_m": 0.03})
    return [forms[1], *({**form, **bend} for bend in bends for form in forms)]


def _cause(frame: FlightFrame, _: Numbers, channel: str) -> tuple[str, Array]:
    if channel in ("torque_x", "torque_y"):
        axis = channel[-1]
        return f"rate_{axis}_rad_s", frame.rates[:, "xy".index(axis)]
    return "climb_m_s", hub_climb(frame).mean(axis=1)


FLIGHT: Tracing[FlightFrame] = Tracing(
    needs=("vel_d_m_s", "roll_rad", "pitch_rad", "yaw_rad"),
    channels=("force_z", "torque_x", "torque_y"),
    starts=_starts,
    further=_further,
    changes=_changes,
    cause=_cause,
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    climb = vehicle.at.climb_m_s
    if climb is None:
        raise LeftOut(_NEEDS_CLIMB)
    usual = vehicle.usual_lift(vehicle.airframe, vehicle.model)

    def change(_: RotorModel, loads: Loads) -> Loads:
        upper = climb_loss(p, climb, loads.upper, loads.upper_thrust, usual)
        lower = climb_loss(p, climb, loads.lower, loads.lower_thrust, usual)
        return loads.plus({Load.UPPER_THRUST: -upper, Load.LOWER_THRUST: -lower})

    vehicle.changes.append(change)
    lost = climb_loss(p, climb, 0.5, 0.25 * usual, usual)
    return f"{-float(lost):+.2f} N a rotor at half speed, climbing at {climb:.2f} m/s"


def _live(view: LiveView, p: Numbers) -> Part:
    positions = np.array([r.position_m for r in view.airframe.rotors])
    axis = np.array([r.axis for r in view.airframe.rotors])
    by_rate = np.cross(positions, axis)  # (w x r) . a = w . (r x a)
    usual = view.usual_lift

    def part(speeds: Sequence[float]) -> Array:
        velocity, rates = view.velocity(), view.rates()
        if velocity is None or rates is None:
            return nothing()
        climb = axis @ np.asarray(velocity) + by_rate @ np.asarray(rates)
        thrust, _ = view.loads(speeds)
        most = MOST_OF_THRUST * float(thrust.sum()) / len(thrust)
        return view.wrench_of(-np.clip(climb_loss(p, climb, speeds, thrust, usual), -most, most))

    return part


_NEEDS_CLIMB = (
    "thrust follows the climb speed: a static mixer needs it stated (`climb_m_s`), live mixing measures it"
)
EFFECT = PhysicalEffect(
    name="axial_inflow",
    stage=Stage.AIR,
    physics="thrust falls with the hub's speed along its axis: dT = -c u V",
    source="blade element theory in axial flight (Leishman 2006)",
    parameters=(
        Parameter("thrust_per_climb_N_s_m", "N s/m", 0.0, 30.0, (2.0, 2.0), amount=True, nil=0.0,
            source="blade element theory (Leishman 2006, ch. 3): per cents of the lift for 1 m/s; 2 N of "
                   "50 N assumed"),
        Parameter("thrust_per_climb_squared_N_s2_m2", "N s2/m2", -30.0, 30.0, (0.0, 0.5), amount=True,
            source="momentum theory (Leishman 2006, ch. 2): of second order; a quarter of the first is "
                   "assumed"),
        Parameter("levelling_s_m", "s/m", 0.0, 0.3, moves=True,
            source="wide: any value between the bounds; the share of climb in the inflow goes with disc "
                   "loading"),
        Parameter("by_thrust", "1", 0.0, 1.0,
            source="a switch, 0 or 1: the loss goes with the thrust instead of the speed"),
    ),
    flight=FLIGHT,
    static=_static,
    live=_live,
    required=("thrust_per_climb_N_s_m",),
    messages={"ATTITUDE": 100.0, "LOCAL_POSITION_NED": 50.0},
)  # fmt: skip
