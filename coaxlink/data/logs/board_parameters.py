"""An autopilot's parameters from whatever holds them: a file of any ground station, or a log.

The one reader of `init`, `table`, `upload`, `verify` and `restore`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from coaxlink.data.logs.flight import log_kind, refuse_other_system
from coaxlink.errors import InputError
from firmware_params.errors import ParamsFileError
from firmware_params.reading import ARDUPILOT, PX4, ParamsFile, firmware_of, read_params


def read_board_parameters(path: Path, *, telling: bool = False, system: int | None = None) -> ParamsFile:
    """Of a file in any form of `firmware_params.reading`, a ULog, a DataFlash log or a tlog.

    With `telling` the names must say whose they are; of several vehicles `system` says which. Raises
    InputError with the line; for a damaged ULog or DataFlash log, whose messages have no checksum.

    >>> read_board_parameters(Path("/dev/null"))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    coaxlink.errors.InputError: /dev/null: cannot be read (a file is expected, found a pipe or a device...
    """
    path = Path(path)
    kind = log_kind(path)
    try:
        if kind == "text":
            found = read_params(path, finite=False, system=system)
        else:
            found = _of_log(path, kind, system)
    except ParamsFileError as error:
        raise InputError(path, f"line {error.line}" if error.line else "", error.problem) from error
    if not found.params:
        raise InputError(path, "", "the log holds no parameters")
    if kind != "tlog" and not found.system:
        refuse_other_system(path, system, found.params)
    if telling and not found.firmware:
        problem = "neither FRAME_CLASS (ArduPilot) nor CA_* (PX4): whose parameters these are is not known"
        raise InputError(path, "", "; ".join([problem, *found.notes]))
    return found


def _of_log(path: Path, kind: str, system: int | None) -> ParamsFile:
    if kind == "ulog":
        from coaxlink.data.logs.ulog import ulog_parameters

        return ParamsFile(ulog_parameters(path, whole=True), PX4)
    if kind == "tlog":
        from coaxlink.data.logs.tlog import tlog_parameters

        params, provenance = tlog_parameters(path, system)
        found = ParamsFile({n: float(v) for n, v in params.items()}, notes=provenance)
        return replace(found, firmware=firmware_of(path, params))
    from coaxlink.data.logs.dataflash import dataflash_parameters

    params = dataflash_parameters(path, whole=True)
    return ParamsFile({n: float(v) for n, v in params.items()}, ARDUPILOT)
