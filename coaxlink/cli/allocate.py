"""`coaxlink allocate`: one wrench through one law."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli._shell import JsonOption, console
from coaxlink.errors import InputError


def allocate(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    law: Annotated[str, typer.Option(help="standard, reduced, coaxial, exact, ...")] = "coaxial",
    wrench: Annotated[str, typer.Option(metavar="F,TX,TY,TZ", help="Thrust (up) in N, then N m, FRD.")] = "",
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    law_rotor: Annotated[
        Path | None, typer.Option(help="What the law believes, if not the rotors it is weighed on.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """One allocation: speeds, thrusts, torques, and what the rotors miss of the wrench."""
    from coaxlink import files, mixer
    from coaxlink.airframe import AXES, load_airframe
    from coaxlink.rotor.model import load_rotor_model

    demand = parse_wrench(wrench)
    frame = load_airframe(airframe)
    model = load_rotor_model(rotor_path(frame.rotor_model, rotor, airframe))
    believed = load_rotor_model(law_rotor) if law_rotor else model
    result = mixer.allocate(mixer.make_law(law, frame, believed), frame, model, demand)
    if json_file:
        files.write_json(json_file, result.to_json())

    from rich.table import Table

    out = console()
    table = Table("rotor", "speed", "thrust N", "torque N m", "", box=None)
    for i, placed in enumerate(frame.rotors):
        at = "at its bound" if result.saturated[i] else ""
        row = f"{result.speeds[i]:.4f}", f"{result.thrust_N[i]:.3f}", f"{result.torque_Nm[i]:.4f}"
        table.add_row(f"{placed.number} {placed.level}", *row, at)
    out.print(table)
    table = Table("axis", "asked", "delivered", "error", box=None)
    for k, axis in enumerate(AXES):
        gave_up = " (given up)" if axis in result.dropped else ""
        row = f"{result.wrench[k]:.4f}", f"{result.delivered[k]:.4f}", f"{result.error[k]:.3g}{gave_up}"
        table.add_row(f"{axis} {'N' if k == 0 else 'N m'}", *row)
    out.print(table)
    out.print(f"{result.law}: power {result.power:.4f} (sum of torque x speed), {result.power_W:.0f} W")


def parse_wrench(text: str) -> list[float]:
    """`F,TX,TY,TZ` as four numbers. Raises InputError."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not all(abs(n) < float("inf") for n in numbers):
        raise InputError("--wrench", text or "(not given)", "four finite numbers F,TX,TY,TZ expected")
    return numbers


def rotor_path(own: Path | None, option: Path | None, airframe: Path) -> Path:
    """The rotor model to use: the option, or the airframe's own. Raises InputError when there is neither."""
    path = option or own
    if path is None:
        raise InputError(airframe, "rotor_model", "names no rotor model; give one with --rotor")
    return path


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("allocate")(allocate)
