"""`coaxlink loop`: fly, find what the model lacks, put it into the table, fly again."""

from __future__ import annotations

import secrets
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli._shell import JsonOption, console, say, talk

if TYPE_CHECKING:
    from coaxlink.residual.compensate import Compensation
    from coaxlink.residual.result import Refinement

LAW = "fitted"
ROWS = (
    ("thrust_error_N", "thrust, N"),
    ("torque_error_Nm", "roll, pitch, yaw, N m"),
    ("height_error_m", "height, m"),
)


def loop(
    truth: Annotated[
        Path | None,
        typer.Option(metavar="TRUTH.toml", help="What is true of the world; else drawn and hidden."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the hidden effect and the noise.")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where tables, logs and the report go.")] = Path(
        "loop"
    ),
    speed: Annotated[float, typer.Option(min=0.1, max=50, help="Simulator speed, times real time.")] = 8.0,
    json: JsonOption = None,
) -> None:
    """Fly, refine, re-table, fly again: the flight's allocation error before and after."""
    from coaxlink import files
    from coaxlink.report.page import page
    from coaxlink.report.refine import tables, verdict

    chosen = secrets.randbelow(1_000_000) if seed is None else seed
    document, refinement, made = run_loop(truth, chosen, out, speed)
    files.write_atomic(out / "report.html", page(refinement, "What the first flight showed"))
    if json is not None:
        files.write_json(json, document)
    screen = console()
    screen.print(verdict(refinement))
    for table in tables(refinement):
        screen.print(table)
    for key, label in ROWS:
        screen.print(
            f"{label}: {_text(document['before'][key])} before, {_text(document['after'][key])} after"
        )
    for name, why in made.cannot.items():
        say(f"not compensated: {name}: {why}")
    say(f"report: {out / 'report.html'}")


def run_loop(
    truth: Path | None, seed: int, out: Path, speed: float
) -> tuple[dict[str, Any], Refinement, Compensation]:
    """Two flights and what lies between them. Raises what the steps raise."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.cli import _demo as steps
    from coaxlink.cli.demo import upload_into, write_table
    from coaxlink.data import read_flight_log, read_stand_log
    from coaxlink.link import tables
    from coaxlink.link.trajectory import paper_flight
    from coaxlink.residual import refine
    from coaxlink.residual.compensate import compensate
    from coaxlink.rotor import identify, save_rotor_model

    airframe_file = files.example("x8_demo.toml")
    airframe, plan = load_airframe(airframe_file), paper_flight()
    hidden = ["--truth", str(truth)] if truth is not None else ["--hidden-seed", str(seed)]
    world = ["--airframe", str(airframe_file), "--seed", str(seed), *hidden]
    with talk().status("identifying the rotor pair") as status:
        model = identify(read_stand_log(files.example("stand_eq17.csv")), "crm").model
        save_rotor_model(out / "rotor.toml", model)
        first = tables.report_px4(airframe, model, LAW)

        def fly(name: str, report: Any) -> Any:
            folder = write_table(out, airframe, name, report, out / "rotor.toml")
            status.update(f"flying {name}")
            flown, _ = steps.fly_tables(
                world, speed, {name: folder}, upload_into(out), plan, out,
                lambda segment, _: status.update(f"flying {name}: {segment}"),
            )  # fmt: skip
            return flown[name]

        before = fly("before", first)
        log = read_flight_log(before.log)
        refinement = refine(log, airframe, model, progress=status.update)
        if refinement.model is not None:
            save_rotor_model(out / "rotor_refined.toml", refinement.model)
        volts = (
            float(log["voltage_V"][log["height_m"] > 0.5].mean())
            if log.has("voltage_V", "height_m")
            else None
        )
        made = compensate(first.params, airframe, model, refinement.effects, voltage_V=volts)
        after = fly("after", replace(first, params=made.params))
        errors = steps.errors_of_table(before, airframe, model, first.params)
        errors_after = steps.errors_of_table(after, made.airframe, model, made.params)
    document = {
        "seed": seed,
        "before": errors.to_json(),
        "effects": refinement.to_json()["effects"],
        "after": errors_after.to_json(),
        "compensated": list(made.done),
        "not_compensated": dict(made.cannot),
        "log_before": str(before.log),
        "log_after": str(after.log),
        "refine": refinement.to_json(),
    }
    return document, refinement, made


def _text(value: float | list[float]) -> str:
    return ", ".join(f"{v:.3g}" for v in value) if isinstance(value, list) else f"{value:.3g}"


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("loop")(loop)
