"""The external module for PX4: the exact law in the allocator's place, a companion's outputs while fresh."""

from __future__ import annotations

from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import ArrayLike

from coaxlink._version import __version__
from coaxlink.errors import InputError
from coaxlink.live.onboard.description import BoardLaw
from coaxlink.mixer.edge import STRAIGHT, Edge

FOLDER = Path(__file__).with_name("px4_module")
SOURCES = ("CoaxMixer.cpp", "CoaxMixer.hpp", "Companion.hpp", "Share.hpp", "coax_law.hpp", "module.yaml")
MOTORS = 12  # actuator_motors_s::NUM_CONTROLS


def vehicle_header(about: BoardLaw, made_from: str) -> str:
    """`coax_vehicle.hpp`: the numbers of one vehicle."""
    arms = about.arms
    return Template((FOLDER / "coax_vehicle.hpp.in").read_text()).substitute(
        version=__version__,
        name=plain_ascii(about.name),
        made_from=plain_ascii(made_from),
        identity=f"0x{about.identity:06x}",
        rotors=about.rotors,
        arms=arms.size,
        surfaces=arms.surfaces,
        order_u=arms.order_u,
        order_s=arms.order_s,
        power_u=arms.power_u,
        power_s=arms.power_s,
        slots=", ".join(map(str, about.units.slots)),
        hover=_number(about.hover),
        surface=_table(arms.surface),
        power=_table(arms.power),
        lean=_table(about.units.lean),
        shares=len(about.shares.share),
        share=_singles(about.shares.share),
        lean_of=_singles(about.shares.lean),
        own_share=_single(about.shares.own),
        gain=_table(arms.gain),
        lo=_table(arms.lo),
        hi=_table(arms.hi),
        cap=_table(arms.cap),
        reduced=_table(arms.squares),
        line=_table(arms.line),
        home=_table(arms.home),
        within=_number(float(arms.within[0])),
        place=_table(about.bereft.place),
        still_surface=_table(about.bereft.surface),
        still_power=_table(about.bereft.power),
        **_drives(about.edge),
        demand=_table(about.demand),
        wrench=_table(about.wrench),
        back=_table(np.linalg.inv(about.demand)),
    )


def _drives(edge: Edge) -> dict[str, str]:
    """What turns a speed, as the header has it."""
    nominal = edge.nominal or (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    found = {"driven": "false" if edge.straight else "true", "nominal": _table(nominal)}
    drives = edge.drives or (STRAIGHT, STRAIGHT)
    torques = [np.array(drive.torque.coefficients) for drive in drives]
    shape = tuple(max(t.shape[i] for t in torques) for i in (0, 1))
    found |= {"torque_u": str(shape[0] - 1), "torque_l": str(shape[1] - 1)}
    for name, drive, torque in zip(("upper_drive", "lower_drive"), drives, torques, strict=True):
        dense = np.zeros(shape)
        dense[: torque.shape[0], : torque.shape[1]] = torque
        tables = _table(dense.ravel()), _table(drive.command), _table(drive.per_torque), _number(drive.least)
        found[name] = ", ".join(tables)
    return found


def plain_ascii(text: str) -> str:
    """One line that ends no comment: what a vehicle may be called is not code."""
    return "".join(c if c.isascii() and c.isprintable() and c not in "\\$?" else "_" for c in text)[:80]


def _number(value: float) -> str:
    return f"Real({value:.17g})"


def _single(value: float) -> str:
    return f"{np.float32(value):.8e}f"


def _singles(values: ArrayLike) -> str:
    return "{" + ", ".join(_single(v) for v in np.asarray(values, float)) + "}"


def _table(values: ArrayLike, depth: int = 1) -> str:
    array = np.asarray(values, float)
    if array.ndim == 1:
        return "{" + ", ".join(_number(v) for v in array) + "}"
    gap = "\n" + "\t" * depth
    return (
        "{"
        + gap
        + ("," + gap).join(_table(row, depth + 1) for row in array)
        + "\n"
        + "\t" * (depth - 1)
        + "}"
    )


def module_files(about: BoardLaw, made_from: str) -> dict[str, str]:
    """{path: text} of the tree for EXTERNAL_MODULES_LOCATION, the card's `etc/extras.txt`, and a README.

    `made_from` says in the numbers' header which airframe and rotor file they are from. Raises InputError for
    more rotors than PX4 has motors.
    """
    if not 1 <= about.rotors <= MOTORS:
        raise InputError(
            "bridge", "rotors", f"1 to {MOTORS} expected, as PX4 has motors; found {about.rotors}"
        )
    module = "src/modules/coax_mixer"
    words = {
        "name": plain_ascii(about.name),
        "identity": f"0x{about.identity:06x}",
        "hover": f"{about.hover:.3f}",
    }
    return {
        "src/CMakeLists.txt": (FOLDER / "src.CMakeLists.txt").read_text(),
        f"{module}/CMakeLists.txt": (FOLDER / "module.CMakeLists.txt").read_text(),
        **{f"{module}/{name}": (FOLDER / name).read_text() for name in SOURCES},
        f"{module}/coax_vehicle.hpp": vehicle_header(about, made_from),
        "etc/extras.txt": Template((FOLDER / "extras.txt.in").read_text()).substitute(words),
        "README.md": Template((FOLDER / "README.md.in").read_text()).substitute(words),
    }
