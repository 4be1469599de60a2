"""The mixer table on an ArduPilot board: which allocation it is of, and the wrench it means.

Its factors are mixing columns without a unit: each axis is scaled to its largest entry. Newtons come back
only for a table of the rotor model in use (`standard`, `reduced`, `fitted`, to two per cent): its columns
then say what the commands mean. A script's factors stand in the parameters under the names of the loader's
(CXL_*), whichever of the two scripts brought them; CXL_N = 0 says that the script is not ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from coaxlink.errors import CoaxlinkError
from coaxlink.monitor.incoming.table_reader import AP_NAMES, COUNT, SCRIPTED
from coaxlink.monitor.state.table import ABSURD, NEAR, TableOnBoard, digest_of
from coaxlink.tables.ardupilot import ApReport, report_ap
from coaxlink.vehicle import Vehicle
from firmware_params import px4
from firmware_params.ardupilot import MotorParameters, realise
from firmware_params.ardupilot.scripts import params_factors
from firmware_params.ardupilot.table import ApTable
from firmware_params.errors import FirmwareParamsError

_KINDS = ("standard", "curved", "reduced", "fitted")  # the last is worked out in seconds


def describe(used: Mapping[str, float], vehicle: Vehicle) -> TableOnBoard:
    """What the table's parameters heard so far say, held against the vehicle. May take seconds."""
    airframe = vehicle.airframe
    missing = [n for n in AP_NAMES if n not in used]
    frame = used.get("FRAME_CLASS", 0.0)
    if missing or (frame in SCRIPTED and COUNT not in used):
        return TableOnBoard("partial", notes=(f"{max(len(missing), 1)} of its parameters not read yet",))
    digest = digest_of(used)
    number = int(frame) if np.isfinite(frame) else 0
    if number in SCRIPTED and used[COUNT] == 0.0:
        note = "the script on board is none of coaxlink's: what it does is not known here"
        return TableOnBoard("read", "custom", digest, frame_class=number, notes=(note,))
    try:
        table = _table(used, number)
        with np.errstate(all="ignore"):
            mix = realise(table)
    except FirmwareParamsError as error:
        return TableOnBoard("invalid", digest=digest, frame_class=number, notes=(str(error),))
    except ABSURD:
        note = "its numbers are beyond all arithmetic"
        return TableOnBoard("invalid", digest=digest, frame_class=number, notes=(note,))
    notes = [f.text for f in mix.warnings]
    rotors, expo = len(mix.factors), table.parameters.thst_expo
    if rotors != len(airframe.rotors):
        notes.append(f"table of {rotors} rotors, airframe {airframe.name} has {len(airframe.rotors)}")
        return TableOnBoard(
            "read", "custom", digest, rotors, frame_class=number, thst_expo=expo, notes=tuple(notes)
        )
    upper, lower = (
        _mean(mix.factors[:, 3], [(r.level == "lower") == below for r in airframe.rotors])
        for below in (False, True)
    )
    ours = _ours(mix.factors, vehicle, table.parameters)
    if ours is None:
        notes.append("none of this rotor model's tables for this airframe")
    elif abs(ours.table.parameters.thst_expo - expo) > NEAR:
        due = ours.table.parameters.thst_expo
        notes.append(f"MOT_THST_EXPO is {expo:.3f}; this allocation's curve needs {due:.3f}")
    return TableOnBoard(
        "read",
        "custom" if ours is None else ours.law,
        digest,
        rotors,
        of_model=ours is not None,
        notes=tuple(notes),
        frame_class=number,
        upper_factor=upper,
        lower_factor=lower,
        thst_expo=expo,
        columns=() if ours is None else _columns(ours),
        curve=None if ours is None else ours.columns.thr_mdl_fac,
    )


def intended(
    table: TableOnBoard, used: Mapping[str, float], commands: Sequence[float | None]
) -> tuple[float, ...] | None:
    """Wrench [thrust up, roll, pitch, yaw] (N, N m) that the table means by the commands (N,), 0..1 of the
    pulse range; None if unknown.

    The board takes a motor's thrust as its curve's over the spin range; what that range begins and ends with
    is the allocation's own.
    """
    if not table.columns or table.curve is None or len(commands) != len(table.columns):
        return None
    if any(c is None for c in commands):
        return None
    try:
        on_board = _table(used, table.frame_class or 0)
        with np.errstate(all="ignore"):
            thrust = realise(on_board).thrust_of([float(c or 0.0) for c in commands])
    except (FirmwareParamsError, *ABSURD):
        return None
    spin = on_board.parameters.spin_min, on_board.parameters.spin_max
    least, most = (table.curve * s * s + (1.0 - table.curve) * s for s in spin)
    running = np.array([c is not None and c >= 0.5 * spin[0] for c in commands])
    wrench = (np.where(running, least + (most - least) * thrust, 0.0)) @ np.array(table.columns)
    return tuple(float(w) for w in wrench) if np.isfinite(wrench).all() else None


def _table(used: Mapping[str, float], frame: int) -> ApTable:
    factors = params_factors(used) if frame in SCRIPTED else ()
    return ApTable(frame, factors, MotorParameters.from_params(used), int(used["FRAME_TYPE"]))


def _mean(values: NDArray[np.float64], chosen: list[bool]) -> float | None:
    return float(np.mean(values[np.array(chosen)])) if any(chosen) else None


def _ours(factors: NDArray[np.float64], vehicle: Vehicle, motor: MotorParameters) -> ApReport | None:
    """Our table with these factors, up to a scale on each axis; of two alike the one of that curve."""
    found: ApReport | None = None
    for kind in _KINDS:
        try:
            made = report_ap(vehicle, kind, spin_min=motor.spin_min)
        except (CoaxlinkError, FirmwareParamsError, *ABSURD):
            continue
        if np.abs(_scaled(factors) - _scaled(made.mix.factors)).max() < NEAR:
            if abs(made.table.parameters.thst_expo - motor.thst_expo) < NEAR:
                return made
            found = found or made
        elif found is not None:
            break  # kinds that are alike stand side by side
    return found


def _scaled(factors: NDArray[np.float64]) -> NDArray[np.float64]:
    top = np.abs(factors).max(axis=0)
    return np.divide(factors, top, out=np.zeros_like(factors), where=top > 0)


def _columns(ours: ApReport) -> tuple[tuple[float, ...], ...]:
    effect = np.asarray(px4.effectiveness(ours.columns))
    return tuple(map(tuple, np.stack([-effect[5], effect[0], effect[1], effect[2]], axis=1).tolist()))
