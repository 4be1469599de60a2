"""How fast each rotor turns, and who says so.

Measured speeds (ESC_STATUS, ArduPilot's ESC_TELEMETRY) are preferred to commanded ones (SERVO_OUTPUT_RAW,
ACTUATOR_OUTPUT_STATUS). A source is passed over, and a note says so, when another one knows more rotors, when
it went quiet, when it contradicts itself, or when a steady hover has contradicted it (`hover`).
"""

from __future__ import annotations

from dataclasses import dataclass

from coaxlink.monitor.telemetry.hover import Verdict
from coaxlink.monitor.telemetry.readings import Readings
from coaxlink.monitor.telemetry.sources import RUNNING, Source, better, commanded_speeds, measured_speeds
from coaxlink.vehicle import Vehicle

_FASTER, _ALIKE = 1.05, 0.02  # rpm over command, on every rotor alike: not what one full pack can do


@dataclass(frozen=True)
class Speeds:
    """The speeds the screen goes by."""

    source: str  # "ESC_STATUS rpm", ...; "" while nobody reports any
    basis: str  # measured, commanded or none
    u: tuple[float | None, ...]  # (N,) normalised speed where measured, else the command
    rpm: tuple[float | None, ...]  # (N,) measured, or what u means by the rotor model
    throttle: tuple[float | None, ...]  # (N,) commanded 0..1, whatever `u` is from
    received_s: float | None
    notes: tuple[str, ...] = ()


def rotor_speeds(
    readings: Readings, vehicle: Vehicle, now_s: float, verdict: Verdict | None = None
) -> Speeds:
    """Choose among what was heard of the N rotors; measured u are speeds, commanded ones commands."""
    rotors, speed_max_rpm = len(vehicle.airframe.rotors), vehicle.speed_model.speed_max_rpm
    commanded = commanded_speeds(readings, rotors, now_s)
    measured, notes = measured_speeds(readings, rotors, speed_max_rpm, commanded, now_s)
    chosen = better(measured, commanded, now_s)
    if chosen.known == 0:
        blank = (None,) * rotors
        return Speeds("", "none", blank, blank, blank, None, tuple(notes))
    believed = verdict is None or verdict.believes(measured.name)
    if chosen is measured and not believed and commanded.fresh(now_s) and commanded.known == rotors:
        assert verdict is not None
        notes.insert(0, verdict.why_not(commanded.name))
        chosen = commanded
    elif chosen is commanded and measured.known:
        kind = measured.name.removesuffix(" rpm")
        notes.append(
            f"{kind} knows {measured.known} of {rotors} rotors"
            if measured.fresh(now_s)
            else f"{kind} went quiet"
        )
    elif chosen is measured and commanded.fresh(now_s):
        notes += _scaled(measured, commanded, speed_max_rpm)
    if chosen.known < rotors:
        missing = ", ".join(str(i + 1) for i, u in enumerate(chosen.u) if u is None)
        notes.append(f"no speed of rotor {missing}")
    if chosen.extra:
        notes.append(f"{chosen.name} reports {chosen.extra} more than the airframe's {rotors} rotors")
    full_rpm = speed_max_rpm if chosen is measured else vehicle.model.speed_max_rpm
    rpm = tuple(None if u is None else u * full_rpm for u in chosen.u)
    old = not commanded.fresh(now_s) and chosen.fresh(now_s)
    throttle = (None,) * rotors if old else commanded.u
    return Speeds(chosen.name, chosen.basis, chosen.u, rpm, throttle, chosen.received_s, tuple(notes))


def _scaled(measured: Source, commanded: Source, speed_max_rpm: float) -> list[str]:
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
