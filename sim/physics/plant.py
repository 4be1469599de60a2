"""One flying vehicle: the compiled kernel's arrays, filled from files, and read back by name."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.physics import layout
from sim.physics.pair import Pair
from sim.physics.power_module import PowerModule
from sim.vehicle import LOWER, SimVehicle

STEP_S = 0.001
GRAVITY = 9.80665
FOOT_Z_M = 0.20


@dataclass(frozen=True)
class BatteryPack:
    """An 8-cell pack; `reference_V` is where a command means its own speed when the ESCs do not regulate."""

    cells: int = 8
    capacity_Ah: float = 7.0
    resistance_ohm: float = 0.025
    charge: float = 0.95
    reference_V: float = 33.6
    efficiency: float = 0.80


def _pack_of(pair: Pair) -> BatteryPack:
    """A pack for the supply that the pair was measured at."""
    if pair.cells is None or pair.reference_V is None:
        return BatteryPack()
    return BatteryPack(cells=pair.cells, capacity_Ah=10.0, reference_V=pair.reference_V)


@dataclass(frozen=True)
class MotorData:
    """220 rpm a volt; resistance and heat of its size's kind."""

    torque_Nm_A: float = 30.0 / (math.pi * 220.0)
    resistance_ohm: float = 0.045
    heat_capacity_J_K: float = 60.0
    cooling_K_W: float = 2.2


@dataclass
class Sensing:
    """What a truth does to the sensors: how late they are, what shakes them, what reads the current."""

    delay_s: float = 0.0
    vibration_m_s2: float = 0.0  # of one rotor at full speed
    blades: int = 1  # times a turn
    power_module: PowerModule | None = None  # None reads the current as it is


class Plant:
    """State and parameters of one vehicle on the ground at the origin; `advance` moves it on."""

    def __init__(self, vehicle: SimVehicle, pair: Pair, battery: BatteryPack | None = None) -> None:
        self.index = layout  # names of the arrays' entries
        self.vehicle, self.pair, self.battery = vehicle, pair, battery or _pack_of(pair)
        self.motor, self.sensing, self.radius_m = MotorData(), Sensing(), pair.radius_m
        n = vehicle.rotors
        self.parameters = self._default_parameters()
        self.geometry = np.zeros((layout.GEOMETRY, n))
        self.geometry[layout.G_POS : layout.G_POS + 3] = vehicle.position_m.T
        self.geometry[layout.G_AXIS : layout.G_AXIS + 3] = vehicle.axis.T
        self.geometry[layout.G_SPIN] = vehicle.spin
        self.geometry[[layout.G_THRUST, layout.G_TORQUE, layout.G_SPEED]] = 1.0
        heads = np.flatnonzero(vehicle.level != LOWER)
        self.compiled = (np.column_stack([heads, vehicle.partner[heads]]), *pair.compiled())
        self.state = np.zeros(layout.SPEED + layout.PER_ROTOR * n)
        self.state[layout.QUAT] = 1.0
        self.state[layout.POS + 2] = GRAVITY / (4 * 300.0)  # resting on its four springs
        self.swap_battery(self.battery.charge)
        self.out = np.zeros(layout.O_THRUST + 2 * n)
        self.steps = 0
        self.advance(np.zeros(n), 0)

    def swap_battery(self, charge: float) -> None:
        """Another pack of the same kind, rested."""
        from sim.physics.drive import open_circuit  # numba takes its time

        self.state[layout.CHARGE], self.state[layout.CURRENT] = charge, 0.0
        self.state[layout.RELAXED : layout.RELAXED + 2] = 0.0
        self.state[layout.VOLTAGE] = open_circuit(float(self.battery.cells), charge)

    def _default_parameters(self) -> NDArray[np.float64]:
        k, v, b, m = layout, self.vehicle, self.battery, self.motor
        top = self.pair.speed_max_rpm * math.pi / 30.0
        p = np.zeros(k.PARAMETERS)
        p[k.MASS], p[[k.IXX, k.IYY, k.IZZ]] = v.mass_kg, v.inertia_kg_m2
        p[k.GRAVITY], p[k.GROUND_Z], p[k.LAG] = GRAVITY, FOOT_Z_M, v.motor_lag_s
        p[k.TOP_RATE], p[k.TIP_SPEED] = top, top * self.radius_m
        p[k.GROUND_SCALE], p[k.FOOT_XY], p[k.FOOT_Z] = 0.8, 0.2, FOOT_Z_M
        p[k.VOLT_REF], p[k.CELLS], p[k.CAPACITY] = b.reference_V, b.cells, b.capacity_Ah * 3600.0
        p[k.AIR], p[k.RADIUS] = 1.0, self.radius_m
        p[k.MOTOR_KT], p[k.WINDING] = m.torque_Nm_A, m.resistance_ohm
        p[k.HEAT_CAPACITY] = m.heat_capacity_J_K
        p[k.COOLING] = 1.0 / (m.heat_capacity_J_K * m.cooling_K_W)
        p[k.RESISTANCE], p[k.EFFICIENCY] = b.resistance_ohm, b.efficiency
        p[k.VOLT_POWER] = float(self.pair.reference_V is not None)  # its ESCs count in volts
        return p

    def steady_speeds(self, commands: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., N) normalised speeds that commands (..., N) give in the end, at the pack's voltage."""
        supply = 1.0 if self.pair.reference_V is None else self.voltage / self.pair.reference_V
        partner, lower = np.asarray(self.vehicle.partner), np.asarray(self.vehicle.level) == LOWER
        mine = np.asarray(commands, float) * supply
        other = np.where(partner >= 0, mine[..., partner], 0.0)
        both = self.pair.turned(np.where(lower, other, mine), np.where(lower, mine, other))
        return np.where(lower, both[1], both[0])

    def rotor_watts(self) -> NDArray[np.float64]:
        """(N,) that each rotor draws from the pack now."""
        u = self.speeds
        partner, lower = np.asarray(self.vehicle.partner), np.asarray(self.vehicle.level) == LOWER
        other = np.where(partner >= 0, u[partner], 0.0)
        both = self.pair.watts(np.where(lower, other, u), np.where(lower, u, other))
        if both is not None:
            left = self.geometry[layout.G_TORQUE] * self.parameters[layout.AIR]
            return np.where(lower, both[1], both[0]) * left
        rate = self.pair.speed_max_rpm * math.pi / 30.0
        return np.maximum(self.torque * u, 0.0) * rate / self.battery.efficiency

    def advance(self, command: NDArray[np.float64], steps: int, step_s: float = STEP_S) -> None:
        """Move on by `steps` steps at constant motor commands (N,) in 0..1."""
        from sim.physics.kernel import advance

        how = (self.parameters, self.geometry, *self.compiled, step_s, steps)
        advance(self.state, command, *how, self.out)
        self.steps += steps

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
    def windings(self) -> NDArray[np.float64]:
        """(N,) of each motor, K over the air."""
        first = self.index.SPEED + 2 * self.vehicle.rotors
        return self.state[first : first + self.vehicle.rotors]

    @property
    def motor_currents(self) -> NDArray[np.float64]:
        """(N,) in the windings, A."""
        return self.torque / self.motor.torque_Nm_A

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
    def resting(self) -> bool:
        """On its feet with its rotors still."""
        return self.height < FOOT_Z_M + 0.05 and float(np.max(self.speeds)) < 0.02

    @property
    def height(self) -> float:
        """Of the body origin above the ground, m."""
        return FOOT_Z_M - float(self.state[2])
