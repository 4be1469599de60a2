"""What every mixer has in common: a wrench in, normalised speeds out, and what the rotors make of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.airframe import AXES
from coaxlink.errors import InputError
from coaxlink.vehicle import Vehicle, battery_watts, shaft_watts, vehicle_of


class Law(Protocol):
    """A mixer for one airframe."""

    @property
    def name(self) -> str:
        """As `make_law` and `--law` know it."""

    def speeds(self, wrench: ArrayLike) -> NDArray[np.float64]:
        """Normalised speeds (N,) in [0, 1] for a wrench (4,): thrust up N, roll, pitch, yaw N m.

        Raises InputError when the wrench is not four finite numbers.
        """

    @property
    def dropped(self) -> tuple[str, ...]:
        """The axes that the last call gave up, by the law's own account (names of AXES)."""


@dataclass(frozen=True)
class Allocation:
    """One wrench through one law, and what the rotor model says comes of it."""

    law: str
    speeds: NDArray[np.float64]  # (N,) normalised
    thrust_N: NDArray[np.float64]  # (N,) of each rotor, after the wake
    torque_Nm: NDArray[np.float64]  # (N,) of each rotor, unsigned
    wrench: NDArray[np.float64]  # (4,) demanded
    delivered: NDArray[np.float64]  # (4,) by the rotor model
    power: float  # sum of torque x normalised speed, N m (the paper's efficiency measure up to a constant)
    power_W: float  # the same in shaft watts, by the model's speed_max_rpm
    battery_W: float  # NaN where the stand measured no volts and amps
    commands: NDArray[np.float64]  # (N,) 0..1, that hold these speeds
    saturated: NDArray[np.bool_]  # (N,) commanded to 0 or to 1
    dropped: tuple[str, ...]  # axes given up

    @property
    def error(self) -> NDArray[np.float64]:
        """(4,) delivered minus demanded, N and N m."""
        return self.delivered - self.wrench

    def __repr__(self) -> str:
        missed = f", {', '.join(self.dropped)} given up" if self.dropped else ""
        return f"Allocation({self.law} law, {len(self.speeds)} rotors, {self.power_W:.0f} W{missed})"

    def __str__(self) -> str:
        """A row a rotor, then a row an axis."""
        lines = [repr(self), "rotor     speed   command  thrust N  torque N m"]
        for n, (u, c) in enumerate(zip(self.speeds, self.commands, strict=True)):
            bound = "  at its bound" if self.saturated[n] else ""
            loads = f"{self.thrust_N[n]:10.3f}{self.torque_Nm[n]:12.4f}"
            lines.append(f"{n + 1:<5d}{u:10.4f}{c:10.4f}{loads}{bound}")
        for k, axis in enumerate(AXES):
            unit = "N m" if k else "N"
            lines.append(f"{axis} {self.delivered[k]:.4f} {unit} of {self.wrench[k]:.4f}")
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """As `coaxlink allocate --json` writes it."""
        return {
            "law": self.law,
            "speeds": self.speeds.tolist(),
            "thrust_N": self.thrust_N.tolist(),
            "torque_Nm": self.torque_Nm.tolist(),
            "wrench": self.wrench.tolist(),
            "delivered": self.delivered.tolist(),
            "error": self.error.tolist(),
            "power": self.power,
            "power_W": self.power_W,
            "battery_W": self.battery_W if math.isfinite(self.battery_W) else None,
            "commands": self.commands.tolist(),
            "saturated": self.saturated.tolist(),
            "dropped": list(self.dropped),
        }


def allocate(law: Law, vehicle: Vehicle | str | Path, wrench: ArrayLike) -> Allocation:
    """Run `law` on one wrench (4,): thrust up N, roll, pitch, yaw N m (FRD), and weigh it on `vehicle`.

    The vehicle need not be the law's own. Raises InputError when the wrench is not four finite numbers, or
    the law is none.
    """
    if not hasattr(law, "speeds"):
        problem = f"a law is expected, as make_law makes it of a name and a vehicle; found {law!r}"
        raise InputError("law", "", problem)
    vehicle = vehicle_of(vehicle)
    airframe, model = vehicle.airframe, vehicle.model
    demand = checked_wrench(wrench)
    u = law.speeds(demand)
    thrust, torque = airframe.loads(model, u)
    commands = vehicle.commanded(u)
    return Allocation(
        law=law.name,
        speeds=u,
        thrust_N=thrust,
        torque_Nm=torque,
        wrench=demand,
        delivered=airframe.wrench(thrust, torque),
        power=float(torque @ u),
        power_W=float(shaft_watts(vehicle, u)),
        battery_W=float(battery_watts(vehicle, u)),
        commands=np.clip(commands, 0.0, 1.0),
        saturated=(commands <= 1e-9) | (commands >= 1 - 1e-6),
        dropped=law.dropped,
    )


def checked_wrench(wrench: ArrayLike) -> NDArray[np.float64]:
    """The wrench as (4,) floats. Raises InputError on another shape and on what is not finite."""
    try:
        demand = np.array(wrench, float)
    except (TypeError, ValueError):
        demand = np.array(np.nan)
    if demand.shape != (len(AXES),) or not np.isfinite(demand).all():
        raise InputError("wrench", "", f"four finite numbers expected ({', '.join(AXES)}), found {wrench!r}")
    return demand
