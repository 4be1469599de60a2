"""Layouts from ArduPilot's parameters: a frame of its own, two ESCs a motor, a script's matrix."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.errors import InputError
from coaxlink.setup.layout import Layout, Mount
from coaxlink.setup.sources import frame_layout
from firmware_params.ardupilot import scripts
from firmware_params.ardupilot.frames import FRAME_NAMES, OTHER_CLASSES, frame_of
from firmware_params.ardupilot.owners_script import own_matrix
from firmware_params.ardupilot.parameters import MOTOR_FUNCTIONS, SURFACES, other_vehicle
from firmware_params.ardupilot.table import DYNAMIC_MATRIX, SCRIPTING_MATRIX, Factors
from firmware_params.errors import TableError

_OUTPUTS = 32  # SERVO1 to SERVO32
_CIRCLE = 0.15  # of a radius: places that differ by less are of arms of one length
_STRETCH = (0.25, 4.0)  # of one axis' scale squared against the other's, that arms of one length may mean
Params = Mapping[str, float | int]


def ardupilot_layout(
    params: Params, source: str, script: Callable[[], bytes | None] = lambda: None
) -> Layout:
    """FRAME_CLASS and FRAME_TYPE (Q_FRAME_* of a quadplane), or the matrix of a script: no lengths.

    `script` reads the script. Raises InputError where the frame is not one that rotors alone steer.
    """
    if other := other_vehicle(params):
        raise InputError(source, "", f"parameters of {other}: a multirotor (ArduCopter) is expected")
    plane = "FRAME_CLASS" not in params and "Q_FRAME_CLASS" in params
    prefix = "Q_" if plane else ""
    if f"{prefix}FRAME_CLASS" not in params:
        raise InputError(source, "FRAME_CLASS", "missing: ArduCopter 3.5 or later is expected")
    if plane and not params.get("Q_ENABLE", 1):
        raise InputError(source, "Q_ENABLE 0", "a plane without lift motors: a quadplane (1) is expected")
    numbers = params[f"{prefix}FRAME_CLASS"], params.get(f"{prefix}FRAME_TYPE", 1)
    if not all(math.isfinite(n) for n in numbers):
        raise InputError(
            source, f"{prefix}FRAME_CLASS, _TYPE", f"whole numbers are expected, found {numbers}"
        )
    frame, kind = map(int, numbers)
    where = f"{prefix}FRAME_CLASS {frame}"
    outputs = _outputs(params)
    notes: list[str] = []
    if f"{prefix}FRAME_TYPE" not in params and frame not in (SCRIPTING_MATRIX, DYNAMIC_MATRIX):
        notes.append(f"{prefix}FRAME_TYPE stands nowhere: X (1), ArduCopter's default, is taken")
    given = {n: f for n in range(1, _OUTPUTS + 1) if (f := params.get(f"SERVO{n}_FUNCTION")) is not None}
    surfaces = [f"SERVO{n}_FUNCTION {f:g} ({SURFACES[int(f)]})" for n, f in given.items() if f in SURFACES]
    if surfaces and not outputs:
        problem = f"no output drives a motor ({', '.join(surfaces[:4])}): a multirotor is expected"
        raise InputError(source, where, problem)
    if surfaces:
        notes.append(f"outputs that drive no rotor: {', '.join(surfaces)}")
    doubled = None
    if frame in (SCRIPTING_MATRIX, DYNAMIC_MATRIX):
        layout = _scripted(params, source, where, frame, script)
    else:
        layout = _own_frame(source, where, prefix, frame, kind)
        doubled = _doubled(layout, outputs)
        if doubled:
            layout, outputs = doubled
            notes.append(
                "each motor function drives two outputs: pairs that turn alike, by one command; the motor of "
                "the lower output is taken for the upper rotor where `upper` does not say"
            )
    mounts = tuple(
        replace(mount, output=" and ".join(outputs.get(n, ())))
        for n, mount in enumerate(layout.mounts, start=1)
    )
    if plane:
        notes.append("a quadplane: these are its lift motors; coaxlink's tables are ArduCopter's (MOT_*)")
    open_pairs = any(p.level is None and len(s) > 1 for s in layout.stacks() for p in _of(layout, s))
    if open_pairs and not (plane or doubled):
        notes.append(
            "which rotor of a pair is the upper one stands nowhere on this board: where `upper` does not "
            "say, the one that the motor test turns first"
        )
    idle = tuple(n for n, mount in enumerate(mounts, 1) if not mount.output)
    if idle and len(given) < len(mounts):  # a file of a few parameters does not say
        idle = ()
        notes.insert(0, "not all SERVOn_FUNCTION are there: whether every motor has an output is not known")
    return replace(layout, mounts=mounts, notes=(*layout.notes, *notes), idle=idle)


def _of(layout: Layout, stack: tuple[int, ...]) -> list[Mount]:
    return [layout.mounts[n] for n in stack]


def _own_frame(source: str, where: str, prefix: str, frame: int, kind: int) -> Layout:
    """One of ArduPilot's own frames. Raises InputError for what is none, or not known here."""
    if frame in OTHER_CLASSES:
        also = "; its pair can be identified on a stand (`identify`)" if frame == 9 else ""
        problem = f"{OTHER_CLASSES[frame]}: no mixer table of rotors alone holds it{also}"
        raise InputError(source, where, problem)
    motors = frame_of(frame, kind)
    full = f"{where}, {prefix}FRAME_TYPE {kind}"
    if motors is None:
        name = FRAME_NAMES.get(frame)
        what = (
            f"{name}s of this type are" if name else "no frame is chosen: this is" if not frame else "this is"
        )
        raise InputError(source, full, f"{what} not known to coaxlink; start from a template")
    return frame_layout(motors, f"{source}: {full}")


