"""One demand through the law: what it means in N and N m, and eight bounded commands; no clock, no link."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.errors import InputError
from coaxlink.live import hot_kernel
from coaxlink.live.counts import Counters
from coaxlink.mixer import Law, StandardCoefficients, make_law, standard_coefficients
from coaxlink.mixer.plain import PlainRotors
from coaxlink.vehicle import Vehicle, require_vehicle
from firmware_params.px4 import Px4Table, RotorEntry, realise

CONTROLS = 8  # what the messages carry
ABSURD = 1.5  # a normalised demand beyond this is no demand; up to it, it is held to the range
FIRST_DT_S, MOST_DT_S = 0.004, 0.05  # between demands, where it is not known or out of the ordinary
JUMP_US = 1_000_000  # stamps further apart than this are another clock, which must show itself twice


class Compensation(Protocol):
    """Effects beside the rotor model, as `live_effects.LiveEffects` knows them."""

    @property
    def names(self) -> Sequence[str]:
        """What is compensated."""

    @property
    def left_out(self) -> Mapping[str, str]:
        """What is not, and why."""

    def wrench(self, speeds: Sequence[float]) -> NDArray[np.float64]:
        """(4,) what the effects add to the wrench at these speeds."""

    @property
    def factor(self) -> float:
        """Normalised speed per command."""


class DemandScale:
    """The wrench that a normalised demand means: W = E (mix s) of a reference table.

    E is the table's effectiveness in N and N m per unit setpoint and `mix` PX4's normalised mix of it. For
    the legacy mixers (<= 1.13) the reference is the standard table of the airframe. `own_curve` is the
    THR_MDL_FAC on board, which shapes only what the autopilot's own mixer does.
    """

    def __init__(self, airframe: Airframe, standard: StandardCoefficients, own_curve: float = 0.0) -> None:
        table = Px4Table(
            tuple(RotorEntry(r.position_m, r.axis, standard.p, r.yaw_sign * standard.q / standard.p)
                  for r in airframe.rotors),
            thr_mdl_fac=own_curve,
        )  # fmt: skip
        self._mix = mix = realise(table)
        body = mix.effectiveness @ mix.mix  # (6, 6): roll, pitch, yaw, x, y, z of each normalised control
        per_control = body[:, [0, 1, 2, 5]] * np.array([1.0, 1.0, 1.0, -1.0])  # thrust counts upward
        self.matrix: NDArray[np.float64] = np.stack([-per_control[5], *per_control[:3]])  # (4, 4)
        self._finish()

    def _finish(self) -> None:
        """What `wrench` and `controls` work with."""
        self._rows = self.matrix.tolist()
        self._inverse = np.linalg.pinv(self.matrix[1:, :3]).tolist()

    def wrench(self, controls: Sequence[float]) -> list[float]:
        """(4,) wrench, N and N m, of controls [roll, pitch, yaw, thrust]; a list, which costs less here."""
        a, b, c, d = controls[:4]
        return [r[0] * a + r[1] * b + r[2] * c + r[3] * d for r in self._rows]

    def controls(self, thrust: float, torque: Sequence[float]) -> list[float]:
        """Controls [roll, pitch, yaw, thrust] that mean a torque (3,) in N m, held to -1..1."""
        inverse = self._inverse
        # thrust first: a tilted rotor's share of it in the torque is then made up for
        rest = [t - r[3] * thrust for t, r in zip(torque, self._rows[1:], strict=True)]
        out = [sum(i * t for i, t in zip(row, rest, strict=True)) for row in inverse]
        return [min(max(v, -1.0), 1.0) for v in out] + [thrust]

    def own(self, controls: Sequence[float]) -> list[float]:
        """(N,) commands that the autopilot's own mixer makes of the controls."""
        roll, pitch, yaw, thrust = controls[:4]
        mix = self._mix
        return [float(u) for u in mix.throttle(mix.setpoints((roll, pitch, yaw, 0.0, 0.0, -thrust)))]


