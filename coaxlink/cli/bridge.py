"""`coaxlink bridge`: the script that lets a companion mix live on ArduPilot, ready to upload."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli.shared.shell import say


def bridge(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the files go.")] = Path("bridge"),
    hold_ms: Annotated[
        int, typer.Option(min=20, max=500, help="On so much silence the matrix flies again.")
    ] = 100,
) -> None:
    """Write the ArduPilot bridge: DIR/scripts/coaxlink_bridge.lua and the parameters that start it."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.errors import InputError
    from coaxlink.live.bridge import SCRIPT_NAME, bridge_script
    from coaxlink.tables.files import file_name
    from firmware_params import ardupilot
    from firmware_params.ardupilot import scripts as ardupilot_scripts

    frame = load_airframe(airframe)
    script = out / "scripts" / SCRIPT_NAME
    params = {"SCR_ENABLE": 1.0}
    text = bridge_script(len(frame.rotors), hold_ms=hold_ms)
    # the folder's checksum is made of all its scripts: the upload adds those that are there
    params["SCR_LD_CHECKSUM"] = float(ardupilot_scripts.load_checksum([text.encode()]))
    files.write_atomic(script, text)
    path = out / f"{file_name(frame.name)}.param"
    try:
        ardupilot.write_param_file(path, params, [f"coaxlink bridge of {frame.name}"])
    except OSError as error:
        raise InputError(path, "", f"cannot be written ({error.strerror})") from error
    say(f"{path}\n{script}\nnext: coaxlink upload {out} --connect URL, a reboot, coaxlink mix")


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("bridge", short_help="Write the script that lets an ArduPilot follow `mix`.")(bridge)
