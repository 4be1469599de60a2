"""One frozen view of the vehicle at one moment: all that the screen shows, none of how.

`observe` only looks. A value that nobody reports, or that is not finite, is None; a value that grew old keeps
its number and is marked stale.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.live.in_air import NOTHING_HEARD, RotorsInAir
from coaxlink.live.mixer_core import DemandScale
from coaxlink.mavlink.telemetry import Text
from coaxlink.mixer.coefficients import standard_coefficients
from coaxlink.mixer.law import Law
from coaxlink.monitor.incoming.heard import Heard, Traffic
from coaxlink.monitor.incoming.table_reader import is_ardupilot, table_parameters
from coaxlink.monitor.state import table as table_px4
from coaxlink.monitor.state.rotors import (
    ArmView,
    RotorView,
    arms_of,
    esc_readings,
    ideal_shares,
    rotors_of,
    share_of,
)
from coaxlink.monitor.state.speeds import STALE_S, RotorSpeeds, rotor_speeds
from coaxlink.monitor.state.table import TableOnBoard
from coaxlink.monitor.state.vehicle import VehicleState, on_ground, vehicle_of, version_of
from coaxlink.premises.answer import as_json
from coaxlink.tables.px4 import not_in_newtons
from coaxlink.vehicle import Vehicle
from firmware_params.plain import plain

LOST_S = 3.0  # without any message for this long the link counts as lost
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
class LinkState:
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
class Moment:
    """The whole screen."""

    airframe: str
    rotor_form: str
    link: LinkState
    vehicle: VehicleState | None
    speeds: RotorSpeeds
    speeds_age_s: float | None
    speeds_stale: bool
    arms: tuple[ArmView, ...]
    balance: Balance
    board: TableOnBoard
    parameters: Mapping[str, float]  # of the table on board, as far as they were heard
    notes: tuple[str, ...]
    escs_stale: bool
    texts: tuple[Text, ...]  # what the autopilot reported, oldest first
    unheard: str  # why no more of them arrive
    now_s: float  # of the clock of `texts`
    health: RotorsInAir

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values; unknown ones are null."""
        values: dict[str, Any] = _json(asdict(self))
        values["health"].pop("reasons")
        return {**values, "health": {**values["health"], **as_json(self.health.reasons)}}


def observe(
    heard: Heard,
    vehicle: Vehicle,
    *,
    address: str = "",
    board: TableOnBoard | None = None,
    allocation: Law | None = None,
    trend_min: float | None = None,
    health: RotorsInAir = NOTHING_HEARD,
) -> Moment:
    """The present, by the clock of `heard`.

    `board` is the table on board, judged; `allocation` gives the ideal split,
    `trend_min` are the minutes of battery by its own fall, `health` what the test in the air believes.
    """
    now, airframe, telemetry = heard.now(), vehicle.airframe, heard.telemetry
    traffic = heard.traffic
    two_senders = _two_senders(traffic)
    link = _link(heard, traffic, address, two_senders)
    speeds = rotor_speeds(heard, vehicle)
    age = None if speeds.received_s is None else now - speeds.received_s
    table = TableOnBoard("unread") if board is None else board
    reported = vehicle_of(heard, energy_Wh=airframe.battery_Wh, trend_min=trend_min)
    escs = esc_readings(heard, len(airframe.rotors))
    flying = reported is not None and reported.armed and not on_ground(telemetry)
    rotors = rotors_of(vehicle, speeds, escs, health, flying=flying, least=_least(heard.parameters))
    balance = _balance(vehicle, rotors, heard, table)
    arms = arms_of(airframe, rotors, ideal_shares(allocation, vehicle, balance.wrench))
    notes = list(speeds.notes)
    if vehicle.left_out:
        names = ", ".join(vehicle.left_out)
        notes.append(f"effects in the rotor file are not in these thrusts: {names}")
    if heard.target and two_senders:
        notes.insert(
            0, f"two vehicles call themselves system {heard.target[0]} here: these values are of both"
        )
    notes.extend(heard.line())
    if heard.others:
        notes.append("further autopilots here: system " + ", ".join(map(str, heard.others)))
    return Moment(
        plain(airframe.name),
        plain(vehicle.rotors.form),
        link,
        reported,
        speeds,
        age,
        age is not None and age > STALE_S,
        arms,
        balance,
        table,
        table_parameters(heard.parameters),
        tuple(map(plain, notes)),
        escs.stale,
        telemetry.texts,
        heard.unheard(),
        now,
        health,
    )


def _least(parameters: Mapping[str, float]) -> float:
    """The command at which motors run slowest in flight: ArduPilot's MOT_SPIN_MIN; PX4 goes down to 0."""
    least = parameters.get("MOT_SPIN_MIN", 0.0)
    return least if 0.0 < least < 1.0 else 0.0


