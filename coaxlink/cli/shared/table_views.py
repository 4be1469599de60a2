"""How tables look: their mix, traps and worth, on the screen and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from coaxlink.cli.shared.line import vehicle_at
from coaxlink.cli.shared.shell import PIPE_WIDTH, console, say
from coaxlink.errors import InputError

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.mixer.worth import Worth
    from coaxlink.tables.ardupilot import ApReport
    from coaxlink.tables.px4 import TableReport
    from coaxlink.tables.worth import Worths
    from coaxlink.vehicle import Vehicle
    from firmware_params.errors import Finding


def as_json(frame: Airframe, report: TableReport | ApReport, written: list[str]) -> dict[str, Any]:
    """A report as `--json` writes it."""
    from coaxlink.tables.px4 import TableReport

    px4 = isinstance(report, TableReport)
    return {
        "airframe": frame.name,
        "firmware": "px4" if px4 else "ardupilot",
        "law": report.law,
        "parameters": report.params,
        **(_px4_json(report) if px4 else _ap_json(frame, report)),  # type: ignore[arg-type]
        "rotor_model": report.behaviour.to_json(),
        "findings": [finding_json(f) for f in report.findings],
        "files": written,
    }


def _px4_json(report: TableReport) -> dict[str, Any]:
    pairs = [
        {
            "upper": s.upper,
            "lower": s.lower,
            "lower_over_upper_u2": s.squared_ratio,
            "hover_u": list(s.hover),
        }
        for s in report.splits
    ]
    axes = ["roll", "pitch", "yaw", "thrust_x", "thrust_y", "thrust_z"]
    return {
        "mix": {"axes": axes, "rows": report.mix.mix.tolist()},
        "pairs": pairs,
        "hover_thrust_setpoint": report.behaviour.hover,
        "hover_thrust_setpoint_by_table": report.hover_thrust_table,
        "ceiling_N": report.ceiling_N,
        "full_throttle_N": report.full_N,
    }


def _ap_json(frame: Airframe, report: ApReport) -> dict[str, Any]:
    pairs = zip(frame.pairs, report.squared_ratio, strict=True)
    return {
        "factors": {"axes": ["roll", "pitch", "yaw", "throttle"], "rows": report.mix.factors.tolist()},
        "pairs": [{"upper": u + 1, "lower": w + 1, "lower_over_upper_u2": ratio} for (u, w), ratio in pairs],
        "hover_throttle": report.behaviour.hover,
    }


def finding_json(finding: Finding) -> dict[str, str]:
    """A finding as JSON."""
    return {key: getattr(finding, key) for key in ("id", "severity", "text", "evidence")}


def show(frame: Airframe, report: TableReport | ApReport, lead: Sequence[str]) -> None:
    """The mix that the firmware will make, in words and columns; `lead` goes before it: the table's price,
    and what becomes of the loops."""
    from coaxlink.tables.px4 import TableReport

    if isinstance(report, TableReport):
        _show_px4(frame, report, lead)
    else:
        _show_ap(frame, report, lead)
    for finding in report.findings:
        console().print(f"{finding.severity}: {finding}")


def _show_px4(frame: Airframe, report: TableReport, lead: Sequence[str]) -> None:
    from rich.table import Table

    out = console()
    out.print(f"{frame.name}: {report.law} law as PX4 parameters, THR_MDL_FAC {report.table.thr_mdl_fac:g}")
    for line in lead:
        out.print(line, soft_wrap=out.width >= PIPE_WIDTH)
    rows = Table("rotor", "CT N", "KM m", "roll", "pitch", "yaw", "thrust", "hover u", box=None)
    for n, (rotor, entry) in enumerate(zip(frame.rotors, report.table.rotors, strict=True)):
        roll, pitch, yaw, _, _, thrust = report.mix.mix[n]
        numbers = [f"{entry.ct:.3f}", f"{entry.km:+.5f}", *(f"{x:+.4f}" for x in (roll, pitch, yaw, -thrust))]
        rows.add_row(f"{rotor.number} {rotor.level}", *numbers, f"{report.behaviour.hover_speeds[n]:.4f}")
    out.print(rows)
    for split in report.splits:
        out.print(
            f"pair {split.upper}/{split.lower}: lower/upper u^2 = {split.squared_ratio:.4f} (setpoints), "
            f"u = {split.hover[0]:.4f} / {split.hover[1]:.4f} in hover"
        )
    out.print(
        f"hover at thrust setpoint {_hover(report)} on the rotor model ({report.hover_thrust_table:.3f} by "
        f"the table's own numbers): MPC_THR_HOVER {report.params['MPC_THR_HOVER']:.3f}"
    )
    out.print(
        f"ceiling {report.ceiling_N:.1f} N by the table at thrust setpoint 1 (every rotor full: "
        f"{report.full_N:.1f} N); {report.behaviour.ceiling_N:.1f} N on the rotor model"
    )
    if not report.findings:
        out.print("traps: none (every axis survives PX4's zeroing)")


def _show_ap(frame: Airframe, report: ApReport, lead: Sequence[str]) -> None:
    from rich.table import Table

    out, p = console(), report.table.parameters
    out.print(
        f"{frame.name}: {report.law} law for FRAME_CLASS {report.table.frame_class}, "
        f"MOT_THST_EXPO {p.thst_expo:g}, MOT_SPIN_MIN {p.spin_min:g}"
    )
    for line in lead:
        out.print(line, soft_wrap=out.width >= PIPE_WIDTH)
    rows = Table("rotor", "roll", "pitch", "yaw", "throttle", "hover u", box=None)
    for n, rotor in enumerate(frame.rotors):
        numbers = [f"{x:+.4f}" for x in report.mix.factors[n]]
        rows.add_row(f"{rotor.number} {rotor.level}", *numbers, f"{report.behaviour.hover_speeds[n]:.4f}")
    out.print(rows)
    for (upper, lower), ratio in zip(frame.pairs, report.squared_ratio, strict=True):
        factor = report.mix.factors[lower, 3] / report.mix.factors[upper, 3]
        out.print(
            f"pair {upper + 1}/{lower + 1}: lower/upper throttle {factor:.4f}, "
            f"u^2 in hover {ratio:.4f} (spin range)"
        )
    out.print(
        f"hover at throttle {_hover(report)}, ceiling {report.behaviour.ceiling_N:.1f} N, "
        "both on the rotor model"
    )
    if not report.findings:
        out.print("traps: none")


def _hover(report: TableReport | ApReport) -> str:
    return "no hover" if report.behaviour.hover is None else f"{report.behaviour.hover:.3f}"


def load_shares(frame: Airframe, light: float | None, heavy: float | None) -> tuple[float, float]:
    """--light and --heavy (kg) as shares of the vehicle's mass. Raises InputError."""
    from coaxlink.mixer.worth import HEAVY, LIGHT

    mass = frame.mass_kg
    kg = {
        "--light": LIGHT * mass if light is None else light,
        "--heavy": HEAVY * mass if heavy is None else heavy,
    }
    for name, load in kg.items():
        if not (math.isfinite(load) and 0.0 < load <= 10.0 * mass):
            raise InputError(name, f"{load:g}", f"a mass near {mass:g} kg is expected")
    if kg["--light"] >= kg["--heavy"]:
        raise InputError("--light", f"{kg['--light']:g}", f"less than {kg['--heavy']:g} kg is expected")
    return kg["--light"] / mass, kg["--heavy"] / mass


