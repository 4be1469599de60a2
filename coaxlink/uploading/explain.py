"""A table explained: what the allocation method demands of every rotor, what the firmware does, its worth.

"Demanded" is the method's own A+ (u^2 per N and per N m); "done" is the firmware's mix, each axis scaled back
to physical units by the one factor that fits it best. Where the two differ, the firmware cannot do it.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.errors import InputError
from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.parameters import Number, Parameters
from coaxlink.mavlink.session import Session
from coaxlink.mixer.worth import Worth, weigh
from coaxlink.tables.ardupilot import ApReport, ap_speeds, report_ap
from coaxlink.tables.behaviour import TURNS, Behaviour, behaviour
from coaxlink.tables.law_commands import nearest, wanted_mix, worst_relative
from coaxlink.tables.px4 import TableReport, px4_speeds, report_px4
from coaxlink.uploading.ardupilot_scripts import await_loader, matrix_script
from coaxlink.uploading.ardupilot_table import present_table
from coaxlink.vehicle import Vehicle
from firmware_params import ardupilot as ap
from firmware_params import px4
from firmware_params.ardupilot import scripts
from firmware_params.ardupilot.table import ApTable
from firmware_params.errors import TableError

AXES = ("roll", "pitch", "yaw", "thrust")
STANDARD, ON_BOARD = "standard law", "on board"  # what a table is held against
Changed = tuple[tuple[str, float, float], ...]  # name, on board, in the table
_GAIN = re.compile(r"MC_(ROLL|PITCH|YAW)RATE_K|ATC_RAT_(RLL|PIT|YAW)_[PID]")


@dataclass(frozen=True)
class Explanation:
    """Demanded against done, and this table against another on the same rotors."""

    demanded: NDArray[np.float64]  # (N, 4) u^2 per N m (roll, pitch, yaw) and per N (thrust)
    done: NDArray[np.float64]  # (N, 4) the same, as the firmware mixes
    flown: Behaviour
    reference: Behaviour
    reference_name: str
    worth: Worth  # of this table
    worth_before: Worth  # of the reference
    changed: Changed = ()  # parameters that the board has otherwise
    gains_now: Mapping[str, float] = field(default_factory=dict)  # the board's rate gains
    axes: tuple[str, ...] = AXES

    @property
    def worst(self) -> dict[str, float]:
        """Largest difference of done from asked on each axis, relative to the axis's largest entry."""
        return dict(zip(AXES, worst_relative(self.demanded, self.done), strict=True))

    def to_json(self) -> dict[str, Any]:
        """The `explain` part of the JSON of `table`."""
        hint = self.flown.gain_hint(self.reference)
        return {
            "axes": list(AXES),
            "asked": self.demanded.tolist(),
            "done": self.done.tolist(),
            "worst_relative": self.worst,
            "against": self.reference_name,
            "gain_Nm": {"this": list(self.flown.gain_Nm), "reference": list(self.reference.gain_Nm)},
            "authority_Nm": {
                "this": list(self.flown.authority_Nm),
                "reference": list(self.reference.authority_Nm),
            },
            "ceiling_N": {"this": self.flown.ceiling_N, "reference": self.reference.ceiling_N},
            "worth": {"this": self.worth.to_json(), "reference": self.worth_before.to_json()},
            "gain_scale": {a: h if np.isfinite(h) else None for a, h in zip(TURNS, hint, strict=True)},
            "changed": [{"name": n, "board": a, "new": b} for n, a, b in self.changed],
        }


def explain_px4(
    vehicle: Vehicle, report: TableReport, board: Mapping[str, Number] | None = None
) -> Explanation:
    """Explain a PX4 table against the board's present one, else against the standard law.

    Raises InputError when the board holds no table of this vehicle.
    """
    airframe = vehicle.airframe
    mixed = np.stack([*report.mix.mix.T[:3], -report.mix.mix[:, 5]], axis=-1)
    demanded = wanted_mix(report.table)
    changed: Changed = ()
    if board is None:
        standard = report_px4(vehicle, "standard")
        present, reference, name = standard.mix, standard.behaviour, STANDARD
    else:
        try:
            present = px4.realise(board)
        except (TableError, ValueError) as error:
            raise InputError("`board`", "", f"the board holds no multirotor table: {error}") from error
        if len(present.mix) != len(airframe.rotors):
            raise InputError(
                "`board`", "", f"the board has {len(present.mix)} rotors, {airframe.name} another number"
            )
        reference, name = behaviour(vehicle, px4_speeds(present)), ON_BOARD
        changed = _differing(board, report.params)
    done = nearest(mixed, demanded)
    worth = weigh(vehicle, px4_speeds(report.mix), report.law)
    before = weigh(vehicle, px4_speeds(present), _word(name))
    return Explanation(
        demanded, done, report.behaviour, reference, name, worth, before, changed, _gains(board or {})
    )


