"""How `coaxlink table --constrain` looks: what each limit does to the fitted table, and what it costs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli.shared.shell import console
from coaxlink.errors import InputError

if TYPE_CHECKING:
    from coaxlink.mixer.constrained import ConstrainedTable
    from coaxlink.mixer.fitted import Trade
    from coaxlink.vehicle import Vehicle

ConstrainOption = Annotated[
    Path | None,
    typer.Option("--constrain", metavar="LIMITS.toml", help="With --law fitted: limits it shall keep."),
]


def constrained(vehicle: Vehicle, path: Path | None, law: str, spin_min: float) -> ConstrainedTable | None:
    """The table under the limits of a file. Raises InputError, and CheckFailed when none keeps them."""
    if path is None:
        return None
    if law != "fitted":
        raise InputError("--constrain", "", f"--law fitted is expected, found {law}: only that one is chosen")
    from coaxlink.mixer.constrained import constrained_table
    from coaxlink.mixer.limits import load_limits

    return constrained_table(vehicle, load_limits(path, vehicle.airframe), spin_min=spin_min)


def show(made: ConstrainedTable, speed_max_rpm: float) -> None:
    """What every limit does, then all of them together."""
    from rich.table import Table

    rows = Table("limit", "fitted", "now", "power", "ceiling", "yaw in hover", "mean thrust error", box=None)
    for held in made.limits:
        values = ["" if x is None else held.limit.shown(x) for x in (held.before, held.now)]
        rows.add_row(str(held.limit), *values, *_change(held.without, made.table.chosen, speed_max_rpm))
    if len(made.limits) > 1:
        rows.add_row("all", "", "", *_change(made.fitted.chosen, made.table.chosen, speed_max_rpm))
    out = console()
    out.print("limits hold; what each costs (this table less the one without it, power over the envelope):")
    out.print(rows)


def _change(without: Trade, now: Trade, speed_max_rpm: float) -> list[str]:
    """Power, ceiling, yaw and error of `now` beside those of `without`."""
    watts = speed_max_rpm * math.pi / 30.0
    power = now.power - without.power
    if abs(power) < 1e-5 * now.power and abs(now.ceiling_N - without.ceiling_N) < 1e-4 * now.ceiling_N:
        return ["nothing", "", "", ""]
    return [
        f"{power * watts:+.0f} W ({power / without.power:+.1%})",
        f"{without.ceiling_N:.0f} -> {now.ceiling_N:.0f} N",
        f"{without.yaw_Nm:.2f} -> {now.yaw_Nm:.2f} N m",
        f"{without.error[0]:.2f} -> {now.error[0]:.2f} N",
    ]


def as_json(made: ConstrainedTable | None) -> dict[str, Any]:
    """For `--json`: {} without limits."""
    if made is None:
        return {}
    return {
        "limits": {
            "fitted": _trade(made.fitted.chosen),
            "now": _trade(made.table.chosen),
            "kept": [
                {"limit": k.limit.to_json(), "fitted": k.before, "now": k.now, "without": _trade(k.without)}
                for k in made.limits
            ],
        }
    }


def _trade(trade: Trade) -> dict[str, Any]:
    return {
        "power": trade.power,
        "power_excess": trade.power_excess,
        "ceiling_N": trade.ceiling_N,
        "yaw_Nm": trade.yaw_Nm,
        "error": list(trade.error),
    }
