"""Whether the board on the line is that of the vehicle file: its own rotors, held against the file's.

A rotor that stands or turns elsewhere gets another's command: what is mixed for it turns the vehicle over.
"""

from __future__ import annotations

from coaxlink.airframe import Airframe
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.live.bridge import loader_parameters
from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.parameters import Parameters
from coaxlink.mavlink.session import Session
from coaxlink.setup import Layout, ardupilot_layout, px4_layout
from coaxlink.setup.checks import check_against
from coaxlink.uploading.ardupilot_scripts import matrix_script
from firmware_params.ardupilot.table import DYNAMIC_MATRIX

_PX4 = ("SYS_CTRL_ALLOC", "CA_AIRFRAME", "CA_ROTOR_COUNT")
_ROTOR = ("PX", "PY", "PZ", "AX", "AY", "AZ", "CT", "KM")
_ARDUPILOT = ("FRAME_CLASS", "FRAME_TYPE", *(f"SERVO{n}_FUNCTION" for n in range(1, 33)))


def refuse_other_vehicle(session: Session, airframe: Airframe, *, new_geometry: bool = False) -> list[str]:
    """What there is to say of the board's rotors beside the file's, a line each.

    Raises SafetyRefusal where they are others, unless `new_geometry` is meant; LinkError.
    """
    try:
        found = check_against(airframe, _layout(session))
    except InputError as error:
        return [f"the board's own rotors are not known ({error}): check each motor with `turn_motors`"]
    wrong = [finding for finding in found if finding.severity == "error"]
    if wrong and not new_geometry:
        more = f" ({len(wrong)} findings)" if len(wrong) > 1 else ""
        raise SafetyRefusal(f"another vehicle: {wrong[0].text}{more}; `new_geometry` to mean it")
    return [finding.text for finding in found]


def _layout(session: Session) -> Layout:
    """Raises InputError for a board whose rotors are not in its parameters."""
    parameters, source = Parameters(session), f"{session.identity.name}, system {session.identity.system}"
    names = _PX4 if session.identity.is_px4 else _ARDUPILOT
    held = {n: v.value for n, v in parameters.read_many(names, missing_ok=True).items()}
    if not session.identity.is_px4:
        if held.get("FRAME_CLASS") == DYNAMIC_MATRIX:
            held |= loader_parameters(parameters)
        return ardupilot_layout(held, source, lambda: matrix_script(Files(session)))
    if not held.get("SYS_CTRL_ALLOC", 1):
        raise InputError(source, "SYS_CTRL_ALLOC 0", "it flies a mixer file")
    count = min(max(int(held.get("CA_ROTOR_COUNT", 0)), 0), 16)
    rotors = [f"CA_ROTOR{n}_{field}" for n in range(count) for field in _ROTOR]
    held |= {n: v.value for n, v in parameters.read_many(rotors, missing_ok=True).items()}
    return px4_layout(held, source)
