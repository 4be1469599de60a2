"""The Lua bridge for ArduPilot: its whole demand out to the companion, the companion's outputs in.

ArduPilot has no handler for SET_ACTUATOR_CONTROL_TARGET, but its scripts may receive it and hold outputs for
a while (`SRV_Channels:set_output_pwm_chan_timeout`). The script (`onboard.ardupilot`) sends roll, pitch, yaw
and throttle as ACTUATOR_CONTROL_TARGET each time it runs, takes the newest answer meant for this vehicle,
checks it whole (eight finite numbers in 0..1, armed, no emergency stop) and holds the motors' outputs for
HOLD_MS: on silence the matrix flies again. Overrides bypass ArduPilot's own emergency stop, hence the
checks.

The demand goes to the links where a companion has asked for it within REQUEST_MS, by an answer or by one of
group ASK that commands nothing: a radio with a ground station behind it is not flooded. One companion is
followed until it has been silent for HOLD_MS, and told to all: controls 5 and 6 of the demand are the system
and component of the companion followed, 0 when there is none. Control 7 is how many commands it has taken,
modulo COUNTED: what a line loses shows in it. Control 8 is the token with which the companion followed asked:
two with the same ids, on two links, tell by it which of them that is.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import SafetyRefusal
from coaxlink.live.arrival import Count
from coaxlink.live.mixer_core import CONTROLS
from coaxlink.live.onboard.ardupilot import ASK, COUNTED
from coaxlink.mavlink.parameters import Parameters
from firmware_params.ardupilot import scripts
from firmware_params.ardupilot.frames import OCTAQUAD, Y6
from firmware_params.ardupilot.table import (
    DYNAMIC_MATRIX,
    SCRIPTING_MATRIX,
    ApTable,
    Factors,
    used_factors,
)
from firmware_params.errors import TableError

if TYPE_CHECKING:
    from coaxlink.mavlink.session import Session

TOKENS = 2**24  # whole numbers so far are exact in the message's single precision
FIND_S, ASK_EVERY_S, REMIND_S = 1.5, 0.3, 1.0


def board_factors(session: Session) -> list[list[float]]:
    """(N, 4) factors of the frame on board, as the firmware uses them.

    A frame whose factors come from a script (15, 17) is read back from coaxlink's own. Raises SafetyRefusal
    for one whose factors are not known here: another's script, or half a table.
    """
    parameters = Parameters(session)
    found = parameters.read_many(["FRAME_CLASS", "FRAME_TYPE"])
    frame = int(found["FRAME_CLASS"].value), int(found["FRAME_TYPE"].value)
    try:
        given: tuple[Factors, ...] = ()
        if frame[0] == SCRIPTING_MATRIX:
            given = scripts.script_factors(_script_on_board(session))
        elif frame[0] == DYNAMIC_MATRIX:
            given = scripts.params_factors(loader_parameters(parameters))
        elif frame[0] not in (OCTAQUAD, Y6):
            raise TableError("the bridge is known to work on 4 (octaquad), 5 (Y6), 15 and 17")
        factors = used_factors(ApTable(frame[0], given, frame_type=frame[1]))
    except TableError as error:
        raise SafetyRefusal(f"FRAME_CLASS {frame[0]}: {error}") from error
    return [[float(f) for f in row] for row in factors]


class BridgeEnd:
    """The companion's end of the bridge: asks for the demand, and reads in it whom the bridge follows."""

    def __init__(self, session: Session) -> None:
        self._session, self._clock, self._requested_s = session, session.clock, 0.0
        self.token = 1 + secrets.randbelow(TOKENS - 1)  # 0 is none
        self.taken = Count(COUNTED)  # of our commands, by the script
        self.acknowledged = False  # at some time it reported that it follows us

    def find(self) -> bool:
        """Whether our script speaks."""
        end = self._clock.monotonic() + FIND_S
        while self._clock.monotonic() < end:  # one question may be lost
            self._ask()
            if self._session.wait("ACTUATOR_CONTROL_TARGET", ASK_EVERY_S) is not None:
                return True
        return False

    def tick(self, now: float) -> None:
        """Remind it that we are here."""
        if now - self._requested_s > REMIND_S:
            self._ask()

    def hear(self, demand: Sequence[float]) -> str | None:
        """Another companion that a demand (stamp, eight controls, group) says the bridge follows."""
        who, token = tuple(demand[5:7]), demand[8]
        self.taken.hear(demand[7])
        named = f"system {who[0]:g} component {who[1]:g}"
        if who == self._session.source and token in (0.0, self.token):
            self.acknowledged = True
            return None
        if who == (0.0, 0.0):
            return None
        return named if who != self._session.source else f"{named}, our own ids, on another link"

    def account(self) -> dict[str, int]:
        """What it reported of itself, as `coaxlink mix --json` has it under `board`."""
        return {"taken": self.taken.total}

    def _ask(self) -> None:
        self._requested_s = self._clock.monotonic()
        identity = self._session.identity
        self._session.send(
            mavlink.MAVLink_set_actuator_control_target_message(
                0, ASK, identity.system, identity.component, [self.token, *[0.0] * (CONTROLS - 1)]
            )
        )


def _script_on_board(session: Session) -> str:
    from coaxlink.mavlink.ftp import Files

    board = Files(session)
    for folder in scripts.SCRIPT_FOLDERS:
        data = board.read(f"{folder}/{scripts.MATRIX_NAME}")
        if data is not None:
            return data.decode("utf-8", "replace")
    raise TableError(f"no {scripts.MATRIX_NAME} on board")


def loader_parameters(parameters: Parameters) -> dict[str, float]:
    """The table that the loader script holds, by its parameters' names."""
    prefix = scripts.PREFIX
    count = parameters.read_many([f"{prefix}N"], missing_ok=True).get(f"{prefix}N")
    motors = min(max(int(count.value), 0), scripts.MAX_LOADER_MOTORS) if count else 0
    names = [f"{prefix}{axis}{n}" for n in range(1, motors + 1) for axis in "RPYT"]
    found = parameters.read_many([f"{prefix}N", f"{prefix}SUM", *names], missing_ok=True)
    return {name: float(value.value) for name, value in found.items()}
