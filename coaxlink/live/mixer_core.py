"""One demand through the law: what it means in N and N m, and eight bounded commands; no clock, no link."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError
from coaxlink.live.counts import Counters
from coaxlink.mixer import Law, StandardCoefficients, make_law, standard_coefficients
from coaxlink.mixer.demands import weight_arm
from coaxlink.mixer.edge import Edge
from coaxlink.mixer.plain import PlainRotors
from coaxlink.vehicle import Vehicle, require_vehicle
from firmware_params.px4 import Px4Table, RotorEntry, realise

CONTROLS = 8  # motors that the messages carry
GUARDED = 0.005  # of the weight, or of weight x arm: less is missed without another look
BETTER = 0.02  # of what is missed: the reduced mixer has to be that much nearer to be flown instead
ABSURD = 1.5  # a normalised demand beyond this is no demand; up to it, it is held to the range


class Compensation(Protocol):
    """Effects beside the rotor model, as `live.effects.LiveEffects` knows them."""

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
        self._read_by(np.stack([-per_control[5], *per_control[:3]]))

    def _read_by(self, matrix: NDArray[np.float64]) -> None:
        self.matrix = matrix  # (4, 4) wrench per roll, pitch, yaw, thrust
        self._rows = matrix.tolist()

    def wrench(self, controls: Sequence[float]) -> list[float]:
        """(4,) wrench, N and N m, of controls [roll, pitch, yaw, thrust]; a list, which costs less here."""
        a, b, c, d = controls[:4]
        return [r[0] * a + r[1] * b + r[2] * c + r[3] * d for r in self._rows]

    def own(self, controls: Sequence[float]) -> list[float]:
        """(N,) commands that the autopilot's own mixer makes of the controls."""
        roll, pitch, yaw, thrust = controls[:4]
        mix = self._mix
        return [float(u) for u in mix.throttle(mix.setpoints((roll, pitch, yaw, 0.0, 0.0, -thrust)))]


class ToldScale(DemandScale):
    """The wrench of a demand where the module on board says it: (4, 4) per roll, pitch, yaw, thrust."""

    def __init__(self, matrix: NDArray[np.float64]) -> None:
        self._read_by(matrix)

    def own(self, controls: Sequence[float]) -> list[float]:
        """Not known here. Raises InputError."""
        raise InputError("the board", "", "its own mixer's outputs are not known here")


class MatrixScale(ToldScale):
    """The wrench that ArduPilot's demand means: normalised thrust of every motor by the matrix on board.

    Its own outputs are not known, for its saturation depends on its state.

    `factors` (N, 4) are each motor's roll, pitch, yaw and throttle as the firmware uses them; a normalised
    thrust of 1 is the standard rotor's (eq. 18).
    """

    def __init__(
        self, airframe: Airframe, standard: StandardCoefficients, factors: Sequence[Sequence[float]]
    ) -> None:
        per_thrust, per_torque = airframe.effectiveness()
        per_motor = standard.p * per_thrust + standard.q * per_torque  # (4, N)
        super().__init__(per_motor @ np.asarray(factors, float))


def live_law(name: str, vehicle: Vehicle) -> Law:
    """A law that never keeps the loop waiting: of the exact one the compiled form, where numba is there.

    Where a demand jumps out of reach it looks all round: 0.4 ms compiled, 50 to 100 ms in plain Python. The
    first call compiles or fills caches (seconds, once for a release), so it is made here and never in flight.
    """
    law = make_law(name, vehicle, **({"compiled": None} if name == "exact" else {}))
    law.speeds([GRAVITY_M_S2 * vehicle.airframe.mass_kg, 0.0, 0.0, 0.0])
    return law


