"""`coaxlink compare`: all laws on one vehicle, as a table and a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli._effects import (
    ClimbOption,
    DensityOption,
    HeightOption,
    VoltageOption,
    load_seen,
    say_effects,
)
from coaxlink.cli._shell import JsonOption, console, say


def compare(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    printed: Annotated[
        bool, typer.Option("--printed", help="Also the standard and reduced mixers with the paper's numbers.")
    ] = False,
    rows: Annotated[int, typer.Option(min=10, help="Wrenches in the envelope.")] = 400,
    out: Annotated[Path | None, typer.Option(metavar="PNG", help="Draw the comparison here.")] = None,
    voltage: VoltageOption = None,
    height: HeightOption = None,
    climb: ClimbOption = None,
    density: DensityOption = None,
    json_file: JsonOption = None,
) -> None:
    """Weigh all laws over an envelope of wrenches: error per axis, power, authority, efficiency."""
    from rich.table import Table

    from coaxlink import files
    from coaxlink.mixer import make_law
    from coaxlink.mixer.comparison import compare as weigh
    from coaxlink.mixer.fitted import GRAVITY, FittedLaw, envelope
    from coaxlink.rotor.model import load_rotor_model

    seen, _ = load_seen(airframe, rotor, voltage=voltage, height=height, climb=climb, density=density)
    say_effects(seen)
    frame, model = seen.airframe, seen.model
    fitted = FittedLaw(frame, model)
    names = ("standard", "reduced", "coaxial-printed", "coaxial", "exact")
    laws = [(name, make_law(name, frame, model)) for name in names]
    laws.insert(2, ("fitted", fitted))
    if printed:
        for name, file in (("reduced", "rotor_rcrm_paper.toml"), ("standard", "rotor_srm_paper.toml")):
            belief = load_rotor_model(files.example(file))
            laws.insert(0, (f"{name} (paper's numbers)", make_law(name, frame, belief)))
    wrenches = envelope(frame, rows, seed=2)
    result = weigh(frame, model, laws, wrenches)
    low, high = wrenches.min(axis=0), wrenches.max(axis=0)
    table = Table(
        "law",
        "thrust N",
        "roll N m",
        "pitch N m",
        "yaw N m",
        "power",
        "N/W",
        "most N",
        "most yaw N m",
        box=None,
    )
    for row in result:
        errors = [f"{e:.3g}" if e > 1e-8 else "0" for e in row.mean_error]
        rest = (
            f"{row.power:.4f}",
            f"{row.efficiency_N_W:.4f}",
            f"{row.most_thrust_N:.0f}",
            f"{row.most_yaw_Nm:.2f}",
        )
        table.add_row(row.label, *errors, *rest)
    screen = console()
    screen.print(
        f"{frame.name}: mean |error| over {rows} wrenches, {low[0]:.0f}..{high[0]:.0f} N, "
        f"roll and pitch to {high[1]:.1f} N m, yaw to {high[3]:.1f} N m"
    )
    screen.print(table)
    if out:
        from coaxlink.report.mixers import draw_comparison

        draw_comparison(out, frame.name, frame.mass_kg * GRAVITY, result, fitted.table)
        say(f"wrote {out}")
    if json_file:
        envelope_json = {"rows": rows, "low": low.tolist(), "high": high.tolist()}
        laws_json = [row.to_json() for row in result]
        files.write_json(json_file, {"envelope": envelope_json, "laws": laws_json} | seen.to_json())


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("compare")(compare)
