"""`coaxlink airframe`: a vehicle file drawn and checked, alone or against a board."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.board_source import WAIT_S, TimeoutOption
from coaxlink.cli.shared.shell import JsonOption, console, say
from coaxlink.cli.upload import SystemOption
from coaxlink.errors import CheckFailed, InputError

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.rotor import RotorModel
    from coaxlink.setup import Layout
    from firmware_params.errors import Finding


def airframe(
    file: Annotated[Path, typer.Argument(metavar="AIRFRAME.toml", help="Airframe file.")],
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="Hold it against a board's parameters."),
    ] = None,
    connect: Annotated[str, typer.Option(metavar="URL", help="Hold it against this board.")] = "",
    timeout: TimeoutOption = WAIT_S,
    system: SystemOption = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw it from above, as .png, .svg or .pdf.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Draw a vehicle and say what looks wrong; exit code 1 where something must be mended."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.cli.shared.board_source import layout_of_board, layout_of_file
    from coaxlink.vehicle import load_rotors

    if source and connect:
        raise InputError("airframe", "", "one of --from and --connect is expected, found both")
    for output in (picture, json_file):
        files.refuse_unwritable(output)
    frame = load_airframe(file)
    path = rotor or frame.rotor_model
    model = load_rotors(path) if path else None
    board = (
        layout_of_file(source, None, system)
        if source
        else layout_of_board(connect, timeout, system)
        if connect
        else None
    )
    for note in board.notes if board else ():
        say(f"note: {note}")
    findings = report(frame, model, board, picture, json_file, differs=True)
    wrong = sum(f.severity == "error" for f in findings)
    if wrong:
        raise CheckFailed(f"{file}: {wrong} thing{'s' if wrong > 1 else ''} to mend")


def report(
    frame: Airframe,
    model: RotorModel | None,
    board: Layout | None,
    picture: Path | None,
    json_file: Path | None,
    *,
    differs: bool = False,
) -> tuple[Finding, ...]:
    """Draw it, list the findings (with `differs` also against the board), write what was asked for."""
    from coaxlink import files
    from coaxlink.cli.shared.table_views import finding_json
    from coaxlink.setup import check_against, check_airframe, check_outputs, draw

    findings = check_airframe(frame, model) + (check_outputs(board) if board else ())
    if board and differs:
        findings += check_against(frame, board)
    out = console()
    for finding in findings:
        out.print(f"{finding.severity}: {finding}", markup=False)
    if not findings:
        against = f", and {board.source} has the same rotors" if board and differs else ""
        out.print(f"nothing to mend: {_checked(frame)}{against}", markup=False)
    fits = board and len(board.mounts) == len(frame.rotors)
    out.print(draw(frame, board if fits else None), markup=False)
    if model is None:
        say("no rotor model given: thrust against weight was not checked")
    if picture:
        from coaxlink.report.pictures.airframe_picture import draw_airframe

        draw_airframe(picture, frame, board if fits else None)
        say(f"wrote {picture}")
    if json_file:
        document = {
            "airframe": frame.name,
            "mass_kg": frame.mass_kg,
            "inertia_kg_m2": list(frame.inertia_kg_m2),
            "motor_lag_s": frame.motor_lag_s,
            "sources": dict(frame.sources),
            "rotors": [
                {
                    "number": r.number,
                    "position_m": list(r.position_m),
                    "spin": "ccw" if r.yaw_sign > 0 else "cw",
                    "level": r.level,
                    "pair": r.pair,
                    "output": board.mounts[n].output if board and fits else "",
                }
                for n, r in enumerate(frame.rotors)
            ],
            "source": board.source if board else "",
            "findings": [finding_json(f) for f in findings],
        }
        files.write_json(json_file, document)
    return findings


def _checked(frame: Airframe) -> str:
    """What was looked at: an inertia that was made from these same lengths bears no witness."""
    from coaxlink.premises.moves import UNKNOWN

    source = frame.source_of("inertia_kg_m2")
    if source in UNKNOWN:
        return f"lengths, pairs, spins and balance fit; the inertia is {source}, which checks nothing"
    return "lengths, pairs, spins, balance and inertia fit"
