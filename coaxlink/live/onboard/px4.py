"""The external module for PX4: the exact law in the allocator's place, a companion's outputs while fresh."""

from __future__ import annotations

from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import ArrayLike

from coaxlink._version import __version__
from coaxlink.errors import InputError
from coaxlink.live.onboard.description import BoardLaw

FOLDER = Path(__file__).with_name("px4_module")
SOURCES = ("CoaxMixer.cpp", "CoaxMixer.hpp", "Companion.hpp", "coax_law.hpp", "module.yaml")
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
        upper=arms.upper_order,
        lower=arms.lower_order,
        slots=", ".join(map(str, about.units.slots)),
        hover=_number(about.hover),
        load=_table(arms.load),
        gain=_table(arms.gain),
        lo=_table(arms.lo),
        hi=_table(arms.hi),
        cap=_table(arms.cap),
        reduced=_table(about.reduced),
        demand=_table(about.demand),
        wrench=_table(about.wrench),
        back=_table(np.linalg.inv(about.demand)),
    )


def plain_ascii(text: str) -> str:
    """One line that ends no comment: what a vehicle may be called is not code."""
    return "".join(c if c.isascii() and c.isprintable() and c not in "\\$?" else "_" for c in text)[:80]


def _number(value: float) -> str:
    return f"Real({value:.17g})"


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
