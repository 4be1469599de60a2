"""What a table is worth, in words and as rows: the first thing to read before anybody bothers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from coaxlink.mixer.worth import DRIVE_EFFICIENCY, HARD, SAG, Worth, front
from coaxlink.tables.worth import CURVED, LIVE, ON_BOARD, Worths

NONE = "cannot"
OFF = (
    1.1,
    1.4,
)  # points of a saving, as printed less as flown over the stand's own rows: research/real_pairs.py
NOTICED = 1.03  # of the ceiling: as much as a pack's charge moves it within a minute of flight
EXACT_WAY = (
    "No table holds it: it flies on a PX4 firmware of your own (coaxlink bridge) or from a "
    "companion (coaxlink mix)."
)


def sentences(worths: Worths) -> list[str]:
    """What the table that `table` writes gains and loses against the board's or the standard one, and what
    the curve alone would; none where one of both is missing."""
    name = worths.chosen if worths.chosen != "standard" else "fitted"
    this, other = worths.named(name), worths.named(ON_BOARD) or worths.named("standard")
    if this is None or other is None:
        return []
    lines = [
        verdict(this, other),
        remark_on_curve(worths.named(CURVED), this, worths.own_curve),
        remark_on_exact(worths.named(LIVE), this),
    ]
    return [line for line in lines if line]


def to_json(
    worths: Worths, battery_Wh: float | None = None, drive_efficiency: float = DRIVE_EFFICIENCY
) -> dict[str, Any]:
    """The `worth` part of the JSON of `compare` and `demo`."""
    tables = []
    for row, best in zip(worths.rows, front(worths.rows), strict=True):
        minutes = row.minutes(battery_Wh, drive_efficiency) if battery_Wh is not None else math.nan
        tables.append(
            row.to_json() | {"hover_minutes": minutes if math.isfinite(minutes) else None, "front": best}
        )
    return {
        "summary": sentences(worths),
        "own_curve": worths.own_curve,
        "chosen": worths.chosen,
        "tables": tables,
        "left_out": worths.left_out,
    }


def verdict(this: Worth, other: Worth) -> str:
    """One sentence: what `this` gains and loses against `other`, and where nobody will notice."""
    if math.isnan(this.hover_W):
        return f"the {this.name} table cannot carry this vehicle"
    if math.isnan(other.hover_W):
        return f"the {this.name} table carries this vehicle, the {other.name} one does not"
    (power_W, _), (before_W, where) = this.drawn, other.drawn
    saved = 1.0 - power_W / before_W
    loads = "{:.3g} to {:.3g} kg".format(*this.load_kg)
    same = abs(saved) < 5e-4  # a figure that is shown as 0.0 %
    power = f"needs the hover power of the {other.name} one"
    if not same:
        longer = f"{before_W / power_W - 1.0:+.1%} time in the air"
        word = "saves" if saved > 0 else "costs"
        power = f"{word} {abs(saved):.1%} of hover power {where} against the {other.name} one ({longer})"
    gains = (
        f"Loop gains change by {_within(this)} from {loads} ({other.name}: {_within(other)})"
        if np.isfinite([this.load_span, other.load_span]).all()
        else f"Not both tables carry {loads}"
    )
    ceiling = f"ceiling {this.thrust_to_weight:.2f} times the weight ({other.thrust_to_weight:.2f}"
    yaw, before = this.limits[2].moment_Nm, other.limits[2].moment_Nm
    margins = {
        f"{ceiling}{_against(this.ceiling_N, other.ceiling_N)})": this.ceiling_N >= 0.999 * other.ceiling_N,
        f"yaw {yaw:.1f} N m until a rotor is at its bound ({before:.1f}{_against(yaw, before)})": yaw
        >= 0.999 * before,
    }
    lost = [text for text, kept in margins.items() if not kept]
    kept = [text for text, kept in margins.items() if kept]
    reported = [f"The {this.name} table {power}{', and gives up: ' + ', '.join(lost) if lost else ''}."]
    reported += [f"It keeps: {', '.join(kept)}."] if kept else []
    notice = "nothing" if same else "the power alone"
    return (
        f"{' '.join(reported)} {gains}. Integrators take off all of the error but {_left(this)} "
        f"({other.name}: {_left(other)}): in calm hover and slow circles you notice {notice}."
    )


def remark_on_exact(exact: Worth | None, this: Worth) -> str:
    """What the exact law has beyond a table, and what that costs; empty where nobody would notice."""
    if exact is None or not exact.ceiling_N > NOTICED * this.ceiling_N:
        return ""
    return (
        f"The exact law lifts {exact.thrust_to_weight:.2f} times the weight at {exact.drawn[0]:.0f} W in "
        f"hover ({this.name}: {this.thrust_to_weight:.2f}, {this.drawn[0]:.0f} W). {EXACT_WAY}"
    )


def price(this: Worth, other: Worth, against: str) -> list[str]:
    """What a table costs beside another, a line a figure: ceiling, yaw authority, hover power."""

    def changed(new: float, old: float) -> str:
        return f" ({new / old - 1.0:+.1%})" if math.isfinite(new) and math.isfinite(old) and old else ""

    yaw, yaw_before = (t.limits[2].moment_Nm for t in (this, other))
    (power, where), (before, _) = this.drawn, other.drawn
    return [
        f"ceiling: {this.ceiling_N:.0f} N, {this.thrust_to_weight:.2f} times the weight; {against} "
        f"{other.ceiling_N:.0f} N, {other.thrust_to_weight:.2f}{changed(this.ceiling_N, other.ceiling_N)}",
        f"yaw authority: {_number(yaw, '.1f')} N m in hover until a rotor is at its bound; {against} "
        f"{_number(yaw_before, '.1f')} N m{changed(yaw, yaw_before)}",
        f"hover power: {_number(power, '.0f')} W {where}; {against} "
        f"{_number(before, '.0f')} W{changed(power, before)}",
        *(
            [f"the exact law gives up no ceiling. {EXACT_WAY}"]
            if other.ceiling_N > NOTICED * this.ceiling_N
            else []
        ),
    ]


def remark_on_curve(curved: Worth | None, this: Worth, curve: float | None) -> str:
    """What THR_MDL_FAC alone gives, empty where that is not known."""
    if curved is None or curve is None or not np.isfinite(curved.load_span).all():
        return ""
    dearer = curved.drawn[0] / this.drawn[0] - 1.0
    return (
        f"THR_MDL_FAC {curve:.2f} in the standard table alone (`law` curved): loop gains change by "
        f"{_within(curved)}, ceiling {curved.thrust_to_weight:.2f} times the weight, hover power "
        f"{dearer:+.1%} against the {this.name} table; a hard turn puts {_tipped(curved):.2f} N m into roll "
        f"or pitch ({this.name}: {_tipped(this):.2f})."
    )


def rows(
    tables: Sequence[Worth], battery_Wh: float | None = None, drive_efficiency: float = DRIVE_EFFICIENCY
) -> list[list[str]]:
    """A row a figure with its unit, a column a table; the first cell says what it is."""
    low, high = tables[0].load_kg
    hard = tables[0].hard_Nm
    first = tables[0]
    made: list[tuple[str, list[str]]] = []
    measured = any(math.isfinite(t.battery_W) for t in tables)
    if measured:
        made.append(("hover power from the battery, W", [_number(t.battery_W, ".0f") for t in tables]))
    made += [
        ("hover power at the shafts, W", [_number(t.hover_W, ".0f") for t in tables]),
        (
            f"time in the air against {first.name}, %",
            [_share(first.drawn[0] / t.drawn[0] - 1.0) for t in tables],
        ),
    ]
    if battery_Wh is not None:
        minutes = [_number(t.minutes(battery_Wh, drive_efficiency), ".1f") for t in tables]
        by = "" if measured else f", drive {drive_efficiency:.0%}"
        made.append((f"hover on {battery_Wh:g} Wh{by}, minutes", minutes))
    made += [
        ("ceiling, N", [f"{t.ceiling_N:.0f}" for t in tables]),
        ("ceiling, times the weight", [f"{t.thrust_to_weight:.2f}" for t in tables]),
        ("held in hard roll and yaw at once, kg", [_number(t.held_kg, ".1f") for t in tables]),
        ("yaw authority in hover, N m", [_number(t.limits[2].moment_Nm, ".1f") for t in tables]),
        ("roll authority in hover, N m", [_number(t.limits[0].moment_Nm, ".1f") for t in tables]),
        ("vertical gain in hover (loops expect 1)", [_number(t.lift_exponent, ".2f") for t in tables]),
        (f"loop gains, {low:.3g} to {high:.3g} kg, change %", [_change(t.load_span) for t in tables]),
        (f"loop gains, full to {SAG:.0%} voltage, change %", [_change(t.sag_span) for t in tables]),
        (f"lift lost at {hard[0]:.0f} N m of roll, N", [_signed(-t.coupling[0, 0]) for t in tables]),
        (f"lift lost at {hard[2]:.1f} N m of yaw, N", [_signed(-t.coupling[2, 0]) for t in tables]),
        (f"roll or pitch from {hard[2]:.1f} N m of yaw, N m", [_number(_tipped(t), ".2f") for t in tables]),
        ("error after integrators: lift, N", [_number(t.shape_error[0], ".2f") for t in tables]),
        ("  torque, N m", [_number(float(t.shape_error[1:].max()), ".3f") for t in tables]),
    ]
    return [[label, *cells] for label, cells in made]


def used(worths: Worths) -> str:
    """What the marked column is."""
    if worths.used == ON_BOARD:
        return f"flies now; coaxlink table would write {worths.chosen}"
    return "what coaxlink table writes where no law is named"


def terms() -> str:
    """What the rows' words mean, one paragraph."""
    return (
        "Power is the rotor model's: of twenty measured pairs a saving was off by "
        f"{OFF[0]:g} points at the shafts and {OFF[1]:g} from the battery (rms). "
        "Authority: torque when the first rotor is at a bound. Vertical gain: thrust over demand, as the "
        "height loop meets it. Held: the most that any thrust demand carries under both torques below at "
        "once. Lift lost: what an autopilot must make up while that one torque is demanded, "
        f"{HARD:g} times what an ordinary flight meets. Error after integrators: mean |error| from 0.77 to "
        "1.33 of the weight, the best constant gain an axis taken off."
    )


def _tipped(t: Worth) -> float:
    """What a hard yaw demand puts into roll or pitch, N m."""
    return float(np.abs(t.coupling[2, 1:3]).max())


def _left(t: Worth) -> str:
    return f"{t.shape_error[0]:.2f} N and {float(t.shape_error[1:].max()):.2f} N m"


def _change(span: np.ndarray) -> str:
    return _number(100.0 * (float(span.max()) - 1.0), ".1f")


def _against(new: float, old: float) -> str:
    return f", {new / old - 1.0:+.0%}" if math.isfinite(new) and math.isfinite(old) and old else ""


def _within(t: Worth) -> str:
    return f"{float(t.load_span.max()) - 1.0:.1%}"


def _number(x: float, form: str) -> str:
    return f"{x:{form}}" if math.isfinite(x) else NONE


def _share(x: float) -> str:
    return f"{100 * x if abs(x) >= 5e-4 else 0.0:+.1f}" if math.isfinite(x) else NONE


def _signed(x: float) -> str:
    return f"{x if abs(x) >= 5e-3 else 0.0:+.2f}" if math.isfinite(x) else NONE
