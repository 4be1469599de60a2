"""Keeps our copy of the mixer table as it is on board: an upload over another link shows in seconds.

A PX4's is read again when its own parameter hash changes. An ArduPilot has none: the few parameters of its
table are read each time, its script's factors when the checksum (of the file, or CXL_SUM) changes. Nothing is
written: files are read, and only when two looks found them the same, so as not to stand in an upload's way.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from coaxlink.errors import CoaxlinkError
from coaxlink.mavlink import Session
from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.parameters import HASH, Parameters
from coaxlink.monitor.incoming.heard import Heard
from firmware_params.ardupilot import MotorParameters, scripts
from firmware_params.ardupilot.table import DYNAMIC_MATRIX, SCRIPTING_MATRIX
from firmware_params.errors import TableError

PX4_NAMES = ("CA_AIRFRAME", "CA_METHOD", "CA_ROTOR_COUNT", "THR_MDL_FAC")
ROTOR_FIELDS = ("PX", "PY", "PZ", "AX", "AY", "AZ", "CT", "KM")
# all that is of an ArduPilot's table, but what the autopilot learns in flight
AP_NAMES = ("FRAME_CLASS", "FRAME_TYPE", *(n for n in MotorParameters().to_params() if n != "MOT_THST_HOVER"))
COUNT = f"{scripts.PREFIX}N"  # motors in a script's factors; 0 says that the script is not ours
SCRIPTED = (SCRIPTING_MATRIX, DYNAMIC_MATRIX)
THRESHOLDS = ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")
_SERVOS = tuple(f"SERVO{n}_FUNCTION" for n in range(1, 17))
_FACTORS = f"{scripts.PREFIX}SUM", COUNT


def rotor_names(count: int) -> tuple[str, ...]:
    """The CA_ROTORn_* names of the first `count` rotors."""
    return tuple(f"CA_ROTOR{n}_{field}" for n in range(count) for field in ROTOR_FIELDS)


def is_ardupilot(parameters: Mapping[str, float]) -> bool:
    """Whether these are an ArduPilot's."""
    return "FRAME_CLASS" in parameters


def table_parameters(parameters: Mapping[str, float]) -> dict[str, float]:
    """Those of `parameters` that belong to the mixer table, in the order of their names."""
    if is_ardupilot(parameters):
        names, prefix = AP_NAMES, scripts.PREFIX if parameters["FRAME_CLASS"] in SCRIPTED else None
    else:
        names, prefix = PX4_NAMES, "CA_ROTOR"
    return {
        n: v
        for n, v in sorted(parameters.items())
        if n in names or (prefix is not None and n.startswith(prefix))
    }


class TableReader:
    """Reads the table of one vehicle when something of it changed."""

    def __init__(self, heard: Heard, session: Session) -> None:
        self._heard, self._session = heard, session
        self._parameters, self._files = Parameters(session), Files(session)
        self._hash: float | None = None
        self._complete = False
        self._outputs: dict[str, float] = {}
        self._script: tuple[str, int] | None = None  # path and checksum at the last look
        self._factors: tuple[object, dict[str, float]] = (None, {})  # of which checksum, and what they are

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
        self._heard.put_parameters(self._read(THRESHOLDS))
        self._complete = len(table) == len(PX4_NAMES) + len(rotors)
        self._hash = current

    def _refresh_ardupilot(self) -> None:
        table = self._read(AP_NAMES)
        if not self._outputs or table.get("FRAME_CLASS") != self._outputs.get("FRAME_CLASS"):
            self._outputs = {**self._read(_SERVOS), "FRAME_CLASS": table.get("FRAME_CLASS", 0.0)}
        factors = self._factors_on_board(table.get("FRAME_CLASS", 0.0))
        if factors is not None:
            self._heard.put_parameters(factors, replace_prefix=scripts.PREFIX)
        self._heard.put_parameters(self._outputs | table)

    def _factors_on_board(self, frame: float) -> dict[str, float] | None:
        """The factors under the loader's names; empty for a frame that is built in, None if not known yet."""
        if frame == DYNAMIC_MATRIX:
            mark = self._read(_FACTORS)
            if mark != self._factors[0]:
                count = int(min(max(mark.get(COUNT, 0.0), 0.0), scripts.MAX_LOADER_MOTORS))
                names = [f"{scripts.PREFIX}{axis}{n}" for n in range(1, count + 1) for axis in "RPYT"]
                self._factors = mark, self._read(names) | mark if count else {COUNT: 0.0}
            return self._factors[1]
        if frame != SCRIPTING_MATRIX:
            return {}
        previous, self._script = self._script, self._script_on_board()
        if self._script is None:
            return {COUNT: 0.0}
        if self._script != previous and self._factors[0] is not None:
            return None  # it changes just now
        if self._script != self._factors[0]:
            self._factors = self._script, self._in_script(self._script[0])
        return self._factors[1]

    def _script_on_board(self) -> tuple[str, int] | None:
        for folder in scripts.SCRIPT_FOLDERS:
            path = f"{folder}/{scripts.MATRIX_NAME}"
            checksum = self._files.crc(path)
            if checksum is not None:
                return path, checksum
        return None

    def _in_script(self, path: str) -> dict[str, float]:
        data = self._files.read(path) or b""
        try:
            return scripts.loader_params(scripts.script_factors(data.decode("utf-8", "replace")))
        except TableError:
            return {COUNT: 0.0}

    def _read(self, names: Iterable[str]) -> dict[str, float]:
        found = self._parameters.read_many(names, missing_ok=True)
        return {name: float(value.value) for name, value in found.items()}
