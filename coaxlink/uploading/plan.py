"""What an upload is to put on board, from the files of `coaxlink table`; whether the vehicle may have it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from coaxlink import files
from coaxlink.data.logs.board_parameters import read_board_parameters
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.mavlink.identity import Identity, type_name
from coaxlink.mavlink.parameters import Number, Value
from coaxlink.tables.files import SCRIPTS, refuse_halves
from coaxlink.uploading.backup import FILES
from firmware_params import ardupilot, px4
from firmware_params.ardupilot.owned import OWNED as AP_OWNED
from firmware_params.ardupilot.parameters import MOTOR_FUNCTIONS
from firmware_params.errors import TableError
from firmware_params.owned import COUNTER, READ_ONLY, kind_of
from firmware_params.px4.owned import OWNED as PX4_OWNED

# MAV_TYPE of multirotors, and the rotor counts each may stand for (a coaxial vehicle has twice the arms)
_MULTIROTORS = {
    mavlink.MAV_TYPE_QUADROTOR: {4, 8},
    mavlink.MAV_TYPE_COAXIAL: {2},
    mavlink.MAV_TYPE_HEXAROTOR: {6, 12},
    mavlink.MAV_TYPE_OCTOROTOR: {8, 16},
    mavlink.MAV_TYPE_TRICOPTER: {3, 6},
    mavlink.MAV_TYPE_DECAROTOR: {10},
    mavlink.MAV_TYPE_DODECAROTOR: {12},
    mavlink.MAV_TYPE_GENERIC_MULTIROTOR: set(range(3, 17)),
    mavlink.MAV_TYPE_GENERIC: set(range(3, 17)),
}
_OLDEST = (1, 13, 0)
_SAME_PLACE_M = 0.02  # a sign that changes within this is no other place
_SAME_GEOMETRY = 0.02  # of the longest arm: what a tape measure is off by on half a metre


@dataclass(frozen=True)
class Plan:
    """Files and what they want on board."""

    firmware: str  # px4 or ardupilot
    files: tuple[Path, ...]
    params: Mapping[str, Number]
    types: Mapping[str, int]  # MAV_PARAM_TYPE
    notes: tuple[str, ...] = field(default=())  # what was assumed in reading it, in words
    scripts: Mapping[str, bytes] = field(default_factory=dict)  # ArduPilot's, by name

    @property
    def rotor_count(self) -> int | None:
        """Rotors of the table, None when it does not say."""
        if self.firmware == "ardupilot":
            return motor_outputs(self.params) or None
        count = self.params.get("CA_ROTOR_COUNT")
        return None if count is None else int(count)

    def is_for(self, identity: Identity) -> bool:
        """Whether that autopilot runs the firmware the files are for."""
        return identity.is_px4 if self.firmware == "px4" else identity.is_ardupilot


def motor_outputs(params: Mapping[str, Number]) -> int:
    """How many outputs are motors on an ArduPilot board."""
    return sum(params.get(f"SERVO{n}_FUNCTION") in MOTOR_FUNCTIONS for n in range(1, 33))


def load_plan(source: Path) -> Plan:
    """Read a folder with one table (or one file). Raises InputError with the file and line."""
    if source.is_dir():
        found = sorted([*source.glob("*.params"), *source.glob("*.param")])
        if len(found) != 1:
            names = ", ".join(path.name for path in found)
            problem = (
                "no .params or .param file in it" if not found else f"{len(found)} tables ({names}): name one"
            )
            raise InputError(source, "", f"{problem}; one is expected")
        source = found[0]
    read = read_board_parameters(source, telling=True)
    refuse_halves(source, read.header)
    notes = list(read.notes)
    params: Mapping[str, Number] = read.params
    owned, known = (PX4_OWNED, px4.PARAMETERS) if read.firmware == "px4" else (AP_OWNED, ardupilot.PARAMETERS)
    if any(kind_of(owned, name, {}) in (COUNTER, READ_ONLY) for name in params):
        params = {n: v for n, v in params.items() if n in known or n.startswith(ardupilot.scripts.PREFIX)}
        notes.append(
            f"all parameters of a board: {len(params)} of the {len(read.params)} are of a mixer table, "
            "the others stay as they are on board"
        )
    types = {name: read.types[name] for name in params if name in read.types}
    if read.firmware == "px4":
        return Plan("px4", (source,), params, types, tuple(notes))
    backed_up = source.with_suffix(FILES)
    folder = backed_up if backed_up.is_dir() else source.parent / SCRIPTS
    paths = sorted(folder.glob("*.lua"))
    scripts = {path.name: files.read_bytes(path) for path in paths}
    if params.get("FRAME_CLASS") in (15, 17) and not scripts:
        raise InputError(folder, "", "FRAME_CLASS 15 and 17 need a script, found none")
    if scripts and not backed_up.is_dir():
        _refuse_other_scripts(source, params, scripts)
    return Plan("ardupilot", (source, *paths), params, {}, tuple(notes), scripts)


def _refuse_other_scripts(source: Path, params: Mapping[str, Number], scripts: Mapping[str, bytes]) -> None:
    """Raises InputError where the table's own checksum of its scripts is not theirs: halves of two tables."""
    wanted = params.get("SCR_LD_CHECKSUM", -1)
    if wanted >= 0 and wanted != ardupilot.scripts.load_checksum(scripts.values()):
        names = ", ".join(scripts)
        problem = f"its SCR_LD_CHECKSUM is not that of {SCRIPTS}/ ({names}): make the table again"
        raise InputError(source, "", f"{problem}, its files are one thing")


