"""What a rotor model's coefficients, and all that is beside them, add to a measured wrench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.evidence.blocks import Block, joined
from coaxlink.frames import Array, FlightFrame
from coaxlink.health.columns import VERTICAL_ZERO, lasting, passing, rows_of
from coaxlink.rotor.polynomial import design_matrix
from coaxlink.rotor_update.instrumental_variables import LIFT, endogenous, explained, instruments

WEIGHED = 0.005  # of the mass: a luggage scale
BY_SPEED = ("voltage",)  # changes speeds: where these were measured it changes nothing else
# what the coefficients themselves are, or the weighing
OWN = ("upper_", "lower_", "single_", "lift_today", "torque_today", "thrust_", "torque_")


def unit_loads(airframe: Airframe, speeds: Array, names: Sequence[tuple[str, str]]) -> tuple[Array, Array]:
    """(rows, N, K) thrust in N and torque in N m of every rotor for a unit of each coefficient (load, term).

    `speeds` are normalised, (rows, N).
    """
    thrust = np.zeros((*speeds.shape, len(names)))
    torque = np.zeros_like(thrust)
    thrust_gain, torque_gain = airframe.gains
    for k, (load, term) in enumerate(names):
        side, quantity = load.split(".")
        values = np.zeros_like(speeds)
        for upper, lower in airframe.pairs:
            at = design_matrix([term], speeds[:, upper], speeds[:, lower])[:, 0]
            values[:, upper if side == "upper" else lower] = at
        for i in airframe.singles if side == "upper" else ():
            values[:, i] = design_matrix([term], speeds[:, i], 0 * speeds[:, i])[:, 0]
        if quantity == "thrust_N":
            thrust[:, :, k] = values * thrust_gain
        else:
            torque[:, :, k] = values * torque_gain
    return thrust, torque


def coefficient_columns(frame: FlightFrame, names: Sequence[tuple[str, str]]) -> Array:
    """(rows, 6, K) what a unit more of each coefficient adds."""
    thrust, torque = (np.moveaxis(part, -1, 0) for part in unit_loads(frame.airframe, frame.speeds, names))
    return np.moveaxis(frame.airframe.body_loads(thrust, torque), 0, -1)


def nuisances(frame: FlightFrame, measured: bool, zero_sd: float) -> tuple[list[Block], list[Block]]:
    """What lasts from flight to flight and what does not, without what the coefficients themselves are.

    `measured`: the log has the rotors' speeds. `zero_sd`: of the accelerometer's vertical zero, m/s^2.
    """
    without = (*OWN, *(BY_SPEED if measured else ()))
    lasts, passes = (
        [c for c in make(frame) if not c.name.startswith(without)] for make in (lasting, passing)
    )
    passes = [replace(c, deviation=np.array([zero_sd])) if c.name == VERTICAL_ZERO else c for c in passes]
    none = np.zeros_like(frame.thrust)
    lift = rows_of(frame, frame.airframe.body_loads(frame.thrust, none)[..., None])
    lasts.append(Block("weighing", lift, np.array([WEIGHED])))
    return lasts, passes


def regressors(
    frame: FlightFrame, names: Sequence[tuple[str, str]], measured: bool, zero_sd: float
) -> tuple[list[Array], list[Array], tuple[list[Block], list[Block]]]:
    """Columns (kept, 4, .) of the coefficients, of what lasts and of what does not, with these two's priors.

    Twice: as they are, and with what instruments explain of them (`instruments`): of the lift's rows what no
    gust answers, of the coefficients' torques what is no noise of a logged command.
    """
    parts = nuisances(frame, measured, zero_sd)
    own = rows_of(frame, coefficient_columns(frame, names))
    stacked = [joined(part)[0] for part in parts]
    follows = endogenous([*parts[0], *parts[1]])
    beside = np.concatenate(stacked, axis=-1)
    known = instruments(frame, beside, follows)
    lift = explained(beside, known)[:, LIFT]
    beside[:, LIFT] = np.where(follows, lift, beside[:, LIFT])
    seen = [explained(own, known), *np.split(beside, [len(parts[0])], axis=-1)]
    return [own, *stacked], seen, parts
