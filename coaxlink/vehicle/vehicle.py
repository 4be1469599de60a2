"""A vehicle as mixers see it: airframe, rotors, effects, and the conditions it shall be right at.

The one place that turns [[effects]] into what laws, tables and the allocator work with: a rotor model over
true speeds, a gain for every rotor, places from the true centre of mass, and what commands turn at the stated
conditions. Laws, loads and power know speeds alone; `turned` and `commanded` lead from commands and back.
What each effect does stands in its own module of `coaxlink.effects`; what no static mixer can hold stays
outside and is named in `left_out` with the reason. Laws take nothing but a Vehicle: no effect is dropped in
silence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.airframe import Airframe, load_airframe
from coaxlink.constants import GRAVITY_M_S2, RAD_S_PER_RPM
from coaxlink.effects import effect
from coaxlink.effects.static import Conditions, LeftOut, StaticVehicle
from coaxlink.errors import InputError
from coaxlink.rotor import RotorModel, load_rotor_model
from coaxlink.rotor.model import EffectEntry
from coaxlink.vehicle.changed_model import changed_model

Array = NDArray[np.float64]
NOT_STATED = Conditions()
TOP, POINTS = 1.6, 4097  # normalised speeds: of the tabulated inverse of what effects leave of them


@dataclass(frozen=True)
class Turning:
    """True speeds are `bends` of `share` of the nominal ones, which the commands alone would give."""

    share: float = 1.0
    bends: Sequence[Callable[[Array], Array]] = field(default=())

    def true(self, nominal: ArrayLike) -> Array:
        """Normalised speeds (...) that rotors turn at where the drive alone would give these (...)."""
        u = self.share * np.asarray(nominal, float)
        for bend in self.bends:
            u = bend(u)
        return u

    def nominal(self, speeds: ArrayLike) -> Array:
        """The inverse: what has to be commanded for true speeds (...)."""
        u = np.asarray(speeds, float)
        if not self.bends:
            return u / self.share
        grid, bent = self._table
        return np.asarray(np.interp(u, bent, grid))

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        grid = np.linspace(0.0, TOP, POINTS)
        # a dead band gives no speed for many commands: a slope too small to be felt orders them
        return grid, np.maximum.accumulate(self.true(grid)) + 1e-12 * np.arange(POINTS)


@dataclass(frozen=True)
class Vehicle:
    """See the module.

    `declared` and `rotors` are as in their files, whose paths do as well. `measured_live` leaves to live
    mixing what it can measure: only effects that change the rotors' own surfaces are put in, the others are
    in `live_effects`.

    Raises InputError on effects whose numbers are missing or that no rotor here can have, and on conditions
    that cannot be.

    >>> from coaxlink.airframe import load_airframe
    >>> from coaxlink.files import example
    >>> from coaxlink.rotor import load_rotor_model
    >>> x8 = Vehicle(load_airframe(example("x8_paper.toml")), load_rotor_model(example("rotor_paper.toml")))
    >>> len(x8.airframe.rotors), dict(x8.left_out)
    (8, {})
    """

    declared: Airframe
    rotors: RotorModel
    conditions: Conditions = NOT_STATED
    measured_live: bool = False
    airframe: Airframe = field(init=False)  # with the effects it can hold: gains, places, mass
    model: RotorModel = field(init=False)  # over true speeds; with the effects it can hold, carrying none
    compensated: Mapping[str, str] = field(init=False)  # effect -> what was done, in words
    left_out: Mapping[str, str] = field(init=False)  # effect -> why nothing was
    live_effects: tuple[EffectEntry, ...] = field(init=False)  # for live mixing to measure
    turning: Turning = field(init=False)  # what effects leave of the speeds that the drive alone gives

    def __post_init__(self) -> None:
        for name, kind, load in (
            ("declared", Airframe, load_airframe),
            ("rotors", RotorModel, load_rotor_model),
        ):
            given = getattr(self, name)
            if isinstance(given, (str, Path)):  # a file of either
                object.__setattr__(self, name, load(Path(given)))
            elif not isinstance(given, kind):
                found = (
                    f"an airframe and a rotor model are expected, in this order; found {type(given).__name__}"
                )
                raise InputError("vehicle", name, found)
        vehicle = StaticVehicle(self.declared, self.rotors, self.conditions, *self.declared.gains, usual_lift)
        compensated: dict[str, str] = {}
        left_out: dict[str, str] = {}
        live: list[EffectEntry] = []
        for named in sorted(self.rotors.effects, key=_turn):
            known = effect(named.name)
            if self.measured_live and (known is None or known.surface is None):
                live.append(named)
                continue
            try:
                if known is None or known.static is None:
                    raise LeftOut(known.no_static if known else "not known to the mixers")
                known.check(named.parameters)
                compensated[named.name] = known.static(vehicle, named.parameters)
            except LeftOut as reason:
                left_out[named.name] = str(reason)
        model = changed_model(vehicle.model, vehicle.changes) if vehicle.changes else vehicle.model
        for name, value in (
            ("airframe", _airframe(vehicle)),
            ("model", replace(model, effects=())),
            ("compensated", compensated),
            ("left_out", left_out),
            ("live_effects", tuple(live)),
            ("turning", Turning(vehicle.speed, tuple(vehicle.turning))),
        ):
            object.__setattr__(self, name, value)

    def turned(self, commands: ArrayLike, full_speed: float = 1.0) -> Array:
        """Normalised true speeds (..., N) that commands (..., N) give.

        `full_speed` is what a command brings, of the speed it brings at the stated conditions.
        """
        nominal = self.declared.turned(self.rotors, commands, self.conditions.voltage_V)
        return self.turning.true(full_speed * nominal)

    def commanded(self, speeds: ArrayLike) -> Array:
        """Commands (..., N) that hold true speeds (..., N), beyond 0 .. 1 where no command does."""
        nominal = self.turning.nominal(speeds)
        return self.declared.commanded(self.rotors, nominal, self.conditions.voltage_V)

    @cached_property
    def full(self) -> Array:
        """(N,) true speeds of all rotors at full command."""
        return self.turned(np.ones(len(self.declared.rotors)))

    def to_json(self) -> dict[str, dict[str, str]]:
        """The keys that every verb adds to its JSON; `live_effects` are the live mixer's to account for."""
        return {"compensated": dict(self.compensated), "not_compensated": dict(self.left_out)}

    def __repr__(self) -> str:
        inside = ", ".join(self.compensated) or "none"
        outside = ", ".join([*self.left_out, *(e.name for e in self.live_effects)]) or "none"
        size = f"{len(self.airframe.rotors)} rotors, {self.airframe.mass_kg:g} kg"
        return f"Vehicle({self.airframe.name!r}, {size}, effects in: {inside}, left out: {outside})"