def refuse_values(firmware: str, params: Mapping[str, Number], source: Path) -> None:
    """Raise SafetyRefusal for a value of `source` that is not finite or out of the firmware's range."""
    found = px4.out_of_range(params) if firmware == "px4" else ardupilot.out_of_range(params)
    for finding in found:
        raise SafetyRefusal(f"{source.name}: {finding}")


def refuse_vehicle(plan: Plan, identity: Identity) -> None:
    """Raise SafetyRefusal when this is not a vehicle the plan can be for."""
    if not plan.is_for(identity):
        firmware = "PX4" if plan.firmware == "px4" else "ArduPilot"
        raise SafetyRefusal(f"{plan.files[0].name} is for {firmware}, the vehicle runs {identity.name}")
    if identity.is_px4 and identity.version and identity.version < _OLDEST:
        raise SafetyRefusal(
            f"{identity.name} reads no CA_ROTOR table, its experimental builds mix their CA_MC_* in another "
            "way; v1.14 or later is needed"
        )
    counts = _MULTIROTORS.get(identity.vehicle_type)
    name = type_name(identity.vehicle_type)
    if counts is None:
        raise SafetyRefusal(f"another vehicle: of type {name}, not a multirotor")
    if identity.is_px4 and plan.rotor_count is not None and plan.rotor_count not in counts:
        raise SafetyRefusal(
            f"another vehicle: the table is for {plan.rotor_count} rotors, the vehicle is of type {name}"
        )


def refuse_ignored(identity: Identity, present: Mapping[str, Number]) -> None:
    """Raise SafetyRefusal where a PX4 flies a mixer file, whatever table its parameters hold."""
    if identity.version and identity.version < (1, 14, 0) and not present.get("SYS_CTRL_ALLOC", 1):
        raise SafetyRefusal(
            f"{identity.name} ignores the table while SYS_CTRL_ALLOC is 0: set it to 1 and reboot"
        )


def refuse_table(
    plan: Plan, identity: Identity, board: Mapping[str, Value], *, new_geometry: bool = False
) -> None:
    """Raise SafetyRefusal when the table and what is on board do not belong together.

    `new_geometry` allows rotors at other places or with another spin than the board has now.
    """
    unknown = [name for name in plan.params if name not in board]
    if unknown:
        raise SafetyRefusal(
            f"{identity.name} has no parameter {unknown[0]} ({len(unknown)} of the table's are unknown)"
        )
    present = {name: value.value for name, value in board.items()}
    refuse_ignored(identity, present)
    now, wanted = int(present.get("CA_ROTOR_COUNT", 0)), plan.rotor_count
    if wanted is not None and now not in (0, wanted):
        raise SafetyRefusal(
            f"another vehicle: the table is for {wanted} rotors, the board is set up for {now}"
        )
    if now and not new_geometry:
        moved = _moved_rotors(present, plan.params, now)
        if moved:
            raise SafetyRefusal(
                f"another vehicle: {moved[0]} ({len(moved)} rotors differ); `new_geometry` to mean it"
            )
    try:
        mix = px4.realise({**present, **plan.params})
    except (TableError, ValueError) as error:
        raise SafetyRefusal(f"PX4 cannot fly this table: {error}") from error
    for finding in mix.warnings:
        if finding.severity == "error":
            raise SafetyRefusal(str(finding))


def _moved_rotors(old: Mapping[str, Number], new: Mapping[str, Number], count: int) -> list[str]:
    """Rotors that would change their quadrant, their spin, or their place by more than 2 %, in words."""
    moved = []
    places = [
        [
            [float(of.get(f"CA_ROTOR{n}_P{axis}", old.get(f"CA_ROTOR{n}_P{axis}", 0.0))) for axis in "XYZ"]
            for of in (old, new)
        ]
        for n in range(count)
    ]
    arm = max((math.hypot(*place[:2]) for both in places for place in both), default=0.0)
    for n in range(count):
        for key, what in (("PX", "front or rear"), ("PY", "left or right"), ("KM", "spin")):
            name = f"CA_ROTOR{n}_{key}"
            before, after = float(old.get(name, 0.0)), float(new.get(name, old.get(name, 0.0)))
            least = _SAME_PLACE_M if key != "KM" else 0.0
            if before * after < 0 and min(abs(before), abs(after)) > least:
                moved.append(f"rotor {n + 1} changes {what}, {name} {before:g} -> {after:g}")
                break
        else:
            off = math.dist(*places[n])
            if off > _SAME_GEOMETRY * arm:
                here, there = (", ".join(f"{x:.3g}" for x in place) for place in places[n])
                moved.append(f"rotor {n + 1} moves by {off:.3g} m, ({here}) -> ({there}) m")
    return moved
