"""The control cascade of a PX4 multirotor, at one rate: position, velocity, attitude, rates.

Position P and velocity PID make an acceleration; with the hover thrust it becomes a thrust vector and an
attitude; quaternion P makes body rates; rate PID makes a normalised torque. NED, FRD, SI. The equations are
in `loops`; a goal in space is tracked by the compiled `track.track`, as in batch flights.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sim.physics.sensors import SensorReading
from sim.px4 import loops
from sim.px4.loops import euler as euler

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]
NAN3 = (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class Goal:
    """What the vehicle is to follow; NaN in position or velocity leaves that axis to the other."""

    position: Three = NAN3
    velocity: Three = NAN3
    acceleration: Three = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    yaw_rate: float = 0.0


class LoopDemand(NamedTuple):
    """Normalised torque and thrust (up, 0..1), and what led to it."""

    roll: float
    pitch: float
    yaw: float
    thrust: float
    attitude: Four
    rates: Three


IDLE = LoopDemand(0.0, 0.0, 0.0, 0.0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class Settings(Protocol):
    """Parameters by PX4's names, wherever they come from."""

    def __getitem__(self, name: str) -> float: ...
    def listen(self, callback: Callable[[str], None]) -> None:
        """Call `callback(name)` after every change."""
        ...


def read_gains(store: Settings) -> NDArray[np.float64]:
    """The parameters the cascade reads, at the places of `loops`."""

    def get(name: str) -> float:
        return float(store[name])

    g = np.zeros(loops.GAINS)
    for first, name in (
        (loops.POSITION, "MPC_{}_P"),
        (loops.VELOCITY_P, "MPC_{}_VEL_P_ACC"),
        (loops.VELOCITY_I, "MPC_{}_VEL_I_ACC"),
        (loops.VELOCITY_D, "MPC_{}_VEL_D_ACC"),
    ):
        g[first : first + 3] = [get(name.format(axis)) for axis in ("XY", "XY", "Z")]
    for k, (axis, rate, short) in enumerate(
        (("ROLL", "ROLLRATE", "RR"), ("PITCH", "PITCHRATE", "PR"), ("YAW", "YAWRATE", "YR"))
    ):
        factor = get(f"MC_{rate}_K")
        g[loops.ATTITUDE + k] = get(f"MC_{axis}_P")
        g[loops.RATE_MAX + k] = math.radians(get(f"MC_{rate}_MAX"))
        g[loops.RATE_P + k] = get(f"MC_{rate}_P") * factor
        g[loops.RATE_I + k] = get(f"MC_{rate}_I") * factor
        g[loops.RATE_D + k] = get(f"MC_{rate}_D") * factor
        g[loops.RATE_FF + k], g[loops.RATE_LIMIT + k] = get(f"MC_{rate}_FF"), get(f"MC_{short}_INT_LIM")
    g[loops.FASTEST], g[loops.TILT] = get("MPC_XY_VEL_MAX"), math.radians(get("MPC_TILTMAX_AIR"))
    g[loops.CLIMB], g[loops.SINK] = get("MPC_Z_VEL_MAX_UP"), get("MPC_Z_VEL_MAX_DN")
    g[loops.THRUST_MIN], g[loops.THRUST_MAX] = get("MPC_THR_MIN"), get("MPC_THR_MAX")
    g[loops.HOVER], g[loops.ESTIMATE] = get("MPC_THR_HOVER"), float(get("MPC_USE_HTE") == 1)
    g[loops.HOVER_RANGE], g[loops.YAW_WEIGHT] = get("HTE_THR_RANGE"), get("MC_YAW_WEIGHT")
    g[loops.GYRO_CUTOFF], g[loops.RATE_CUTOFF] = get("IMU_GYRO_CUTOFF"), get("IMU_DGYRO_CUTOFF")
    g[loops.ACCEL_CUTOFF] = get("MPC_VELD_LP")
    return g


class Cascade:
    """The loops' memory: integrals, filters, the hover thrust learnt."""

    def __init__(self, store: Settings, dt: float) -> None:
        self._store, self.dt = store, dt
        self.gains = read_gains(store)
        self._memory = np.zeros(loops.MEMORY)
        self.hover = self.gains[loops.HOVER]
        self._stale = False
        store.listen(self._heard)
        self.reset()

    @property
    def hover(self) -> float:
        """The thrust 0..1 taken to hover."""
        return float(self._memory[loops.M_HOVER])

    @hover.setter
    def hover(self, value: float) -> None:
        self._memory[loops.M_HOVER] = value

    def _heard(self, name: str) -> None:
        self._stale = self._stale or name.startswith(("MPC_", "MC_", "HTE_", "IMU_"))

    def _refresh(self) -> None:
        if self._stale:
            before = self.gains[loops.HOVER]
            self.gains = read_gains(self._store)
            if self.gains[loops.HOVER] != before:
                self.hover = self.gains[loops.HOVER]
            self._stale = False

    def reset(self) -> None:
        """Forget integrals and filters, as on the ground."""
        loops.forget(self._memory)

    def track(self, goal: Goal, reading: SensorReading) -> LoopDemand:
        """All loops, from a goal in space."""
        from sim.px4.track import track  # numba takes its time

        self._refresh()
        d = np.empty(loops.DEMAND)
        aim = np.array((*goal.position, *goal.velocity, *goal.acceleration, goal.yaw, goal.yaw_rate))
        track(aim, reading.values, self.gains, self._memory, self.dt, d)
        roll, pitch, yaw, thrust, w, x, y, z, p, q, r = d.tolist()
        return LoopDemand(roll, pitch, yaw, thrust, (w, x, y, z), (p, q, r))

    def hold_attitude(
        self, wanted: Four, thrust: float, attitude: Four, rates: Three, yaw_rate: float = 0.0
    ) -> LoopDemand:
        """Attitude and rate loops."""
        turned = loops.rates_for(wanted, attitude, yaw_rate, self.gains)
        return self.hold_rates(turned, thrust, rates, wanted)

    def hold_rates(self, wanted: Three, thrust: float, rates: Three, attitude: Four) -> LoopDemand:
        """The rate loop on the low-passed gyro."""
        self._refresh()
        m, at = self._memory, loops.M_OUT
        loops.turn(wanted, thrust, rates, self.gains, m, self.dt)
        return LoopDemand(float(m[at]), float(m[at + 1]), float(m[at + 2]), thrust, attitude, wanted)
