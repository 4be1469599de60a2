"""One frozen view of the vehicle at one moment: all that the screen shows, none of how.

`observe` is a pure function of the readings, the vehicle and the time. A value that
nobody reports, or that is not finite, is None; a value that grew old keeps its number and is marked stale.
Thrusts are the rotor model's (Berra, Trujillo and Heredia 2024, eq. 1-3) at the reported speeds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.live.in_air import NOTHING_HEARD, RotorsInAir
from coaxlink.live.mixer_core import DemandScale
from coaxlink.mixer.coefficients import standard_coefficients
from coaxlink.mixer.law import Law
from coaxlink.monitor.arms import ArmView, RotorView, arm_name, arms_of, ideal_shares, rotors_of, share_of
from coaxlink.monitor.board import ardupilot as board_ardupilot
from coaxlink.monitor.board import description as boards
from coaxlink.monitor.board.view import Board
from coaxlink.monitor.telemetry.escs import escs_of
from coaxlink.monitor.telemetry.hover import Verdict
from coaxlink.monitor.telemetry.readings import Readings
from coaxlink.monitor.telemetry.sources import STALE_S
from coaxlink.monitor.telemetry.speeds import Speeds, rotor_speeds
from coaxlink.monitor.telemetry.texts import Said
from coaxlink.monitor.telemetry.vehicle import VehicleState, is_old, on_ground, vehicle_of, version_of
from coaxlink.vehicle import Vehicle
from firmware_params.plain import plain

LOST_S = 3.0  # without any message for this long the link counts as lost
__all__ = ["ArmView", "Balance", "Link", "RotorView", "View", "arm_name", "observe"]
_OWN_MIX = 0.08  # commands nearer than this to the legacy mixer's are its own; messages are 0.1 s apart
_TWO_SENDERS = 0.02, 0.25  # share out of sequence, and of gaps: a bad line has the second, not the first


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
    escs_stale: bool = False
    texts: tuple[Said, ...] = ()  # what the autopilot said, oldest first
    now_s: float = 0.0  # of the clock of `texts`
    health: RotorsInAir = NOTHING_HEARD


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
    law: Law | None = None,
    trend_min: float | None = None,
    health: RotorsInAir = NOTHING_HEARD,
) -> View:
    """The view at `now_s` (the clock of `Arrival.received_s`); `waiting` says what the link waits for.

    `board` spares describing an unchanged table again; `verdict` is what a steady hover said of the ESCs,
    `line` what the session says of others there, `law` gives the ideal split, `trend_min` are the minutes
    of battery by its own fall, `health` what the test in the air believes.
    """
    link = _link(readings, now_s, address, waiting)
    airframe = vehicle.airframe
    speeds = rotor_speeds(readings, vehicle, now_s, verdict)
    age = None if speeds.received_s is None else now_s - speeds.received_s
    table = boards.describe(readings.parameters, vehicle) if board is None else board
    said = vehicle_of(readings, now_s, energy_Wh=airframe.battery_Wh, trend_min=trend_min)
    escs = escs_of(readings, len(airframe.rotors), now_s)
    rotors = rotors_of(
        vehicle,
        speeds,
        escs,
        flying=said is not None and said.armed and not on_ground(readings, now_s),
        least=_least(readings.parameters),
    )
    rotors = tuple(replace(r, health=health.mark(r.number)) for r in rotors)
    balance = _balance(vehicle, rotors, readings, table, now_s)
    arms = arms_of(airframe, rotors, ideal_shares(law, vehicle, balance.wrench))
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
        said,
        speeds,
        age,
        age is not None and age > STALE_S,
        arms,
        balance,
        table,
        tuple(map(plain, notes)),
        escs.stale,
        readings.texts,
        now_s,
        health,
    )


def _least(parameters: Mapping[str, float]) -> float:
    """The command at which motors run slowest in flight: ArduPilot's MOT_SPIN_MIN; PX4 goes down to 0."""
    least = parameters.get("MOT_SPIN_MIN", 0.0)
    return least if 0.0 < least < 1.0 else 0.0


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
        share_of(upper, lower) if airframe.pairs else None,
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
