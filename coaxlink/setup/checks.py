"""What an airframe file may have wrong though every key can be read, and how it differs from a board."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.rotor import RotorModel
from coaxlink.setup.layout import WIDEST_M, Layout
from firmware_params.errors import Finding

_SHORTEST_M = 0.03  # an arm shorter than this is a unit of another kind
_APART = 0.1  # of the longest arm: rotors of a pair stand one above the other within this
_BALANCE = 0.05  # of the longest arm: how far the rotors' middle may be from the centre of mass
_LEAST_THRUST, _MOST_THRUST = 1.15, 12.0  # full thrust over weight: does not fly; grams taken for kilograms
# weight over the largest discs that fit: from toys to coaxial lifters multirotors have 15 to 1500 N/m^2, and
# grams taken for kilograms are a thousandfold
_DISC_LOADING_N_M2 = (3.0, 6000.0)
_LARGEST_DISC = 0.65  # radius over the longest arm, where the discs of four arms touch
_GYRATION = (0.1, 1.5)  # radius of gyration over the longest arm, of any body that carries rotors
# of the lengths here over the board's: tapes agree within a few per cent, and PX4 norms what is alike on all
# arms; the usual slips are a side for an arm (1.41) and a diagonal for it (2)
_SCALE = 1.25
_SIDE = 0.2  # of the longest arm: closer to an axis than this, a side is not told


def check_airframe(airframe: Airframe, model: RotorModel | None = None) -> tuple[Finding, ...]:
    """Findings, errors first; an empty tuple is a sound vehicle. With the rotor model also its thrust."""
    checks = (_authority, _lengths, _pairs, _balance, _mass, _inertia)
    found = [finding for check in checks for finding in check(airframe)]
    found += _thrust(airframe, model) if model else ()
    return tuple(sorted(found, key=lambda f: f.severity != "error"))


def check_outputs(board: Layout) -> tuple[Finding, ...]:
    """An error where a rotor has no output: it cannot fly so. A warning where their order is unusual."""
    if not board.idle:
        return tuple(_out_of_order(board))
    numbers = ", ".join(map(str, board.idle))
    text = f"no output drives rotor {numbers}: assign one on the board before it flies"
    return (Finding("airframe.outputs", "error", text, board.source),)


def _out_of_order(board: Layout) -> Iterator[Finding]:
    """Boards come with motor 1 on output 1, and so on: another order is meant, or a slip of the wiring."""
    banks = [mount.output.rpartition(" ") for mount in board.mounts]
    if not all(number.isdecimal() for _, _, number in banks) or len({bank for bank, _, _ in banks}) != 1:
        return
    order = [int(number) for _, _, number in banks]
    if order != sorted(order):
        places = ", ".join(f"{n} on {mount.output}" for n, mount in enumerate(board.mounts, 1))
        text = f"the rotors are not on the outputs in their order: {places}; turn each once, propellers off"
        yield Finding("airframe.output-order", "warning", text, board.source)


def check_against(airframe: Airframe, board: Layout) -> tuple[Finding, ...]:
    """Findings where a board numbers, turns or places its motors otherwise than the airframe does."""
    if len(board.mounts) != len(airframe.rotors):
        text = f"{len(airframe.rotors)} rotors here, {len(board.mounts)} on the board"
        return (Finding("airframe.count", "error", text, board.source),)
    found = []
    arm = airframe_arm(airframe)
    for rotor, mount in zip(airframe.rotors, board.mounts, strict=True):
        wrong = []
        for name, here, there in (
            ("front or rear", rotor.position_m[0], mount.x),
            ("left or right", rotor.position_m[1], mount.y),
        ):
            if here * there < 0 and abs(here) > _SIDE * arm and abs(there) > _SIDE * board.arm:
                wrong.append(name)
        if mount.spin != ("ccw" if rotor.yaw_sign > 0 else "cw"):
            wrong.append(f"spin ({mount.spin} on the board)")
        if mount.level and rotor.level != "single" and mount.level != rotor.level:
            wrong.append(f"level ({mount.level} on the board)")
        if wrong:
            text = f"rotor {rotor.number} is another on the board: {', '.join(wrong)}"
            found.append(Finding("airframe.order", "error", text, board.source))
    if not found and board.metres:
        found = list(_elsewhere(airframe, board))
    return tuple(found)


def _elsewhere(airframe: Airframe, board: Layout) -> Iterator[Finding]:
    apart = {
        r.number: math.hypot(r.position_m[0] - p.x, r.position_m[1] - p.y)
        for r, p in zip(airframe.rotors, board.mounts, strict=True)
    }
    number = max(apart, key=lambda n: apart[n])
    if apart[number] > _APART * airframe_arm(airframe):
        scale, left = _scaled(airframe, board)
        evidence = f"{board.source}: the longest arm {board.arm:.3f} m, here {airframe_arm(airframe):.3f} m"
        if left > _APART * board.arm or not 1 / _SCALE <= scale <= _SCALE:
            text = f"the board has the rotors elsewhere, rotor {number} by {apart[number]:.3f} m"
            yield Finding("airframe.place", "error", text, evidence)
        else:
            text = f"the board's arms are {scale:.2f} times as long, in the same directions"
            yield Finding("airframe.place", "warning", text, evidence)


def _scaled(airframe: Airframe, board: Layout) -> tuple[float, float]:
    """What the lengths here are best multiplied by to be the board's, and how far a rotor is off then, m."""
    here = [(r.position_m[0], r.position_m[1]) for r in airframe.rotors]
    there = [(p.x, p.y) for p in board.mounts]
    product = sum(a * c + b * d for (a, b), (c, d) in zip(here, there, strict=True))
    scale = product / sum(a * a + b * b for a, b in here)
    left = max(math.hypot(scale * a - c, scale * b - d) for (a, b), (c, d) in zip(here, there, strict=True))
    return scale, left


