"""A mixer table as PX4 holds it: rotor geometry, thrust coefficients, one thrust curve for all.

Column n of the effectiveness is CT * axis (force) and CT * (position x axis) - CT * KM * axis (moment), body
frame FRD. A counter-clockwise rotor has KM > 0 (PX4 v1.14 and later; v1.13 with SYS_CTRL_ALLOC = 1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from firmware_params.errors import TableError
from firmware_params.px4.parameters import MAX_ROTORS, PARAMETERS, as_stored

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class RotorEntry:
    """One CA_ROTORn block."""

    position_m: Vector  # FRD, from the centre of mass
    axis: Vector  # thrust direction, FRD; up is (0, 0, -1)
    ct: float  # thrust at setpoint 1; N if the table is physical
    km: float  # torque / thrust, m; > 0 for a counter-clockwise rotor


@dataclass(frozen=True)
class Px4Table:
    """Everything PX4's multirotor allocation reads."""

    rotors: tuple[RotorEntry, ...]  # (N,), PX4's motor order
    thr_mdl_fac: float  # thrust = fac u^2 + (1 - fac) u
    airframe: int = 0
    method: int = 2  # 0 pseudo-inverse, 1 sequential desaturation, 2 auto (= 1 on a multirotor)
    airmode: int = 0  # MC_AIRMODE of the vehicle; read, never written
    reversible: int = 0  # CA_R_REV of the vehicle; read, never written


def table_to_params(table: Px4Table) -> dict[str, float | int]:
    """The parameters of a table, rounded as PX4 stores them. Raises TableError on too many rotors."""
    if len(table.rotors) > MAX_ROTORS:
        raise TableError(f"CA_ROTOR_COUNT = {len(table.rotors)} is above PX4's {MAX_ROTORS}")
    params: dict[str, float | int] = {
        "CA_AIRFRAME": table.airframe,
        "CA_ROTOR_COUNT": len(table.rotors),
        "CA_METHOD": table.method,
        "THR_MDL_FAC": table.thr_mdl_fac,
    }
    for n, rotor in enumerate(table.rotors):
        for kind, vector in (("P", rotor.position_m), ("A", rotor.axis)):
            params |= {f"CA_ROTOR{n}_{kind}{axis}": value for axis, value in zip("XYZ", vector, strict=True)}
        params[f"CA_ROTOR{n}_CT"] = rotor.ct
        params[f"CA_ROTOR{n}_KM"] = rotor.km
    return {name: as_stored(name, value) for name, value in params.items()}


def params_to_table(params: Mapping[str, float | int]) -> Px4Table:
    """The table that a set of parameters describes; a missing one has PX4's default. Raises TableError."""

    def get(name: str) -> float:
        return float(params.get(name, PARAMETERS[name].default))

    airframe, count = int(get("CA_AIRFRAME")), int(get("CA_ROTOR_COUNT"))
    if airframe != 0:
        raise TableError(f"CA_AIRFRAME = {airframe} is not a multirotor (0)")
    if not 1 <= count <= MAX_ROTORS:
        raise TableError(f"CA_ROTOR_COUNT = {count}: 1..{MAX_ROTORS} rotors are expected")

    def vector(n: int, kind: str) -> Vector:
        return (get(f"CA_ROTOR{n}_{kind}X"), get(f"CA_ROTOR{n}_{kind}Y"), get(f"CA_ROTOR{n}_{kind}Z"))

    rotors = tuple(
        RotorEntry(vector(n, "P"), vector(n, "A"), get(f"CA_ROTOR{n}_CT"), get(f"CA_ROTOR{n}_KM"))
        for n in range(count)
    )
    return Px4Table(
        rotors,
        get("THR_MDL_FAC"),
        airframe,
        int(get("CA_METHOD")),
        int(get("MC_AIRMODE")),
        int(get("CA_R_REV")),
    )
