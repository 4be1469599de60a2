"""Rotor files: surfaces of the paper's form (`sim.physics.pair`), with a drive (`sim.physics.driven_pair`),
a raw stand map (`sim.physics.tabled_pair`), or blades (`sim.physics.bemt`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim.documents import read_document, read_number, refuse_unknown
from sim.errors import SimulationError
from sim.physics.bemt import bemt_pair
from sim.physics.driven_pair import driven_pair
from sim.physics.pair import ORDER, Pair
from sim.physics.tabled_pair import map_pair

KEYS = (
    "form", "speed_max_rpm", "rotation", "upper", "lower", "blades", "effects", "identified", "sources",
    "drive", "battery_power",
)  # fmt: skip
SURFACES = (("upper", "thrust_N"), ("upper", "torque_Nm"), ("lower", "thrust_N"), ("lower", "torque_Nm"))


def read_pair(path: Path) -> Pair:
    """Read a rotor file, of surfaces (`rotor_paper.toml` shows the format) or of blades (`pairs/*.toml`), or
    a raw stand map (CSV).

    A name without a file is looked up among the world's own pairs. Raises WorldError.
    """
    own = Path(__file__).parents[1] / "pairs" / f"{path.name}.toml"
    if not path.exists() and own.is_file():
        path = own
    if path.suffix.lower() == ".csv":
        return map_pair(path)
    document = read_document(path)
    refuse_unknown(path, "", document, KEYS)
    top = read_number(path, "speed_max_rpm", document.get("speed_max_rpm"))
    if top <= 0:
        raise SimulationError(path, "speed_max_rpm", f"a positive number is expected, found {top}")
    if document.get("form") == "bemt":
        return bemt_pair(path, document, top)
    coefficients = np.zeros((4, ORDER + 1, ORDER + 1))
    for s, (rotor, load) in enumerate(SURFACES):
        section = document.get(rotor)
        if isinstance(section, dict):
            refuse_unknown(path, rotor, section, ("thrust_N", "torque_Nm"))
        terms = section.get(load) if isinstance(section, dict) else None
        if not isinstance(terms, dict) or not terms:
            raise SimulationError(path, f"{rotor}.{load}", "a table of terms is expected")
        for name, value in terms.items():
            where = f"{rotor}.{load}.{name}"
            a, b = _powers(path, where, name)
            coefficients[s, a, b] += read_number(path, where, value)
    return driven_pair(path, Pair(top, coefficients), document)


def _powers(path: Path, where: str, name: str) -> tuple[int, int]:
    powers = {"u_u": 0, "u_l": 0}
    for factor in name.split():
        base, _, exponent = factor.partition("^")
        if factor == "1":
            continue
        if base not in powers or (exponent and not exponent.isdecimal()):
            raise SimulationError(path, where, "a term is a product of powers such as 'u_u^2 u_l', or '1'")
        powers[base] += int(exponent or 1)
    if max(powers.values()) > ORDER:
        raise SimulationError(path, where, f"simulated rotors know powers up to {ORDER}")
    return powers["u_u"], powers["u_l"]
