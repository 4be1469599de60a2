"""The stand-in's ArduPilot mixer: from its parameters, and from what a script told it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from firmware_params.ardupilot import ApMix, ApTable, Demand, MotorParameters, realise
from firmware_params.errors import TableError
from sim.ardupilot.store import ArduPilotStore

SCRIPTED, DYNAMIC = 15, 17
THR_MIX = 0.5


class ArduPilotMixer:
    """Demand to actuators. A matrix is taken once a boot; a dynamic table whenever it is loaded."""

    def __init__(self, store: ArduPilotStore, rotors: int) -> None:
        self._store, self._rotors = store, rotors
        self._mix: ApMix | None = None
        self.factors: tuple[tuple[float, float, float, float], ...] = ()
        self._frame = int(store["FRAME_CLASS"]), int(store["FRAME_TYPE"])
        self._stale = True
        store.listen(self._heard)

    legacy = False

    def boot(self) -> None:
        """Frame and factors are looked at once, at start-up."""
        self._frame = int(self._store["FRAME_CLASS"]), int(self._store["FRAME_TYPE"])
        self.factors, self._stale = (), True

    def load(self, factors: tuple[tuple[float, float, float, float], ...]) -> None:
        """A script's table."""
        self.factors, self._stale = factors, True

    @property
    def frame_class(self) -> int:
        """As booted with."""
        return self._frame[0]

    def _heard(self, name: str) -> None:
        self._stale = self._stale or name.startswith("MOT_")

    @property
    def mix(self) -> ApMix | None:
        """What the firmware makes of it; None: motors are not initialised."""
        if self._stale:
            self._stale = False
            parameters = MotorParameters.from_params(self._store.values())
            try:
                self._mix = realise(ApTable(self._frame[0], self.factors, parameters, self._frame[1]))
            except (TableError, ArithmeticError, ValueError):
                self._mix = None
        return self._mix

    def pwm(self, roll: float, pitch: float, yaw: float, thrust: float, spool: str) -> list[int]:
        """Microseconds of each motor, in motor order."""
        mix = self.mix
        if mix is None:
            return [round(self._store["MOT_PWM_MIN"])] * self._rotors
        hover = min(max(self._store["MOT_THST_HOVER"], 0.125), 0.6875)
        average = max(thrust, thrust * (1.0 - THR_MIX) + hover * THR_MIX)
        demand = Demand(roll, pitch, yaw, thrust, average, spool=spool)
        try:
            with np.errstate(all="ignore"):
                return [int(p) for p in mix.output(demand).pwm]
        except (ArithmeticError, ValueError):  # a spin range of 1e30 makes no pulse
            return [round(self._store["MOT_PWM_MIN"])] * self._rotors

    def command(self, roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        """(N,) motor commands in 0..1 as the ESCs read them."""
        low, high = self._store["MOT_PWM_MIN"], self._store["MOT_PWM_MAX"]
        pwm = np.array(self.pwm(roll, pitch, yaw, thrust, "THROTTLE_UNLIMITED"), float)
        out = np.zeros(self._rotors)
        count = min(len(pwm), self._rotors)
        out[:count] = np.clip((pwm[:count] - low) / max(high - low, 1.0), 0.0, 1.0)
        return out
