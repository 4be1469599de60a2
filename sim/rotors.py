"""The paper's coaxial pair as the world turns it: eq. 17 surfaces, by Horner on dense coefficients.

Upper and lower thrust (N) and torque (N m) are polynomials of the normalised speeds u_u, u_l = rpm / top
(Berra, Trujillo and Heredia 2024, eq. 1-3, 17). The reader and the evaluation are the world's own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_params import bounded
from firmware_params.keys import unknown_key
from firmware_params.plain import plain
from sim.errors import WorldError

ORDER = 4  # highest power of either speed a rotor file may use
KEYS = ("form", "speed_max_rpm", "upper", "lower", "blades", "effects", "identified")
SURFACES = (("upper", "thrust_N"), ("upper", "torque_Nm"), ("lower", "thrust_N"), ("lower", "torque_Nm"))


@dataclass(frozen=True)
class Pair:
    """A coaxial pair: coefficients[s, a, b] multiplies u_u^a u_l^b of surface s (see SURFACES)."""

    speed_max_rpm: float
    coefficients: NDArray[np.float64]  # (4, ORDER + 1, ORDER + 1)

    @property
    def radius_m(self) -> float:
        """Of the disc; where a rotor file does not say: 18.5 in."""
        return 0.235

    def compiled(self) -> tuple[Any, Any, Any]:
        """What the compiled plant turns: 24 coefficients of eq. 17, any powers, or blades; else None."""
        c = self.coefficients
        used = np.nonzero(c.any(axis=0))
        top = max(2, *(int(axis.max(initial=0)) for axis in used)) + 1
        if top > 3 or c[:2, :, 1:].any():
            return None, np.ascontiguousarray(c[:, :top, :top]), None
        upper = [c[s, a, 0] for s in (0, 1) for a in (2, 1, 0)]
        lower = [c[s, a, b] for s in (2, 3) for a in (2, 1, 0) for b in (2, 1, 0)]
        return tuple(float(x) for x in upper + lower), None, None

    def loads(self, u_upper: ArrayLike, u_lower: ArrayLike) -> NDArray[np.float64]:
        """(4, ...) upper thrust, upper torque, lower thrust, lower torque at normalised speeds."""
        upper, lower = np.broadcast_arrays(np.asarray(u_upper, float), np.asarray(u_lower, float))
        total = np.zeros((4, *upper.shape))
        for s in range(4):
            for a in range(ORDER, -1, -1):
                row = np.zeros(upper.shape)
                for b in range(ORDER, -1, -1):
                    row = row * lower + self.coefficients[s, a, b]
                total[s] = total[s] * upper + row
        return total


def read_document(path: Path) -> dict[str, Any]:
    """A TOML file as a dict. Raises WorldError."""
    try:
        return bounded.parse_toml(bounded.read_text(path, bounded.SETTINGS))
    except OSError as error:
        raise WorldError(path, "", f"cannot be read ({error.strerror})") from error
    except bounded.Unreadable as error:
        raise WorldError(path, error.where, error.problem) from error


def refuse_unknown(path: Path, where: str, table: dict[str, Any], known: Iterable[str]) -> None:
    """Raises WorldError for a key that is not in `known`, naming the nearest one that is."""
    if odd := unknown_key(table, known):
        raise WorldError(path, f"{where}.{odd[0]}" if where else odd[0], odd[1])


def read_number(path: Path, where: str, value: object) -> float:
    """`value` as a finite float. Raises WorldError naming the key."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise WorldError(path, where, f"a finite number is expected, found {plain(repr(value), 80)}")
    return float(value)


def read_pair(path: Path) -> Pair:
    """Read a rotor file, of surfaces (`rotor_paper.toml` shows the format) or of blades (`pairs/*.toml`).

    A name without a file is looked up among the world's own pairs. Raises WorldError.
    """
    own = Path(__file__).parent / "pairs" / f"{path.name}.toml"
    if not path.exists() and own.is_file():
        path = own
    document = read_document(path)
    refuse_unknown(path, "", document, KEYS)
    top = read_number(path, "speed_max_rpm", document.get("speed_max_rpm"))
    if top <= 0:
        raise WorldError(path, "speed_max_rpm", f"a positive number is expected, found {top}")
    if document.get("form") == "bemt":
        from sim.bemt import bemt_pair

        return bemt_pair(path, document, top)
    coefficients = np.zeros((4, ORDER + 1, ORDER + 1))
    for s, (rotor, load) in enumerate(SURFACES):
        section = document.get(rotor)
        if isinstance(section, dict):
            refuse_unknown(path, rotor, section, ("thrust_N", "torque_Nm"))
        terms = section.get(load) if isinstance(section, dict) else None
        if not isinstance(terms, dict) or not terms:
            raise WorldError(path, f"{rotor}.{load}", "a table of terms is expected")
        for name, value in terms.items():
            where = f"{rotor}.{load}.{name}"
            a, b = _powers(path, where, name)
            coefficients[s, a, b] += read_number(path, where, value)
    return Pair(top, coefficients)


def _powers(path: Path, where: str, name: str) -> tuple[int, int]:
    powers = {"u_u": 0, "u_l": 0}
    for factor in name.split():
        base, _, exponent = factor.partition("^")
        if factor == "1":
            continue
        if base not in powers or (exponent and not exponent.isdecimal()):
            raise WorldError(path, where, "a term is a product of powers such as 'u_u^2 u_l', or '1'")
        powers[base] += int(exponent or 1)
    if max(powers.values()) > ORDER:
        raise WorldError(path, where, f"the world's rotors know powers up to {ORDER}")
    return powers["u_u"], powers["u_l"]
