"""An autopilot's parameters from a file: QGC's .params, ArduPilot's .param, or a log that holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from coaxlink import files
from coaxlink.data.logs.flight import log_kind
from coaxlink.errors import InputError
from firmware_params import ardupilot, px4
from firmware_params.bounded import lines_of
from firmware_params.errors import ParamsFileError


@dataclass(frozen=True)
class BoardParameters:
    """Parameters as a board had them; `firmware` is px4 or ardupilot."""

    firmware: str
    params: Mapping[str, float | int]


def read_board_parameters(path: Path) -> BoardParameters:
    """From .params, .param (.parm), a ULog or a DataFlash log, recognised by content. Raises InputError."""
    path = Path(path)
    kind = log_kind(path)
    if kind == "tlog":
        raise InputError(path, "", "a tlog: .params, .param, a ULog or a DataFlash log is expected")
    if kind == "text":
        return _of_text(path)
    params: Mapping[str, float | int]
    if kind == "ulog":
        from coaxlink.data.logs.ulog import ulog_parameters

        firmware, params = "px4", ulog_parameters(path)
    else:
        from coaxlink.data.logs.dataflash import dataflash_parameters

        firmware, params = "ardupilot", dataflash_parameters(path)
    if not params:
        raise InputError(path, "", "the log holds no parameters")
    return BoardParameters(firmware, params)


def _of_text(path: Path) -> BoardParameters:
    """QGC's rows have five fields between tabs, ArduPilot's have two."""
    text = files.read_bytes(path).decode("utf-8", "replace")
    rows = (line for _, line in lines_of(text) if line.strip() and not line.startswith("#"))
    try:
        if next(rows, "")[:1000].count("\t") == 4:
            return BoardParameters("px4", px4.read_params_file(path, finite=False).params)
        return BoardParameters("ardupilot", ardupilot.read_param_file(path, finite=False).params)
    except ParamsFileError as error:
        raise InputError(path, f"line {error.line}" if error.line else "", error.problem) from error
