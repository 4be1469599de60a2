"""`coaxlink compare`: all laws on one vehicle, as a table and a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.effects import (
    ClimbOption,
    DensityOption,
    HeightOption,
    VoltageOption,
    say_effects,
    vehicle_of,
)
from coaxlink.cli.shared.next import after_compare
from coaxlink.cli.shared.shell import JsonOption, console, figure, say

if TYPE_CHECKING:
    from coaxlink.mixer.comparison import Row

LAW_HEADS = (
    "law", "thrust N", "roll N m", "pitch N m", "yaw N m", "power", "N/W", "most N", "most yaw N m"
)  # fmt: skip


def compare(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    printed: Annotated[
        bool, typer.Option("--printed", help="Also the standard and reduced mixers with the paper's numbers.")
    ] = False,
    rows: Annotated[int, typer.Option(min=10, help="Wrenches in the envelope.")] = 400,
    out: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Draw the comparison here (.png, .svg or .pdf).")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="R.html", help="Write one self-contained page.")
    ] = None,
    light: Annotated[
        float | None, typer.Option(metavar="KG", help="Without payload; else 3/4 of the mass.")
    ] = None,
    heavy: Annotated[
        float | None, typer.Option(metavar="KG", help="Fully loaded; else 5/4 of the mass.")
    ] = None,
    battery_wh: Annotated[
        float | None, typer.Option(metavar="WH", min=0.0, help="Energy to fly on, if not the airframe's own.")
    ] = None,
    drive_efficiency: Annotated[
        float, typer.Option(min=0.05, max=1.0, help="Shaft over electrical power, for the minutes.")
    ] = 0.8,
    voltage: VoltageOption = None,
    height: HeightOption = None,
    climb: ClimbOption = None,
    density: DensityOption = None,
    json_file: JsonOption = None,
) -> None:
    """Say what a table is worth to a pilot, and weigh all laws over an envelope of wrenches."""
    from rich.table import Table

    from coaxlink import files
    from coaxlink.cli.shared import table_views
    from coaxlink.constants import GRAVITY_M_S2
    from coaxlink.mixer import make_law
    from coaxlink.mixer.comparison import compare as weigh
    from coaxlink.mixer.fitted import FittedLaw, envelope
    from coaxlink.rotor.model import load_rotor_model
    from coaxlink.tables.curved_law import curved_law
    from coaxlink.vehicle import Vehicle

    for output in (out, report, json_file):
        files.refuse_unwritable(output)
    vehicle, _ = vehicle_of(airframe, rotor, voltage=voltage, height=height, climb=climb, density=density)
    say_effects(vehicle)
    frame = vehicle.airframe
    load = table_views.load_shares(frame, light, heavy)
    fitted = FittedLaw(vehicle)
    names = ("standard", "reduced", "coaxial-printed", "coaxial", "exact")
    laws = [(name, make_law(name, vehicle)) for name in names]
    laws.insert(2, ("fitted", fitted))
    laws.insert(1, ("curved", curved_law(vehicle)))
    if printed:
        for name, file in (("reduced", "rotor_rcrm_paper.toml"), ("standard", "rotor_srm_paper.toml")):
            belief = load_rotor_model(files.example(file))
            laws.insert(0, (f"{name} (paper's numbers)", make_law(name, Vehicle(frame, belief))))
    wrenches = envelope(frame, rows, seed=2)
    result = weigh(vehicle, laws, wrenches)
    low, high = wrenches.min(axis=0), wrenches.max(axis=0)
    table = Table(*LAW_HEADS, box=None)
    law_rows = [_law_row(row) for row in result]
    for cells in law_rows:
        table.add_row(*cells)
    screen = console()
    worths = table_views.weigh_tables(vehicle, load)
    battery_wh = frame.battery_Wh if battery_wh is None else battery_wh
    table_views.show_worths(screen, frame, worths, battery_wh, drive_efficiency)
    said = (
        f"{frame.name}, before any integrator: mean |error| over {rows} wrenches, "
        f"{low[0]:.0f}..{high[0]:.0f} N, "
        f"roll and pitch to {high[1]:.1f} N m, yaw to {high[3]:.1f} N m "
        "(most of curved's is a constant gain, which the learnt hover thrust takes off)"
    )
    screen.print(f"\n{said}")
    screen.print(table)
    if out or report:
        from coaxlink.report.compare_page import compare_page
        from coaxlink.report.made import Made
        from coaxlink.report.pictures.figures import write_figure
        from coaxlink.report.pictures.mixers import draw_comparison

        made = Made.now([f for f in (airframe, rotor or frame.rotor_model) if f is not None], frame.name)
        weight_N = frame.mass_kg * GRAVITY_M_S2
        figure = draw_comparison(frame.name, weight_N, result, fitted.table, made.line())
        if out:
            write_figure(out, figure)
            say(f"wrote {out}")
        if report:
            table_of_laws, battery = (LAW_HEADS, law_rows), (battery_wh, drive_efficiency)
            files.write_atomic(
                report, compare_page(frame.name, figure, worths, table_of_laws, said, made, battery)
            )
            say(f"wrote {report}")
    if json_file:
        envelope_json = {"rows": rows, "low": low.tolist(), "high": high.tolist()}
        laws_json = [row.to_json() for row in result]
        from coaxlink.report.worth import to_json

        worth_json = to_json(worths, battery_wh, drive_efficiency)
        document = {"envelope": envelope_json, "laws": laws_json, "worth": worth_json}
        files.write_json(json_file, document | vehicle.to_json())
    say(after_compare(airframe, rotor))


def _law_row(row: Row) -> list[str]:
    """A law's cells under LAW_HEADS."""
    errors = [figure(e) for e in row.mean_error]
    power, reach = (
        (f"{row.power:.4f}", f"{row.efficiency_N_W:.4f}"),
        (f"{row.most_thrust_N:.0f}", f"{row.most_yaw_Nm:.2f}"),
    )
    return [row.label, *errors, *power, *reach]


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("compare", short_help="Say what a table is worth to a pilot; weigh all laws.")(compare)
