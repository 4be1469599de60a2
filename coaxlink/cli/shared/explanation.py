"""How `coaxlink table --explain` looks: what is demanded and done, its worth, what changes on board."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

from coaxlink.report.terminal import table

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.tables.rate_gains import AxisGain
    from coaxlink.uploading.explain import Explanation

_EQUAL = 0.005  # of the axis's largest entry: what differs by less is shown as one number
_STEM = "ATC_RAT_"
_ROTOR = re.compile(r"CA_ROTOR(\d+)_(\w+)")


def show(
    out: Any, frame: Airframe, explained: Explanation, firmware: str, gains: tuple[AxisGain, ...]
) -> None:
    """Print it to a rich console, what it is worth in words first."""
    from coaxlink.report.worth import verdict

    if explained.worth.name != explained.worth_before.name:
        out.print(f"\n{verdict(explained.worth, explained.worth_before)}")
    _show_mix(out, frame, explained, firmware)
    _show_worth(out, explained)
    _show_gains(out, gains, under(explained.reference_name))
    _show_changes(out, explained)


def under(reference_name: str) -> str:
    """Where a comparison stands, in words."""
    return reference_name if reference_name == "on board" else f"under the {reference_name}"


def _show_mix(out: Any, frame: Airframe, explained: Explanation, firmware: str) -> None:
    out.print(f"\nWhat the law demands of each rotor, and what {firmware} does")
    out.print("thousandths of squared speed, for 1 N m of roll, pitch or yaw and for 1 N of thrust")
    rows = []
    largest = abs(explained.demanded).max(axis=0)
    for n, rotor in enumerate(frame.rotors):
        cells = []
        for demanded, done, top in zip(explained.demanded[n], explained.done[n], largest, strict=True):
            same = abs(done - demanded) <= _EQUAL * top
            cells.append(f"{1e3 * demanded:+.2f}" + ("" if same else f" -> {1e3 * done:+.2f}"))
        rows.append((f"{rotor.number} {rotor.level}", *cells))
    out.print(table("", ("rotor", *explained.axes), rows))
    axis, worst = max(explained.worst.items(), key=lambda item: item[1])
    if worst <= _EQUAL:
        out.print(
            f"{firmware} does what the law demands, to {max(worst, 1e-4):.2%} of an axis's largest entry"
        )
    else:
        out.print(
            f"demanded -> done where they differ: by {worst:.1%} of the largest entry at most, on {axis}"
        )


def _show_worth(out: Any, explained: Explanation) -> None:
    from coaxlink.airframe import AXES
    from coaxlink.report.worth import first_bound

    this, other = explained.flown, explained.reference
    now, before = explained.worth, explained.worth_before
    low, high = now.load_kg
    out.print("\nWhat that is worth in hover, by the rotor model")
    hard = now.hard_Nm[2]
    rows = [
        ("thrust demand, 0..1", _shown(other.hover), _shown(this.hover)),
        ("power at the shafts, W", *_pair(before.hover_W, now.hover_W, ".0f")),
        ("vertical gain (1 is counted on)", *_pair(before.lift_exponent, now.lift_exponent, ".2f")),
    ]
    rows += [
        (f"largest / least {axis} gain, {low:.3g}-{high:.3g} kg", *_pair(a, b, ".3f"))
        for axis, a, b in zip(AXES, before.load_span, now.load_span, strict=True)
        if axis in ("thrust", "yaw")
    ]
    rows += [
        ("ceiling, N", *_pair(other.ceiling_N, this.ceiling_N, ".1f")),
        ("first at its bound in yaw", first_bound(before.limits[2]), first_bound(now.limits[2])),
        (f"thrust off at {hard:.1f} N m of yaw, N",
         f"{before.coupling[2, 0]:+.2f}", f"{now.coupling[2, 0]:+.2f}"),
    ]  # fmt: skip
    rows += [
        (f"{axis} in hover to the first bound, N m", *_pair(a, b, ".2f"))
        for axis, a, b in zip(explained.axes, other.authority_Nm, this.authority_Nm, strict=False)
    ]
    rows += [
        (f"{axis} moment per unit of demand, N m", *_pair(a, b, ".2f"))
        for axis, a, b in zip(explained.axes, other.gain_Nm, this.gain_Nm, strict=False)
    ]
    out.print(table("", ("", explained.reference_name, "this table", "change"), rows))


def _show_gains(out: Any, gains: tuple[AxisGain, ...], against: str) -> None:
    """What to do to the rate gains; no gain mends an axis that turns the wrong way."""
    usable = [gain for gain in gains if gain.usable]
    if not usable:
        return
    out.print(f"\nRate gains that keep the loops as they are {against}")
    for gain in usable:
        held = [f"{n.removeprefix(_STEM)} {v:.4g} -> {gain.wanted[n]:.4g}" for n, v in gain.held.items()]
        name = gain.names[0] if len(gain.names) == 1 else f"{gain.names[0]}, I, D"
        shown = ", ".join(text.partition(" ")[2] if len(gain.names) == 1 else text for text in held)
        out.print(f" {name} x {gain.scale:.3f}" + (f": {shown}" if shown else ""))


def _show_changes(out: Any, explained: Explanation) -> None:
    if not explained.changed:
        return
    out.print(f"\nWhat this table changes on board: {len(explained.changed)} parameters")
    rotors: dict[int, dict[str, str]] = {}
    for name, old, new in explained.changed:
        shown = f"{old:.5g} -> {new:.5g}"
        if match := _ROTOR.fullmatch(name):
            rotors.setdefault(int(match[1]), {})[match[2]] = shown
        else:
            out.print(f" {name} {shown}")
    if rotors:
        keys = sorted({key for row in rotors.values() for key in row})
        rows = [(f"CA_ROTOR{n}_*", *(row.get(key, "") for key in keys)) for n, row in sorted(rotors.items())]
        out.print(table("", ("parameter", *keys), rows))


def _pair(old: float, new: float, form: str) -> tuple[str, str, str]:
    change = f"{(new - old) / abs(old):+.1%}" if old and math.isfinite(old) and math.isfinite(new) else ""
    return f"{old:{form}}", f"{new:{form}}", change


def _shown(value: float | None) -> str:
    return "none" if value is None else f"{value:.3f}"