def _doubled(layout: Layout, outputs: Mapping[int, list[str]]) -> tuple[Layout, dict[int, list[str]]] | None:
    """A frame without pairs whose every motor function is on two outputs: the pairs, and their outputs."""
    count = len(layout.mounts)
    if any(len(stack) > 1 for stack in layout.stacks()):
        return None
    if any(len(outputs.get(n, ())) != 2 for n in range(1, count + 1)):
        return None
    lower = tuple(replace(mount, order=count + mount.order) for mount in layout.mounts)
    both = {n + k * count: [outputs[n][k]] for n in range(1, count + 1) for k in range(2)}
    return replace(layout, mounts=(*layout.mounts, *lower)), both


def _scripted(
    params: Params, source: str, where: str, frame: int, script: Callable[[], bytes | None]
) -> Layout:
    """From our own parameters, or by running the script that sets the matrix, whoever wrote it."""
    try:
        if frame == DYNAMIC_MATRIX and f"{scripts.PREFIX}N" in params:
            factors: tuple[Factors, ...] = scripts.params_factors(params)
            order = tuple(range(1, len(factors) + 1))
            whose = "the table of its script"
        else:
            data = script()
            if data is None:
                where_it_is = f"the layout stands in a script on the card ({scripts.MATRIX_NAME} or another)"
                raise TableError(f"{where_it_is}, which is not here: name it")
            numbers = {name: float(value) for name, value in params.items()}
            found = own_matrix(data.decode("utf-8", "replace"), numbers)
            if found.frame_class != frame:
                raise TableError(f"the script is for FRAME_CLASS {found.frame_class}")
            factors, order, whose = found.factors, found.order, "the matrix of its script"
    except TableError as error:
        raise InputError(source, where, str(error)) from error
    mounts = []
    for n, (place, row) in enumerate(zip(_places(factors), factors, strict=True)):
        if row[2] == 0.0:
            raise InputError(source, f"rotor {n + 1}", "no yaw factor: which way it turns is not known")
        spin = "ccw" if row[2] > 0 else "cw"
        mounts.append(Mount(float(place[0]), float(place[1]), None, spin, order=order[n]))
    note = (
        "arm angles from the script's factors, whose axes may be scaled apart: hold them against the vehicle"
    )
    return Layout(f"{source}: {where}, {whose}", tuple(mounts), False, (note,))


def _places(factors: tuple[Factors, ...]) -> NDArray[np.float64]:
    """(N, 2) forward and right of motors by their factors (N, 4), the longest arm 1.

    A rotor that is to do less has all of its factors smaller: over its throttle factor they are its place.
    Each axis may be scaled by itself (class 15 does): where arms of one length explain the numbers, they do.
    """
    rows = np.array(factors, float)
    throttle = np.where(rows[:, 3] > 0.0, rows[:, 3], 1.0)
    places = np.stack([rows[:, 1], -rows[:, 0]], axis=1) / throttle[:, None]
    if not _one_circle(places):
        places = places / np.maximum(np.abs(places).max(axis=0), 1e-9)
        x, y = (places**2).T
        spread = float(np.var(y))
        stretch = -float(np.mean((x - x.mean()) * (y - y.mean()))) / spread if spread > 1e-6 else 1.0
        round_ = places * [1.0, math.sqrt(min(max(stretch, _STRETCH[0]), _STRETCH[1]))]
        if _one_circle(round_):
            places = round_
    radii = np.hypot(*places.T)
    return places / (radii[:, None] if _one_circle(places) else radii.max() or 1.0)


def _one_circle(places: NDArray[np.float64]) -> bool:
    radii = np.hypot(*places.T)
    return bool(radii.min() > (1.0 - _CIRCLE) * radii.max() > 0.0)


def _outputs(params: Params) -> dict[int, list[str]]:
    """Motor number -> connectors."""
    found: dict[int, list[str]] = {}
    for output in range(1, _OUTPUTS + 1):
        motor = MOTOR_FUNCTIONS.get(params.get(f"SERVO{output}_FUNCTION", 0))  # type: ignore[arg-type]
        if motor:
            found.setdefault(motor, []).append(f"SERVO {output}")
    return found
