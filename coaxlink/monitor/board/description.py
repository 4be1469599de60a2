"""The mixer table on board of a PX4: what it is, and the wrench it believes it makes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.mixer.coefficients import reduced_coefficients, standard_coefficients
from coaxlink.monitor.board import ardupilot as board_ardupilot
from coaxlink.monitor.board.view import ABSURD, NEAR, Board, digest_of
from coaxlink.vehicle import Vehicle
from firmware_params.errors import FirmwareParamsError
from firmware_params.px4 import Px4Table, RotorEntry, params_to_table, realise

TABLE_NAMES = ("CA_AIRFRAME", "CA_METHOD", "CA_ROTOR_COUNT", "THR_MDL_FAC")
ROTOR_FIELDS = ("PX", "PY", "PZ", "AX", "AY", "AZ", "CT", "KM")
_PLACE_M = 0.02


def rotor_names(count: int) -> tuple[str, ...]:
    """The CA_ROTORn_* names of the first `count` rotors."""
    return tuple(f"CA_ROTOR{n}_{field}" for n in range(count) for field in ROTOR_FIELDS)


def table_parameters(parameters: Mapping[str, float]) -> dict[str, float]:
    """Those of `parameters` that belong to the table, in the order of their names."""
    if board_ardupilot.is_table(parameters):
        return board_ardupilot.table_parameters(parameters)
    return {n: v for n, v in sorted(parameters.items()) if n in TABLE_NAMES or n.startswith("CA_ROTOR")}


def describe(parameters: Mapping[str, float], vehicle: Vehicle) -> Board:
    """What the parameters heard so far say about the table, held against the vehicle.

    An ArduPilot's takes seconds where it may be the fitted law's.
    """
    if board_ardupilot.is_table(parameters):
        return board_ardupilot.describe(parameters, vehicle)
    table = table_parameters(parameters)
    count = table.get("CA_ROTOR_COUNT")
    if count is None:
        return Board("unread")
    if not math.isfinite(count) or not 0 < count <= 12:
        return Board("invalid", notes=(f"CA_ROTOR_COUNT is {count:g}: no rotors configured",))
    missing = [n for n in (*TABLE_NAMES, *rotor_names(int(count))) if n not in table]
    if missing:
        return Board("partial", rotors=int(count), notes=(f"{len(missing)} of its parameters not read yet",))
    used = {n: table[n] for n in sorted((*TABLE_NAMES, *rotor_names(int(count))))}
    digest = digest_of(used)
    try:
        parsed = params_to_table(used)
        with np.errstate(all="ignore"):
            findings = realise(used).warnings
    except FirmwareParamsError as error:
        return Board("invalid", digest=digest, rotors=int(count), notes=(str(error),))
    except ABSURD:
        note = "its numbers are beyond all arithmetic"
        return Board("invalid", digest=digest, rotors=int(count), notes=(note,))
    notes = [f.text for f in findings] + _differences(parsed, vehicle.airframe)
    kind, upper, lower, of_model = _kind(parsed, vehicle)
    return Board("read", kind, digest, int(count), upper, lower, parsed.thr_mdl_fac, of_model, tuple(notes))


def intended(parameters: Mapping[str, float], commands: Sequence[float | None]) -> tuple[float, ...] | None:
    """Wrench [thrust up, roll, pitch, yaw] (N, N m) the table means by the commands (N,); None if unknown."""
    count = parameters.get("CA_ROTOR_COUNT")
    if count != len(commands) or any(c is None for c in commands):
        return None
    used = {n: parameters[n] for n in (*TABLE_NAMES, *rotor_names(len(commands))) if n in parameters}
    if len(used) < len(TABLE_NAMES) + len(ROTOR_FIELDS) * len(commands):
        return None
    try:
        with np.errstate(all="ignore"):
            wrench = realise(used).wrench([float(c or 0.0) for c in commands])
    except (FirmwareParamsError, *ABSURD):
        return None
    return tuple(float(w) for w in wrench) if np.isfinite(wrench).all() else None


def _differences(table: Px4Table, airframe: Airframe) -> list[str]:
    if len(table.rotors) != len(airframe.rotors):
        return [f"table of {len(table.rotors)} rotors, airframe {airframe.name} has {len(airframe.rotors)}"]
    moved, turned = [], []
    for rotor, entry in zip(airframe.rotors, table.rotors, strict=True):
        if math.dist(rotor.position_m[:2], entry.position_m[:2]) > _PLACE_M:
            moved.append(str(rotor.number))
        if entry.km * rotor.yaw_sign < 0:
            turned.append(str(rotor.number))
    notes = []
    if moved:
        notes.append(f"rotor {', '.join(moved)} elsewhere than in airframe {airframe.name}")
    if turned:
        notes.append(f"rotor {', '.join(turned)} turns the other way than in airframe {airframe.name}")
    return notes


def _kind(table: Px4Table, vehicle: Vehicle) -> tuple[str, float | None, float | None, bool]:
    """Kind, mean CT of the upper and the lower rotors, and whether the rotor model would give them."""
    airframe, model = vehicle.airframe, vehicle.model
    if len(table.rotors) != len(airframe.rotors):
        return "custom", None, None, False
    upper = [e for r, e in zip(airframe.rotors, table.rotors, strict=True) if r.level != "lower"]
    lower = [e for r, e in zip(airframe.rotors, table.rotors, strict=True) if r.level == "lower"]
    top, bottom = _mean(upper), _mean(lower)
    if not (_alike(upper) and _alike(lower)) or top is None:
        return "custom", top, bottom, False
    if bottom is None or _near(top, bottom):
        return "standard", top, bottom, _near(top, standard_coefficients(model).p)
    if table.thr_mdl_fac < 0.995:
        # squares (eq. 6) need THR_MDL_FAC 1: unequal columns under another curve were fitted to it
        return "fitted", top, bottom, False
    reduced = reduced_coefficients(model)
    return "reduced", top, bottom, _near(top, reduced.p_upper) and _near(bottom, reduced.p_lower)


def _mean(entries: list[RotorEntry]) -> float | None:
    return sum(e.ct for e in entries) / len(entries) if entries else None


def _alike(entries: list[RotorEntry]) -> bool:
    return not entries or _near(max(e.ct for e in entries), min(e.ct for e in entries))


def _near(a: float, b: float) -> bool:
    return abs(a - b) <= NEAR * max(abs(a), abs(b))
