"""The stand-in's coax_mixer: what `coaxlink bridge --firmware px4` writes, as far as a line can tell.

It starts at boot when the card's `etc/extras.txt` says so, takes the mixer's place with the law it was built
with, sends its demand as DEBUG_FLOAT_ARRAY, and flies a companion's TUNNEL while what it answers is young.
The share of its upper rotors is that of COAX_SHARE, or on trial that of COAX_SHARE_TRY.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as m

EXTRAS = "etc/extras.txt"
PAYLOAD_TYPE, PROTOCOL, WHOLE, KEPT, TURN = 40001, 1, 1 << 24, 64, 24
FADE_S, FOLLOWED_S, PLAUSIBLE = 0.3, 0.1, 0.15
SHARE_NAMES = ("COAX_SHARE", "COAX_SHARE_TRY")
LOOK_S, SETPOINT_S = 0.1, 0.3  # between two looks at them; a set-point that is older is nobody's
MOVE_1_S, BACK_1_S = 0.05, 1.0  # of the share a second: to a share, and back from a trial
FOREIGN, RIVAL, INVALID, STALE, IMPLAUSIBLE = range(5)
Law = Callable[[float, float, float, float], NDArray[np.float64]]  # roll, pitch, yaw, thrust to speeds (N,)
OfSpeeds = Callable[[NDArray[np.float64]], NDArray[np.float64]]  # speeds (N,), to what a field says


@dataclass(frozen=True)
class CoaxFirmware:
    """What the module was built with."""

    identity: int
    law: Law
    delivered: OfSpeeds  # (4,) of the authority
    wrench: NDArray[np.float64]  # (4, 4) thrust, roll, pitch, yaw per roll, pitch, yaw, thrust
    lean: Callable[[float], None]  # what the law leans by from now on
    shares: NDArray[np.float64]  # (P, 2) rising shares of the upper rotors, and the lean that flies each
    own_share: float  # the law's
    commands: OfSpeeds  # (N,) of the ESCs that hold them
    timeout_s: float = 0.020  # COAX_TIMEOUT


class CoaxModule:
    """One start of it."""

    def __init__(self, built: CoaxFirmware, rotors: int) -> None:
        self.built, self._rotors = built, rotors
        self.refused = [0] * 5
        self.taken = self.handed_back = self._number = self._commanded = 0
        self.share = 0.0
        self.stopped = 0  # motors that the failure detector took out (bit i)
        self._demand = [0.0] * 4
        self._sent: dict[int, tuple[float, NDArray[np.float64]]] = {}  # number: when, what the law delivers
        self._own = self._theirs = np.zeros(rotors)
        self._of = self._heard = -1e9  # when the demand answered was sent, and its answer came
        self._answered, self._who = 0, (0, 0, 0)
        self._last = 0.0
        self.flown_share = self._board = built.own_share
        self._trial, self._seen, self._looked, self._moved = 0.0, 0.0, -1e9, 0.0
        self.tried = self._back = False

    def begin(self, on_board: float, trial: float) -> None:
        """As the parameters are when it starts: a trial that was left there is none."""
        self._board = on_board if self._has(on_board) else self.built.own_share
        self.flown_share, self._seen = self._board, trial
        self.built.lean(self._lean())

    def move_share(self, now: float, on_board: float, trial: float, alive: bool) -> None:
        """Parameters are looked at; `alive`: armed, led by fresh set-points."""
        if now - self._looked >= LOOK_S:
            self._looked = now
            self._board = on_board if self._has(on_board) else self.built.own_share
            if trial != self._seen:
                self._seen, self._trial = trial, trial if self._has(trial) else 0.0
        if not alive or self.stopped:
            self._trial = 0.0
        trying = self._trial > 0
        self._back = (self._back or self.tried) and not trying
        self.tried = trying
        wanted = self._trial if trying else self._board
        step = (BACK_1_S if self._back else MOVE_1_S) * min(now - self._moved, 0.02)
        self._moved = now
        if wanted != self.flown_share:
            self.flown_share += min(max(wanted - self.flown_share, -step), step)
            self.built.lean(self._lean())
        self._back = self._back and wanted != self.flown_share

    def _has(self, share: float) -> bool:
        return bool(self.built.shares[0, 0] <= share <= self.built.shares[-1, 0])

    def _lean(self) -> float:
        return float(np.interp(self.flown_share, *self.built.shares.T))

    def mix(self, now: float, roll: float, pitch: float, yaw: float, thrust: float) -> None:
        """A demand of the rate loops: solved, and numbered for the companion."""
        self._demand = [roll, pitch, yaw, thrust]
        self._own = self.built.law(roll, pitch, yaw, thrust)
        self._number = (self._number + 1) % WHOLE
        self._commanded = (self._commanded + 1) % TURN
        self._sent[self._number] = now, self.built.delivered(self._own)
        self._sent.pop((self._number - KEPT) % WHOLE, None)

    def outputs(self, now: float) -> NDArray[np.float64]:
        """(N,) what is flown."""
        dt, self._last = min(now - self._last, 0.02), now
        if now - self._of > self.built.timeout_s + 1e-9:
            self.handed_back += self.share > 0
            self.share = 0.0
        else:
            self.share = min(1.0, self.share + dt / FADE_S)
        turns = [not self.stopped >> i & 1 for i in range(self._rotors)]
        speeds = self._own + self.share * (self._theirs - self._own)
        return np.where(turns, self.built.commands(np.where(turns, speeds, 0.0)), 0.0)

    def demand_message(self, now: float, time_usec: int) -> m.MAVLink_message:
        """DEBUG_FLOAT_ARRAY."""
        facts = [*self.refused, self.handed_back, 0, self.stopped, *self.built.wrench.ravel().tolist()]
        followed = self._who if self._is_followed(now) else (0, 0, 0)
        data = [
            *self._demand, *followed[:2], self.taken, self._number, self.built.identity, followed[2],
            self.share, self._commanded, facts[self._commanded],
            self.flown_share, float(self.tried), self.built.own_share,
            *self.built.shares[[0, -1], 0].tolist(),
        ]  # fmt: skip
        return m.MAVLink_debug_float_array_message(time_usec, b"coax", PAYLOAD_TYPE, data + [0.0] * 40)

    def hear(self, now: float, message: m.MAVLink_message) -> None:
        """TUNNEL."""
        if message.payload_type == PAYLOAD_TYPE:
            why = self._refusal(now, bytes(message.payload[: message.payload_length]))
            if why is not None:
                self.refused[why] += 1

    def _is_followed(self, now: float) -> bool:
        return now - self._heard <= FOLLOWED_S

    def _refusal(self, now: float, payload: bytes) -> int | None:
        if len(payload) < 16 + 4 * self._rotors or payload[14:16] != bytes([self._rotors, PROTOCOL]):
            return FOREIGN
        identity, token, number, system, component = struct.unpack_from("<IIIBB", payload)
        if identity != self.built.identity:
            return FOREIGN
        who = system, component, token
        if self._is_followed(now) and who != self._who:
            return RIVAL
        u = np.frombuffer(payload, "<f4", self._rotors, 16).astype(float)
        if not ((u >= 0) & (u <= 1)).all():
            return INVALID
        at, own = self._sent.get(number, (-1e9, self._own))
        newer = not self._is_followed(now) or 0 < (number - self._answered) % WHOLE < WHOLE // 2
        if now - at > self.built.timeout_s + 1e-9 or not newer:
            return STALE
        if any(self.stopped >> i & 1 and u[i] > 0 for i in range(self._rotors)):
            return IMPLAUSIBLE
        if np.abs(self.built.delivered(u) - own).max() > PLAUSIBLE:
            return IMPLAUSIBLE
        self._theirs, self._who, self._answered, self._of, self._heard = u, who, number, at, now
        self.taken = (self.taken + 1) % 65536
        return None
