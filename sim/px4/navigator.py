"""Where to be 4 ms from now, by mode: holding, climbing, returning, coming down."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from sim.physics.plant import Plant
from sim.physics.sensors import SensorReading
from sim.place import Place
from sim.px4.cascade import Goal, Settings, Three, euler
from sim.px4.guidance import step_towards
from sim.px4.modes import Mode


class Navigator:
    """Moves `goal`; the rest of the autopilot says where it is and flies there."""

    plant: Plant
    settings: Settings
    home: Place
    mode: Mode
    goal: Goal
    reading: SensorReading
    armed: bool
    landed: bool
    cruise: float
    say: Callable[[int, str], None]
    _offboard_goal: Goal
    _target: Three
    _yaw: float
    _mode_at: float
    _settled_since: Any

    def _enter(self, mode: Mode) -> None:
        """Change the mode; what it flies to starts from where the vehicle is."""
        self.mode, self._mode_at = mode, self.plant.time_s
        self._settled_since = None
        self.cruise = 0.0
        here = self._position()
        self._target = here
        self.goal = Goal(here, (0.0, 0.0, 0.0))
        self._yaw = euler(tuple(self.reading.quaternion.tolist()))[2]

    def _position(self) -> Three:
        n, e, d = self.reading.position.tolist()
        return (n, e, d)

    def _move_goal(self, position: Three) -> None:
        """Where to be 4 ms from now, by mode."""
        if self.mode == Mode.OFFBOARD:
            self.goal = self._offboard_goal
            if self.armed and self.landed and self._goes_up(position):
                self.landed = False
            return
        n, e, d = self._target
        climb = cruise = 0.0
        if self.mode == Mode.TAKEOFF:
            if self.landed:
                self.landed, self._mode_at = False, self.plant.time_s
            ramp = max(float(self.settings["MPC_TKO_RAMP_T"]), 0.1)
            climb = float(self.settings["MPC_TKO_SPEED"]) * min(
                (self.plant.time_s - self._mode_at) / ramp, 1.0
            )
            if abs(position[2] - d) < 0.2 and abs(self.goal.position[2] - d) < 0.05:
                self._enter(Mode.HOLD)
                self._target = (n, e, d)
        elif self.mode == Mode.LAND:
            d, climb = self.goal.position[2] + 1.0, self._landing_speed(-position[2])
        elif self.mode == Mode.RTL:
            n, e, cruise = 0.0, 0.0, float(self.settings["MPC_XY_CRUISE"])
            if math.hypot(position[0], position[1]) < 0.5:
                self._enter(Mode.LAND)
                return
        else:
            climb, cruise = self._vertical_speed(d), self._cruise_speed()
        self.goal = step_towards(self.goal, (n, e, d), cruise, climb, self._yaw)

    def _landing_speed(self, height: float) -> float:
        """Slower with the height, between MPC_LAND_ALT1 and _ALT2 (FlightTaskAuto)."""
        slow, fast = float(self.settings["MPC_LAND_SPEED"]), float(self.settings["MPC_Z_V_AUTO_DN"])
        low, high = float(self.settings["MPC_LAND_ALT2"]), float(self.settings["MPC_LAND_ALT1"])
        return slow + (fast - slow) * min(max((height - low) / max(high - low, 1e-3), 0.0), 1.0)

    def _vertical_speed(self, down: float) -> float:
        """Of a flight to a height, beside take-off and landing."""
        above = down < self.goal.position[2]
        return float(self.settings["MPC_Z_V_AUTO_UP" if above else "MPC_Z_V_AUTO_DN"])

    def _cruise_speed(self) -> float:
        limit = float(self.settings["MPC_XY_VEL_MAX"])
        return min(self.cruise or float(self.settings["MPC_XY_CRUISE"]), limit)

    def _goes_up(self, position: Three) -> bool:
        """Whether an offboard goal asks a landed vehicle to leave the ground."""
        p, v = self._offboard_goal.position[2], self._offboard_goal.velocity[2]
        higher = not math.isnan(p) and p < position[2] - 0.2
        return higher or (math.isnan(p) and not math.isnan(v) and v < -0.1)
