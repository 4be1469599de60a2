"""ESCs count turns of the field: a rotor's speed is theirs over its pairs of magnets. With a wrong number
it is off by a ratio of whole pairs; a parameter of the autopilot says which number was taken."""

from __future__ import annotations

from collections.abc import Mapping

POLES = ("SERVO_BLH_POLES", "SERVO_FTW_POLES", "MOT_POLE_COUNT")  # ArduPilot's two, PX4's
USUAL = 14  # what every firmware begins with
MAGNETS = range(4, 58, 2)  # of motors that carry propellers
NEAR = 0.1  # of the ratio: full speed is known within that (`coefficients.DRIVE_SCALE`)


def counted(parameters: Mapping[str, float]) -> tuple[str, float]:
    """The parameter ("" where none is known), and how many magnets it says."""
    return next(((n, parameters[n]) for n in POLES if parameters.get(n, 0) > 0), ("", float(USUAL)))


def to_set(parameters: Mapping[str, float], magnets: int) -> str:
    """What to change so that `magnets` are counted."""
    name, _ = counted(parameters)
    if not name and parameters:
        name = POLES[0] if "SERVO1_FUNCTION" in parameters else POLES[2]
    return f"set {name or ' or '.join(POLES)} (or the ESC's own) to {magnets}"


def miscounted(parameters: Mapping[str, float], ratio: float) -> str:
    """What rpm are that are `ratio` times too high, as numbers of magnets; "" where no whole pairs fit."""
    _, number = counted(parameters)
    right = 2 * round(ratio * number / 2)
    if right in MAGNETS and abs(ratio * number / right - 1.0) < NEAR:
        return f"{right} magnets counted as {number:g}? {to_set(parameters, right)}"
    took = 2 * round(number / ratio / 2)
    if took in MAGNETS and abs(number / ratio / took - 1.0) < NEAR:
        return f"{number:g} magnets counted as {took}? {to_set(parameters, round(number))}"
    return ""
