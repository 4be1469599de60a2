"""The hover of a split plan: live mixing, or a parameter of PX4's module, moves the split; power is read.

Both make an end quick. Once live mixing is silent, the autopilot's own mixer flies, with the split on board;
and the module flies a trial only while this process flies the vehicle (`split_trial`). So every end of the
plan, a limit, the pilot, a dead link or this process, ends the split too.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import SafetyRefusal
from coaxlink.fly.flight import OverLimit
from coaxlink.fly.split_plan import PowerRecord, SplitPlan, hearing
from coaxlink.fly.split_trial import ShareTrial
from coaxlink.live.bridge import BridgeEnd
from coaxlink.live.mixer import LiveMixer
from coaxlink.live.module_end import ModuleEnd
from coaxlink.live.paths import own_curve
from coaxlink.mavlink import Session
from coaxlink.mavlink.telemetry import Telemetry
from coaxlink.mixer import make_law
from coaxlink.mixer.split import SplitLaw, equal_share, split_levels, upper_share
from coaxlink.tables.behaviour import behaviour
from coaxlink.threads import SWITCH_S
from coaxlink.uploading.beside import commands_on_board
from coaxlink.vehicle import Vehicle

HELD = 0.8  # of the weight, that the autopilot's own mixer must carry at the demand of the law


def split_on_board(session: Session, vehicle: Vehicle) -> tuple[float, ShareTrial | None]:
    """Share of the hover thrust that the upper rotors give with what is on board; nothing is commanded.

    And how the module on board tries another, None without one that does. Raises SafetyRefusal where this
    autopilot cannot be mixed live, or where its own mixer would drop the vehicle at an end; InputError for a
    matrix on board that is not known here.
    """
    airframe, curve = vehicle.airframe, own_curve(session)
    weight = airframe.mass_kg * GRAVITY_M_S2
    with LiveMixer(session, vehicle, own_curve=curve, dry_run=True) as probe:
        bridge = probe.bridge
        carried = probe.core.hand_over_thrust(weight) if bridge is None else weight
    if carried < HELD * weight:
        raise SafetyRefusal(
            f"at its end the autopilot's own mixer would first give {carried:.0f} N of {weight:.0f} N: "
            "set THR_MDL_FAC to 1, or nearer to it"
        )
    if bridge is None:  # PX4's mixer before CA_ parameters
        return equal_share(vehicle), None
    if isinstance(bridge, BridgeEnd):
        speeds = behaviour(vehicle, commands_on_board(vehicle, session)).hover_speeds
        return upper_share(vehicle, speeds), None
    if bridge.share is not None:
        return bridge.share.flown, ShareTrial(session, vehicle, bridge)
    # an older module flies the exact law by itself
    return upper_share(vehicle, make_law("exact", vehicle).speeds([weight, 0.0, 0.0, 0.0])), None


class SplitFlight:
    """Give `mixing` and `watch` to `Pilot.fly`; what came of it is in `record`."""

    def __init__(self, session: Session, vehicle: Vehicle, *, reach: float, levels: int, dwells: int) -> None:
        """Looks at the board (`split_on_board`) and fits the levels. Raises SafetyRefusal, InputError."""
        self._session = session
        board, self.trial = split_on_board(session, vehicle)
        if self.trial:
            shares, self.law, self.mixer = self.trial.levels(reach, levels), None, None
        else:
            made = split_levels(vehicle, board, reach, levels)
            shares, self.law = tuple(level.share for level in made), SplitLaw(made, board)
            self.mixer = LiveMixer(session, vehicle, self.law, own_curve=own_curve(session))
            # caches, never in flight
            self.law.speeds([vehicle.airframe.mass_kg * GRAVITY_M_S2, 0.0, 0.0, 0.0])
        self.plan = SplitPlan(shares, board, dwells)
        self.record = PowerRecord(
            Telemetry(session.clock.monotonic),
            self.plan,
            upper=tuple(rotor.level == "upper" for rotor in vehicle.airframe.rotors),
        )

    @contextmanager
    def mixing(self) -> Iterator[None]:
        """The split is moved; left with that on board."""
        if self.trial:
            with hearing(self._session, self.record), self.trial.mixing():
                yield
            return
        assert self.mixer is not None
        switch = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_S)
        try:
            with hearing(self._session, self.record), self.mixer:
                yield
        finally:
            sys.setswitchinterval(switch)

    @property
    def by_module(self) -> bool:
        """Whether PX4's module has the motors, so that no table acts."""
        return self.trial is not None or isinstance(self.mixer and self.mixer.bridge, ModuleEnd)

    def watch(self, t: float) -> None:
        """Move the split to where it is at `t` s of the plan. Raises OverLimit where it does not move."""
        if self.trial:  # the module makes the ramp itself
            there = self.trial.ask(self.plan.level(t))
            self.record.now_s = t if there else math.nan
            return
        assert self.mixer is not None and self.law is not None
        if self.mixer.failed.is_set():
            raise OverLimit(f"flight ended and landed: live mixing stopped itself: {self.mixer.error}")
        self.law.share = self.plan.share(t)
        self.record.now_s = t if self.mixer.state == "live" else math.nan
