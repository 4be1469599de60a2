"""`coaxlink allocate`: one wrench through one law."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli.shared.completion import laws
from coaxlink.cli.shared.effects import (
    ClimbOption,
    DensityOption,
    HeightOption,
    VoltageOption,
    say_effects,
    vehicle_of,
)
from coaxlink.cli.shared.shell import NOTHING, JsonOption, console, figure
from coaxlink.errors import CheckFailed, InputError

if TYPE_CHECKING:
    from coaxlink.mixer import Allocation


UNITS = ("N", "N m", "N m", "N m")
REACH = 0.01  # of what is demanded of an axis: a law of other rotors than these misses as much within reach
MISSED = 1e-4  # where no law could do more, or this one's rotors are these: what rounding does not explain
REACH_OF = (1.0, 0.1, 0.1, 0.1)  # N, N m: less is demanded of no vehicle that these laws are for


def allocate(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    law: Annotated[
        str, typer.Option(help="standard, reduced, coaxial, exact, ...", autocompletion=laws)
    ] = "coaxial",
    wrench: Annotated[str, typer.Option(metavar="F,TX,TY,TZ", help="Thrust (up) in N, then N m, FRD.")] = "",
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    law_rotor: Annotated[
        Path | None, typer.Option(help="What the law believes, if not the rotors it is weighed on.")
    ] = None,
    voltage: VoltageOption = None,
    height: HeightOption = None,
    climb: ClimbOption = None,
    density: DensityOption = None,
    json_file: JsonOption = None,
) -> None:
    """One allocation: speeds, thrusts, torques, and what the rotors miss of the wrench."""
    from coaxlink import files, mixer
    from coaxlink.airframe import AXES

    demand = parse_wrench(wrench)
    conditions: dict[str, Any] = {"voltage": voltage, "height": height, "climb": climb, "density": density}
    true, _ = vehicle_of(airframe, rotor, **conditions)
    believed = vehicle_of(airframe, law_rotor, **conditions)[0] if law_rotor else true
    result = mixer.allocate(mixer.make_law(law, believed), true, demand)
    if json_file:
        files.write_json(json_file, result.to_json() | believed.to_json())
    say_effects(believed)

    from rich.table import Table

    out = console()
    lift, turn = abs(result.error[0]), max(abs(result.error[1:]))
    out.print(
        f"{result.law}: misses {figure(lift)} N and {figure(turn)} N m of the wrench, at "
        f"{result.power_W:.0f} W (power {result.power:.4f}, the sum of torque x speed)"
    )
    table = Table("rotor", "speed", "thrust N", "torque N m", "", box=None)
    for i, placed in enumerate(true.airframe.rotors):
        at = "at its bound" if result.saturated[i] else ""
        row = f"{result.speeds[i]:.4f}", f"{result.thrust_N[i]:.3f}", f"{result.torque_Nm[i]:.4f}"
        table.add_row(f"{placed.number} {placed.level}", *row, at)
    out.print(table)
    table = Table("axis", "demanded", "delivered", "error", box=None)
    for k, (axis, unit) in enumerate(zip(AXES, UNITS, strict=True)):
        gave_up = " (given up)" if axis in result.dropped else ""
        row = plain(result.wrench[k]), plain(result.delivered[k]), f"{figure(result.error[k])}{gave_up}"
        table.add_row(f"{axis} {unit}", *row)
    out.print(table)
    refuse_out_of_reach(result, exact=law == "exact" and not law_rotor)


def refuse_out_of_reach(result: Allocation, *, exact: bool) -> None:
    """Raises CheckFailed where an axis is missed and was given up, or a rotor is at its bound.

    An error with every rotor within its bounds is the law's own, not the vehicle's; `exact` says that this
    law has none.
    """
    from coaxlink.airframe import AXES

    if not any(result.saturated) and not result.dropped:
        return
    import numpy as np

    share = MISSED if exact or all(result.saturated) else REACH
    scale = np.maximum(np.abs(result.wrench), REACH_OF)
    missed = [
        f"{axis} {result.delivered[k]:.4g} of {result.wrench[k]:.4g} {UNITS[k]}"
        for k, axis in enumerate(AXES)
        if abs(result.error[k]) > share * scale[k]
    ]
    if missed:
        bound = [str(n + 1) for n, at in enumerate(result.saturated) if at]
        word = "rotor" if len(bound) == 1 else "rotors"
        who = "all rotors" if len(bound) == len(result.saturated) else f"{word} {', '.join(bound)}"
        at = f"; {who} at a bound" if bound else ""
        raise CheckFailed(f"out of reach of the {result.law} law: {'; '.join(missed)}{at}")


def plain(number: float) -> str:
    """Four decimals, or powers of ten where those would fill the screen."""
    number = number if abs(number) >= NOTHING else 0.0
    return f"{number:.4f}" if abs(number) < 1e6 else f"{number:.6g}"


def parse_wrench(text: str) -> list[float]:
    """`F,TX,TY,TZ` as four numbers. Raises InputError."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not all(abs(n) < float("inf") for n in numbers):
        raise InputError("--wrench", text or "(not given)", "four finite numbers F,TX,TY,TZ expected")
    return numbers
