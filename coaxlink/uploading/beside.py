"""What a new table is held against, on the same rotors: the board's at a URL, else the standard law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from coaxlink.errors import InputError
from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.parameters import Number, Parameters
from coaxlink.mavlink.session import Session
from coaxlink.mixer.demands import Commands
from coaxlink.mixer.worth import Worth, weigh
from coaxlink.tables.ardupilot import ApReport, ap_commands, report_ap
from coaxlink.tables.behaviour import Behaviour, behaviour
from coaxlink.tables.px4 import TableReport, px4_commands, report_px4
from coaxlink.uploading.ardupilot_scripts import await_loader, matrix_script
from coaxlink.uploading.ardupilot_table import present_table
from coaxlink.uploading.plan import refuse_ignored
from coaxlink.vehicle import Vehicle
from firmware_params import ardupilot as ap
from firmware_params import px4
from firmware_params.ardupilot import scripts
from firmware_params.ardupilot.table import ApTable
from firmware_params.errors import TableError


@dataclass(frozen=True)
class BesideTable:
    """A table and what it is held against, flown by the same rotor model."""

    flown: Behaviour
    worth: Worth
    reference: Behaviour
    reference_worth: Worth
    against: str  # in words


def beside_px4(
    vehicle: Vehicle, report: TableReport, board: Mapping[str, Number] | None = None
) -> BesideTable:
    """A PX4 table beside the board's present one, else beside the standard law.

    Raises InputError when the board holds no table of this vehicle.
    """
    if board is None:
        return _beside(
            vehicle, report, px4_commands(report.mix), px4_commands(report_px4(vehicle, "standard").mix)
        )
    return _beside(vehicle, report, px4_commands(report.mix), _px4_on_board(vehicle, board), on_board=True)


def beside_ap(
    vehicle: Vehicle, report: ApReport, board: tuple[Mapping[str, Number], ApTable | None] | None = None
) -> BesideTable:
    """An ArduPilot table beside the board's, else beside the standard law on the same frame class.

    Raises InputError when the board flies what is not known here.
    """
    if board is None:
        motor = report.table.parameters
        standard = report_ap(
            vehicle,
            "standard",
            frame_class=report.table.frame_class,
            spin_min=motor.spin_min,
            spin_max=motor.spin_max,
        )
        return _beside(vehicle, report, ap_commands(report.mix), ap_commands(standard.mix))
    return _beside(vehicle, report, ap_commands(report.mix), _ap_on_board(vehicle, *board), on_board=True)


def commands_on_board(vehicle: Vehicle, session: Session) -> Commands:
    """How the autopilot of a session mixes now.

    Raises LinkError; InputError for a table that is none or another vehicle's; SafetyRefusal where it flies
    another mixer than the table that it holds.
    """
    if session.identity.is_px4:
        board = present_px4(session)
        refuse_ignored(session.identity, board)
        return _px4_on_board(vehicle, board)
    return _ap_on_board(vehicle, *present_ap(session))


def _px4_on_board(vehicle: Vehicle, board: Mapping[str, Number]) -> Commands:
    try:
        present = px4.realise(board)
    except (TableError, ValueError) as error:
        raise InputError("`board`", "", f"the board holds no multirotor table: {error}") from error
    _require_count(vehicle, len(present.mix))
    return px4_commands(present)


def _ap_on_board(vehicle: Vehicle, numbers: Mapping[str, Number], present: ApTable | None) -> Commands:
    if present is None:
        frame = f"FRAME_CLASS {numbers.get('FRAME_CLASS', 0):g}"
        raise InputError("`board`", "", f"the board flies a matrix that is not known here ({frame})")
    mix = ap.realise(present)
    _require_count(vehicle, len(mix.factors))
    return ap_commands(mix)


def _beside(
    vehicle: Vehicle, report: TableReport | ApReport, new: Commands, old: Commands, *, on_board: bool = False
) -> BesideTable:
    name = "present" if on_board else "standard"
    return BesideTable(
        report.behaviour,
        weigh(vehicle, new, report.law),
        behaviour(vehicle, old),
        weigh(vehicle, old, name),
        "on board" if on_board else "under the standard law",
    )


def _require_count(vehicle: Vehicle, rotors: int) -> None:
    airframe = vehicle.airframe
    if rotors != len(airframe.rotors):
        problem = f"the board has {rotors} rotors, {airframe.name} {len(airframe.rotors)}"
        raise InputError("`board`", "", problem)


def present_px4(session: Session) -> dict[str, Number]:
    """The parameters of a PX4. Raises LinkError, InputError."""
    if not session.identity.is_px4:
        raise InputError(session.address, "", f"the vehicle runs {session.identity.name}, not PX4")
    return {n: v.value for n, v in Parameters(session).read_all().values.items()}


def present_ap(session: Session) -> tuple[dict[str, Number], ApTable | None]:
    """The parameters and the table of an ArduPilot. Raises LinkError, InputError."""
    if not session.identity.is_ardupilot:
        raise InputError(session.address, "", f"the vehicle runs {session.identity.name}, not ArduPilot")
    parameters, files = Parameters(session), Files(session)
    numbers = {n: v.value for n, v in parameters.read_all().values.items()}
    if scripts.LAST not in numbers and await_loader(files, parameters):
        numbers = {n: v.value for n, v in parameters.read_all().values.items()}
    return numbers, present_table(numbers, lambda: matrix_script(files))