class MatrixScale(DemandScale):
    """The wrench that ArduPilot's demand means: normalised thrust of every motor by the matrix on board.

    `factors` (N, 4) are each motor's roll, pitch, yaw and throttle as the firmware uses them; a normalised
    thrust of 1 is the standard rotor's (eq. 18).
    """

    def __init__(
        self, airframe: Airframe, standard: StandardCoefficients, factors: Sequence[Sequence[float]]
    ) -> None:
        per_thrust, per_torque = airframe.effectiveness()
        per_motor = standard.p * per_thrust + standard.q * per_torque  # (4, N)
        self.matrix = per_motor @ np.asarray(factors, float)  # (4, 4): by roll, pitch, yaw, throttle
        self._finish()

    def own(self, controls: Sequence[float]) -> list[float]:
        """Not known: ArduPilot's saturation depends on its state. Raises InputError."""
        raise InputError("ArduPilot", "", "its own mixer's outputs are not known here")


def _refuse_dropped(vehicle: Vehicle, compensation: Compensation | None) -> None:
    known = {*compensation.names, *compensation.left_out} if compensation is not None else set()
    dropped = [e.name for e in vehicle.live_effects if e.name not in known]
    if dropped:
        problem = f"{', '.join(dropped)}: left to live mixing, and not in it"
        raise InputError("vehicle", "compensation", problem)


