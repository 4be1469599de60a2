"""A layout with what no autopilot knows: mass, arm length, spacing, which rotor is on top."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from coaxlink.airframe import AXES, FURTHEST_M, Airframe, Rotor
from coaxlink.errors import InputError
from coaxlink.rotor.model import Source
from coaxlink.setup.layout import WIDEST_M, Layout, Mount, refuse_far

Inertia = tuple[float, float, float]
_TORQUE_ARMS = 0.1  # torque over thrust, of an arm: rank does not hang on it
_OWN_SHARE = 0.02  # of a rotor's full effect on an axis: a tape measure is off by as much


@dataclass(frozen=True)
class Body:
    """What the builder of the vehicle measures."""

    name: str
    mass_kg: float | None
    arm_m: float | None = None  # centre to rotor; for a layout without a scale
    spacing_m: float | None = None  # between the rotors of a pair; for a layout without heights
    upper: tuple[int, ...] = ()  # numbers of the upper rotors, where no source tells
    inertia_kg_m2: Inertia | None = None  # estimated where missing
    motor_lag_s: float | None = None  # 0 where missing, which nobody measured


class MissingError(InputError):
    """What a layout does not tell and `Body` does not either; `fields` are Body's, with what each is."""

    def __init__(self, source: str, fields: Mapping[str, str]) -> None:
        self.fields = dict(fields)
        lacking = ", ".join(f"`{name}` ({what})" for name, what in fields.items())
        super().__init__(source, "", f"does not hold all of the vehicle: {lacking} expected")


def missing(layout: Layout, body: Body) -> dict[str, str]:
    """Fields of `body` without which the layout is no vehicle, and what each is; all of them at once.

    Raises InputError where `body` contradicts the layout.
    """
    found = {}
    if body.mass_kg is None:
        found["mass_kg"] = "the whole vehicle, weighed"
    if not layout.metres and body.arm_m is None:
        found["arm_m"] = "from the centre to a rotor"
    pairs = [stack for stack in layout.stacks() if len(stack) > 1]
    if body.spacing_m is None and any(layout.mounts[n].z is None for stack in pairs for n in stack):
        found["spacing_m"] = "between the two rotors of a pair"
    unknown = _levels(layout, body.upper)[1]
    if unknown:
        found["upper"] = f"which rotor of each pair is on top: {', '.join(unknown)}"
    return found


def completed(layout: Layout, body: Body) -> Airframe:
    """The vehicle. Raises MissingError (all that is missing), InputError (what contradicts the layout)."""
    if lacking := missing(layout, body):
        raise MissingError(layout.source, lacking)
    scale = 1.0 if layout.metres else _metres("`arm_m`", body.arm_m)
    levels = _levels(layout, body.upper)[0]
    partners = {n: other for stack in layout.stacks() for n in stack for other in stack if other != n}
    rotors = tuple(
        Rotor(
            n + 1,
            (mount.x * scale, mount.y * scale, _height(mount, levels[n], body)),
            mount.axis,
            1 if mount.spin == "ccw" else -1,
            levels[n],
            partners[n] + 1 if n in partners else None,
        )
        for n, mount in enumerate(layout.mounts)
    )
    for rotor in rotors:
        refuse_far(layout.source, rotor.number, rotor.position_m)
    mass = _positive("`mass_kg`", body.mass_kg)
    inertia = body.inertia_kg_m2 or inertia_estimate(mass, rotors)
    sources: dict[str, Source] = {
        "mass_kg": "declared",
        "inertia_kg_m2": "declared" if body.inertia_kg_m2 else "estimated",
        "motor_lag_s": "default" if body.motor_lag_s is None else "declared",
        "rotors": "board" if layout.metres else "declared",
    }
    airframe = Airframe(body.name, mass, inertia, rotors, body.motor_lag_s or 0.0, sources=sources)
    if lost := lost_axes(airframe):
        problem = (
            f"{len(rotors)} rotors at these places and with these spins cannot command {' and '.join(lost)} "
            "apart from the other axes"
        )
        raise InputError(layout.source, "rotors", problem)
    return airframe


