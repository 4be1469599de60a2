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
    on_board: Annotated[
        bool, typer.Option("--on-board", help="The exact law itself as Lua; no companion in flight.")
    ] = False,
    frame_class: Annotated[
        int | None,
        typer.Option(
            help="With --on-board: FRAME_CLASS it flies on; 4 (8 rotors), 5 (6), 15 or 17 (fitted)."
        ),
    ] = None,
    rotor: Annotated[
        Path | None, typer.Option(help="With --on-board: rotor model, if not the airframe's own.")
    ] = None,
) -> None:
    """Write the ArduPilot bridge: DIR/scripts/coaxlink_bridge.lua and the parameters that start it.

    With --on-board the exact law itself takes the bridge's place: there is one script or the other.
    """
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.errors import InputError
    from coaxlink.live.scripts.bridge import SCRIPT_NAME, bridge_script
    from coaxlink.tables.files import file_name
    from firmware_params import ardupilot
    from firmware_params.ardupilot import scripts as ardupilot_scripts

    frame = load_airframe(airframe)
    script = out / "scripts" / SCRIPT_NAME
    params = {"SCR_ENABLE": 1.0}
    if on_board:
        from coaxlink.cli.shared.effects import say_effects, vehicle_of
        from coaxlink.live.scripts.onboard import INSTRUCTIONS, onboard_script

        vehicle, _ = vehicle_of(airframe, rotor)
        say_effects(vehicle)
        number = frame_class if frame_class is not None else 5 if len(frame.rotors) == 6 else 4
        text = onboard_script(vehicle, frame_class=number, hold_ms=hold_ms)
        params["SCR_VM_I_COUNT"] = float(INSTRUCTIONS)
    else:
        text = bridge_script(len(frame.rotors), hold_ms=hold_ms)
    # the folder's checksum is made of all its scripts: the upload adds those that are there
    params["SCR_LD_CHECKSUM"] = float(ardupilot_scripts.load_checksum([text.encode()]))
    files.write_atomic(script, text)
    path = out / f"{file_name(frame.name)}.param"
    try:
        ardupilot.write_param_file(path, params, [f"coaxlink bridge of {frame.name}"])
    except OSError as error:
        raise InputError(path, "", f"cannot be written ({error.strerror})") from error
    then = "fly" if on_board else "coaxlink mix"
    say(f"{path}\n{script}\nnext: coaxlink upload {out} --connect URL, a reboot, {then}")


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("bridge", short_help="Write the script that lets an ArduPilot follow `mix`.")(bridge)
