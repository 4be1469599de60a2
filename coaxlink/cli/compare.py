"""`coaxlink compare`: all laws on one vehicle, as a table and a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
from coaxlink.cli.upload import SystemOption

if TYPE_CHECKING:
    from coaxlink.mixer import Law
    from coaxlink.mixer.comparison import Row
    from coaxlink.vehicle import Vehicle

LAW_HEADS = (
    "law, before any integrator", "thrust error, N", "roll, N m", "pitch, N m", "yaw, N m", "power, N m",
    "thrust for power, N/W", "ceiling, N", "yaw authority, N m",
)  # fmt: skip


def compare(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    connect: Annotated[
        str, typer.Option(metavar="URL", help="Autopilot whose present table is weighed beside these.")
    ] = "",
    system: SystemOption = None,
    every: Annotated[
        bool, typer.Option("--all", help="Every table and law, not the three that serve.")
    ] = False,
    printed: Annotated[
        bool, typer.Option("--printed", help="Also the paper's mixers with the numbers and slips it prints.")
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
    from coaxlink.mixer.comparison import compare as weigh
    from coaxlink.mixer.demands import envelope
    from coaxlink.mixer.fitted import FittedLaw

    for output in (out, report, json_file):
        files.refuse_unwritable(output)
    vehicle, _ = vehicle_of(airframe, rotor, voltage=voltage, height=height, climb=climb, density=density)
    say_effects(vehicle)
    frame = vehicle.airframe
    load = table_views.load_shares(frame, light, heavy)
    worths = table_views.weigh_tables(vehicle, load, connect, system)
    shown = worths.rows if every or not worths.serving() else worths.serving()
    wrenches = envelope(frame, rows, seed=2)
    weighed = every or printed or report or json_file
    result = (
        weigh(vehicle, _laws(vehicle, FittedLaw(vehicle, worths.fit), printed=printed), wrenches)
        if weighed
        else []
    )
    battery = (frame.battery_Wh if battery_wh is None else battery_wh, drive_efficiency)
    low, high = wrenches.min(axis=0), wrenches.max(axis=0)
    laws = [_cells(row) for row in result] if every or printed else []
    screen = console()
    table_views.show_worths(screen, frame, worths, shown, battery)
    if laws:
        screen.print(
            f"\nmean |error| over {rows} wrenches, {low[0]:.0f} to {high[0]:.0f} N, "
            f"roll and pitch to {high[1]:.1f} N m, yaw to {high[3]:.1f} N m"
        )
        table = Table(*LAW_HEADS, box=None)
        for cells in laws:
            table.add_row(*cells)
        screen.print(table)
    if out or report:
        from coaxlink.report.compare_page import compare_page
        from coaxlink.report.made import Made
        from coaxlink.report.pictures.figures import write_figure
        from coaxlink.report.pictures.mixers import draw_comparison

        made = Made.now([f for f in (airframe, rotor or frame.rotor_model) if f is not None], frame.name)
        picture = draw_comparison(frame.name, worths, shown, made.line())
        if out:
            write_figure(out, picture)
            say(f"wrote {out}")
        if report:
            page = compare_page(frame.name, picture, worths, shown, (LAW_HEADS, laws), made, battery)
            files.write_atomic(report, page)
            say(f"wrote {report}")
    if json_file:
        from coaxlink.report.worth import to_json

        document: dict[str, Any] = {
            "envelope": {"rows": rows, "low": low.tolist(), "high": high.tolist()},
            "laws": [row.to_json() for row in result],
            "worth": to_json(worths, *battery),
        }
        files.write_json(json_file, document | vehicle.to_json())
    say(after_compare(airframe, rotor))


def _laws(vehicle: Vehicle, fitted: Law, *, printed: bool) -> list[tuple[str, Law]]:
    """All laws of a vehicle by label; `printed`: also the paper's own, as it prints them."""
    from coaxlink.mixer import make_law
    from coaxlink.mixer.exact.compiled import is_kept
    from coaxlink.tables.curved_law import curved_law

    made = {name: make_law(name, vehicle) for name in ("standard", "reduced", "coaxial")}
    made["exact"] = make_law("exact", vehicle, compiled=is_kept())
    made |= {"curved": curved_law(vehicle), "fitted": fitted}
    order = ["standard", "curved", "reduced", "fitted", "coaxial", "exact"]
    if printed:
        from coaxlink import files
        from coaxlink.rotor import load_rotor_model
        from coaxlink.studies.paper import printed_laws
        from coaxlink.vehicle import Vehicle

        for name, file in (("reduced", "rotor_rcrm_paper.toml"), ("standard", "rotor_srm_paper.toml")):
            label = f"{name} (paper's numbers)"
            made[label] = make_law(name, Vehicle(vehicle.airframe, load_rotor_model(files.example(file))))
            order.insert(0, label)
        made["coaxial-printed"] = printed_laws(vehicle)["coaxial-printed"]
        order.insert(order.index("coaxial"), "coaxial-printed")
    return [(label, made[label]) for label in order]


def _cells(row: Row) -> list[str]:
    """A law's cells under LAW_HEADS."""
    errors = [figure(e) for e in row.mean_error]
    reach = f"{row.ceiling_N:.0f}", f"{row.yaw_Nm:.2f}"
    return [row.label, *errors, f"{row.power:.4f}", f"{row.efficiency_N_W:.4f}", *reach]
