"""The Lua script for ArduPilot: the demand out to a companion, its motor commands in; see `live.bridge`."""

from __future__ import annotations

from pathlib import Path
from string import Template

from coaxlink.errors import InputError
from coaxlink.live.mixer_core import CONTROLS
from coaxlink.live.onboard.description import BoardVehicle
from coaxlink.tables.files import file_name
from firmware_params import ardupilot
from firmware_params.ardupilot import scripts

SCRIPT_NAME = "coaxlink_bridge.lua"
HOLD_MS = 100  # an answer's life; the default of the option
PERIOD_MS = 4  # between demands: 250 Hz
ASK = 255  # the group of an answer that only asks for the demand
REQUEST_MS = 3000  # a link where a companion asked within this gets the demand
COUNTED = 65536  # whole numbers up to 2^24 are exact in the message's single precision


def script_files(about: BoardVehicle, *, hold_ms: int = HOLD_MS) -> dict[str, str]:
    """{path: text} of the script and of the parameters that start it. Raises InputError."""
    text = bridge_script(about.rotors, hold_ms=hold_ms)
    # the folder's checksum is made of all its scripts: the upload adds those that are there
    params = {"SCR_ENABLE": 1.0, "SCR_LD_CHECKSUM": float(scripts.load_checksum([text.encode()]))}
    written = ardupilot.param_text(params, [f"coaxlink bridge of {about.name}"])
    return {f"{file_name(about.name)}.param": written, f"scripts/{SCRIPT_NAME}": text}


def bridge_script(motors: int, *, hold_ms: int = HOLD_MS) -> str:
    """The script for a vehicle of so many motors (1..8), numbered as Motor1.. (SERVOn_FUNCTION 33..40).

    Raises InputError when there are more motors than the message carries.
    """
    if not 1 <= motors <= CONTROLS:
        raise InputError("bridge", "motors", f"1 to {CONTROLS} expected, found {motors}")
    if not 20 <= hold_ms <= 500:
        raise InputError("bridge", "hold_ms", f"20 to 500 expected, found {hold_ms}")
    script = Template(Path(__file__).with_name(SCRIPT_NAME).read_text())
    return script.substitute(
        motors=motors, hold=hold_ms, period=PERIOD_MS, ask=ASK, request_ms=REQUEST_MS, counted=COUNTED
    )
