"""One frozen view of the vehicle at one moment: all that the screen shows, none of how.

`observe` is a pure function of the readings, the vehicle and the time. A value that
nobody reports, or that is not finite, is None; a value that grew old keeps its number and is marked stale.
Thrusts are the rotor model's (Berra, Trujillo and Heredia 2024, eq. 1-3) at the reported speeds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.link.mixing import DemandScale
from coaxlink.mixer.coefficients import standard_coefficients
from coaxlink.monitor import board as boards
from coaxlink.monitor import board_ardupilot
from coaxlink.monitor.board_view import Board
from coaxlink.monitor.hover import Verdict
from coaxlink.monitor.readings import Readings
from coaxlink.monitor.sources import STALE_S
from coaxlink.monitor.speeds import Speeds, rotor_speeds
from coaxlink.monitor.vehicle import VehicleState, finite, is_old, vehicle_of, version_of
from coaxlink.rotor import RotorModel
from coaxlink.vehicle import Vehicle
from firmware_params.plain import plain

LOST_S = 3.0  # without any message for this long the link counts as lost
_OWN_MIX = 0.08  # commands nearer than this to the legacy mixer's are its own; messages are 0.1 s apart
_TWO_SENDERS = 0.02, 0.25  # share out of sequence, and of gaps: a bad line has the second, not the first
_STANDING = 0.005  # normalised speed below which a rotor stands still


@dataclass(frozen=True)
class RotorView:
    """One rotor; `number` is the airframe's."""

    number: int
    level: str  # upper, lower, single
    speed: float | None  # normalised, 0..1
    rpm: float | None
    throttle: float | None  # commanded, 0..1
    thrust_N: float | None
    torque_Nm: float | None
    full_N: float  # the most thrust it has, alone at full speed


@dataclass(frozen=True)
class ArmView:
    """One arm: a coaxial pair, or a single rotor (then `lower` is None)."""

    name: str  # "front right"
    upper: RotorView
    lower: RotorView | None
    thrust_N: float | None  # of the arm
    upper_share: float | None  # upper thrust over the pair's, 0..1


@dataclass(frozen=True)
class Balance:
    """Sums over the vehicle; wrenches are [thrust up, roll, pitch, yaw] in N and N m."""

    thrust_N: float | None = None
    of_weight: float | None = None  # thrust over the airframe's weight
    upper_N: float | None = None
    lower_N: float | None = None
    upper_share: float | None = None
    upper_torque_Nm: float | None = None  # rotor torque magnitudes, added
    lower_torque_Nm: float | None = None
    wrench: tuple[float, ...] | None = None  # by the rotor model
    intended: tuple[float, ...] | None = None  # what was wanted, see `basis`
    basis: str = "table"  # what the table on board means by the same commands, or the autopilot's own demand
    error: tuple[float, ...] | None = None  # wrench less intended
    error_note: str = ""  # why there is no error


@dataclass(frozen=True)
class Link:
    """Health of the link."""

    address: str
    state: str  # waiting, live or lost
    detail: str  # what is being waited for
    age_s: float | None  # since the last message
    rate_hz: float
    loss: float | None
    received: int
    missed: int
    others: tuple[int, ...]


@dataclass(frozen=True)
class View:
    """The whole screen."""

    airframe: str
    rotor_form: str
    link: Link
    vehicle: VehicleState | None
    speeds: Speeds
    speeds_age_s: float | None
    speeds_stale: bool
    arms: tuple[ArmView, ...]
    balance: Balance
    board: Board
    notes: tuple[str, ...]


