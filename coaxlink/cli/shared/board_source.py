"""A rotor layout from where the user points: a board on the line, or a file with its parameters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.line import vehicle_at
from coaxlink.cli.shared.shell import say
from coaxlink.errors import InputError

if TYPE_CHECKING:
    from coaxlink.setup import Layout


TimeoutOption = Annotated[float, typer.Option(metavar="S", help="How long an autopilot is waited for.")]


def layout_of_file(path: Path, script: Path | None = None, system: int | None = None) -> Layout:
    """From parameters in any form, ULog, DataFlash, tlog; `script` is the matrix of FRAME_CLASS 15 or 17.

    Of several vehicles that of `system`.
    Raises InputError.
    """
    from coaxlink.data.logs.board_parameters import read_board_parameters
    from coaxlink.setup import ardupilot_layout, px4_layout

    found = read_board_parameters(path, telling=True, system=system)
    try:
        if found.firmware == "px4":
            layout = px4_layout(found.params, path.name)
        else:
            layout = ardupilot_layout(found.params, path.name, lambda: _script_beside(path, script))
    except InputError as error:
        raise InputError(error.source, error.where, "; ".join([error.problem, *found.notes])) from error
    return replace(layout, notes=(*found.notes, *layout.notes))


WAIT_S = 30.0  # a simulator that was just started compiles first, 8 s on a free core


def layout_of_board(url: str, timeout_s: float = WAIT_S, system: int | None = None) -> Layout:
    """From the autopilot at `url`; nothing is written. Raises LinkError, InputError."""
    from coaxlink.mavlink.ftp import Files
    from coaxlink.mavlink.parameters import Parameters
    from coaxlink.setup import ardupilot_layout, px4_layout
    from coaxlink.uploading.ardupilot_scripts import matrix_script

    say(f"waiting for an autopilot at {url}, at most {timeout_s:g} s")
    with vehicle_at(url, timeout_s=timeout_s, system=system) as session:
        source = f"{session.identity.name} at {url}"
        params = {n: v.value for n, v in Parameters(session).read_all().values.items()}
        if session.identity.is_px4:
            return px4_layout(params, source)
        if not session.identity.is_ardupilot:
            raise InputError(url, "", f"PX4 or ArduPilot is expected, found {session.identity.name}")
        return ardupilot_layout(params, source, lambda: matrix_script(Files(session)))


def _script_beside(path: Path, script: Path | None) -> bytes | None:
    """The table's script: named, or where `coaxlink table` puts it."""
    from coaxlink import files
    from firmware_params.ardupilot import scripts

    script_path = script or path.parent / "scripts" / scripts.MATRIX_NAME
    if script is None and not script_path.is_file():
        return None
    return files.read_bytes(script_path)
