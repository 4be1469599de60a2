"""A vehicle seen from above in plain characters: who is where, which way it turns."""

from __future__ import annotations

from coaxlink.airframe import Airframe, Rotor
from coaxlink.setup.layout import Layout

_WIDE, _HIGH = 36, 12  # columns and rows between the outermost arms


def draw(airframe: Airframe, layout: Layout | None = None) -> str:
    """Rows of text: nose up, the upper rotor of a pair over the lower, then a row a rotor.

    Outputs come from `layout` where a board told them.
    """
    reach = max(abs(p) for r in airframe.rotors for p in r.position_m[:2]) or 1.0
    lines = [" " * (_WIDE + 12) for _ in range(_HIGH + 2)]

    def put(x: float, y: float, below: int, text: str) -> None:
        row = round((1.0 - x / reach) * _HIGH / 2) + below
        column = round((1.0 + y / reach) * _WIDE / 2)
        lines[row] = lines[row][:column] + text + lines[row][column + len(text) :]

    put(0.0, 0.0, 0, "     +")
    for rotor in airframe.rotors:
        x, y, _ = rotor.position_m
        put(x, y, rotor.level == "lower", f"{rotor.number:>2} {rotor.level} {_turn(rotor)}")
    nose = " " * (_WIDE // 2 + 5) + "^ nose"
    picture = "\n".join(line.rstrip() for line in lines).rstrip()
    return "\n".join([nose, "", picture, "", *_rows(airframe, layout)])


def _rows(airframe: Airframe, layout: Layout | None) -> list[str]:
    rows = ["rotor  level   turns  pair    x m     y m     z m   output"]
    for n, rotor in enumerate(airframe.rotors):
        x, y, z = rotor.position_m
        row = f"{rotor.number:>5}  {rotor.level:<6}  {_turn(rotor):<5}  {rotor.pair or '-':>4}"
        output = layout.mounts[n].output if layout else ""
        rows.append(f"{row}  {x:+.3f}  {y:+.3f}  {z:+.3f}   {output}".rstrip())
    return rows


def _turn(rotor: Rotor) -> str:
    return "ccw" if rotor.yaw_sign > 0 else "cw"