def observe(
    readings: Readings,
    vehicle: Vehicle,
    now_s: float,
    *,
    address: str = "",
    waiting: str = "",
    board: Board | None = None,
    verdict: Verdict | None = None,
    line: Sequence[str] = (),
) -> View:
    """The view at `now_s` (the clock of `Arrival.received_s`); `waiting` says what the link waits for.

    `board` spares describing an unchanged table again; `verdict` is what a steady hover said of the ESCs,
    `line` what the session says of others there.
    """
    link = _link(readings, now_s, address, waiting)
    airframe = vehicle.airframe
    speeds = rotor_speeds(readings, vehicle, now_s, verdict)
    model = vehicle.speed_model if speeds.basis == "measured" else vehicle.model
    age = None if speeds.received_s is None else now_s - speeds.received_s
    table = boards.describe(readings.parameters, vehicle) if board is None else board
    rotors = _rotors(airframe, model, speeds)
    arms = _arms(airframe, rotors)
    notes = list(speeds.notes)
    if vehicle.left_out:
        names = ", ".join(vehicle.left_out)
        notes.append(f"effects in the rotor file are not in these thrusts: {names}")
    if readings.target and _two_senders(readings):
        notes.insert(
            0, f"two vehicles call themselves system {readings.target[0]} here: these values are of both"
        )
    notes.extend(line)
    if readings.others:
        notes.append("further autopilots here: system " + ", ".join(map(str, readings.others)))
    return View(
        plain(airframe.name),
        plain(vehicle.rotors.form),
        link,
        vehicle_of(readings, now_s),
        speeds,
        age,
        age is not None and age > STALE_S,
        arms,
        _balance(vehicle, rotors, readings, table, now_s),
        table,
        tuple(map(plain, notes)),
    )


def arm_name(x_m: float, y_m: float) -> str:
    """Where an arm points, in words, from its rotor's place in FRD."""
    reach = math.hypot(x_m, y_m)
    if reach < 1e-3:
        return "centre"
    # within about 20 degrees of an axis an arm is simply front or right
    along = "front" if x_m > 0.35 * reach else "rear" if x_m < -0.35 * reach else ""
    across = "right" if y_m > 0.35 * reach else "left" if y_m < -0.35 * reach else ""
    return " ".join(filter(None, (along, across)))


def _link(readings: Readings, now_s: float, address: str, waiting: str) -> Link:
    age = None if readings.last_s is None else max(now_s - readings.last_s, 0.0)
    state = "waiting" if age is None else "live" if age <= LOST_S else "lost"
    detail = waiting or (f"a heartbeat at {address}" if address else "a heartbeat")
    t = readings.traffic
    loss = None if _two_senders(readings) else t.loss  # gaps between two senders are no losses
    return Link(address, state, detail, age, t.rate_hz, loss, t.received, t.missed, readings.others)


def _two_senders(readings: Readings) -> bool:
    """Whether two vehicles of one system id seem to talk here (two simulators on one port, say)."""
    disorder, gaps = _TWO_SENDERS
    t = readings.traffic
    return t.received > 50 and t.disorder > disorder and (t.loss or 0.0) > gaps


def _rotors(airframe: Airframe, model: RotorModel, speeds: Speeds) -> tuple[RotorView, ...]:
    u = np.array([np.nan if s is None else s for s in speeds.u])
    # an unknown speed makes NaN of just those loads that depend on it
    thrust, torque = airframe.loads(model, u)
    for group in (*airframe.pairs, *((i,) for i in airframe.singles)):
        if all(u[i] < _STANDING for i in group):
            thrust[list(group)], torque[list(group)] = 0.0, 0.0  # a fit's constant is no thrust at rest
    full = {
        "upper": float(model.upper_thrust(1.0, 0.0)),
        "single": float(model.upper_thrust(1.0, 0.0)),
        "lower": float(model.lower_thrust(0.0, 1.0)),
    }
    return tuple(
        RotorView(
            rotor.number,
            rotor.level,
            speeds.u[i],
            speeds.rpm[i],
            speeds.throttle[i],
            finite(thrust[i]) if speeds.u[i] is not None else None,
            finite(torque[i]) if speeds.u[i] is not None else None,
            full[rotor.level],
        )
        for i, rotor in enumerate(airframe.rotors)
    )


def _arms(airframe: Airframe, rotors: tuple[RotorView, ...]) -> tuple[ArmView, ...]:
    arms = []
    for i, rotor in enumerate(airframe.rotors):
        if rotor.level == "lower":
            continue
        lower = rotors[rotor.pair - 1] if rotor.pair is not None else None
        upper_N, lower_N = rotors[i].thrust_N, lower.thrust_N if lower else 0.0
        total = None if upper_N is None or lower_N is None else upper_N + lower_N
        share = _share(upper_N, lower_N) if lower else None
        arms.append(ArmView(arm_name(*rotor.position_m[:2]), rotors[i], lower, total, share))
    return tuple(arms)


def _share(upper: float | None, lower: float | None) -> float | None:
    if upper is None or lower is None or upper + lower < 1.0:
        return None  # below 1 N a pair idles and its split means nothing
    return upper / (upper + lower)


