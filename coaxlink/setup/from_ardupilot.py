"""ArduPilot's FRAME_CLASS, FRAME_TYPE and script table as a layout: directions and spin, no lengths."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from coaxlink.errors import InputError
from coaxlink.setup.layout import Layout, Mount
from coaxlink.setup.templates import frame_layout
from firmware_params.ardupilot import scripts, servo_function
from firmware_params.ardupilot.frames import FRAMES
from firmware_params.ardupilot.table import DYNAMIC_MATRIX, SCRIPTING_MATRIX, Factors
from firmware_params.errors import TableError

_OUTPUTS = 32


def ardupilot_layout(
    params: Mapping[str, float | int], source: str, script: Callable[[], bytes | None] = lambda: None
) -> Layout:
    """Raises InputError where the frame is not a coaxial one known here."""
    if "FRAME_CLASS" not in params:
        raise InputError(source, "FRAME_CLASS", "missing: ArduCopter 3.5 or later is expected")
    frame, kind = int(params["FRAME_CLASS"]), int(params.get("FRAME_TYPE", 1))
    if frame in (SCRIPTING_MATRIX, DYNAMIC_MATRIX):
        layout = _scripted(params, source, frame, script)
    elif (frame, kind) in FRAMES:
        layout = frame_layout(FRAMES[frame, kind], f"{source}: FRAME_CLASS {frame}, FRAME_TYPE {kind}")
    else:
        raise InputError(
            source,
            f"FRAME_CLASS {frame}, FRAME_TYPE {kind}",
            "no coaxial frame known here; start from a template",
        )
    outputs = _outputs(params)
    mounts = tuple(
        Mount(p.x, p.y, p.z, p.spin, p.level, " and ".join(outputs.get(n, ())))
        for n, p in enumerate(layout.mounts, start=1)
    )
    notes = list(layout.notes)
    if any(p.level is None for p in mounts):
        notes.append("which rotor of a pair is the upper one stands nowhere on this board")
    return Layout(layout.source, mounts, metres=False, notes=tuple(notes))


def _scripted(
    params: Mapping[str, float | int], source: str, frame: int, script: Callable[[], bytes | None]
) -> Layout:
    """From our own scripts' factors. Each axis may be scaled apart from the others (class 15), so an arm's
    angle is only as good as the vehicle's symmetry."""
    try:
        if frame == DYNAMIC_MATRIX:
            factors: tuple[Factors, ...] = scripts.params_factors(params)
        else:
            data = script()
            if data is None:
                raise TableError(f"the layout stands in {scripts.MATRIX_NAME}, which is not here")
            factors = scripts.script_factors(data.decode("utf-8", "replace"))
    except TableError as error:
        raise InputError(source, f"FRAME_CLASS {frame}", f"{error}; start from a template") from error
    top = [max(abs(f[axis]) for f in factors) or 1.0 for axis in range(2)]
    mounts = []
    for n, (roll, pitch, yaw, _) in enumerate(factors, start=1):
        if yaw == 0.0:
            raise InputError(source, f"rotor {n}", "no yaw factor: which way it turns is not known")
        x, y = pitch / top[1], -roll / top[0]
        length = math.hypot(x, y) or 1.0
        mounts.append(Mount(x / length, y / length, None, "ccw" if yaw > 0 else "cw"))
    note = "arm angles from the script's factors, whose axes are scaled apart: hold them against the vehicle"
    return Layout(f"{source}: FRAME_CLASS {frame}, the table of its script", tuple(mounts), False, (note,))


def _outputs(params: Mapping[str, float | int]) -> dict[int, list[str]]:
    """Motor number -> connectors."""
    found: dict[int, list[str]] = {}
    motors = {servo_function(n): n for n in range(1, 13)}
    for output in range(1, _OUTPUTS + 1):
        motor = motors.get(int(params.get(f"SERVO{output}_FUNCTION", 0)))
        if motor:
            found.setdefault(motor, []).append(f"SERVO {output}")
    return found
