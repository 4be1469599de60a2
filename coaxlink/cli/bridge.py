"""`coaxlink bridge`: what runs on the autopilot so that it flies the exact law, or follows `mix`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli.shared.completion import one_of
from coaxlink.cli.shared.effects import say_effects, vehicle_of
from coaxlink.cli.shared.line import vehicle_at
from coaxlink.cli.shared.shell import say
from coaxlink.cli.upload import NewGeometryOption, SystemOption
from firmware_params import FIRMWARES


def bridge(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the files go.")] = Path("bridge"),
    firmware: Annotated[
        str, typer.Option(help="px4 or ardupilot.", autocompletion=one_of(*FIRMWARES))
    ] = "ardupilot",
    rotor: Annotated[Path | None, typer.Option(help="PX4: rotor model, if not the airframe's own.")] = None,
    connect: Annotated[
        str, typer.Option(metavar="URL", help="PX4: also put etc/extras.txt on the board's SD card.")
    ] = "",
    back: Annotated[
        bool, typer.Option("--back", help="With --connect: take extras.txt off the card again.")
    ] = False,
    new_geometry: NewGeometryOption = False,
    system: SystemOption = None,
    hold_ms: Annotated[
        int, typer.Option(min=20, max=500, help="ArduPilot: on so much silence the matrix flies again.")
    ] = 100,
) -> None:
    """Write what runs on board: PX4's module with the exact law, or ArduPilot's script that follows `mix`."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.errors import InputError
    from coaxlink.live.geometry import refuse_other_vehicle
    from coaxlink.live.onboard import ardupilot, card, description, px4

    if firmware not in ("px4", "ardupilot"):
        raise InputError("--firmware", firmware, "expected px4 or ardupilot")
    if firmware != "px4" and (connect or back):
        raise InputError("--connect", "", "--firmware px4 is expected; for ArduPilot: coaxlink upload DIR")
    if back:
        _take_off_the_card(connect, system)
        return
    if firmware == "px4":
        vehicle, rotors = vehicle_of(airframe, rotor)
        say_effects(vehicle)
        made_from = ", ".join(f"{path.name} sha256 {files.sha256(path)[:16]}" for path in (airframe, rotors))
        contents = px4.module_files(description.board_law(vehicle), made_from)
        following = f"{out / 'README.md'} says how it is built into a firmware (docs/howto/px4_module.md)"
    else:
        about = description.board_vehicle(load_airframe(airframe))
        contents = ardupilot.script_files(about, hold_ms=hold_ms)
        following = f"coaxlink upload {out} --connect URL, a reboot, coaxlink mix"
    files.write_together({out / name: text for name, text in contents.items()})
    if connect:
        with vehicle_at(connect, system=system, station=True) as session:
            for line in refuse_other_vehicle(session, load_airframe(airframe), new_geometry=new_geometry):
                say(line)
            card.put_extras(session, contents["etc/extras.txt"])
        say(f"{card.PATH} is on the card: the module starts with the next boot")
        following = "restart the board, propellers off; coax_mixer status in its console says this vehicle"
    say("\n".join([*(str(out / name) for name in contents), f"next: {following}"]))


def _take_off_the_card(url: str, system: int | None) -> None:
    from coaxlink.errors import InputError
    from coaxlink.live.onboard import card

    if not url:
        raise InputError("--back", "", "--connect URL is expected")
    with vehicle_at(url, system=system, station=True) as session:
        was = card.remove_extras(session)
    gone = f"{card.PATH} is off the card" if was else f"there was no {card.PATH}"
    say(f"{gone}: PX4's own control allocator flies from the next boot on")
