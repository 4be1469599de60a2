"""Steps of the split in hover: which level when, and what the vehicle said of its power meanwhile."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from coaxlink.data.logs.esc_readings import on_a_line
from coaxlink.errors import InputError
from coaxlink.fly.esc_amps import STALE_S, EscAmps, esc_amps
from coaxlink.fly.split_answer import Dwells, SplitAnswer, best_split, dwells_of, joined
from coaxlink.fly.trajectory import FlightPlan, Hold
from coaxlink.mavlink import Session
from coaxlink.mavlink.telemetry import Telemetry

RAMP_S = 1.0  # from a level to the next
SETTLE_S = 4.0  # after a step until readings count: the ramp, the height loop and the power module's filter
DWELL_S = 18.0  # settling takes two ninths of it; at 12 s a third, and savings scattered by a fifth more
POWER_HZ, MODE_HZ = 10.0, 10.0  # of battery readings, and of what tells the pilot's mode change
# message ids; PX4 refuses an interval for its heartbeat, which comes once a second, not for HIGH_LATENCY2
BATTERY, HEARTBEAT, HIGH_LATENCY2 = 147, 0, 235
ESC_STATUS, ESC_TELEMETRY = 291, 11030  # of PX4, and of ArduPilot, which sends its others with it
COLUMNS = ("sinking", "falling", "tilt")  # what moves the watts beside time and the split


@dataclass(frozen=True)
class SplitPlan:
    """Up and down through the levels, then down and up, and so on: what drifts steadily cancels (ABBA).

    It begins and ends at `on_board`; every step goes to a level beside the one before.
    """

    levels: tuple[float, ...]  # rising shares of the upper rotors
    on_board: float
    dwells: int
    dwell_s: float = DWELL_S
    settle_s: float = SETTLE_S

    @property
    def duration_s(self) -> float:
        """All dwells, and a ramp back."""
        return self.dwells * self.dwell_s + RAMP_S

    def number(self, t: float) -> int:
        """Of the dwell at `t` s, from 0."""
        return int(t // self.dwell_s)

    def level(self, t: float) -> float:
        """What is flown at `t` s, once the ramp to it is over."""
        number = self.number(t)
        return self._order(number) if 0 <= number < self.dwells else self.on_board

    def share(self, t: float) -> float:
        """What to fly at `t` s: a ramp of RAMP_S from the level before."""
        before, level = self.level(t - self.dwell_s), self.level(t)
        part = min(t % self.dwell_s / RAMP_S, 1.0)
        return before + part * (level - before)

    def flight(self, height_m: float) -> FlightPlan:
        """The hover in which it is flown."""
        return FlightPlan((Hold("split", (0.0, 0.0, -height_m), self.duration_s),))

    def words(self) -> str:
        """What it will do, in a line."""
        levels = ", ".join(f"{share:.3f}" for share in self.levels)
        return (
            f"split: hovers {self.duration_s / 60:.1f} minutes, the upper rotors give {levels} of the thrust "
            f"in turn ({self.on_board:.3f} on board), {self.dwells} times {self.dwell_s:g} s"
        )

    def _order(self, number: int) -> float:
        """Starting in the middle, up and down; every second round mirrored."""
        top = len(self.levels) - 1
        middle = min(range(top + 1), key=lambda n: abs(self.levels[n] - self.on_board))
        place = (middle + number) % (2 * (top + 1))
        return self.levels[place if place <= top else 2 * top + 1 - place]


@dataclass
class PowerRecord:
    """Battery readings of the hover, and what else moves them: subscribe `hear`, call `at` as time passes.

    Empty where the vehicle measures no current.
    """

    telemetry: Telemetry
    plan: SplitPlan
    now_s: float = math.nan  # into the plan, the vehicle's clock; NaN: nothing is kept
    rows: list[tuple[float, ...]] = field(default_factory=list)  # dwell, s, W, share, sinking m/s, tilt^2
    earlier: tuple[Dwells, ...] = ()  # flights before, with other packs
    upper: tuple[bool, ...] = ()  # of every motor, whether its rotor is an upper one
    amps: list[tuple[float, ...]] = field(
        default_factory=list
    )  # a row each: battery's, then the ESCs' or NaN
    rpm: list[list[float]] = field(default_factory=list)  # a row each, of the ESCs
    battery: int = 256  # whose readings these are, by its id; above all that there are

    def hear(self, message: Any) -> None:
        """Session subscriber."""
        t = self.now_s  # once: it is set on another thread
        if math.isnan(t) or message.get_type() != "BATTERY_STATUS" or message.current_battery < 0:
            return
        if message.id < self.battery:  # of several monitors the first: two may read one pack
            self.battery = message.id
            for heard in (self.rows, self.amps, self.rpm):
                heard.clear()
        if message.id != self.battery:
            return
        volts = sum(v for v in message.voltages if 0 < v < 65535) / 1e3
        velocity, attitude = self.telemetry.latest("velocity"), self.telemetry.latest("attitude")
        if velocity and attitude:
            roll, pitch, _ = attitude.value
            amps = message.current_battery / 100.0
            watts = volts * amps
            number, level = self.plan.number(t), self.plan.level(t)
            self.rows.append((number, t, watts, level, velocity.value[2], roll**2 + pitch**2))
            self.amps.append((amps, *self._each("esc_current")))
            self.rpm.append(self._each("esc_rpm"))

    def _each(self, reading: str) -> list[float]:
        """(N,) by motor, NaN where its ESC did not say it just now."""
        now, each = self.telemetry.now(), self.telemetry.each(reading)
        return [
            each[k].value if k in each and now - each[k].received_s <= STALE_S else math.nan
            for k in range(len(self.upper))
        ]

    def escs(self) -> EscAmps:
        """The ESCs' amps against the battery's. Raises InputError where they are not all there."""
        if len(self.rows) < 2 or not self.upper:
            raise InputError("the ESCs", "current", "no hover in which any was heard")
        rows, amps, rpm = np.array(self.rows), np.array(self.amps), np.array(self.rpm)
        known = np.isfinite(amps[:, 1:]).all(axis=1) & np.isfinite(rpm).all(axis=1)
        if known.any() and all(on_a_line(r, a) for r, a in zip(rpm[known].T, amps[known, 1:].T, strict=True)):
            problem = (
                "a straight line over their rpm to the last digit: a simulator made both of the commands"
            )
            raise InputError("the ESCs", "current", problem)
        return esc_amps(rows, amps, self.upper, self.plan.settle_s, self.plan.on_board)

    def dwells(self) -> Dwells:
        """One row a dwell; columns: sinking, its rate (what the thrust is beside the weight), tilt squared.

        Raises InputError where nothing was measured.
        """
        if len(self.rows) < 2:
            raise InputError("the vehicle", "BATTERY_STATUS", "it says no battery current: no power is known")
        number, t, watts, level, sinking, tilt = np.array(self.rows).T
        step = np.maximum(np.diff(t, append=t[-1] + 1.0), 1e-3)
        falling = np.append(np.diff(sinking), 0.0) / step
        columns = dict(zip(COLUMNS, (sinking, falling, tilt), strict=True))
        return dwells_of(number, t, watts, level, self.plan.settle_s, columns)

    def answer(self) -> SplitAnswer:
        """Of what was flown, now and earlier. Raises InputError where that is too little."""
        return best_split(joined([*self.earlier, self.dwells()]), self.plan.on_board)


@contextmanager
def hearing(session: Session, record: PowerRecord) -> Iterator[None]:
    """A record that hears what the vehicle says of its battery, often enough."""
    session.request_stream(BATTERY, POWER_HZ)
    ardupilot = session.identity.is_ardupilot
    session.request_stream(HEARTBEAT if ardupilot else HIGH_LATENCY2, MODE_HZ)
    session.request_stream(ESC_TELEMETRY if ardupilot else ESC_STATUS, POWER_HZ)
    ends = [session.subscribe(record.telemetry.hear), session.subscribe(record.hear)]
    try:
        yield
    finally:
        record.now_s = math.nan
        for end in ends:
            end()
