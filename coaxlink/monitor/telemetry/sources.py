"""What each kind of message says of the rotors' speeds: measured by ESCs, or commanded by outputs.

A command is a pulse after the thrust curve, u = (us - low) / (high - low): 1000 and 2000 us, on ArduPilot
MOT_PWM_MIN and MOT_PWM_MAX. There a motor's output, and its ESC, is the one whose SERVOn_FUNCTION names it
(once those were read); elsewhere output n drives motor n.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from coaxlink.monitor.telemetry.readings import Arrival, Readings
from firmware_params.ardupilot import servo_function
from firmware_params.ardupilot.messages import ESC_TELEMETRY, NAMES

STALE_S = 1.5  # speeds older than this are not the present
RUNNING = 0.1  # normalised command above which a motor must turn
_DISAGREE = 0.03  # normalised speed between two outputs whose ESCs read the same
_OUTPUTS = 16  # of SERVO_OUTPUT_RAW


@dataclass(frozen=True)
class Source:
    """Speeds of N rotors by one kind of message; None where it says nothing."""

    name: str
    basis: str  # measured or commanded
    u: tuple[float | None, ...]  # (N,) normalised speed
    received_s: float | None
    extra: int = 0  # rotors it reports beyond the airframe's

    @property
    def known(self) -> int:
        """How many rotors it knows."""
        return sum(u is not None for u in self.u)

    def fresh(self, now_s: float) -> bool:
        """Whether it is of the present."""
        return self.received_s is not None and now_s - self.received_s <= STALE_S


def better(first: Source, second: Source, now_s: float) -> Source:
    """The fresher, then the fuller one; `first` when they are level."""

    def rank(source: Source) -> tuple[bool, int]:
        return source.fresh(now_s) and source.known > 0, source.known

    return second if rank(second) > rank(first) else first


def commanded_speeds(readings: Readings, rotors: int, now_s: float) -> Source:
    """SERVO_OUTPUT_RAW, or ACTUATOR_OUTPUT_STATUS where that knows more."""
    return better(_servo(readings, rotors), _actuator_status(readings, rotors), now_s)


def measured_speeds(
    readings: Readings, rotors: int, speed_max_rpm: float, commanded: Source, now_s: float
) -> tuple[Source, list[str]]:
    """What ESCs tell (ESC_STATUS, else ArduPilot's ESC_TELEMETRY), and notes on what is not believed."""
    telemetry = {
        first: arrival
        for first, name in zip(ESC_TELEMETRY.values(), NAMES, strict=True)
        if (arrival := readings.get(name)) is not None
    }
    found, notes = Source("ESC_STATUS rpm", "measured", (None,) * rotors, None), []
    for name, batches in (("ESC_STATUS", readings.batches("ESC_STATUS")), ("ESC_TELEMETRY", telemetry)):
        if batches:
            source, said = _esc(name, batches, readings, rotors, speed_max_rpm, commanded, now_s)
            notes += said
            found = better(found, source, now_s) if found.received_s is not None else source
    return found, notes


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


def _unit(pulse_us: float, low: float = 1000.0, high: float = 2000.0) -> float | None:
    """Normalised command of a pulse; None where there is none, 0 below the lowest (disarmed)."""
    if not math.isfinite(pulse_us) or pulse_us <= 0:
        return None
    return min(max((pulse_us - low) / (high - low), 0.0), 1.0)


def _pulse_range(parameters: Mapping[str, float]) -> tuple[float, float]:
    low, high = parameters.get("MOT_PWM_MIN", 1000.0), parameters.get("MOT_PWM_MAX", 2000.0)
    return (low, high) if 0.0 < low < high < 1e4 else (1000.0, 2000.0)


def _servo(readings: Readings, rotors: int) -> Source:
    arrival = readings.batches("SERVO_OUTPUT_RAW").get(0)
    if arrival is None:
        return Source("SERVO_OUTPUT_RAW", "commanded", (None,) * rotors, None)
    # the second eight are an extension that some senders leave out
    pulses = [float(getattr(arrival.message, f"servo{n}_raw", 0) or 0) for n in range(1, _OUTPUTS + 1)]
    low, high = _pulse_range(readings.parameters)
    outputs = motor_outputs(readings.parameters, rotors)
    u = tuple(None if p is None or p >= _OUTPUTS else _unit(pulses[p], low, high) for p in outputs)
    return Source("SERVO_OUTPUT_RAW", "commanded", u, arrival.received_s)


def _actuator_status(readings: Readings, rotors: int) -> Source:
    arrival = readings.get("ACTUATOR_OUTPUT_STATUS")
    if arrival is None:
        return Source("ACTUATOR_OUTPUT_STATUS", "commanded", (None,) * rotors, None)
    active = int(arrival.message.active) & 0xFFFFFFFF
    values = [float(v) for v in arrival.message.actuator]
    finite = [v for v in values if math.isfinite(v)]
    # in simulation PX4 sends -1..1 instead of pulses
    pulses = any(abs(v) > 1.5 for v in finite)
    u: list[float | None] = []
    for i, value in enumerate(values[:rotors]):
        if (active and not active >> i & 1) or not math.isfinite(value):
            u.append(None)
        else:
            u.append(_unit(value) if pulses else min(max(value, 0.0), 1.0))
    return Source("ACTUATOR_OUTPUT_STATUS", "commanded", tuple(u), arrival.received_s)


def _esc(
    name: str,
    batches: dict[int, Arrival],
    readings: Readings,
    rotors: int,
    speed_max_rpm: float,
    commanded: Source,
    now_s: float,
) -> tuple[Source, list[str]]:
    title = f"{name} rpm"
    newest = max(a.received_s for a in batches.values())
    # a batch that stopped coming says nothing about now
    live = {i: a for i, a in batches.items() if newest - a.received_s <= STALE_S}
    notes: list[str] = []
    for index in _repeated(live, commanded, now_s):
        notes.append(f"{name} repeats rotors 1-4 as {index + 1}-{index + 4}: not used for them")
        del live[index]
    at = {index + k: rpm for index, a in live.items() for k, rpm in enumerate(a.message.rpm)}
    # PX4 numbers ESCs by motor, ArduPilot by output
    outputs = motor_outputs(readings.parameters, rotors)
    u = tuple(
        abs(at[p]) / speed_max_rpm if p in at and math.isfinite(at[p]) else None
        for p in (-1 if p is None else p for p in outputs)
    )
    extra = sum(1 for output, rpm in at.items() if rpm and output not in outputs)
    driven = commanded.fresh(now_s) and any(c is not None and c > RUNNING for c in commanded.u)
    if driven and not any(u):
        blank = Source(title, "measured", (None,) * rotors, None)
        return blank, [*notes, f"{name} reads 0 rpm while the motors are driven: not used"]
    return Source(title, "measured", u, newest, extra), notes


def _repeated(batches: dict[int, Arrival], commanded: Source, now_s: float) -> list[int]:
    """Indices of batches that only repeat batch 0 (PX4 of the v1.14 era sends such)."""
    first = batches.get(0)
    if first is None or not any(first.message.rpm):
        return []
    repeated = []
    for index, arrival in batches.items():
        if index == 0 or list(arrival.message.rpm) != list(first.message.rpm):
            continue
        outputs = commanded.u if commanded.fresh(now_s) else ()
        pairs = zip(outputs[:4], outputs[index : index + 4], strict=False)
        witness = [abs(b - a) for a, b in pairs if a is not None and b is not None]
        # equal speeds are real under the standard table: the outputs tell, or else four different ones do
        if max(witness) > _DISAGREE if witness else len(set(first.message.rpm)) > 1:
            repeated.append(index)
    return repeated
