"""The mixer table on board: what is known of it, and what a PX4's is and means.

What is judged are the parameters as they were heard; any number may stand in them.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.mixer.coefficients import reduced_coefficients, standard_coefficients
from coaxlink.monitor.incoming.table_reader import AP_NAMES, PX4_NAMES, is_ardupilot, rotor_names
from coaxlink.vehicle import Vehicle
from firmware_params.errors import FirmwareParamsError
from firmware_params.px4 import Px4Table, RotorEntry, params_to_table, realise

NEAR = 0.02  # relative; QGC rounds CT to 0.1
_PLACE_M = 0.02
# a vehicle stores whatever it is sent: 1e38 metres, or an infinite CT
ABSURD = (ArithmeticError, ValueError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class TableOnBoard:
    """The table on board, as far as it was heard."""

    state: str  # unread, partial, read, or invalid
    kind: str = ""  # standard, reduced, fitted, custom; "" unless read
    digest: str = ""  # first 8 hex digits of the SHA-256 over "NAME=value" lines, by name
    rotors: int = 0
    upper_ct: float | None = None  # mean CA_ROTORn_CT of the airframe's upper (and single) rotors
    lower_ct: float | None = None
    thr_mdl_fac: float | None = None
    of_model: bool = False  # its coefficients are those of the rotor model in use
    notes: tuple[str, ...] = ()
    # ArduPilot's
    frame_class: int | None = None
    thst_expo: float | None = None  # MOT_THST_EXPO


def digest_of(used: Mapping[str, float]) -> str:
    """The hash of a table's parameters."""
    text = "".join(f"{name}={value:.9g}\n" for name, value in sorted(used.items()))
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def describe(table: Mapping[str, float], vehicle: Vehicle) -> TableOnBoard:
    """What the table's parameters heard so far say, held against the vehicle."""
    if is_ardupilot(table):
        return _of_ardupilot(table)
    count = table.get("CA_ROTOR_COUNT")
    if count is None:
        return TableOnBoard("unread")
    if not math.isfinite(count) or not 0 < count <= 12:
        return TableOnBoard("invalid", notes=(f"CA_ROTOR_COUNT is {count:g}: no rotors configured",))
    names = (*PX4_NAMES, *rotor_names(int(count)))
    missing = sum(n not in table for n in names)
    if missing:
        note = f"{missing} of its parameters not read yet"
        return TableOnBoard("partial", rotors=int(count), notes=(note,))
    used = {n: table[n] for n in sorted(names)}
    digest = digest_of(used)
    try:
        parsed = params_to_table(used)
        with np.errstate(all="ignore"):
            findings = realise(used).warnings
    except FirmwareParamsError as error:
        return TableOnBoard("invalid", digest=digest, rotors=int(count), notes=(str(error),))
    except ABSURD:
        note = "its numbers are beyond all arithmetic"
        return TableOnBoard("invalid", digest=digest, rotors=int(count), notes=(note,))
    notes = [f.text for f in findings] + _differences(parsed, vehicle.airframe)
    kind, upper, lower, of_model = _kind(parsed, vehicle)
    return TableOnBoard(
        "read", kind, digest, int(count), upper, lower, parsed.thr_mdl_fac, of_model, tuple(notes)
    )


def _of_ardupilot(table: Mapping[str, float]) -> TableOnBoard:
    """Which class it flies; its factors have no unit, and a script's are not among the parameters."""
    missing = sum(n not in table for n in AP_NAMES)
    if missing:
        return TableOnBoard("partial", notes=(f"{missing} of its parameters not read yet",))
    frame = table["FRAME_CLASS"]
    if not math.isfinite(frame):
        return TableOnBoard("invalid", notes=("its FRAME_CLASS is no number",))
    expo = table["MOT_THST_EXPO"]
    return TableOnBoard("read", "ArduPilot's", digest_of(table), frame_class=int(frame), thst_expo=expo)


def intended(table: Mapping[str, float], commands: Sequence[float | None]) -> tuple[float, ...] | None:
    """Wrench [thrust up, roll, pitch, yaw] (N, N m) the table means by the commands (N,); None if unknown."""
    names = (*PX4_NAMES, *rotor_names(len(commands)))
    used = {n: table[n] for n in names if n in table}
    if table.get("CA_ROTOR_COUNT") != len(commands) or len(used) < len(names):
        return None
    known = [c for c in commands if c is not None]
    if len(known) < len(commands):
        return None
    try:
        with np.errstate(all="ignore"):
            wrench = realise(used).wrench(known)
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
    of = {
        level: [e for r, e in zip(airframe.rotors, table.rotors, strict=True) if r.level == level]
        for level in ("upper", "lower", "single")
    }
    top, bottom = _mean(of["upper"] or of["single"]), _mean(of["lower"])
    pairs = [(table.rotors[u].ct, table.rotors[w].ct) for u, w in airframe.pairs]
    if pairs and table.thr_mdl_fac < 0.995 and not any(_near(u, w) for u, w in pairs):
        # squares (eq. 6) need THR_MDL_FAC 1: unequal columns under another curve were fitted, arm by arm
        return "fitted", top, bottom, False
    if not all(map(_alike, of.values())) or top is None:
        return "custom", top, bottom, False
    if bottom is None or _near(top, bottom):
        return "standard", top, bottom, _near(top, standard_coefficients(model, of_commands=True).p)
    reduced = reduced_coefficients(model, of_commands=True)
    return "reduced", top, bottom, _near(top, reduced.p_upper) and _near(bottom, reduced.p_lower)


def _mean(entries: list[RotorEntry]) -> float | None:
    return sum(e.ct for e in entries) / len(entries) if entries else None


def _alike(entries: list[RotorEntry]) -> bool:
    return not entries or _near(max(e.ct for e in entries), min(e.ct for e in entries))


def _near(a: float, b: float) -> bool:
    return abs(a - b) <= NEAR * max(abs(a), abs(b))
