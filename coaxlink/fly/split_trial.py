"""The split moved by a parameter of PX4's module (COAX_SHARE_TRY), which flies it with nobody in the loop.

The module flies a trial only while set-points come and the vehicle is in offboard mode; the pilot's mode
change, a dead process or a dead link end it there, not here (`onboard/px4_module/Share.hpp`). What it flies
it says itself; a parameter that reads back well is not enough.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.fly.flight import OverLimit
from coaxlink.live.module_end import PAYLOAD_TYPE, ModuleEnd, SharesFlown
from coaxlink.mavlink import Session, codec
from coaxlink.mavlink.parameters import Parameters
from coaxlink.mavlink.values import FLOAT, ParamSet
from coaxlink.mixer.shares import shares_of
from coaxlink.vehicle import Vehicle

ON_BOARD, TRIAL = "COAX_SHARE", "COAX_SHARE_TRY"
REPORT_HZ = 20.0  # of what the module flies
SAME_MODEL = 0.005  # of the share: further apart, board and file are of different rotor models
NEAR = 0.002  # of the share: flown as asked
AGAIN_S = 0.5  # until a write that was not echoed is sent again
REFUSED_S = 3.0  # of asking in vain until the flight ends; a step takes 1 s
STALE_S = 0.5  # what it reported longer ago counts no more
NUDGE = 1e-5  # of the share: a trial that ended is taken up again once its number changes


class ShareTrial:
    """One flight's trials: `mixing` around the plan, `ask` at every set-point."""

    def __init__(self, session: Session, vehicle: Vehicle, module: ModuleEnd) -> None:
        """Raises SafetyRefusal where the module was built with another rotor model, or a companion mixes."""
        assert module.share is not None
        self.share: SharesFlown = module.share
        if module.companion:
            raise SafetyRefusal(f"the module follows a companion ({module.companion}): end that first")
        self._session, self._clock = session, session.clock
        own = shares_of(vehicle).own
        if abs(own - self.share.own) > SAME_MODEL:
            raise SafetyRefusal(
                f"the module's law gives {self.share.own:.3f} of the thrust from above, with this rotor "
                f"model it is {own:.3f}: the module was built with another one (write and build it again)"
            )
        self._heard_s = self._flown_s = -math.inf
        self._asked, self._asked_s, self._nudges = 0.0, -math.inf, 0
        self._echo = math.nan

    def levels(self, reach: float, count: int) -> tuple[float, ...]:
        """`count` shares (odd) evenly to both sides of that on board, those that the rotors have.

        Raises InputError for fewer than three.
        """
        board, least, most = self.share.flown, self.share.least, self.share.most
        even = np.linspace(board - reach, board + reach, count)
        found = tuple(float(share) for share in even if least <= share <= most)
        if len(found) < 3:
            problem = f"within {reach:g} of {board:.3f} too few can be had: {least:.3f} to {most:.3f}"
            raise InputError("the module", "share", problem)
        return found

    @contextmanager
    def mixing(self) -> Iterator[None]:
        """Left with the share on board."""
        session = self._session
        session.request_stream(codec.DEBUG_FLOAT_ARRAY.number, REPORT_HZ)
        end = session.subscribe(self._hear)
        try:
            self._write(0.0)
            yield
        finally:
            # the module lets go by itself; this clears the number, and a line may lose one
            for _ in range(3):
                self._write(0.0)
            end()

    def ask(self, share: float) -> bool:
        """Have it flown; whether it is. Raises OverLimit where the module takes up no trial."""
        now, flown = self._clock.monotonic(), self.share
        heard = now - self._heard_s < STALE_S
        there = heard and flown.on_trial and abs(flown.flown - share) < NEAR
        if (heard and flown.on_trial) or math.isinf(self._flown_s):
            self._flown_s = now
        if now - self._flown_s > REFUSED_S:
            raise OverLimit(
                f"flight ended and landed: for {REFUSED_S:g} s the module has flown {flown.flown:.3f} and "
                f"not {TRIAL} {share:.3f}"
            )
        wanted = share + NUDGE * (self._nudges % 2)
        if abs(wanted - self._asked) > 0.5 * NUDGE:
            self._write(wanted)
        elif now - self._asked_s > AGAIN_S and not there:
            if abs(self._echo - wanted) < 0.1 * NUDGE and heard and not flown.on_trial:
                self._nudges += 1  # it has the number and let go of it: set-points were late for once
                wanted = share + NUDGE * (self._nudges % 2)
            self._write(wanted)
        return there

    def _write(self, share: float) -> None:
        self._asked, self._asked_s = share, self._clock.monotonic()
        parameters = Parameters(self._session)
        target = self._session.identity
        value = parameters.encode(TRIAL, share, FLOAT)
        self._session.send(ParamSet(target.system, target.component, value))

    def _hear(self, message: Any) -> None:
        """Session subscriber."""
        kind = message.get_type()
        if kind == "PARAM_VALUE" and message.param_id == TRIAL:
            self._echo = float(message.param_value)
        elif kind == codec.DEBUG_FLOAT_ARRAY.name and message.array_id == PAYLOAD_TYPE:
            share = SharesFlown.of(message.data)
            if share is not None:
                self.share, self._heard_s = share, self._clock.monotonic()