def _link(heard: Heard, traffic: Traffic, address: str, two_senders: bool) -> LinkState:
    age = None if heard.last_s is None else max(heard.now() - heard.last_s, 0.0)
    state = "waiting" if age is None else "live" if age <= LOST_S else "lost"
    detail = heard.waiting or (f"a heartbeat at {address}" if address else "a heartbeat")
    loss = None if two_senders else traffic.loss  # gaps between two senders are no losses
    received, missed = traffic.received, traffic.missed
    return LinkState(address, state, detail, age, traffic.rate_hz, loss, received, missed, heard.others)


def _two_senders(traffic: Traffic) -> bool:
    """Whether two vehicles of one system id seem to talk here (two simulators on one port, say)."""
    disorder, gaps = _TWO_SENDERS
    return traffic.received > 50 and traffic.disorder > disorder and (traffic.loss or 0.0) > gaps


def _balance(vehicle: Vehicle, rotors: Sequence[RotorView], heard: Heard, table: TableOnBoard) -> Balance:
    airframe = vehicle.airframe
    thrust = [r.thrust_N for r in rotors if r.thrust_N is not None]
    torque = [r.torque_Nm for r in rotors if r.torque_Nm is not None]
    if len(thrust) < len(rotors) or len(torque) < len(rotors):
        return Balance(error_note="needs the speed of every rotor")
    wrench = tuple(float(w) for w in airframe.wrench(thrust, torque))
    below = [r.level == "lower" for r in rotors]
    lower = sum(t for t, is_lower in zip(thrust, below, strict=True) if is_lower)
    lower_torque = sum(t for t, is_lower in zip(torque, below, strict=True) if is_lower)
    upper = sum(thrust) - lower
    intended, note, basis = _wanted(vehicle, rotors, heard, table, wrench[0])
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
        None if intended is None else tuple(a - b for a, b in zip(wrench, intended, strict=True)),
        note,
    )


def _wanted(
    vehicle: Vehicle, rotors: Sequence[RotorView], heard: Heard, table: TableOnBoard, thrust_N: float
) -> tuple[tuple[float, ...] | None, str, str]:
    """Wanted wrench or None, why there is none, and whose it is: the demand's or the table's."""
    version = version_of(heard.telemetry)
    legacy = bool(version) and tuple(map(int, version.split(".")[:2])) <= (1, 13)
    if not legacy or heard.parameters.get("SYS_CTRL_ALLOC") == 1.0:
        return *_intended(rotors, table_parameters(heard.parameters), table, thrust_N), "table"
    demand = heard.telemetry.newest("ACTUATOR_CONTROL_TARGET")
    if demand is None or heard.now() - demand.received_s > STALE_S:
        return None, f"PX4 {version} flies its legacy mixer, and its demand is not heard", "demand"
    controls = [float(c) for c in demand.value.controls[:4]]
    commands = [r.throttle for r in rotors if r.throttle is not None]
    if not all(map(math.isfinite, controls)) or len(commands) < len(rotors):
        return None, "the demand or the commands are not numbers", "demand"
    curve = heard.parameters.get("THR_MDL_FAC", 0.0)
    scale = DemandScale(
        vehicle.airframe,
        standard_coefficients(vehicle.model, of_commands=True),
        curve if 0.0 <= curve <= 1.0 else 0.0,
    )
    # a demand means newtons to a companion that mixes; the legacy mixer makes throttle of it, as it comes
    apart = max(abs(c - own) for c, own in zip(commands, scale.own(controls), strict=True))
    if apart < _OWN_MIX:
        note = f"PX4 {version} flies its own legacy mixer: its demand is throttle, not newtons"
        return None, note, "demand"
    return tuple(float(w) for w in scale.wrench(controls)), "", "demand"


def _intended(
    rotors: Sequence[RotorView], parameters: Mapping[str, float], table: TableOnBoard, thrust_N: float
) -> tuple[tuple[float, ...] | None, str]:
    if is_ardupilot(parameters):
        return None, "ArduPilot's factors have no newtons"
    if table.state in ("unread", "partial"):
        return None, "needs the table on board (CA_*)"
    if table.state != "read" or table.rotors != len(rotors):
        return None, "the table on board is not this airframe's"
    commands = [r.throttle if r.throttle is not None else r.speed for r in rotors]
    meant = table_px4.intended(parameters, commands)
    if meant is None:
        return None, "the table on board cannot be realised"
    why = not_in_newtons(parameters, meant[0], thrust_N)
    return (None, why) if why else (meant, "")


def _json(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_json(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