def airframe_arm(airframe: Airframe) -> float:
    """The longest distance of a rotor from the centre of mass, seen from above, m."""
    return max(math.hypot(r.position_m[0], r.position_m[1]) for r in airframe.rotors)


def _authority(airframe: Airframe) -> Iterator[Finding]:
    if lost := ", ".join(airframe.lost_axes()):
        text = f"these rotors cannot make {lost}, whatever their thrusts"
        yield Finding(
            "airframe.authority", "error", text, "positions in metres, and both spins, are expected"
        )


def _lengths(airframe: Airframe) -> Iterator[Finding]:
    arm = airframe_arm(airframe)
    if not _SHORTEST_M <= arm <= WIDEST_M:
        text = f"an arm of {arm:g} m: {'millimetres' if arm > WIDEST_M else 'another unit'}?"
        yield Finding("airframe.units", "error", text, "metres are expected")


def _pairs(airframe: Airframe) -> Iterator[Finding]:
    arm = airframe_arm(airframe)
    for u, w in airframe.pairs:
        upper, lower = airframe.rotors[u], airframe.rotors[w]
        names = f"rotors {upper.number} and {lower.number}"
        apart = math.hypot(*(upper.position_m[k] - lower.position_m[k] for k in range(2)))
        if apart > _APART * arm:
            text = f"{names} are a pair but do not stand one above the other"
            yield Finding("airframe.pair-apart", "error", text, f"{apart:.3f} m apart, seen from above")
        if upper.position_m[2] >= lower.position_m[2]:
            text = f"rotor {upper.number} is called upper but is not above rotor {lower.number}"
            yield Finding("airframe.pair-height", "error", text, "z is down: the upper one has the smaller z")
    alike = [f"{u + 1}/{w + 1}" for u, w in airframe.co_rotating]
    if alike:
        text = f"rotors of pair {', '.join(alike)} turn the same way"
        yield Finding("airframe.co-rotating", "warning", text, "a rotor model of such a pair is expected")


def _balance(airframe: Airframe) -> Iterator[Finding]:
    count, arm = len(airframe.rotors), airframe_arm(airframe)
    turns = sum(r.yaw_sign for r in airframe.rotors)
    if turns:
        text = f"{(count + turns) // 2} rotors turn ccw and {(count - turns) // 2} cw"
        yield Finding("airframe.spin-balance", "warning", text, "hover needs a steady yaw correction")
    middle = math.hypot(*(sum(r.position_m[k] for r in airframe.rotors) / count for k in range(2)))
    if middle > _BALANCE * arm:
        text = f"the rotors' middle is {middle:.3f} m from the centre of mass"
        yield Finding("airframe.centre", "warning", text, "positions count from the centre of mass")


def _inertia(airframe: Airframe) -> Iterator[Finding]:
    arm = airframe_arm(airframe)
    xx, yy, zz = airframe.inertia_kg_m2
    if xx + yy < zz or yy + zz < xx or xx + zz < yy:
        text = "inertia_kg_m2: no body has one moment larger than the sum of the others"
        yield Finding("airframe.inertia", "error", text, f"{xx:g}, {yy:g}, {zz:g}")
        return
    for axis, moment in zip("xyz", (xx, yy, zz), strict=True):
        radius = math.sqrt(moment / airframe.mass_kg) / max(arm, _SHORTEST_M)
        if not _GYRATION[0] <= radius <= _GYRATION[1]:
            text = f"inertia about {axis} of {moment:g} kg m^2 does not fit {airframe.mass_kg:g} kg"
            yield Finding("airframe.inertia", "warning", text, f"radius of gyration {radius:.2f} arms")


def _mass(airframe: Airframe) -> Iterator[Finding]:
    arm = airframe_arm(airframe)
    if not _SHORTEST_M <= arm <= WIDEST_M:
        return  # the length is wrong, and reported to be
    arms = len(airframe.pairs) + len(airframe.singles)
    area = arms * math.pi * (_LARGEST_DISC * arm) ** 2
    loading = airframe.mass_kg * GRAVITY_M_S2 / area
    if not _DISC_LOADING_N_M2[0] <= loading <= _DISC_LOADING_N_M2[1]:
        text = f"{airframe.mass_kg:g} kg on arms of {arm:.3g} m: is mass_kg in kilograms?"
        yield Finding("airframe.mass", "error", text, f"{loading:.3g} N/m^2 on the largest discs that fit")


def _thrust(airframe: Airframe, model: RotorModel) -> Iterator[Finding]:
    thrust, torque = airframe.loads(model, airframe.turned(model, np.ones(len(airframe.rotors))))
    ratio = float(airframe.wrench(thrust, torque)[0]) / (airframe.mass_kg * GRAVITY_M_S2)
    if not _LEAST_THRUST <= ratio <= _MOST_THRUST:
        least = f"{ratio:.2f} times the weight: mass_kg or the rotor model is wrong"
        most = f"{ratio:.0f} times the weight: is mass_kg in kilograms?"
        text = f"full thrust is {least if ratio < _LEAST_THRUST else most}"
        yield Finding("airframe.mass", "error", text, f"{airframe.mass_kg:g} kg")