def _balance(
    vehicle: Vehicle,
    rotors: tuple[RotorView, ...],
    readings: Readings,
    table: Board,
    now_s: float,
) -> Balance:
    airframe = vehicle.airframe
    thrusts, torques = [r.thrust_N for r in rotors], [r.torque_Nm for r in rotors]
    thrust = [t for t in thrusts if t is not None]
    torque = [t for t in torques if t is not None]
    if len(thrust) < len(rotors) or len(torque) < len(rotors):
        return Balance(error_note="needs the speed of every rotor")
    wrench = tuple(float(w) for w in airframe.wrench(thrust, torque))
    lower = sum(t for t, r in zip(thrust, rotors, strict=True) if r.level == "lower")
    upper = sum(thrust) - lower
    lower_torque = sum(t for t, r in zip(torque, rotors, strict=True) if r.level == "lower")
    intended, note, basis = _wanted(vehicle, rotors, readings, table, wrench[0], now_s)
    error = None if intended is None else tuple(a - b for a, b in zip(wrench, intended, strict=True))
    return Balance(
        wrench[0],
        wrench[0] / (airframe.mass_kg * GRAVITY_M_S2),
        upper,
        lower,
        _share(upper, lower) if airframe.pairs else None,
        sum(torque) - lower_torque,
        lower_torque,
        wrench,
        intended,
        basis,
        error,
        note,
    )


def _wanted(
    vehicle: Vehicle,
    rotors: tuple[RotorView, ...],
    readings: Readings,
    table: Board,
    thrust_N: float,
    now_s: float,
) -> tuple[tuple[float, ...] | None, str, str]:
    """Wanted wrench or None, why there is none, and whose it is: the demand's or the table's."""
    version = version_of(readings)
    legacy = bool(version) and tuple(map(int, version.split(".")[:2])) <= (1, 13)
    if not legacy or readings.parameters.get("SYS_CTRL_ALLOC") == 1.0:
        return *_intended(rotors, readings.parameters, table, thrust_N), "table"
    arrival = readings.batches("ACTUATOR_CONTROL_TARGET").get(0)
    if arrival is None or is_old(arrival, now_s, STALE_S):
        return None, f"PX4 {version} flies its legacy mixer, and its demand is not heard", "demand"
    controls = [float(c) for c in arrival.message.controls[:4]]
    commands = [r.throttle for r in rotors]
    if not all(map(math.isfinite, controls)) or any(c is None for c in commands):
        return None, "the demand or the commands are not numbers", "demand"
    curve = readings.parameters.get("THR_MDL_FAC", 0.0)
    scale = DemandScale(
        vehicle.airframe, standard_coefficients(vehicle.model), curve if 0.0 <= curve <= 1.0 else 0.0
    )
    # a demand means newtons to a companion that mixes; the legacy mixer makes throttle of it, as it comes
    apart = max(abs(float(c or 0.0) - own) for c, own in zip(commands, scale.own(controls), strict=True))
    if apart < _OWN_MIX:
        return (
            None,
            f"PX4 {version} flies its own legacy mixer: its demand is throttle, not newtons",
            "demand",
        )
    return tuple(float(w) for w in scale.wrench(controls)), "", "demand"


def _intended(
    rotors: tuple[RotorView, ...], parameters: Mapping[str, float], table: Board, thrust_N: float
) -> tuple[tuple[float, ...] | None, str]:
    ardupilot = board_ardupilot.is_table(parameters)
    if table.state in ("unread", "partial"):
        return None, "needs the table on board" if ardupilot else "needs the table on board (CA_*)"
    if table.state == "read" and table.frame_class is not None and not table.of_model:
        return None, "ArduPilot's factors have newtons only as a table of this rotor model"
    if table.state != "read" or table.rotors != len(rotors):
        return None, "the table on board is not this airframe's"
    commands = [r.throttle if r.throttle is not None else r.speed for r in rotors]
    if ardupilot:
        meant = board_ardupilot.intended(table, parameters, commands)
    else:
        meant = boards.intended(parameters, commands)
    if meant is None:
        return None, "the table on board cannot be realised"
    if thrust_N > 1.0 and not 0.4 < meant[0] / thrust_N < 2.5:
        return None, f"the CT on board are not in newtons ({meant[0]:.0f} N for {thrust_N:.0f} N)"
    return meant, ""