def lost_axes(airframe: Airframe) -> list[str]:
    """Of thrust, roll, pitch and yaw those that the others command along: the effectiveness is not of rank 4.

    >>> from coaxlink.setup import Body, completed, template
    >>> lost_axes(completed(template("x8"), Body("x8", 12.0, 0.5, 0.1)))
    []
    """
    thrust, torque = airframe.effectiveness()
    arm = max(math.hypot(r.position_m[0], r.position_m[1]) for r in airframe.rotors) or 1.0
    rows = (thrust + _TORQUE_ARMS * arm * torque) / np.array([[1.0], [arm], [arm], [_TORQUE_ARMS * arm]])
    lost = []
    for n, axis in enumerate(AXES):
        others = np.delete(rows, n, axis=0)
        rest = rows[n] - np.linalg.lstsq(others.T, rows[n], rcond=None)[0] @ others
        if np.linalg.norm(rest) < _OWN_SHARE * math.sqrt(len(airframe.rotors)):
            lost.append(axis)
    return lost


def inertia_estimate(mass_kg: float, rotors: tuple[Rotor, ...]) -> Inertia:
    """Moments of inertia (3,) in kg m^2 if half of the mass were in the rotors and half a ball of half an
    arm's radius: good to a factor of two, for `sim` and the look of a report; no table depends on it."""
    share = 0.5 * mass_kg / len(rotors)
    arm = max(math.hypot(r.position_m[0], r.position_m[1]) for r in rotors)
    ball = 0.4 * 0.5 * mass_kg * (0.5 * arm) ** 2
    xx = sum(share * (r.position_m[1] ** 2 + r.position_m[2] ** 2) for r in rotors)
    yy = sum(share * (r.position_m[0] ** 2 + r.position_m[2] ** 2) for r in rotors)
    zz = sum(share * (r.position_m[0] ** 2 + r.position_m[1] ** 2) for r in rotors)
    return xx + ball, yy + ball, zz + ball


def _levels(layout: Layout, upper: tuple[int, ...]) -> tuple[list[str], list[str]]:
    """The level of each rotor, and the pairs ("1 or 6") of which nobody says it."""
    count = len(layout.mounts)
    wrong = [n for n in upper if not 1 <= n <= count]
    if wrong:
        raise InputError("`upper`", str(wrong[0]), f"rotor numbers from 1 to {count} are expected")
    levels, unknown = ["single"] * count, []
    for stack in layout.stacks():
        if len(stack) == 1:
            continue
        a, b = stack
        known = _known_level(layout.mounts[a], layout.mounts[b])
        above = {n: n + 1 in upper for n in stack}
        if upper and above[a] == above[b]:
            both = "both" if above[a] else "neither"
            raise InputError("`upper`", "", f"one of pair {a + 1}/{b + 1} is expected, {both} stands there")
        stated = None if not upper else ("upper" if above[a] else "lower")
        if known and stated and known != stated:
            top = (a if known == "upper" else b) + 1
            raise InputError("`upper`", "", f"{layout.source} has rotor {top} on top of its pair")
        level = known or stated or _by_order(layout.mounts[a], layout.mounts[b])
        if level is None:
            unknown.append(f"{a + 1} or {b + 1}")
            continue
        levels[a], levels[b] = level, "lower" if level == "upper" else "upper"
    return levels, unknown


def _known_level(a: Mount, b: Mount) -> str | None:
    """Of `a`, from heights or from the frame; None where neither tells."""
    if a.z is not None and b.z is not None and a.z != b.z:
        return "upper" if a.z < b.z else "lower"  # z is down
    return a.level if a.level and b.level and a.level != b.level else None


def _by_order(a: Mount, b: Mount) -> str | None:
    """Of `a`, where the firmware's motor test has an order."""
    return None if not (a.order and b.order) else "upper" if a.order < b.order else "lower"


def _height(mount: Mount, level: str, body: Body) -> float:
    if mount.z is not None:
        return mount.z
    if level == "single":
        return 0.0
    half = 0.5 * _metres("`spacing_m`", body.spacing_m)
    return -half if level == "upper" else half


def _positive(field: str, value: float | None) -> float:
    if value is None or not 0.0 < value < math.inf:
        raise InputError(field, "", f"a number above 0 is expected, found {value}")
    return float(value)


def _metres(field: str, value: float | None) -> float:
    """A length of the vehicle; raises InputError for what are millimetres or centimetres."""
    length = _positive(field, value)
    if WIDEST_M < length <= FURTHEST_M:
        meant = f"{length / 1000:g} for millimetres, {length / 100:g} for centimetres?"
        raise InputError(field, f"{length:g}", f"metres are expected: {meant}")
    return length
