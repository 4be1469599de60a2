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
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.exact.arms import Units
from coaxlink.mixer.exact.solver import Arms
from coaxlink.vehicle import Vehicle, refuse_live

HASH_BITS = 24  # whole numbers up to 2^24 are exact in a message's single precision


@dataclass(frozen=True)
class BoardVehicle:
    """Which vehicle it is."""

    name: str
    identity: int  # `airframe_hash`
    rotors: int  # N


@dataclass(frozen=True)
class BoardLaw(BoardVehicle):
    """The exact law of a vehicle in the solver's own units, and what a demand means in them."""

    arms: Arms  # numpy arrays; see exact.solver
    units: Units
    wrench: NDArray[np.float64]  # (4, 4) N and N m [thrust, roll, pitch, yaw] per [roll, pitch, yaw, thrust]
    hover: float  # thrust demand that lifts the weight
    edge: Edge  # what motors are told for speeds

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
    of = board_vehicle(vehicle.declared)
    return BoardLaw(of.name, of.identity, of.rotors, arms, units, wrench, hover, Edge.of(vehicle))


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
