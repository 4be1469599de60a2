"""`coaxlink init`: a vehicle file from a board, its parameters, a log, or a template; drawn and checked."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.board_source import WAIT_S, TimeoutOption
from coaxlink.cli.shared.shell import JsonOption, say
from coaxlink.cli.upload import SystemOption
from coaxlink.errors import CheckFailed, InputError
from firmware_params.plain import name_problem

if TYPE_CHECKING:
    from coaxlink.setup import Layout

PictureOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Draw it from above, as .png, .svg or .pdf.")
]


_OPTIONS = {
    "mass_kg": "--mass KG",
    "arm_m": "--arm METRES",
    "spacing_m": "--spacing METRES",
    "upper": "--upper NUMBERS",
}


def init(
    out: Annotated[Path, typer.Argument(metavar="AIRFRAME.toml", help="The file to make.")],
    mass: Annotated[float | None, typer.Option(metavar="KG", help="All-up mass, weighed.")] = None,
    template: Annotated[str, typer.Option(metavar="NAME", help="x8, coax-quad (+), y6 or hexa-coax.")] = "",
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="The board's .params, .param, ULog or DataFlash log."),
    ] = None,
    script: Annotated[
        Path | None, typer.Option(metavar="LUA", help="With --from: the matrix script of FRAME_CLASS 15.")
    ] = None,
    connect: Annotated[str, typer.Option(metavar="URL", help="Read it from this board.")] = "",
    system: SystemOption = None,
    timeout: TimeoutOption = WAIT_S,
    arm: Annotated[
        float | None, typer.Option(metavar="M", help="Centre to rotor, where the source holds no lengths.")
    ] = None,
    spacing: Annotated[
        float | None,
        typer.Option(metavar="M", help="Between the rotors of a pair, if it holds no heights."),
    ] = None,
    upper: Annotated[
        str, typer.Option(metavar="1,2,..", help="The upper rotors, where the source does not say.")
    ] = "",
    inertia: Annotated[
        str, typer.Option(metavar="X,Y,Z", help="Moments of inertia, kg m^2; estimated if not given.")
    ] = "",
    lag: Annotated[
        float | None, typer.Option(metavar="S", min=0.0, help="The motors' lag; 0 and unknown if not given.")
    ] = None,
    name: Annotated[str, typer.Option(help="The vehicle's name; the file's if not given.")] = "",
    rotor: Annotated[Path | None, typer.Option(metavar="ROTOR.toml", help="Its rotor model.")] = None,
    picture: PictureOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
    json_file: JsonOption = None,
) -> None:
    """Make a vehicle file; show who is where, which way it turns, and what looks wrong (exit code 1)."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.cli.airframe import report
    from coaxlink.premises import guesses
    from coaxlink.setup import Body, MissingError, airframe_toml, completed
    from coaxlink.vehicle import load_rotors

    if out.exists() and not force:
        raise InputError(out, "", "is there already; --force replaces it")
    for output in (out, picture, json_file):
        files.refuse_unwritable(output)
    model = load_rotors(rotor) if rotor else None
    layout = _layout(template, source, script, system, connect, timeout, mass)
    if problem := name_problem(name or out.stem):
        raise InputError("--name", "", problem)
    body = Body(name or out.stem, mass, arm, spacing, _numbers(upper), _inertia(inertia), lag)
    try:
        frame = completed(layout, body)
    except MissingError as error:
        missing = ", ".join(f"{_OPTIONS[field]} ({what})" for field, what in error.fields.items())
        raise InputError(layout.source, "", f"does not hold all of the vehicle; give {missing}") from error
    text = airframe_toml(
        frame,
        f"coaxlink init from {layout.source}",
        rotor_model=os.path.relpath(rotor, out.parent) if rotor else None,
    )
    files.write_atomic(out, text)
    frame = load_airframe(out)
    for note in layout.notes:
        say(f"note: {note}")
    findings = report(frame, model, layout, picture, json_file)
    say(f"wrote {out}")
    for line in guesses(frame):
        say(f"guessed: {line}")
    if wrong := sum(f.severity == "error" for f in findings):
        many = "thing" if wrong == 1 else "things"
        raise CheckFailed(f"{out}: {wrong} {many} to mend before a table is made of it")
    if not rotor:
        say(f"next: coaxlink identify STAND.csv --out rotor.toml, then set rotor_model in {out}")
    else:
        say(f"next: coaxlink table {out} --firmware px4|ardupilot --out tables")


def _layout(
    template: str,
    source: Path | None,
    script: Path | None,
    system: int | None,
    connect: str,
    timeout_s: float,
    mass_kg: float | None,
) -> Layout:
    from coaxlink import setup
    from coaxlink.cli.shared.board_source import layout_of_board, layout_of_file

    given = [bool(template), source is not None, bool(connect)]
    if sum(given) != 1:
        options = ", ".join(setup.TEMPLATES)
        besides = ", and --mass KG" if mass_kg is None else ""
        raise InputError(
            "init", "", f"one of --connect URL, --from FILE, --template NAME ({options}) is expected{besides}"
        )
    if template:
        return setup.template(template)
    if source:
        return layout_of_file(source, script, system)
    return layout_of_board(connect, timeout_s, system)


def _numbers(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(",") if part.strip())
    except ValueError as error:
        raise InputError("--upper", text, "rotor numbers with commas between are expected") from error


def _inertia(text: str) -> tuple[float, float, float] | None:
    if not text:
        return None
    try:
        xx, yy, zz = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError("--inertia", text, "three numbers with commas between are expected") from error
    return xx, yy, zz
