"""The vehicle, read from an airframe file by the world's own reader (`x8_paper.toml` shows the format).

Body frame FRD from the nominal centre of mass, SI units. Spin is seen from above; a counter-clockwise rotor
pushes the body to +yaw.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_params.plain import name_problem
from sim.documents import read_document, read_number, refuse_unknown
from sim.errors import SimulationError

UPPER, LOWER, SINGLE = 0, 1, 2
LEVELS = {"upper": UPPER, "lower": LOWER, "single": SINGLE}

KEYS = (
    "name",
    "mass_kg",
    "inertia_kg_m2",
    "rotor_model",
    "motor_lag_s",
    "battery_Wh",
    "attitude_loop",
    "rotors",
    "sources",  # of the owner's numbers; the world's are the file's
    "defaults",  # of the owner's calls
)
# from the smallest toys (a Cheerson CX-10 has 12 g) to those that carry people (a VoloCity, 0.9 t)
MASS_KG = (0.005, 2000.0)
LAG_S = (0.0, 2.0)  # small motors have 10 to 100 ms, rotors of 2 m a few tenths; slower ones steer nothing
ROTOR_KEYS = ("number", "position_m", "spin", "level", "pair", "axis")


@dataclass(frozen=True)
class SimVehicle:
    """N rotors in the order of their numbers, and the body they carry."""

    name: str
    mass_kg: float
    inertia_kg_m2: NDArray[np.float64]  # (3,)
    position_m: NDArray[np.float64]  # (N, 3)
    axis: NDArray[np.float64]  # (N, 3) unit vectors of thrust
    spin: NDArray[np.float64]  # (N,) +1 counter-clockwise, -1 clockwise
    level: NDArray[np.int64]  # (N,) UPPER, LOWER or SINGLE
    partner: NDArray[np.int64]  # (N,) index of the other rotor of the pair, or -1
    motor_lag_s: float
    rotor_file: Path | None

    @property
    def rotors(self) -> int:
        """How many."""
        return len(self.spin)


def read_vehicle(path: Path) -> SimVehicle:
    """Read an airframe file. Raises WorldError naming the key."""
    document = read_document(path)
    refuse_unknown(path, "", document, KEYS)
    tables = document.get("rotors")
    if not isinstance(tables, list) or not 3 <= len(tables) <= 16:
        raise SimulationError(path, "rotors", "3 to 16 [[rotors]] are expected")
    by_number = {t.get("number"): t for t in tables if isinstance(t, dict)}
    if set(by_number) != set(range(1, len(tables) + 1)):
        raise SimulationError(path, "rotors.number", f"numbers must run from 1 to {len(tables)}, each once")
    for number, table in by_number.items():
        refuse_unknown(path, f"rotors[{number}]", table, ROTOR_KEYS)
    ordered = [by_number[n] for n in range(1, len(tables) + 1)]
    axis = np.array(
        [_vector(path, f"rotors[{t['number']}].axis", t.get("axis", [0, 0, -1])) for t in ordered]
    )
    if not np.all(np.linalg.norm(axis, axis=1) > 1e-6):
        raise SimulationError(path, "rotors.axis", "a direction is expected, found none of any length")
    lag = read_number(path, "motor_lag_s", document.get("motor_lag_s", 0.0))
    rotor = document.get("rotor_model")
    mass = read_number(path, "mass_kg", document.get("mass_kg"))
    inertia = _vector(path, "inertia_kg_m2", document.get("inertia_kg_m2"))
    if min(inertia) <= 0:
        raise SimulationError(path, "inertia_kg_m2", "positive numbers are expected")
    refuse_body(path, mass, lag)
    return SimVehicle(
        _name(path, document.get("name", path.stem)),
        mass,
        np.array(inertia),
        np.array([_vector(path, f"rotors[{t['number']}].position_m", t.get("position_m")) for t in ordered]),
        axis / np.linalg.norm(axis, axis=1, keepdims=True),
        np.array([_choice(path, t, "spin", {"ccw": 1.0, "cw": -1.0}) for t in ordered]),
        np.array([_choice(path, t, "level", LEVELS) for t in ordered], dtype=np.int64),
        np.array([_partner(path, t, by_number) for t in ordered], dtype=np.int64),
        lag,
        path.parent / rotor if isinstance(rotor, str) else None,
    )


def refuse_body(path: Path, mass_kg: float, lag_s: float) -> None:
    """Raises WorldError for what no multirotor has."""
    for name, value, (low, high), what in (
        ("mass_kg", mass_kg, MASS_KG, "kg"),
        ("motor_lag_s", lag_s, LAG_S, "s from command to speed"),
    ):
        if not low <= value <= high:
            problem = f"{value:g}: {low:g} to {high:g} {what} are expected of a multirotor"
            raise SimulationError(path, name, problem)


def _name(path: Path, value: object) -> str:
    if problem := name_problem(str(value)):
        raise SimulationError(path, "name", problem)
    return str(value)


def _vector(path: Path, where: str, value: object) -> list[float]:
    if not isinstance(value, list) or len(value) != 3:
        raise SimulationError(path, where, f"three numbers are expected, found {value!r}")
    return [read_number(path, where, v) for v in value]


def _choice(path: Path, table: dict[str, Any], key: str, known: dict[str, Any]) -> Any:
    if table.get(key) not in known:
        where = f"rotors[{table['number']}].{key}"
        raise SimulationError(path, where, f"one of {', '.join(known)} is expected, found {table.get(key)!r}")
    return known[table[key]]


def _partner(path: Path, table: dict[str, Any], by_number: dict[Any, dict[str, Any]]) -> int:
    if table["level"] == "single":
        return -1
    other = by_number.get(table.get("pair"))
    levels = {table["level"], other["level"]} if other else set()
    if not other or other.get("pair") != table["number"] or levels != {"upper", "lower"}:
        where = f"rotors[{table['number']}].pair"
        raise SimulationError(path, where, "a pair is an upper and a lower rotor that name each other")
    return int(table["pair"]) - 1
