"""One demand through the law: what it means in N and N m, and eight bounded commands; no clock, no link."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.errors import InputError
from coaxlink.live.counts import Counters
from coaxlink.live.kernel import JUMP_US, command
from coaxlink.live.state import FIRST_DT_S, MOST_DT_S, MOTORS, plain_state
from coaxlink.mixer import Law, StandardCoefficients, make_law, standard_coefficients
from coaxlink.mixer.plain import PlainRotors
from coaxlink.vehicle import Vehicle, require_vehicle
from firmware_params.px4 import Px4Table, RotorEntry, realise

CONTROLS = MOTORS
ABSURD = 1.5  # a normalised demand beyond this is no demand; up to it, it is held to the range
NO_CLOCK_US = 2**62  # a stamp beyond it is none: 146 000 years


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

        `lead_s`: the motors' lag and the lag wanted of them instead (s); see `kernel.lead`.
        Raises InputError also where the vehicle leaves effects to live mixing and `compensation` has not all.
        """
        require_vehicle(vehicle)
        _refuse_dropped(vehicle, compensation)
        airframe, model = vehicle.airframe, vehicle.model
        if len(airframe.rotors) > CONTROLS:
            raise InputError(
                airframe.source or airframe.name, "rotors", f"live mixing carries {CONTROLS} rotors at most"
            )
        self.vehicle = vehicle
        self.law = make_law(law, vehicle) if isinstance(law, str) else law
        self.scale = DemandScale(airframe, standard_coefficients(model), own_curve)
        self._airframe, self._standard = airframe, standard_coefficients(model)
        self.counters = Counters()
        self.compensation = compensation
        self.rotors = PlainRotors.of(vehicle)
        self.count = len(airframe.rotors)
        self._strange_us: int | None = None
        self._lead_s, self._slots = lead_s, range(self.count)
        self.use(plain_state())

    def use(self, state: Any) -> None:
        """Keep the books in this record from now on; the loop has not begun."""
        self.state = state
        state.count = self.count
        state.lag_s, state.quick_s = self._lead_s

    def adopt(self, law: Law, vehicle: Vehicle) -> None:
        """Fly this law of the same airframe from the next demand on; what a demand means stays."""
        self.law, self.rotors = law, PlainRotors.of(vehicle)

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

    @property
    def last_us(self) -> int | None:
        """Stamp of the last demand admitted."""
        last: int = self.state.last_us
        return last if last >= 0 else None

    @property
    def held(self) -> list[float]:
        """(4,) that demand, held to the range."""
        return _floats(self.state.held)

    @property
    def wrench(self) -> list[float]:
        """(4,) what it means, N and N m."""
        return self.scale.wrench(self.held)

    @property
    def speeds(self) -> list[float]:
        """(N,) of the law, for the last answer."""
        return _floats(self.state.speeds)[: self.count]

    @property
    def sent(self) -> list[float]:
        """(8,) the last commands of the motors, zeros for motors that are not there."""
        return _floats(self.state.commands)

    @property
    def error(self) -> list[float]:
        """(4,) delivered by the rotor model at these speeds, minus demanded."""
        return _floats(self.state.error)

    def use_matrix(self, factors: Sequence[Sequence[float]]) -> None:
        """Read demands as ArduPilot's with these factors (N, 4) on board. Raises InputError."""
        if len(factors) != self.count:
            raise InputError(
                self._airframe.source or self._airframe.name,
                "rotors",
                f"{self.count} rotors here, {len(factors)} in the frame on board",
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
        held = [
            min(max(roll, -1.0), 1.0), min(max(pitch, -1.0), 1.0), min(max(yaw, -1.0), 1.0),
            min(max(thrust, 0.0), 1.0),
        ]  # fmt: skip
        if held != [roll, pitch, yaw, thrust]:
            c.clamped += 1
        self.state.held[:] = held
        return True

    def _in_order(self, stamp: int) -> bool:
        """Stamps must rise by less than a second; another clock must come twice in a row to be believed."""
        c, state, last = self.counters, self.state, self.last_us
        if stamp >= NO_CLOCK_US:
            c.clock_jumps += 1
            return False
        if last is None or 0 < stamp - last < JUMP_US:
            state.dt_s = min((stamp - last) * 1e-6, MOST_DT_S) if last is not None else FIRST_DT_S
            state.last_us, self._strange_us = stamp, None
            return True
        if -JUMP_US < stamp - last <= 0:
            c.late += 1
            return False
        strange, self._strange_us = self._strange_us, stamp
        if strange is not None and 0 < stamp - strange < JUMP_US:
            state.last_us, self._strange_us = stamp, None
            return True
        c.clock_jumps += 1
        return False

    def mix(self, share: float = 1.0) -> list[float] | None:
        """Eight commands in [0, 1] for the demand held; None when the law gave what is no command.

        `share` is the law's part; the rest is the autopilot's own mixer.
        """
        state = self.state
        self.compensate()
        wanted = self.wrench
        if self.compensation is not None:
            wanted = [w - e for w, e in zip(wanted, _floats(state.extra), strict=True)]
        if not command(state, state.dt_s, self._law_speeds(wanted), self._slots):
            self.counters.refused_outputs += 1
            state.speeds[:] = [0.0] * MOTORS
            return None
        commands = _floats(state.commands)
        return self.say(self.blend(commands, share)) if share < 1.0 else commands

    def compensate(self) -> None:
        """Bring what the effects add up to date."""
        extra = self.compensation
        if extra is not None:
            self.state.extra[:] = extra.wrench(self.speeds).tolist()
            self.state.factor = extra.factor

    def say(self, commands: Sequence[float]) -> list[float]:
        """Eight commands, zeros for the motors that are not there; kept as the motors' last."""
        eight = [*commands[: self.count], *[0.0] * (CONTROLS - self.count)]
        self.state.commands[:] = eight
        return eight

    def blend(self, commands: Sequence[float], share: float) -> list[float]:
        """`share` of these commands and the rest of the autopilot's own for the demand held."""
        own = self.scale.own(self.held)
        return [min(max(o + share * (u - o), 0.0), 1.0) for o, u in zip(own, commands, strict=False)]

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
        wanted, extra = self.wrench, self.compensation
        got: Any = self.rotors.plain_wrench(self.speeds)
        if extra is not None:
            got = got + extra.wrench(self.speeds)
        self.state.error[:] = [g - w for g, w in zip(got, wanted, strict=True)]
        self.book(latency_s, self.error, bool(self.law.dropped))

    def book(self, latency_s: float, error: Sequence[float], given_up: bool) -> None:
        """Count an answer."""
        c = self.counters
        c.cycles += 1
        c.latency.add(latency_s)
        c.miss(error)
        c.dropped += given_up


def _floats(numbers: Any) -> list[float]:
    """Of a record's field, in Python's own kind."""
    return list(numbers) if isinstance(numbers, list) else numbers.tolist()
