"""`coaxlink table`: a mixing law as an autopilot's own files, and what that firmware will make of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli._shell import JsonOption, console, say
from coaxlink.errors import InputError

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.link.tables import TableReport


def table(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    firmware: Annotated[str, typer.Option(help="px4.")],
    law: Annotated[str, typer.Option(help="reduced or standard.")] = "reduced",
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Write the files here.")] = None,
    json_file: JsonOption = None,
) -> None:
    """Write a mixer table and say what mix the firmware will make of it."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.cli.allocate import rotor_path
    from coaxlink.link import tables
    from coaxlink.rotor import load_rotor_model

    if firmware != "px4":
        raise InputError("--firmware", firmware, "expected px4")
    frame = load_airframe(airframe)
    model_path = rotor_path(frame.rotor_model, rotor, airframe)
    report = tables.report_px4(frame, load_rotor_model(model_path), law)
    written: list[str] = []
    if not report.blocking and out is not None:
        written = [str(write_px4(out, frame, model_path, report))]
    if json_file:
        files.write_json(json_file, to_json(frame, report, written))
    show(frame, report)
    for path in written:
        say(f"wrote {path}")
    tables.refuse_traps(report)


def write_px4(folder: Path, frame: Airframe, model_path: Path, report: TableReport) -> Path:
    """Write DIR/NAME.params. Raises InputError when the place cannot be written."""
    import coaxlink
    from coaxlink import files
    from firmware_params import px4

    header = (
        f"coaxlink {coaxlink.__version__}: mixer table of {frame.name}",
        "",
        "Firmware: PX4 v1.14 or later",
        f"Vehicle: {frame.name}",
        f"Rotors: {len(frame.rotors)}",
        f"Law: {report.law}",
        f"Rotor model: {model_path.name} sha256 {files.sha256(model_path)}",
        "",
        "Vehicle-Id Component-Id Name Value Type",
    )
    path = folder / f"{file_name(frame.name)}.params"
    try:
        px4.write_params_file(path, report.params, header=header)
    except OSError as error:
        raise InputError(path, "", f"cannot be written ({error.strerror})") from error
    return path


def file_name(name: str) -> str:
    """A vehicle's name as a file name."""
    return "".join(c if c.isalnum() or c in "-_." else "-" for c in name).strip("-.") or "vehicle"


def to_json(frame: Airframe, report: TableReport, written: list[str]) -> dict[str, Any]:
    """The report as `--json` writes it."""
    mix = report.mix
    return {
        "airframe": frame.name,
        "firmware": "px4",
        "law": report.law,
        "parameters": report.params,
        "mix": {
            "axes": ["roll", "pitch", "yaw", "thrust_x", "thrust_y", "thrust_z"],
            "rows": mix.mix.tolist(),
        },
        "pairs": [
            {
                "upper": s.upper,
                "lower": s.lower,
                "lower_over_upper_u2": s.squared_ratio,
                "hover_u": list(s.hover),
            }
            for s in report.splits
        ],
        "hover_thrust_setpoint": report.hover_thrust,
        "hover_thrust_setpoint_by_table": report.hover_thrust_table,
        "hover_speeds": list(report.hover_speeds),
        "ceiling_N": report.ceiling_N,
        "ceiling_rotor_model_N": report.ceiling_model_N,
        "full_throttle_N": report.full_N,
        "findings": [
            {"id": f.id, "severity": f.severity, "text": f.text, "evidence": f.evidence}
            for f in report.findings
        ],
        "files": written,
    }


def show(frame: Airframe, report: TableReport) -> None:
    """The mix PX4 will make, in words and columns."""
    from rich.table import Table

    out = console()
    out.print(f"{frame.name}: {report.law} law as PX4 parameters, THR_MDL_FAC {report.table.thr_mdl_fac:g}")
    rows = Table("rotor", "CT N", "KM m", "roll", "pitch", "yaw", "thrust", "hover u", box=None)
    for n, (rotor, entry) in enumerate(zip(frame.rotors, report.table.rotors, strict=True)):
        roll, pitch, yaw, _, _, thrust = report.mix.mix[n]
        numbers = [f"{entry.ct:.3f}", f"{entry.km:+.5f}"]
        numbers += [f"{x:+.4f}" for x in (roll, pitch, yaw, -thrust)]
        rows.add_row(f"{rotor.number} {rotor.level}", *numbers, f"{report.hover_speeds[n]:.4f}")
    out.print(rows)
    for split in report.splits:
        out.print(
            f"pair {split.upper}/{split.lower}: lower/upper u^2 = {split.squared_ratio:.4f} (setpoints), "
            f"u = {split.hover[0]:.4f} / {split.hover[1]:.4f} in hover"
        )
    out.print(
        f"hover at thrust setpoint {report.hover_thrust:.3f} on the rotor model "
        f"({report.hover_thrust_table:.3f} by the table's own numbers): MPC_THR_HOVER "
        f"{report.params['MPC_THR_HOVER']:.3f}"
    )
    out.print(
        f"ceiling {report.ceiling_N:.1f} N by the table at thrust setpoint 1 "
        f"(every rotor full: {report.full_N:.1f} N); {report.ceiling_model_N:.1f} N on the rotor model"
    )
    for finding in report.findings:
        out.print(f"{finding.severity}: {finding}")
    if not report.findings:
        out.print("traps: none (every axis survives PX4's zeroing)")


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("table")(table)
