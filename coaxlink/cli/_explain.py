"""How `coaxlink table --explain` looks: what is asked and done, what that is worth, what changes on board."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.link.explain import Explanation

_EQUAL = 0.005  # of the axis's largest entry: what differs by less is shown as one number
_ROTOR = re.compile(r"CA_ROTOR(\d+)_(\w+)")


def show(out: Any, frame: Airframe, explained: Explanation, firmware: str, gains: tuple[str, ...]) -> None:
    """Print it to a rich console."""
    _show_mix(out, frame, explained, firmware)
    _show_worth(out, explained)
    _show_gains(out, explained, gains)
    _show_changes(out, explained)


def _show_mix(out: Any, frame: Airframe, explained: Explanation, firmware: str) -> None:
    from rich.table import Table

    out.print(f"\nWhat the law asks of each motor, and what {firmware} does")
    out.print("thousandths of squared speed, for 1 N m of roll, pitch or yaw and for 1 N of thrust")
    rows = Table("rotor", *explained.axes, box=None)
    largest = np.abs(explained.asked).max(axis=0)
    for n, rotor in enumerate(frame.rotors):
        cells = []
        for asked, done, top in zip(explained.asked[n], explained.done[n], largest, strict=True):
            same = abs(done - asked) <= _EQUAL * top
            cells.append(f"{1e3 * asked:+.2f}" + ("" if same else f" -> {1e3 * done:+.2f}"))
        rows.add_row(f"{rotor.number} {rotor.level}", *cells)
    out.print(rows)
    axis, worst = max(explained.worst.items(), key=lambda item: item[1])
    if worst <= _EQUAL:
        out.print(f"{firmware} does what the law asks, to {max(worst, 1e-4):.2%} of an axis's largest entry")
    else:
        out.print(f"asked -> done where they differ: by {worst:.1%} of the largest entry at most, on {axis}")


def _show_worth(out: Any, explained: Explanation) -> None:
    from rich.table import Table

    this, other = explained.flown, explained.reference
    out.print("\nWhat that is worth in hover, by the rotor model")
    rows = Table("", explained.reference_name, "this table", "change", box=None)
    rows.add_row("thrust demand, 0..1", _shown(other.hover), _shown(this.hover))
    rows.add_row("most thrust, N", *_pair(other.ceiling_N, this.ceiling_N, ".1f"))
    for axis, a, b in zip(explained.axes, other.authority_Nm, this.authority_Nm, strict=False):
        rows.add_row(f"most {axis} moment, N m", *_pair(a, b, ".2f"))
    for axis, a, b in zip(explained.axes, other.gain_Nm, this.gain_Nm, strict=False):
        rows.add_row(f"{axis} moment per unit of demand, N m", *_pair(a, b, ".2f"))
    out.print(rows)


def _show_gains(out: Any, explained: Explanation, gains: tuple[str, ...]) -> None:
    """What to do to the rate gains; no gain mends an axis that turns the wrong way."""
    hints = zip(gains, explained.flown.gain_hint(explained.reference), strict=True)
    usable = [(gain, scale) for gain, scale in hints if 0.0 < scale < float("inf")]
    if not usable:
        return
    reference = explained.reference_name
    under = reference if reference == "on board" else f"under the {reference}"
    out.print(f"\nRate gains that keep the loops as they are {under}")
    for gain, scale in usable:
        stem, letters = gain.removesuffix("[PID]"), "PID" if gain.endswith("[PID]") else ("",)
        held = [(k, explained.gains_now[stem + k]) for k in letters if stem + k in explained.gains_now]
        shown = ", ".join(f"{k} {v:.4g} -> {v * scale:.4g}".strip() for k, v in held)
        out.print(f" {stem}{', '.join(letters)} x {scale:.3f}" + (f": {shown}" if shown else ""))


def _show_changes(out: Any, explained: Explanation) -> None:
    from rich.table import Table

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
        rows = Table("parameter", *keys, box=None)
        for n, row in sorted(rotors.items()):
            rows.add_row(f"CA_ROTOR{n}_*", *(row.get(key, "") for key in keys))
        out.print(rows)


def _pair(old: float, new: float, form: str) -> tuple[str, str, str]:
    change = f"{(new - old) / abs(old):+.1%}" if old else ""
    return f"{old:{form}}", f"{new:{form}}", change


def _shown(value: float | None) -> str:
    return "none" if value is None else f"{value:.3f}"