def weigh_tables(
    vehicle: Vehicle, load: tuple[float, float], connect: str = "", system: int | None = None
) -> Worths:
    """All tables of a vehicle, the one on board first; what cannot be made is reported on stderr."""
    from coaxlink.tables.worth import px4_worths

    board = None
    if connect:
        from coaxlink.uploading.beside import commands_on_board

        with vehicle_at(connect, system=system) as session:
            board = commands_on_board(vehicle, session)
    worths = px4_worths(vehicle, light=load[0], heavy=load[1], board=board)
    for name, why in worths.left_out.items():
        say(f"left out: {name}: {why}")
    return worths


def show_worths(
    screen: Any, frame: Airframe, worths: Worths, tables: Sequence[Worth], battery: tuple[float | None, float]
) -> None:
    """The answer, a column a table, what its words mean; `battery`: Wh and the drive's efficiency."""
    from rich.table import Table

    from coaxlink.report import worth

    for line in worth.sentences(worths)[: 1 if len(tables) <= 3 else 2]:
        screen.print(line)
    shown = Table(
        "", box=None, title=f"{frame.name}, {frame.mass_kg:g} kg, by the rotor model", title_justify="left"
    )
    for t in tables:
        shown.add_column(f"* {t.name}" if t.name == worths.used else t.name, justify="right")
    for row in worth.rows(tables, *battery):
        shown.add_row(*row)
    screen.print()
    screen.print(shown)
    screen.print(f"* {worth.used(worths)}. {worth.terms()}")
