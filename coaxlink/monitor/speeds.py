"""How fast each rotor turns, and who says so.

Measured speeds (ESC_STATUS, rpm) are preferred to commanded ones (SERVO_OUTPUT_RAW, then
ACTUATOR_OUTPUT_STATUS, 1000..2000 us after the thrust curve, so u = (us - 1000) / 1000). A source is
passed over, and a note says so, when another one knows more rotors, when it went quiet, or when it
contradicts itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from coaxlink.monitor.readings import Arrival, Readings

STALE_S = 1.5  # speeds older than this are not the present
_RUNNING = 0.1  # normalised command above which a motor must turn
_FASTER, _ALIKE = 1.05, 0.02  # rpm over command, on every rotor alike: not what one full pack can do
_DISAGREE = 0.03  # normalised speed between an ESC and the output that drives it


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


@dataclass(frozen=True)
class Speeds:
    """The speeds the screen goes by."""

    source: str  # "ESC_STATUS rpm", ...; "" while nobody reports any
    basis: str  # measured, commanded or none
    u: tuple[float | None, ...]  # (N,) normalised speed
    rpm: tuple[float | None, ...]  # (N,) measured, or what u means by the rotor model
    throttle: tuple[float | None, ...]  # (N,) commanded 0..1, whatever `u` is from
    received_s: float | None
    notes: tuple[str, ...] = ()


def rotor_speeds(readings: Readings, rotors: int, speed_max_rpm: float, now_s: float) -> Speeds:
    """Choose among what was heard; `rotors` is the airframe's count N, `speed_max_rpm` the model's."""
    outputs = _servo(readings, rotors)
    status = _actuator_status(readings, rotors)
    commanded = _better(outputs, status, now_s)
    measured, notes = _esc(readings, rotors, speed_max_rpm, commanded, now_s)
    chosen = _better(measured, commanded, now_s)
    if chosen.known == 0:
        blank = (None,) * rotors
        return Speeds("", "none", blank, blank, blank, None, tuple(notes))
    if chosen is commanded and measured.known:
        notes.append(
            f"ESC_STATUS knows {measured.known} of {rotors} rotors"
            if _fresh(measured, now_s)
            else "ESC_STATUS went quiet"
        )
    if chosen.known < rotors:
        missing = ", ".join(str(i + 1) for i, u in enumerate(chosen.u) if u is None)
        notes.append(f"no speed of rotor {missing}")
    if chosen.extra:
        notes.append(f"{chosen.name} reports {chosen.extra} more than the airframe's {rotors} rotors")
    rpm = tuple(None if u is None else u * speed_max_rpm for u in chosen.u)
    throttle = commanded.u if _fresh(commanded, now_s) or not _fresh(chosen, now_s) else (None,) * rotors
    return Speeds(chosen.name, chosen.basis, chosen.u, rpm, throttle, chosen.received_s, tuple(notes))


def _fresh(source: Source, now_s: float) -> bool:
    return source.received_s is not None and now_s - source.received_s <= STALE_S


def _better(first: Source, second: Source, now_s: float) -> Source:
    """The fresher, then the fuller one; `first` when they are level."""

    def rank(source: Source) -> tuple[bool, int]:
        return _fresh(source, now_s) and source.known > 0, source.known

    return second if rank(second) > rank(first) else first


def _unit(pulse_us: float) -> float | None:
    """Normalised command of a pulse; None where there is none, 0 below 1000 us (disarmed)."""
    if not math.isfinite(pulse_us) or pulse_us <= 0:
        return None
    return min(max((pulse_us - 1000.0) / 1000.0, 0.0), 1.0)


def _servo(readings: Readings, rotors: int) -> Source:
    arrival = readings.batches("SERVO_OUTPUT_RAW").get(0)
    if arrival is None:
        return Source("SERVO_OUTPUT_RAW", "commanded", (None,) * rotors, None)
    # the second eight are an extension that some senders leave out
    pulses = [float(getattr(arrival.message, f"servo{n}_raw", 0) or 0) for n in range(1, 17)]
    u = [_unit(p) for p in pulses]
    return Source("SERVO_OUTPUT_RAW", "commanded", tuple(u[:rotors]), arrival.received_s)


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
    readings: Readings, rotors: int, speed_max_rpm: float, commanded: Source, now_s: float
) -> tuple[Source, list[str]]:
    batches = readings.batches("ESC_STATUS")
    blank = Source("ESC_STATUS rpm", "measured", (None,) * rotors, None)
    if not batches:
        return blank, []
    newest = max(a.received_s for a in batches.values())
    # a batch that stopped coming says nothing about now
    live = {i: a for i, a in batches.items() if newest - a.received_s <= STALE_S}
    notes: list[str] = []
    for index in _repeated(live, commanded, speed_max_rpm, now_s):
        notes.append(f"ESC_STATUS repeats motors 1-4 as {index + 1}-{index + 4}: not used for them")
        del live[index]
    u: list[float | None] = [None] * rotors
    extra = 0
    for index, arrival in live.items():
        for k, rpm in enumerate(arrival.message.rpm):
            if index + k < rotors:
                u[index + k] = abs(rpm) / speed_max_rpm if math.isfinite(rpm) else None
            elif rpm:
                extra += 1
    driven = [c is not None and c > _RUNNING for c in commanded.u]
    if _fresh(commanded, now_s) and any(driven) and not any(u):
        return blank, [*notes, "ESC_STATUS reads 0 rpm while the motors are driven: not used"]
    if _fresh(commanded, now_s):
        notes += _scaled(u, commanded.u, speed_max_rpm)
    return Source("ESC_STATUS rpm", "measured", tuple(u), newest, extra), notes


def _scaled(
    measured: list[float | None], commanded: tuple[float | None, ...], speed_max_rpm: float
) -> list[str]:
    """A note when every rotor turns faster than commanded by one factor: another full speed is behind it."""
    pairs = zip(measured, commanded, strict=True)
    ratios = [a / c for a, c in pairs if a is not None and c is not None and c > _RUNNING]
    if len(ratios) < 3 or min(ratios) < _FASTER or max(ratios) - min(ratios) > _ALIKE * max(ratios):
        return []
    factor = sum(ratios) / len(ratios)
    return [
        f"ESC_STATUS rpm is {factor:.2f} of the command on every rotor: full speed is not the model's "
        f"{speed_max_rpm:.0f} rpm, or nobody measures (PX4's simulation says 6000 at full command)"
    ]


def _repeated(
    batches: dict[int, Arrival], commanded: Source, speed_max_rpm: float, now_s: float
) -> list[int]:
    """Indices of batches that only repeat batch 0 (PX4 of the v1.14 era sends such)."""
    first = batches.get(0)
    if first is None or not any(first.message.rpm):
        return []
    repeated = []
    for index, arrival in batches.items():
        if index == 0 or list(arrival.message.rpm) != list(first.message.rpm):
            continue
        outputs = commanded.u[index : index + 4] if _fresh(commanded, now_s) else ()
        witness = [
            abs(abs(rpm) / speed_max_rpm - u)
            for rpm, u in zip(arrival.message.rpm, outputs, strict=False)
            if u is not None
        ]
        # equal speeds are real under the standard table: the outputs tell, or else four different ones do
        if max(witness) > _DISAGREE if witness else len(set(first.message.rpm)) > 1:
            repeated.append(index)
    return repeated
