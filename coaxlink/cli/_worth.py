"""What tables are worth, as verbs say it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from coaxlink.cli._shell import say
from coaxlink.errors import InputError

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.mixer.worth import Worth
    from coaxlink.tables.worth import Worths
    from coaxlink.vehicle import Vehicle


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


def show(
    screen: Any, frame: Airframe, worths: Worths, battery_Wh: float | None, drive_efficiency: float
) -> None:
    """The sentence first, then a column a table."""
    from coaxlink.report.worth import sentences

    for line in sentences(worths):
        screen.print(line)
    screen.print(f"\n{frame.name}: what a table is worth, by the rotor model")
    show_rows(screen, worths.rows, battery_Wh, drive_efficiency)


def show_rows(
    screen: Any, tables: tuple[Worth, ...], battery_Wh: float | None = None, drive_efficiency: float = 0.8
) -> None:
    """The table, and what its words mean."""
    from rich.table import Table

    from coaxlink.report import worth

    shown = Table("", *(t.name for t in tables), box=None)
    for row in worth.rows(tables, battery_Wh, drive_efficiency):
        shown.add_row(*row)
    screen.print(shown)
    screen.print(worth.terms())
