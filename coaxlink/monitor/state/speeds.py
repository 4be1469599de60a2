"""How fast each rotor turns, and who says so.

Measured speeds (ESC_STATUS, ArduPilot's ESC_TELEMETRY) are preferred to commanded ones (SERVO_OUTPUT_RAW,
ACTUATOR_OUTPUT_STATUS). A source is passed over, and a note says so, when another one knows more rotors, when
it went quiet, or when it contradicts itself.

A command is a pulse after the thrust curve, u = (us - low) / (high - low), between the limits, and on the
output, that the board's parameters give a motor (`data.logs.outputs`, as of any log); until those are read
output n drives motor n from 1000 to 2000 us, and a note says so. An ArduPilot numbers ESCs as outputs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from coaxlink.data.logs.outputs import motor_map
from coaxlink.mavlink.telemetry import Telemetry, Timed
from coaxlink.monitor.incoming.heard import Heard
from coaxlink.vehicle import Vehicle
from firmware_params.ardupilot import servo_function

STALE_S = 1.5  # speeds older than this are not the present
INFO_STALE_S, ONLINE_BITS = 3.0, 8  # of ESC_INFO, which comes once a second; it has the first eight ESCs'
RUNNING = 0.1  # normalised command above which a motor must turn
Values = tuple[float | None, ...]  # (N,) by rotor
_APART = 0.03  # normalised speed between two outputs whose ESCs read the same
_OUTPUTS = 16  # of SERVO_OUTPUT_RAW
_FASTER, _ALIKE = 1.05, 0.02  # rpm over command, on every rotor alike: not what one full pack can do


@dataclass(frozen=True)
class SpeedSource:
    """Speeds of N rotors by one kind of message; None where it says nothing."""

    name: str
    basis: str  # measured or commanded
    u: Values  # normalised speed
    received_s: float | None = None
    extra: int = 0  # rotors it reports beyond the airframe's

    @property
    def known(self) -> int:
        """How many rotors it knows."""
        return sum(u is not None for u in self.u)

    def fresh(self, now_s: float) -> bool:
        """Whether it is of the present."""
        return self.received_s is not None and now_s - self.received_s <= STALE_S


@dataclass(frozen=True)
class RotorSpeeds:
    """The speeds the screen goes by."""

    source: str  # "ESC_STATUS rpm", ...; "" while nobody reports any
    basis: str  # measured, commanded or none
    u: Values  # normalised speed, measured or what the commands give
    rpm: Values  # the same
    throttle: Values  # commanded 0..1, whatever `u` is from
    received_s: float | None
    notes: tuple[str, ...] = ()


def rotor_speeds(heard: Heard, vehicle: Vehicle) -> RotorSpeeds:
    """Choose among what was heard of the N rotors: measured speeds, or what the commands turn."""
    now, rotors = heard.now(), len(vehicle.airframe.rotors)
    commanded = commanded_speeds(heard, rotors)
    measured, notes = measured_speeds(heard, vehicle, commanded)
    chosen = _better(measured, commanded, now)
    if chosen.known == 0:
        blank = (None,) * rotors
        return RotorSpeeds("", "none", blank, blank, blank, None, tuple(notes))
    if chosen is commanded and measured.known:
        kind = measured.name.removesuffix(" rpm")
        fresh = measured.fresh(now)
        notes.append(f"{kind} knows {measured.known} of {rotors} rotors" if fresh else f"{kind} went quiet")
    elif chosen is measured and commanded.fresh(now):
        notes += _scaled(measured, commanded, vehicle.model.speed_max_rpm)
    if chosen.known < rotors:
        missing = ", ".join(str(i + 1) for i, u in enumerate(chosen.u) if u is None)
        notes.append(f"no speed of rotor {missing}")
    if chosen is commanded and (taken := motor_map(heard.parameters, rotors)[1]):
        notes.append(taken)
    if chosen.extra:
        notes.append(f"{chosen.name} reports {chosen.extra} more than the airframe's {rotors} rotors")
    known = np.array([np.nan if u is None else u for u in chosen.u])
    turned = known if chosen is measured else vehicle.turned(known)
    u = tuple(None if math.isnan(t) else float(t) for t in turned)
    rpm = tuple(None if t is None else t * vehicle.model.speed_max_rpm for t in u)
    old = not commanded.fresh(now) and chosen.fresh(now)
    throttle = (None,) * rotors if old else commanded.u
    return RotorSpeeds(chosen.name, chosen.basis, u, rpm, throttle, chosen.received_s, tuple(notes))


def commanded_speeds(heard: Heard, rotors: int) -> SpeedSource:
    """SERVO_OUTPUT_RAW, or ACTUATOR_OUTPUT_STATUS where that knows more."""
    return _better(_servo(heard, rotors), _actuator_status(heard, rotors), heard.now())


def measured_speeds(heard: Heard, vehicle: Vehicle, commanded: SpeedSource) -> tuple[SpeedSource, list[str]]:
    """What ESCs tell, and notes on what is not believed."""
    rotors, rpm = len(vehicle.airframe.rotors), heard.telemetry.each("esc_rpm")
    if not rpm:
        return SpeedSource("ESC_STATUS rpm", "measured", (None,) * rotors), []
    now, newest = heard.now(), max(rpm.values(), key=lambda t: t.received_s)
    kind = newest.kind if newest.kind == "ESC_STATUS" else "ESC_TELEMETRY"
    title, notes = f"{kind} rpm", []
    # an ESC that stopped coming says nothing about now
    live = {i: t for i, t in rpm.items() if newest.received_s - t.received_s <= STALE_S}
    if offline := _offline(heard.telemetry, live, newest.received_s):
        named = ", ".join(str(esc) for esc in offline)
        notes.append(f"ESC_INFO: ESC {named} (from 0) is offline, its rpm is not used")
        live = {i: t for i, t in live.items() if i not in offline}
    for first in _repeated(live, commanded.u if commanded.fresh(now) else ()):
        notes.append(f"{kind} repeats rotors 1-4 as {first + 1}-{first + 4}: not used for them")
        live = {i: t for i, t in live.items() if not first <= i < first + 4}
    outputs = motor_outputs(heard.parameters, rotors)  # PX4 numbers ESCs by motor, ArduPilot by output
    full_rpm = vehicle.model.speed_max_rpm
    u = tuple(abs(live[p].value) / full_rpm if p in live else None for p in outputs)
    driven = commanded.fresh(now) and any(c is not None and c > RUNNING for c in commanded.u)
    if driven and not any(u):
        notes.append(f"{kind} reads 0 rpm while the motors are driven: not used")
        return SpeedSource(title, "measured", (None,) * rotors), notes
    extra = sum(1 for output, t in live.items() if t.value and output not in outputs)
    return SpeedSource(title, "measured", u, newest.received_s, extra), notes


def _offline(telemetry: Telemetry, live: Mapping[int, Timed], newest_s: float) -> list[int]:
    """ESCs, counted from 0, without a bit in the newest ESC_INFO: PX4 repeats what it last heard of them.

    No bit at all is a driver's that does not keep them.
    """
    info = telemetry.newest("ESC_INFO")
    if info is None or not info.value.info or newest_s - info.received_s > INFO_STALE_S:
        return []
    return [esc for esc in live if esc < ONLINE_BITS and not info.value.info >> esc & 1]


def motor_outputs(parameters: Mapping[str, float], rotors: int) -> tuple[int | None, ...]:
    """(N,) the output (from 0) of each motor; by number where no SERVOn_FUNCTION is known."""
    functions = {
        int(value): n
        for n in range(_OUTPUTS)
        if math.isfinite(value := parameters.get(f"SERVO{n + 1}_FUNCTION", math.nan))
    }
    if not functions:
        return tuple(range(rotors))
    return tuple(functions.get(servo_function(motor)) for motor in range(1, rotors + 1))


def _better(first: SpeedSource, second: SpeedSource, now_s: float) -> SpeedSource:
    """The fresher, then the fuller one; `first` when they are level."""

    def rank(source: SpeedSource) -> tuple[bool, int]:
        return source.fresh(now_s) and source.known > 0, source.known

    return second if rank(second) > rank(first) else first


def _servo(heard: Heard, rotors: int) -> SpeedSource:
    name, newest = "SERVO_OUTPUT_RAW", heard.telemetry.newest("SERVO_OUTPUT_RAW")
    if newest is None:
        return SpeedSource(name, "commanded", (None,) * rotors)
    # the second eight are an extension that some senders leave out
    pulses = {n: float(getattr(newest.value, f"servo{n}_raw", 0) or 0) for n in range(1, _OUTPUTS + 1)}
    return SpeedSource(name, "commanded", _commands(pulses, heard.parameters, rotors), newest.received_s)


def _actuator_status(heard: Heard, rotors: int) -> SpeedSource:
    name, newest = "ACTUATOR_OUTPUT_STATUS", heard.telemetry.newest("ACTUATOR_OUTPUT_STATUS")
    if newest is None:
        return SpeedSource(name, "commanded", (None,) * rotors)
    active = int(newest.value.active) & 0xFFFFFFFF
    values = [float(v) for v in newest.value.actuator]
    live = {i + 1: v for i, v in enumerate(values) if (not active or active >> i & 1) and math.isfinite(v)}
    # in simulation PX4 sends -1..1 instead of pulses
    if any(abs(v) > 1.5 for v in values if math.isfinite(v)):
        u = _commands(live, heard.parameters, rotors)
    else:
        u = tuple(min(max(live[n], 0.0), 1.0) if n in live else None for n in range(1, rotors + 1))
    return SpeedSource(name, "commanded", u, newest.received_s)


def _commands(outputs: Mapping[int, float], parameters: Mapping[str, float], rotors: int) -> Values:
    """(N,) normalised commands of outputs, counted from 1; None where there is no pulse, 0 below the lowest
    (disarmed)."""
    drives = {o.motor: o for o in motor_map(parameters, rotors)[0]}
    found: list[float | None] = []
    for motor in range(1, rotors + 1):
        pulse = outputs.get(drives[motor].channel, 0.0) if motor in drives else 0.0
        if not math.isfinite(pulse) or pulse <= 0:
            found.append(None)
        else:
            low, high = drives[motor].low, drives[motor].high
            found.append(min(max((pulse - low) / (high - low), 0.0), 1.0))
    return tuple(found)


def _repeated(rpm: Mapping[int, Timed], commanded: Values) -> list[int]:
    """First ESCs of the fours that only repeat the first four (PX4 of the v1.14 era sends such)."""

    def four(first: int) -> list[float | None]:
        return [rpm[first + k].value if first + k in rpm else None for k in range(4)]

    own = four(0)
    if not any(own):
        return []
    repeated = []
    for first in range(4, max(rpm) + 1, 4):
        if four(first) != own:
            continue
        pairs = zip(commanded[:4], commanded[first : first + 4], strict=False)
        witness = [abs(b - a) for a, b in pairs if a is not None and b is not None]
        # equal speeds are real under the standard table: the outputs tell, or else four different ones do
        if max(witness) > _APART if witness else len(set(own)) > 1:
            repeated.append(first)
    return repeated


def _scaled(measured: SpeedSource, commanded: SpeedSource, speed_max_rpm: float) -> list[str]:
    """A note when every rotor turns faster than commanded by one factor: another full speed is behind it."""
    pairs = zip(measured.u, commanded.u, strict=True)
    ratios = [a / c for a, c in pairs if a is not None and c is not None and c > RUNNING]
    if len(ratios) < 3 or min(ratios) < _FASTER or max(ratios) - min(ratios) > _ALIKE * max(ratios):
        return []
    factor = sum(ratios) / len(ratios)
    return [
        f"{measured.name} is {factor:.2f} of the command on every rotor: full speed is not the model's "
        f"{speed_max_rpm:.0f} rpm, or nobody measures (PX4's simulation says 6000 at full command)"
    ]
