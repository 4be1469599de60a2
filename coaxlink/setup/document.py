"""An airframe as the text of its file, with comments that say where each number comes from."""

from __future__ import annotations

import tomli_w

from coaxlink.airframe import Airframe
from firmware_params.text import comment

_HEAD = """\
# {source}
# Body frame: x forward, y right, z down, from the centre of mass. Every key: docs/airframe.md
"""


def airframe_toml(airframe: Airframe, source: str, *, rotor_model: str | None = None) -> str:
    """The text of an airframe file; `load_airframe` gives the same vehicle back (to 1e-6 m)."""
    head = {"name": airframe.name, "mass_kg": airframe.mass_kg}
    text = _HEAD.format(source=comment(source)) + tomli_w.dumps(head)
    inertia = ", ".join(f"{value:.4g}" for value in airframe.inertia_kg_m2)
    guessed = airframe.source_of("inertia_kg_m2") == "estimated"
    remark = "  # an estimate (half the mass in the rotors): measure it" if guessed else ""
    text += f"inertia_kg_m2 = [{inertia}]{remark}\n"
    text += f"motor_lag_s = {airframe.motor_lag_s:g}  # command to speed, first order\n"
    if airframe.battery_Wh is not None:
        text += f"battery_Wh = {airframe.battery_Wh:g}\n"
    if rotor_model:
        text += tomli_w.dumps({"rotor_model": rotor_model})
    else:
        text += '# rotor_model = "rotor.toml"  # from coaxlink identify\n'
    if airframe.sources:
        text += (
            "\n# measured, declared, board, estimated or default; docs/howto/measure.md makes them measured\n"
        )
        text += tomli_w.dumps({"sources": dict(airframe.sources)})
    for rotor in airframe.rotors:
        text += f"\n[[rotors]]\nnumber = {rotor.number}\n"
        text += f"position_m = [{', '.join(_number(p) for p in rotor.position_m)}]\n"
        if rotor.axis != (0.0, 0.0, -1.0):
            text += f"axis = [{', '.join(_number(a) for a in rotor.axis)}]\n"
        text += f'spin = "{"ccw" if rotor.yaw_sign > 0 else "cw"}"\nlevel = "{rotor.level}"\n'
        if rotor.pair is not None:
            text += f"pair = {rotor.pair}\n"
    return text


def _number(value: float) -> str:
    text = f"{value:.6f}".rstrip("0")
    return text + "0" if text.endswith(".") else text
