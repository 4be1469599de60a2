"""A vehicle as code on board needs it: who it is, what its demand means, and the numbers of the exact law.

The one description that the writers of both autopilots take: `px4.module_files`, `ardupilot.script_files`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError
from coaxlink.live.mixer_core import DemandScale
from coaxlink.mixer import standard_coefficients
from coaxlink.mixer.edge import Edge
from coaxlink.mixer.exact import PRIORITY, ExactLaw
from coaxlink.mixer.exact.arms import Units, scaled
from coaxlink.mixer.exact.solver import Arms
from coaxlink.mixer.shares import Shares, shares_of
from coaxlink.vehicle import Vehicle, refuse_live

HASH_BITS = 24  # whole numbers up to 2^24 are exact in a message's single precision


@dataclass(frozen=True)
class BoardVehicle:
    """Which vehicle it is."""

    name: str
    identity: int  # `airframe_hash`
    rotors: int  # N


@dataclass(frozen=True)
class Bereft:
    """Arms of which a rotor stands still, in the coordinates of the whole arm: a motor may fail in flight."""

    place: NDArray[np.float64]  # (K, 2) bounds of s beneath a still upper rotor, which takes no torque off it
    surface: NDArray[np.float64]  # (K, M, order_u + 1) above a still lower rotor, by powers of u
    power: NDArray[np.float64]  # (K, power_u + 1)


@dataclass(frozen=True)
class BoardLaw(BoardVehicle):
    """The exact law of a vehicle in the solver's own units, and what a demand means in them."""

    arms: Arms  # numpy arrays; see exact.solver
    units: Units
    wrench: NDArray[np.float64]  # (4, 4) N and N m [thrust, roll, pitch, yaw] per [roll, pitch, yaw, thrust]
    hover: float  # thrust demand that lifts the weight
    edge: Edge  # what motors are told for speeds
    bereft: Bereft
    shares: Shares  # of the upper rotors, that may be asked for

    @property
    def demand(self) -> NDArray[np.float64]:
        """(4, 4) the solver's demand, by rank, per [roll, pitch, yaw, thrust]."""
        return self.wrench[self.units.order] / self.units.scale[:, None]


def board_vehicle(declared: Airframe) -> BoardVehicle:
    """Of an airframe as its file declares it."""
    return BoardVehicle(declared.name, airframe_hash(declared), len(declared.rotors))


def board_law(vehicle: Vehicle) -> BoardLaw:
    """The numbers of a vehicle.

    Raises InputError where effects were left to live mixing or bend commands more than `Edge` holds, and
    where the rotors cannot make four axes or do not hover between 0.05 and 0.95 of the thrust that a demand
    of 1 means.
    """
    refuse_live(vehicle)
    frame = vehicle.airframe
    law = ExactLaw(vehicle)
    arms, units = law.arms, law.units
    wrench = DemandScale(frame, standard_coefficients(vehicle.model, of_commands=True)).matrix
    weight = frame.mass_kg * GRAVITY_M_S2
    hover = weight / float(wrench[0, 3])
    if not 0.05 < hover < 0.95:
        problem = f"{weight:.0f} N is {hover:.2f} of what the rotors lift: 0.05 to 0.95 is expected"
        raise InputError(frame.source or frame.name, "mass_kg", problem)
    of, bereft, edge = board_vehicle(vehicle.declared), _bereft(vehicle, arms), Edge.of(vehicle)
    shares = shares_of(vehicle)
    return BoardLaw(of.name, of.identity, of.rotors, arms, units, wrench, hover, edge, bereft, shares)


def _bereft(vehicle: Vehicle, arms: Arms) -> Bereft:
    """As `scaled` has arms with all their upper, and with all their lower rotors failed."""
    frame = vehicle.airframe
    upper, lower = (
        scaled(
            vehicle,
            low=0.0,
            high=1.0,
            failed=[frame.rotors[pair[side]].number for pair in frame.pairs],
            priority=PRIORITY,
        )[0]
        for side in (0, 1)
    )
    least, span = arms.line[:, 0], arms.line[:, 2] - arms.line[:, 0]
    place = np.zeros((arms.size, 2))
    for end in (0, 1):
        np.divide(upper.line[:, 2 * end] - least, span, out=place[:, end], where=span > 0.0)
    return Bereft(
        place,
        _at_rest(lower.surface, (lower.order_u, lower.order_s), arms.order_u),
        _at_rest(lower.power, (lower.power_u, lower.power_s), arms.power_u),
    )


def _at_rest(c: NDArray[np.float64], orders: tuple[int, int], order_u: int) -> NDArray[np.float64]:
    """(..., order_u + 1) by powers of u at s = 0, of coefficients (..., T)."""
    by_u = c.reshape(*c.shape[:-1], orders[0] + 1, orders[1] + 1)[..., 0]
    return np.pad(by_u, [(0, 0)] * (by_u.ndim - 1) + [(0, order_u - orders[0])])


def airframe_hash(frame: Airframe) -> int:
    """HASH_BITS of the SHA-256 of the rotors' places, axes and spins, as declared: what a command is for.

    Not of the rotor model: a companion may fly a newer one than the board.
    """
    rows = [
        f"{r.number} {_millimetres(r.position_m)} {_millimetres(r.axis)} {r.yaw_sign:+g}"
        for r in frame.rotors
    ]
    return int.from_bytes(hashlib.sha256("\n".join(rows).encode()).digest()[:4], "big") >> (32 - HASH_BITS)


def _millimetres(values: Sequence[float]) -> str:
    return " ".join(str(round(1000.0 * v)) for v in values)
