"""PX4's CA_* parameters as a layout (v1.14 and later; v1.13 with SYS_CTRL_ALLOC = 1)."""

from __future__ import annotations

import re
from collections.abc import Mapping

from coaxlink.errors import InputError
from coaxlink.setup.layout import Layout, Mount
from firmware_params import px4
from firmware_params.errors import TableError

_OUTPUT = re.compile(r"PWM_(MAIN|AUX)_FUNC(\d+)|(UAVCAN|HIL|TAP)_(?:ESC_FUNC|EC_FUNC|ACT_FUNC)(\d+)")
_FIRST_MOTOR = 101  # of the *_FUNC parameters: 101 is motor 1
_FLAT_M = 1e-3  # heights that differ by less are no heights


def px4_layout(params: Mapping[str, float | int], source: str) -> Layout:
    """Raises InputError where the parameters hold no multirotor."""
    if "CA_ROTOR_COUNT" not in params:
        raise InputError(
            source, "CA_ROTOR_COUNT", "missing: PX4 v1.14 or later with a multirotor is expected"
        )
    try:
        table = px4.params_to_table(params)
    except TableError as error:
        raise InputError(source, "", f"holds no multirotor: {error}") from error
    outputs = _outputs(params)
    heights = [rotor.position_m[2] for rotor in table.rotors]
    flat = max(heights) - min(heights) < _FLAT_M
    mounts = []
    for n, rotor in enumerate(table.rotors, start=1):
        if rotor.km == 0.0:
            raise InputError(source, f"CA_ROTOR{n - 1}_KM", "0: which way the rotor turns is not known")
        x, y, z = rotor.position_m
        spin = "ccw" if rotor.km > 0 else "cw"
        mounts.append(
            Mount(x, y, None if flat else z, spin, None, " and ".join(outputs.get(n, ())), rotor.axis)
        )
    notes = []
    if flat:
        notes.append("CA_ROTOR*_PZ are all alike: which rotor of a pair is the upper one stands nowhere")
    unassigned = [n for n in range(1, len(mounts) + 1) if n not in outputs]
    if outputs and unassigned:
        notes.append(f"no output is assigned to rotor {', '.join(map(str, unassigned))}")
    return Layout(source, tuple(mounts), metres=True, notes=tuple(notes))


def _outputs(params: Mapping[str, float | int]) -> dict[int, list[str]]:
    """Motor number -> connectors."""
    found: dict[int, list[str]] = {}
    for name, value in params.items():
        match = _OUTPUT.fullmatch(name)
        if match and value >= _FIRST_MOTOR:
            connector = f"{match[1] or match[3]} {match[2] or match[4]}"
            found.setdefault(int(value) - _FIRST_MOTOR + 1, []).append(connector)
    return found