class MixCore:
    """Demand in, commands out: what `LiveMixer` runs and tests drive by hand."""

    def __init__(
        self,
        vehicle: Vehicle,
        law: str | Law = "exact",
        compensation: Compensation | None = None,
        own_curve: float = 0.0,
    ) -> None:
        """`law` by its name is made for this vehicle; a Law must have been.

        Raises InputError also where the vehicle leaves effects to live mixing and `compensation` has not all.
        """
        require_vehicle(vehicle)
        known = {*compensation.names, *compensation.left_out} if compensation is not None else set()
        if dropped := [e.name for e in vehicle.live_effects if e.name not in known]:
            problem = f"{', '.join(dropped)}: left to live mixing, and not in it"
            raise InputError("vehicle", "compensation", problem)
        airframe = vehicle.airframe
        if len(airframe.rotors) > CONTROLS:
            raise InputError(
                airframe.source or airframe.name, "rotors", f"live mixing carries {CONTROLS} rotors at most"
            )
        self._standard = standard_coefficients(vehicle.model, of_commands=True)
        self.scale = DemandScale(airframe, self._standard, own_curve)
        self.vehicle, self.compensation = vehicle, compensation
        self.law = live_law(law, vehicle) if isinstance(law, str) else law
        self.rotors = PlainRotors.of(vehicle)
        self.edge = Edge.of(vehicle)
        self.board_turns = False  # whether the board makes commands of true speeds itself: its module does
        self._reduced_law = make_law("reduced", vehicle)
        weight, arm = GRAVITY_M_S2 * airframe.mass_kg, weight_arm(airframe)
        self._per_axis = (1.0 / weight, 1.0 / arm, 1.0 / arm, 0.1 / arm)
        self.counters = Counters()
        self.count = count = len(airframe.rotors)
        self.last_us: int | None = None  # stamp of the last demand admitted, the vehicle's clock
        self.held = [0.0] * 4  # that demand: roll, pitch, yaw, thrust, held to the range
        self.speeds = [0.0] * count  # of the law, for the last answer
        self.commands = [0.0] * count  # that bring these speeds
        self.sent = [0.0] * CONTROLS  # last commands sent, zeros for motors that are not there
        self.error = [0.0] * 4  # delivered by the rotor model at these speeds minus demanded, N and N m

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
        airframe = self.vehicle.airframe
        if len(factors) != self.count:
            problem = f"{self.count} rotors here, {len(factors)} in the frame on board"
            raise InputError(airframe.source or airframe.name, "rotors", problem)
        self.scale = MatrixScale(airframe, self._standard, factors)

    @property
    def wrench(self) -> list[float]:
        """(4,) what the demand held means, N and N m."""
        return self.scale.wrench(self.held)

    def admit(self, time_usec: int, group: int, controls: Sequence[float]) -> bool:
        """Whether a demand, new and fresh (`live.age`), deserves an answer; keeps it, held to the range."""
        c = self.counters
        if group != 0:
            c.other_group += 1
            return False
        roll, pitch, yaw, thrust = controls[:4]
        if not math.isfinite(roll + pitch + yaw + thrust):
            c.not_finite += 1
            return False
        if max(abs(roll), abs(pitch), abs(yaw)) > ABSURD or not 1.0 - ABSURD <= thrust <= ABSURD:
            c.absurd += 1
            return False
        self.last_us = time_usec
        self.held = [*(min(max(v, -1.0), 1.0) for v in (roll, pitch, yaw)), min(max(thrust, 0.0), 1.0)]
        c.clamped += self.held != [roll, pitch, yaw, thrust]
        return True

    def mix(self, share: float = 1.0) -> list[float] | None:
        """Eight commands in [0, 1] for the demand held; None when the law gave what is no speed.

        `share` is the law's part; the rest is the autopilot's own mixer.
        """
        wanted, factor = self.wrench, 1.0
        if self.compensation is not None:
            added = self.compensation.wrench(self.speeds).tolist()
            wanted = [w - a for w, a in zip(wanted, added, strict=True)]
            factor = self.compensation.factor
        speeds = self._law_speeds(wanted)
        if self._short(wanted, speeds):
            speeds = self._reduced(wanted)
            self.counters.reduced_flown += 1
        if self.board_turns:
            commanded = [u / factor for u in speeds]
        else:
            commanded = self.edge.commands([u / factor for u in self.edge.nominals(speeds)])
        commands = [min(max(c, 0.0), 1.0) if math.isfinite(c) else c for c in commanded]
        if not all(0.0 <= u <= 1.0 + 1e-9 for u in (*speeds, *commands)):  # also for NaN
            self.counters.refused_outputs += 1
            return None
        self.speeds, self.commands = speeds, commands
        return self.blend(share)

    def _short(self, wanted: Sequence[float], speeds: Sequence[float]) -> bool:
        """Whether the law misses what the reduced mixer would deliver: weighed only where it misses much."""
        if self._law.name != "exact" or not all(map(math.isfinite, speeds)):
            return False
        missed = self._missed(wanted, speeds)
        if missed < GUARDED:
            return False
        return self._missed(wanted, self._reduced(wanted)) < (1.0 - BETTER) * missed

    def _missed(self, wanted: Sequence[float], speeds: Sequence[float]) -> float:
        """Largest miss of an axis, of the weight or of weight x arm; yaw counts a tenth."""
        got = self.rotors.plain_wrench(speeds)
        return max(abs(g - w) * u for g, w, u in zip(got, wanted, self._per_axis, strict=True))

    def _reduced(self, wanted: Sequence[float]) -> list[float]:
        speeds: list[float] = self._reduced_law.speeds(wanted).tolist()
        return speeds

    def blend(self, share: float) -> list[float]:
        """(8,) `share` of the law's last commands, the rest of the autopilot's own for the demand held."""
        commands = self.commands
        if share < 1.0:
            own = self.scale.own(self.held)
            commands = [min(max(o + share * (u - o), 0.0), 1.0) for o, u in zip(own, commands, strict=True)]
        self.sent = [*commands, *[0.0] * (CONTROLS - self.count)]
        return self.sent

    def hand_over_thrust(self, weight_N: float) -> float:
        """Thrust (N) of the autopilot's own mixer at the demand that hovers `weight_N` under the law.

        Far from the weight, taking over and handing back means a climb or a fall until its integrators
        have learnt the other scale.
        """
        hover = (0.0, 0.0, 0.0, weight_N / float(self.scale.matrix[0, 3]))
        return float(self.rotors.wrench(self.vehicle.turned(self.scale.own(hover)))[0])

    def step(self, time_usec: int, group: int, controls: Sequence[float]) -> list[float] | None:
        """Eight commands in [0, 1] for one demand, or None when it deserves no answer."""
        return self.mix() if self.admit(time_usec, group, controls) else None

    def account(self, latency_s: float) -> None:
        """Book the last answer: its latency, and what the rotor model says its speeds miss of the demand."""
        got: Any = self.rotors.plain_wrench(self.speeds)
        if self.compensation is not None:
            got = got + self.compensation.wrench(self.speeds)
        self.error = [float(g) - w for g, w in zip(got, self.wrench, strict=True)]
        self.counters.answered(latency_s, self.error, bool(self.law.dropped))
