"""How tables look: their mix, traps and worth, on the screen and as JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from coaxlink.cli.shared.shell import PIPE_WIDTH, console, say
from coaxlink.errors import InputError

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.tables.ardupilot import ApReport
    from coaxlink.tables.behaviour import Behaviour
    from coaxlink.tables.px4 import TableReport
    from coaxlink.tables.worth import Worths
    from coaxlink.vehicle import Vehicle
    from firmware_params.errors import Finding


def px4_json(frame: Airframe, report: TableReport, written: list[str]) -> dict[str, Any]:
    """The report as `--json` writes it."""
    return {
        "airframe": frame.name,
        "firmware": "px4",
        "law": report.law,
        "parameters": report.params,
        "mix": {
            "axes": ["roll", "pitch", "yaw", "thrust_x", "thrust_y", "thrust_z"],
            "rows": report.mix.mix.tolist(),
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
        "hover_thrust_setpoint": report.behaviour.hover,
        "hover_thrust_setpoint_by_table": report.hover_thrust_table,
        "ceiling_N": report.ceiling_N,
        "full_throttle_N": report.full_N,
        "rotor_model": behaviour_json(report.behaviour),
        "findings": [finding_json(f) for f in report.findings],
        "files": written,
    }


def ap_json(frame: Airframe, report: ApReport, written: list[str]) -> dict[str, Any]:
    """The report as `--json` writes it."""
    return {
        "airframe": frame.name,
        "firmware": "ardupilot",
        "law": report.law,
        "parameters": report.params,
        "factors": {"axes": ["roll", "pitch", "yaw", "throttle"], "rows": report.mix.factors.tolist()},
        "pairs": [
            {"upper": u + 1, "lower": w + 1, "lower_over_upper_u2": ratio}
            for (u, w), ratio in zip(frame.pairs, report.squared_ratio, strict=True)
        ],
        "hover_throttle": report.behaviour.hover,
        "rotor_model": behaviour_json(report.behaviour),
        "findings": [finding_json(f) for f in report.findings],
        "files": written,
    }


def behaviour_json(flown: Behaviour) -> dict[str, Any]:
    """A behaviour as JSON."""
    return {
        "hover": flown.hover,
        "hover_speeds": list(flown.hover_speeds),
        "ceiling_N": flown.ceiling_N,
        "gain_Nm": list(flown.gain_Nm),
        "authority_Nm": list(flown.authority_Nm),
    }


def finding_json(finding: Finding) -> dict[str, str]:
    """A finding as JSON."""
    return {
        "id": finding.id,
        "severity": finding.severity,
        "text": finding.text,
        "evidence": finding.evidence,
    }


def show_px4(frame: Airframe, report: TableReport, gains: str) -> None:
    """The mix PX4 will make, in words and columns."""
    from rich.table import Table

    out = console()
    out.print(f"{frame.name}: {report.law} law as PX4 parameters, THR_MDL_FAC {report.table.thr_mdl_fac:g}")
    out.print(gains, soft_wrap=out.width >= PIPE_WIDTH)
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
    hover = "no hover" if report.behaviour.hover is None else f"{report.behaviour.hover:.3f}"
    out.print(
        f"hover at thrust setpoint {hover} on the rotor model ({report.hover_thrust_table:.3f} by the "
        f"table's own numbers): MPC_THR_HOVER {report.params['MPC_THR_HOVER']:.3f}"
    )
    out.print(
        f"ceiling {report.ceiling_N:.1f} N by the table at thrust setpoint 1 (every rotor full: "
        f"{report.full_N:.1f} N); {report.behaviour.ceiling_N:.1f} N on the rotor model"
    )
    show_findings(report.findings, "traps: none (every axis survives PX4's zeroing)")


def show_ap(frame: Airframe, report: ApReport, gains: str) -> None:
    """The factors ArduPilot will use, in words and columns."""
    from rich.table import Table

    out, p = console(), report.table.parameters
    out.print(
        f"{frame.name}: {report.law} law for FRAME_CLASS {report.table.frame_class}, "
        f"MOT_THST_EXPO {p.thst_expo:g}, MOT_SPIN_MIN {p.spin_min:g}"
    )
    out.print(gains, soft_wrap=out.width >= PIPE_WIDTH)
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
    hover = "no hover" if report.behaviour.hover is None else f"{report.behaviour.hover:.3f}"
    out.print(
        f"hover at throttle {hover}, ceiling {report.behaviour.ceiling_N:.1f} N, both on the rotor model"
    )
    show_findings(report.findings, "traps: none")


def show_findings(findings: tuple[Finding, ...], none: str) -> None:
    """Findings, a line each."""
    out = console()
    for finding in findings:
        out.print(f"{finding.severity}: {finding}")
    if not findings:
        out.print(none)


def load_shares(frame: Airframe, light: float | None, heavy: float | None) -> tuple[float, float]:
    """--light and --heavy (kg) as shares of the vehicle's mass. Raises InputError."""
    from coaxlink.mixer.worth import HEAVY, LIGHT

    low = LIGHT if light is None else light / frame.mass_kg
    high = HEAVY if heavy is None else heavy / frame.mass_kg
    for name, share in (("--light", low), ("--heavy", high)):
        if not (math.isfinite(share) and 0.0 < share <= 10.0):
            raise InputError(
                name, f"{share * frame.mass_kg:g}", f"a mass near {frame.mass_kg:g} kg is expected"
            )
    if low >= high:
        raise InputError(
            "--light", f"{low * frame.mass_kg:g}", f"less than {high * frame.mass_kg:g} kg is expected"
        )
    return low, high


def weigh_tables(vehicle: Vehicle, load: tuple[float, float]) -> Worths:
    """All tables of a vehicle; what cannot be made is said on stderr."""
    from coaxlink.tables.worth import px4_worths

    worths = px4_worths(vehicle, light=load[0], heavy=load[1])
    for name, why in worths.left_out.items():
        say(f"left out: {name}: {why}")
    return worths


def show_worths(
    screen: Any, frame: Airframe, worths: Worths, battery_Wh: float | None, drive_efficiency: float
) -> None:
    """The sentence first, then a column a table, and what its words mean."""
    from rich.table import Table

    from coaxlink.report import worth

    for line in worth.sentences(worths):
        screen.print(line)
    screen.print(f"\n{frame.name}: what a table is worth, by the rotor model")
    shown = Table("", *(t.name for t in worths.rows), box=None)
    for row in worth.rows(worths.rows, battery_Wh, drive_efficiency):
        shown.add_row(*row)
    screen.print(shown)
    screen.print(worth.terms())