def require_vehicle(given: object) -> None:
    """Raise InputError for anything else: an airframe and a rotor model beside each other drop effects."""
    if not isinstance(given, Vehicle):
        problem = f"a Vehicle is expected, which has the effects in it; found {type(given).__name__}"
        raise InputError("vehicle", "", problem)


def refuse_live(vehicle: Vehicle) -> None:
    """Raise InputError where effects were left to live mixing: a table would drop them."""
    require_vehicle(vehicle)
    if vehicle.live_effects:
        names = ", ".join(e.name for e in vehicle.live_effects)
        problem = f"{names}: left to live mixing, which this is not; a vehicle made without it is expected"
        raise InputError("vehicle", "measured_live", problem)


def plain_rotors(model: RotorModel) -> RotorModel:
    """The model, which must carry no effects: they would be dropped here.

    Raises InputError: such a model belongs into a Vehicle, which puts them in or says why not.
    """
    if model.effects:
        names = ", ".join(e.name for e in model.effects)
        problem = f"carries {names}, which would be dropped here: make a Vehicle of airframe and rotors"
        raise InputError("rotor model", "effects", problem)
    return model


def usual_lift(airframe: Airframe, model: RotorModel) -> float:
    """Thrust over speed squared (N) of the middle one of the rotors, all turning alike in hover."""
    weight = GRAVITY_M_S2 * airframe.mass_kg
    low, high = 0.05, 1.0
    count = len(airframe.rotors)
    for _ in range(40):
        middle = 0.5 * (low + high)
        lift = float(airframe.wrench(*airframe.loads(model, np.full(count, middle)))[0])
        low, high = (middle, high) if lift < weight else (low, middle)
    thrust, _ = airframe.loads(model, np.full(count, high))
    return max(float(np.median(thrust / high**2)), 1e-9)


def shaft_watts(vehicle: Vehicle, speeds: ArrayLike) -> Array:
    """(...) shaft watts of all rotors together at normalised speeds (..., N)."""
    u = np.asarray(speeds, float)
    torque = vehicle.airframe.loads(vehicle.model, u)[1]
    return np.asarray((torque * u).sum(axis=-1) * vehicle.model.speed_max_rpm * RAD_S_PER_RPM)


def battery_watts(vehicle: Vehicle, speeds: ArrayLike) -> Array:
    """(...) battery watts at normalised speeds (..., N); NaN where the stand measured no volts and amps."""
    u = np.asarray(speeds, float)
    powers = vehicle.model.battery_power
    if not powers:
        return np.full(u.shape[:-1], np.nan)
    torque = vehicle.airframe.loads(vehicle.model, u)[1]
    rad_s = u * (vehicle.model.speed_max_rpm * RAD_S_PER_RPM)
    total = np.zeros(u.shape[:-1])
    for i, rotor in enumerate(vehicle.airframe.rotors):
        side = powers["lower" if rotor.level == "lower" else "upper"]
        total = total + side.watts(rad_s[..., i], torque[..., i])
    return total


def _turn(named: EffectEntry) -> int:
    """Surfaces last, in the order in which they act on one another."""
    known = effect(named.name)
    return -1 if known is None or known.surface is None else known.surface


def _airframe(vehicle: StaticVehicle) -> Airframe:
    rotors = tuple(
        replace(r, thrust_gain=float(f), torque_gain=float(q))
        for r, f, q in zip(vehicle.airframe.rotors, vehicle.thrust, vehicle.torque, strict=True)
    )
    return replace(vehicle.airframe, rotors=rotors)
