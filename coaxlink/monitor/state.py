"""One frozen view of the vehicle at one moment: all that the screen shows, none of how.

`observe` is a pure function of the readings, the airframe, the rotor model and the time. A value that
nobody reports, or that is not finite, is None; a value that grew old keeps its number and is marked stale.
Thrusts are the rotor model's (Berra, Trujillo and Heredia 2024, eq. 1-3) at the reported speeds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.monitor import board as boards
from coaxlink.monitor.board import Board
from coaxlink.monitor.modes import ARMED_FLAG, firmware_name, mode_name
from coaxlink.monitor.readings import Arrival, Readings
from coaxlink.monitor.speeds import STALE_S, Speeds, rotor_speeds
from coaxlink.rotor import RotorModel

LOST_S = 3.0  # without any message for this long the link counts as lost
GRAVITY_M_S2 = 9.80665
_STANDING = 0.005  # normalised speed below which a rotor stands still
_DOWN = 25  # MAV_SENSOR_ROTATION_PITCH_270: a range finder that looks down
_TEXT_S = 15.0  # how long a status text stays on the screen


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
    intended: tuple[float, ...] | None = None  # what the table on board means by the same commands
    error: tuple[float, ...] | None = None  # wrench less intended
    error_note: str = ""  # why there is no error


@dataclass(frozen=True)
class Vehicle:
    """What the autopilot says about itself."""

    system: int
    firmware: str
    version: str
    mode: str
    armed: bool
    voltage_V: float | None
    current_A: float | None
    remaining: float | None  # 0..1
    battery_stale: bool
    roll_rad: float | None
    pitch_rad: float | None
    yaw_rad: float | None
    attitude_stale: bool
    height_m: float | None
    height_source: str  # range (above ground), local or global (above home)
    height_stale: bool
    clock_s: float | None
    text: str  # newest status text, if it is fresh


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
    vehicle: Vehicle | None
    speeds: Speeds
    speeds_age_s: float | None
    speeds_stale: bool
    arms: tuple[ArmView, ...]
    balance: Balance
    board: Board
    notes: tuple[str, ...]


def observe(
    readings: Readings,
    airframe: Airframe,
    model: RotorModel,
    now_s: float,
    *,
    address: str = "",
    waiting: str = "",
    board: Board | None = None,
) -> View:
    """The view at `now_s` (the clock of `Arrival.received_s`); `waiting` says what the link waits for.

    `board` spares describing an unchanged table again.
    """
    link = _link(readings, now_s, address, waiting)
    speeds = rotor_speeds(readings, len(airframe.rotors), model.speed_max_rpm, now_s)
    age = None if speeds.received_s is None else now_s - speeds.received_s
    table = boards.describe(readings.parameters, airframe, model) if board is None else board
    rotors = _rotors(airframe, model, speeds)
    arms = _arms(airframe, rotors)
    notes = list(speeds.notes)
    if model.effects:
        names = ", ".join(e.name for e in model.effects)
        notes.append(f"effects in the rotor file are not in these thrusts: {names}")
    if readings.others:
        notes.append("further autopilots here: system " + ", ".join(map(str, readings.others)))
    return View(
        airframe.name,
        model.form,
        link,
        _vehicle(readings, now_s),
        speeds,
        age,
        age is not None and age > STALE_S,
        arms,
        _balance(airframe, rotors, readings.parameters, table),
        table,
        tuple(notes),
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
    return Link(address, state, detail, age, t.rate_hz, t.loss, t.received, t.missed, readings.others)


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
            _finite(thrust[i]) if speeds.u[i] is not None else None,
            _finite(torque[i]) if speeds.u[i] is not None else None,
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
    airframe: Airframe, rotors: tuple[RotorView, ...], parameters: Mapping[str, float], table: Board
) -> Balance:
    thrusts, torques = [r.thrust_N for r in rotors], [r.torque_Nm for r in rotors]
    thrust = [t for t in thrusts if t is not None]
    torque = [t for t in torques if t is not None]
    if len(thrust) < len(rotors) or len(torque) < len(rotors):
        return Balance(error_note="needs the speed of every rotor")
    wrench = tuple(float(w) for w in airframe.wrench(thrust, torque))
    lower = sum(t for t, r in zip(thrust, rotors, strict=True) if r.level == "lower")
    upper = sum(thrust) - lower
    lower_torque = sum(t for t, r in zip(torque, rotors, strict=True) if r.level == "lower")
    intended, note = _intended(rotors, parameters, table, wrench[0])
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
        error,
        note,
    )


def _intended(
    rotors: tuple[RotorView, ...], parameters: Mapping[str, float], table: Board, thrust_N: float
) -> tuple[tuple[float, ...] | None, str]:
    if table.state in ("unread", "partial"):
        return None, "needs the table on board (CA_*)"
    if table.state != "read" or table.rotors != len(rotors):
        return None, "the table on board is not this airframe's"
    commands = [r.throttle if r.throttle is not None else r.speed for r in rotors]
    meant = boards.intended(parameters, commands)
    if meant is None:
        return None, "the table on board cannot be realised"
    if thrust_N > 1.0 and not 0.4 < meant[0] / thrust_N < 2.5:
        return None, f"CT on board is not in newtons: it means {meant[0]:.0f} N by {thrust_N:.0f} N"
    return meant, ""


def _vehicle(readings: Readings, now_s: float) -> Vehicle | None:
    heartbeat = readings.get("HEARTBEAT")
    if heartbeat is None:
        return None
    beat = heartbeat.message
    voltage, current, remaining, battery_s = _battery(readings)
    attitude = readings.get("ATTITUDE")
    roll, pitch, yaw = (_field(attitude, name) for name in ("roll", "pitch", "yaw"))
    height, source, height_s = _height(readings, now_s)
    text = readings.get("STATUSTEXT")
    return Vehicle(
        readings.target[0] if readings.target else 0,
        firmware_name(beat.autopilot),
        _version(readings),
        mode_name(beat.autopilot, beat.custom_mode),
        bool(beat.base_mode & ARMED_FLAG),
        voltage,
        current,
        remaining,
        battery_s is not None and now_s - battery_s > 5.0,
        roll,
        pitch,
        yaw,
        _old(attitude, now_s, 2.0),
        height,
        source,
        height_s is not None and now_s - height_s > 2.0,
        readings.clock_s,
        _plain(text.message.text) if text and now_s - text.received_s <= _TEXT_S else "",
    )


def _battery(readings: Readings) -> tuple[float | None, float | None, float | None, float | None]:
    """Voltage in V, current in A, remaining 0..1 of the first battery, and when it was told."""
    batteries = readings.batches("BATTERY_STATUS")
    if batteries:
        arrival = next(iter(batteries.values()))
        m = arrival.message
        cells = [v for v in m.voltages if v != 0xFFFF]
        voltage = sum(cells) / 1e3 if cells else None
    elif (found := readings.get("SYS_STATUS")) is not None:
        arrival, m = found, found.message
        voltage = m.voltage_battery / 1e3 if m.voltage_battery != 0xFFFF else None
    else:
        return None, None, None, None
    current = m.current_battery / 100 if m.current_battery >= 0 else None
    remaining = m.battery_remaining / 100 if m.battery_remaining >= 0 else None
    return voltage, current, remaining, arrival.received_s


def _height(readings: Readings, now_s: float) -> tuple[float | None, str, float | None]:
    """Height in m, whose it is, and when it was told: above ground if a range finder says so."""
    for arrival in readings.batches("DISTANCE_SENSOR").values():
        m = arrival.message
        seen = m.min_distance < m.current_distance < m.max_distance
        if m.orientation == _DOWN and seen and not _old(arrival, now_s, 2.0):
            return m.current_distance / 100, "range", arrival.received_s
    local = readings.get("LOCAL_POSITION_NED")
    down = _field(local, "z")
    if local is not None and down is not None:
        return -down, "local", local.received_s
    place = readings.get("GLOBAL_POSITION_INT")
    if place is not None:
        return place.message.relative_alt / 1e3, "global", place.received_s
    return None, "", None


def _version(readings: Readings) -> str:
    arrival = readings.get("AUTOPILOT_VERSION")
    number = int(arrival.message.flight_sw_version) if arrival else 0
    return ".".join(str(number >> shift & 0xFF) for shift in (24, 16, 8)) if number else ""


def _old(arrival: Arrival | None, now_s: float, limit_s: float) -> bool:
    return arrival is not None and now_s - arrival.received_s > limit_s


def _field(arrival: Arrival | None, name: str) -> float | None:
    return None if arrival is None else _finite(getattr(arrival.message, name))


def _finite(value: Any) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None


def _plain(text: Any) -> str:
    """A status text without what a terminal would act on."""
    raw = text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
    return "".join(c for c in raw if c.isprintable()).strip()
