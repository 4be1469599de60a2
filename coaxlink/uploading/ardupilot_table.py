"""The mixer table that an ArduPilot board flies now, whoever put it there."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from coaxlink.mavlink.parameters import Number
from firmware_params import ardupilot
from firmware_params.ardupilot import scripts
from firmware_params.ardupilot.owners_script import own_matrix
from firmware_params.ardupilot.table import DYNAMIC_MATRIX, SCRIPTING_MATRIX, ApTable, Factors
from firmware_params.errors import TableError

_PLAIN = 0.05  # of a normalised factor; below it a motor stands on the axis
_WORDS = ("left or right", "front or rear", "spin")

ReadScript = Callable[[], bytes | None]


def present_table(params: Mapping[str, Number], script: ReadScript) -> ApTable | None:
    """The table behind FRAME_CLASS; `script` reads our class 15 script. None where it is not known here."""
    frame, kind = int(params.get("FRAME_CLASS", 0)), int(params.get("FRAME_TYPE", 0))
    factors: tuple[Factors, ...] = ()
    try:
        if frame == SCRIPTING_MATRIX:
            factors = script_table(script())
        elif frame == DYNAMIC_MATRIX:
            factors = scripts.params_factors(params)
        table = ApTable(frame, factors, ardupilot.MotorParameters.from_params(params), kind)
        ardupilot.used_factors(table)
    except TableError:
        return None
    return table


def script_table(data: bytes | None) -> tuple[Factors, ...]:
    """Factors in a class 15 script, ours or another's. Raises TableError for none."""
    if data is None:
        raise TableError("no script")
    text = data.decode("utf-8", "replace")
    try:
        return scripts.script_factors(text)
    except TableError:
        return own_matrix(text).factors


def planned_table(params: Mapping[str, Number], files: Mapping[str, bytes]) -> ApTable | None:
    """The table that files are to bring, None where they bring scripts of another kind."""
    return present_table(params, lambda: files.get(scripts.MATRIX_NAME))


def moved_rotors(old: ApTable, new: ApTable) -> list[str]:
    """Rotors that would change their quadrant or their spin, in words."""
    before, after = _signs(old), _signs(new)
    if len(before) != len(after):
        return [f"{len(before)} rotors now, {len(after)} in the table"]
    moved = []
    for n, (was, is_) in enumerate(zip(before, after, strict=True), start=1):
        changed = [word for word, a, b in zip(_WORDS, was, is_, strict=True) if a * b < 0]
        if changed:
            moved.append(f"rotor {n} changes {' and '.join(changed)}")
    return moved


def _signs(table: ApTable) -> NDArray[np.float64]:
    """(N, 3) of roll, pitch and yaw: -1, 0 or 1."""
    factors = ardupilot.used_factors(table)[:, :3]
    top = np.abs(factors).max(axis=0)
    scaled = np.divide(factors, top, out=np.zeros_like(factors), where=top > 0)
    return np.where(np.abs(scaled) < _PLAIN, 0.0, np.sign(scaled))
