"""One flying vehicle: the compiled kernel's arrays, filled from files, and read back by name."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.rotors import Pair
from sim.vehicle import SINGLE, UPPER, Vehicle

STEP_S = 0.001
GRAVITY = 9.80665
ROTOR_RADIUS_M = 0.235  # 18.5 in
FOOT_Z_M = 0.20


@dataclass(frozen=True)
class Battery:
    """An 8-cell pack; `reference_V` is where a command means its own speed when the ESCs do not regulate."""

    cells: int = 8
    capacity_Ah: float = 7.0
    resistance_ohm: float = 0.025
    charge: float = 0.95
    reference_V: float = 33.6
    efficiency: float = 0.80


class Plant:
    """State and parameters of one vehicle on the ground at the origin; `advance` moves it on."""

    def __init__(self, vehicle: Vehicle, pair: Pair, battery: Battery | None = None) -> None:
        from sim import kernel  # numba takes its time

        self.index = self._kernel = kernel  # names of the arrays' entries
        self.vehicle, self.pair, self.battery = vehicle, pair, battery or Battery()
        self.radius_m = ROTOR_RADIUS_M
        n = vehicle.rotors
        self.parameters = self._default_parameters()
        self.geometry = np.zeros((kernel.GEOMETRY, n))
        self.geometry[kernel.G_POS : kernel.G_POS + 3] = vehicle.position_m.T
        self.geometry[kernel.G_AXIS : kernel.G_AXIS + 3] = vehicle.axis.T
        self.geometry[kernel.G_SPIN] = vehicle.spin
        self.geometry[[kernel.G_THRUST, kernel.G_TORQUE, kernel.G_SPEED]] = 1.0
        uppers = [i for i in range(n) if vehicle.level[i] == UPPER]
        # unsigned, for an index that may be negative costs a test
        self._pairs = np.array([(i, vehicle.partner[i]) for i in uppers], np.uint64).reshape(-1, 2)
        self._singles: NDArray[np.uint64] | None = np.array(
            [i for i in range(n) if vehicle.level[i] == SINGLE], np.uint64
        )
        quadratic, self._surfaces = _surfaces(pair.coefficients)
        if quadratic and not len(self._singles):
            self._singles = None  # the fast way
        self.state = np.zeros(kernel.SPEED + kernel.PER_ROTOR * n)
        self.state[kernel.QUAT] = 1.0
        self.state[kernel.POS + 2] = GRAVITY / (4 * 300.0)  # resting on its four springs
        self.state[kernel.CHARGE] = self.battery.charge
        self.state[kernel.VOLTAGE] = kernel.open_circuit(float(self.battery.cells), self.battery.charge)
        self.out = np.zeros(kernel.O_THRUST + 2 * n)
        self.steps = 0
        self.advance(np.zeros(n), 0)

    def _default_parameters(self) -> NDArray[np.float64]:
        k, v, b = self._kernel, self.vehicle, self.battery
        top = self.pair.speed_max_rpm * math.pi / 30.0
        p = np.zeros(k.PARAMETERS)
        p[k.MASS], p[[k.IXX, k.IYY, k.IZZ]] = v.mass_kg, v.inertia_kg_m2
        p[k.GRAVITY], p[k.GROUND_Z], p[k.LAG] = GRAVITY, FOOT_Z_M, v.motor_lag_s
        p[k.TOP_RATE], p[k.TIP_SPEED] = top, top * ROTOR_RADIUS_M
        p[k.GROUND_SCALE], p[k.FOOT_XY], p[k.FOOT_Z] = 0.8, 0.2, FOOT_Z_M
        p[k.VOLT_REF], p[k.CELLS], p[k.CAPACITY] = b.reference_V, b.cells, b.capacity_Ah * 3600.0
        p[k.INFLOW], p[k.DRAG] = self.pair.inflow, self.pair.in_plane_drag
        p[k.RESISTANCE], p[k.EFFICIENCY] = b.resistance_ohm, b.efficiency
        return p

    def advance(self, command: NDArray[np.float64], steps: int, step_s: float = STEP_S) -> None:
        """Move on by `steps` steps at constant motor commands (N,) in 0..1."""
        self._kernel.advance(
            self.state,
            command,
            self.parameters,
            self.geometry,
            self._pairs,
            self._singles,
            self._surfaces,
            step_s,
            steps,
            self.out,
        )
        self.steps += steps

    def advance_many(
        self,
        states: NDArray[np.float64],
        commands: NDArray[np.float64],
        steps: int,
        outs: NDArray[np.float64],
        step_s: float = STEP_S,
    ) -> None:
        """Move M vehicles like this one on: states (M, S), commands (M, N), outs (M, 6 + 2 N), as one's own.

        In place; this vehicle itself does not move.
        """
        rotors = self.parameters, self.geometry, self._pairs, self._singles, self._surfaces
        self._kernel.advance_many(states, commands, *rotors, step_s, steps, outs)

    @property
    def time_s(self) -> float:
        """Simulated time (of 1 ms steps)."""
        return self.steps * STEP_S

    @property
    def position(self) -> NDArray[np.float64]:
        """(3,) NED, m."""
        return self.state[0:3]

    @property
    def velocity(self) -> NDArray[np.float64]:
        """(3,) NED, m/s."""
        return self.state[3:6]

    @property
    def quaternion(self) -> NDArray[np.float64]:
        """(4,) w, x, y, z, body to NED."""
        return self.state[6:10]

    @property
    def rates(self) -> NDArray[np.float64]:
        """(3,) body, rad/s."""
        return self.state[10:13]

    @property
    def charge(self) -> float:
        """State of charge, 0..1."""
        return float(self.state[self.index.CHARGE])

    @property
    def voltage(self) -> float:
        """At the terminals, V."""
        return float(self.state[self.index.VOLTAGE])

    @property
    def current(self) -> float:
        """Drawn, A."""
        return float(self.state[self.index.CURRENT])

    @property
    def speeds(self) -> NDArray[np.float64]:
        """(N,) normalised."""
        first = self.index.SPEED
        return self.state[first : first + self.vehicle.rotors]

    @property
    def specific_force(self) -> NDArray[np.float64]:
        """(3,) body, at its origin, m/s^2."""
        return self.out[0:3]

    @property
    def thrust(self) -> NDArray[np.float64]:
        """(N,) N."""
        return self.out[6 : 6 + self.vehicle.rotors]

    @property
    def torque(self) -> NDArray[np.float64]:
        """(N,) N m."""
        return self.out[6 + self.vehicle.rotors :]

    @property
    def height(self) -> float:
        """Of the body origin above the ground, m."""
        return FOOT_Z_M - float(self.state[2])


def _surfaces(c: NDArray[np.float64]) -> tuple[bool, NDArray[np.float64]]:
    """Whether the upper rotor is alone and no power is above two, and the coefficients that are used."""
    used = np.nonzero(c.any(axis=0))
    top = max(2, *(int(axis.max(initial=0)) for axis in used)) + 1
    small = np.ascontiguousarray(c[:, :top, :top])
    return top == 3 and not small[:2, :, 1:].any(), small