class MixCore:
    """Demand in, commands out: what `LiveMixer` runs and tests drive by hand."""

    def __init__(
        self,
        vehicle: Vehicle,
        law: str | Law = "exact",
        compensation: Compensation | None = None,
        own_curve: float = 0.0,
        lead_s: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """`law` by its name is made for this vehicle; a Law must have been.

        `lead_s`: the motors' lag and the lag wanted of them instead (s); see `hot_kernel.lead`.
        Raises InputError also where the vehicle leaves effects to live mixing and `compensation` has not all.
        """
        require_vehicle(vehicle)
        _refuse_dropped(vehicle, compensation)
        airframe, model = vehicle.airframe, vehicle.model
        if len(airframe.rotors) > CONTROLS:
            raise InputError(
                airframe.source or airframe.name, "rotors", f"live mixing carries {CONTROLS} motors at most"
            )
        self.vehicle = vehicle
        self.law = make_law(law, vehicle) if isinstance(law, str) else law
        self.scale = DemandScale(airframe, standard_coefficients(model), own_curve)
        self._airframe, self._standard = airframe, standard_coefficients(model)
        self.counters = Counters()
        self.compensation = compensation
        self.rotors = PlainRotors.of(vehicle)
        self.count = len(airframe.rotors)
        self._last_us: int | None = None
        self._strange_us: int | None = None
        self.dt_s = FIRST_DT_S  # between the last two demands
        self.lead_s = lead_s
        self._floats = [0.0] * hot_kernel.FLOATS
        self._floats[hot_kernel.FACTOR] = 1.0
        self._floats[hot_kernel.LAG_S], self._floats[hot_kernel.QUICK_S] = lead_s
        # the speeds the motors are taken to have, and what they were told last; the hot loop's own if it runs
        self.motors: Any = [0.0] * CONTROLS
        self.told: Any = [0.0] * CONTROLS
        self.wrench: list[float] = [0.0] * 4  # demanded
        self.error: Any = [0.0] * 4  # (4,) delivered by the rotor model at the law's speeds, minus demanded
        self.speeds: list[float] = [0.0] * self.count  # of the law
        self.held = (0.0, 0.0, 0.0, 0.0)

    @property
    def law(self) -> Law:
        """What makes speeds of a wrench."""
        return self._law

    @law.setter
    def law(self, law: Law) -> None:
        self._law = law
        self._law_speeds: Callable[[Any], list[float]] = getattr(law, "plain", None) or (
            lambda wrench: law.speeds(wrench).tolist()
        )

    def use_matrix(self, factors: Sequence[Sequence[float]]) -> None:
        """Read demands as ArduPilot's with these factors (N, 4) on board. Raises InputError."""
        if len(factors) != self.count:
            raise InputError(
                self._airframe.source or self._airframe.name,
                "rotors",
                f"{self.count} rotors here, {len(factors)} motors in the frame on board",
            )
        self.scale = MatrixScale(self._airframe, self._standard, factors)

    def admit(self, time_usec: int, group: int, controls: Sequence[float]) -> bool:
        """Whether a demand deserves an answer; keeps it, held to the range, as `held`."""
        c = self.counters
        if group != 0:
            c.other_group += 1
            return False
        roll, pitch, yaw, thrust = controls[0], controls[1], controls[2], controls[3]
        if not math.isfinite(roll + pitch + yaw + thrust):
            c.not_finite += 1
            return False
        if max(abs(roll), abs(pitch), abs(yaw)) > ABSURD or not 1.0 - ABSURD <= thrust <= ABSURD:
            c.absurd += 1
            return False
        if not self._in_order(time_usec):
            return False
        held = (
            min(max(roll, -1.0), 1.0), min(max(pitch, -1.0), 1.0), min(max(yaw, -1.0), 1.0),
            min(max(thrust, 0.0), 1.0),
        )  # fmt: skip
        if held != (roll, pitch, yaw, thrust):
            c.clamped += 1
        self.held = held
        return True

    def _in_order(self, stamp: int) -> bool:
        """Stamps must rise by less than a second; another clock must come twice in a row to be believed."""
        c, last = self.counters, self._last_us
        if last is None or 0 < stamp - last < JUMP_US:
            self.dt_s = min((stamp - last) * 1e-6, MOST_DT_S) if last is not None else FIRST_DT_S
            self._last_us, self._strange_us = stamp, None
            return True
        if -JUMP_US < stamp - last <= 0:
            c.late += 1
            return False
        strange, self._strange_us = self._strange_us, stamp
        if strange is not None and 0 < stamp - strange < JUMP_US:
            self._last_us, self._strange_us = stamp, None
            return True
        c.clock_jumps += 1
        return False

    def mix(self, share: float = 1.0) -> list[float] | None:
        """Eight commands in [0, 1] for the demand held; None when the law gave what is no command.

        `share` is the law's part; the rest is the autopilot's own mixer.
        """
        c, extra = self.counters, self.compensation
        wanted: Any = self.scale.wrench(self.held)
        self.wrench = wanted
        if extra is not None:
            wanted = wanted - extra.wrench(self.speeds)
            self._floats[hot_kernel.FACTOR] = extra.factor
        self.speeds = speeds = self._law_speeds(wanted)
        if not hot_kernel.command(speeds, self.motors, self.told, self.count, self.dt_s, self._floats):
            c.refused_outputs += 1
            self.speeds = [0.0] * self.count
            return None
        if share < 1.0:
            return self.say(self.blend(self.told, share))
        return list(self.told)

    def say(self, commands: Sequence[float]) -> list[float]:
        """Eight commands, zeros for the motors that are not there; kept as what the motors were told."""
        told = self.told
        for n in range(CONTROLS):
            told[n] = commands[n] if n < self.count else 0.0
        return list(told)

    @property
    def last_us(self) -> int | None:
        """Stamp of the last demand admitted."""
        return self._last_us

    def blend(self, commands: Sequence[float], share: float) -> list[float]:
        """`share` of these commands and the rest of the autopilot's own for the demand held."""
        own = self.scale.own(self.held)
        return [min(max(o + share * (u - o), 0.0), 1.0) for o, u in zip(own, commands, strict=False)]

    def caught_up(self, stamp_us: int, cycles: int, dropped: int, superseded: int) -> None:
        """Demands up to that stamp were answered by the hot loop."""
        c = self.counters
        self._last_us, self._strange_us = stamp_us, None
        c.cycles, c.dropped = c.cycles + cycles, c.dropped + dropped
        c.superseded += superseded

    def hand_over_thrust(self, weight_N: float) -> float:
        """Thrust (N) of the autopilot's own mixer at the demand that hovers `weight_N` under the law.

        Far from the weight, taking over and handing back means a climb or a fall until its integrators
        have learnt the other scale.
        """
        hover = (0.0, 0.0, 0.0, weight_N / float(self.scale.matrix[0, 3]))
        return float(self.rotors.wrench(self.scale.own(hover))[0])

    def step(self, time_usec: int, group: int, controls: Sequence[float]) -> list[float] | None:
        """Eight commands in [0, 1] for one demand, or None when it deserves no answer."""
        return self.mix() if self.admit(time_usec, group, controls) else None

    def account(self, latency_s: float) -> None:
        """Book the last step: its latency and what the rotor model says its speeds miss of the demand."""
        c = self.counters
        c.cycles += 1
        c.latency.add(latency_s)
        got: Any = self.rotors.plain_wrench(self.speeds)
        if self.compensation is not None:
            got = got + self.compensation.wrench(self.speeds)
        self.error = [g - w for g, w in zip(got, self.wrench, strict=True)]
        c.miss(self.error)
        if self.law.dropped:
            c.dropped += 1
