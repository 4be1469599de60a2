"""Keeps our copy of the mixer table as it is on board: an upload over another link shows in seconds.

A PX4's is read again when its own parameter hash changes. An ArduPilot has none: the few parameters of its
table are read each time. Nothing is written.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from coaxlink.data.logs.outputs import PX4_MOTOR_1, PX4_MOTORS
from coaxlink.errors import CoaxlinkError
from coaxlink.mavlink import Session
from coaxlink.mavlink.parameters import HASH, Parameters
from coaxlink.monitor.incoming.heard import Heard
from firmware_params.ardupilot import MotorParameters

PX4_NAMES = ("CA_AIRFRAME", "CA_METHOD", "CA_ROTOR_COUNT", "THR_MDL_FAC")
ROTOR_FIELDS = ("PX", "PY", "PZ", "AX", "AY", "AZ", "CT", "KM")
# all that is of an ArduPilot's table, but what the autopilot learns in flight
AP_NAMES = ("FRAME_CLASS", "FRAME_TYPE", *(n for n in MotorParameters().to_params() if n != "MOT_THST_HOVER"))
DRIVERS = ("PWM_MAIN", "PWM_AUX", "UAVCAN_EC")
THRESHOLDS = ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")
_SERVOS = (*(f"SERVO{n}_FUNCTION" for n in range(1, 17)), "MOT_PWM_TYPE")


def rotor_names(count: int) -> tuple[str, ...]:
    """The CA_ROTORn_* names of the first `count` rotors."""
    return tuple(f"CA_ROTOR{n}_{field}" for n in range(count) for field in ROTOR_FIELDS)


def is_ardupilot(parameters: Mapping[str, float]) -> bool:
    """Whether these are an ArduPilot's."""
    return "FRAME_CLASS" in parameters


def table_parameters(parameters: Mapping[str, float]) -> dict[str, float]:
    """Those of `parameters` that belong to the mixer table, in the order of their names."""
    ardupilot = is_ardupilot(parameters)
    names = AP_NAMES if ardupilot else PX4_NAMES
    return {
        n: v
        for n, v in sorted(parameters.items())
        if n in names or (not ardupilot and n.startswith("CA_ROTOR"))
    }


class TableReader:
    """Reads the table of one vehicle when something of it changed."""

    def __init__(self, heard: Heard, session: Session) -> None:
        self._heard, self._session = heard, session
        self._parameters = Parameters(session)
        self._hash: float | None = None
        self._complete = False
        self._outputs: dict[str, float] = {}

    def refresh(self) -> None:
        """Read again if need be; silence is for another time."""
        try:
            if self._session.identity.is_px4:
                self._refresh_px4()
            else:
                self._refresh_ardupilot()
        except CoaxlinkError:
            return

    def _refresh_px4(self) -> None:
        current = self._read((HASH,)).get(HASH)
        if self._complete and current is not None and current == self._hash:
            return
        table = self._read(PX4_NAMES)
        count = table.get("CA_ROTOR_COUNT", 0.0)
        rotors = rotor_names(int(count)) if 0 < count <= 16 else ()
        table |= self._read(rotors)
        if (self._session.identity.version or (99,)) < (1, 14):
            self._heard.put_parameters(self._read(("SYS_CTRL_ALLOC",)))
        self._heard.put_parameters(table, replace_prefix="CA_")
        self._heard.put_parameters(self._read(THRESHOLDS) | self._px4_outputs())
        self._complete = len(table) == len(PX4_NAMES) + len(rotors)
        self._hash = current

    def _px4_outputs(self) -> dict[str, float]:
        """Which outputs drive motors, and between which numbers, of the driver that has them."""
        for driver in DRIVERS:
            functions = self._read(f"{driver}_FUNC{n}" for n in range(1, 9))
            own = [
                name.removeprefix(f"{driver}_FUNC")
                for name, function in functions.items()
                if PX4_MOTOR_1 <= function < PX4_MOTOR_1 + PX4_MOTORS
            ]
            if own:
                ends = (f"{driver}_{end}{n}" for n in own for end in ("MIN", "MAX"))
                return functions | self._read(ends) | self._read(f"{driver}_TIM{n}" for n in range(4))
        return {}

    def _refresh_ardupilot(self) -> None:
        table = self._read(AP_NAMES)
        if not self._outputs or table.get("FRAME_CLASS") != self._outputs.get("FRAME_CLASS"):
            self._outputs = {**self._read(_SERVOS), "FRAME_CLASS": table.get("FRAME_CLASS", 0.0)}
        self._heard.put_parameters(self._outputs | table)

    def _read(self, names: Iterable[str]) -> dict[str, float]:
        found = self._parameters.answering(names)
        return {name: float(value.value) for name, value in found.items()}