def explain_ap(
    vehicle: Vehicle,
    report: ApReport,
    board: tuple[Mapping[str, Number], ApTable | None] | None = None,
) -> Explanation:
    """Explain an ArduPilot table against the board's parameters and table, else against the standard law on
    the same frame class. Raises InputError when the board flies what is not known here."""
    airframe = vehicle.airframe
    demanded = wanted_mix(report.columns)
    done = nearest(report.mix.factors, demanded)
    worth = weigh(vehicle, ap_speeds(report.mix), report.law)
    if board is not None:
        numbers, present = board
        if present is None:
            frame = f"FRAME_CLASS {numbers.get('FRAME_CLASS', 0):g}"
            raise InputError("`board`", "", f"the board flies a matrix that is not known here ({frame})")
        mix = ap.realise(present)
        if len(mix.factors) != (count := len(airframe.rotors)):
            problem = f"the board has {len(mix.factors)} rotors, {airframe.name} {count}"
            raise InputError("`board`", "", problem)
        held = behaviour(vehicle, ap_speeds(mix))
        changed = tuple(row for row in _differing(numbers, report.params) if row[0] != "SCR_LD_CHECKSUM")
        before = weigh(vehicle, ap_speeds(mix), _word(ON_BOARD))
        return Explanation(
            demanded, done, report.behaviour, held, ON_BOARD, worth, before, changed, _gains(numbers)
        )
    standard = report_ap(
        vehicle,
        "standard",
        frame_class=report.table.frame_class,
        spin_min=report.table.parameters.spin_min,
        spin_max=report.table.parameters.spin_max,
    )
    before = weigh(vehicle, ap_speeds(standard.mix), _word(STANDARD))
    return Explanation(demanded, done, report.behaviour, standard.behaviour, STANDARD, worth, before)


def _word(name: str) -> str:
    return {STANDARD: "standard", ON_BOARD: "present"}[name]


def present_px4(url: str) -> dict[str, Number]:
    """The parameters of the PX4 at `url`. Raises LinkError, InputError."""
    with _open(url) as session:
        if not session.identity.is_px4:
            raise InputError(url, "", f"the vehicle runs {session.identity.name}, not PX4")
        return {n: v.value for n, v in Parameters(session).read_all().values.items()}


def present_ap(url: str) -> tuple[dict[str, Number], ApTable | None]:
    """The parameters and the table of the ArduPilot at `url`. Raises LinkError, InputError."""
    with _open(url) as session:
        if not session.identity.is_ardupilot:
            raise InputError(url, "", f"the vehicle runs {session.identity.name}, not ArduPilot")
        parameters, files = Parameters(session), Files(session)
        numbers = {n: v.value for n, v in parameters.read_all().values.items()}
        if scripts.LAST not in numbers and await_loader(files, parameters):
            numbers = {n: v.value for n, v in parameters.read_all().values.items()}
        return numbers, present_table(numbers, lambda: matrix_script(files))


def _open(url: str) -> Session:
    from coaxlink.mavlink.opening import connect

    return connect(url)


def _differing(board: Mapping[str, Number], params: Mapping[str, Number]) -> Changed:
    pairs = ((n, float(board[n]), float(v)) for n, v in params.items() if n in board)
    return tuple(row for row in pairs if struct.pack("<f", row[1]) != struct.pack("<f", row[2]))


def _gains(board: Mapping[str, Number]) -> dict[str, float]:
    return {n: float(v) for n, v in board.items() if _GAIN.fullmatch(n)}
