"""What an ArduCopter writes into its own parameters: counters, what it measures, what it learns.

As its source does: AP_Stats (a start counted, times every 30 s and after a flight), AP_Mission, AP_Baro,
AP_Compass (declination of the place, not saved), AP_InertialSensor (gyro offsets at every start),
AP_MotorsMulticopter (hover throttle in level hover, a first-order filter of 10 s, saved on disarming).
"""

from __future__ import annotations

import math

from sim.ardupilot.store import ArduPilotStore
from sim.px4.autopilot import SensorReading

FLUSH_S = 30.0
HOVER_TC_S, HOVER_LEAST, HOVER_MOST = 10.0, 0.125, 0.6875
LEVEL_RAD, STILL_M_S = math.radians(5.0), 0.6
FIXED_S, DECLINATION_RAD = 1.0, 0.0563  # a position some time after the start, and the field there
PRESSURE_PA = 95590.0
LEARN_AND_SAVE = 2


class OwnValues:
    """Of one vehicle; the store keeps them."""

    def __init__(self, store: ArduPilotStore) -> None:
        self._store = store
        self._booted_s = self._flushed_s = 0.0
        self._flying_since: float | None = None
        self._located = False

    def boot(self, now: float) -> None:
        """A start: it is counted, the ground pressure and the gyros are measured."""
        store = self._store
        self._booted_s = self._flushed_s = now
        self._flying_since, self._located = None, False
        store.own("STAT_BOOTCNT", store["STAT_BOOTCNT"] + 1)
        store.own("BARO1_GND_PRESS", PRESSURE_PA + 3.0 * math.sin(store["STAT_BOOTCNT"]))
        for k, axis in enumerate("XYZ"):
            store.own(f"INS_GYROFFS_{axis}", 1e-3 * math.sin(store["STAT_BOOTCNT"] + 2.0 * k))

    def arm(self, now: float) -> None:
        """The ground is where the barometer is now."""
        self._flying_since = now
        self._store.live("BARO1_GND_PRESS", self._store["BARO1_GND_PRESS"] + math.sin(now))

    def disarm(self, now: float) -> None:
        """The flight is counted, what was learned is saved."""
        if self._flying_since is not None:
            self._store.own("STAT_FLTTIME", self._store["STAT_FLTTIME"] + int(now - self._flying_since))
            self._flying_since = None
        self._flush(now)
        if self._store["MOT_HOVER_LEARN"] == LEARN_AND_SAVE:
            self._store.save("MOT_THST_HOVER")

    def step(self, now: float) -> None:
        """What goes on by itself."""
        store = self._store
        if now - self._flushed_s > FLUSH_S:
            self._flush(now)
        if store["STAT_RESET"] == 0:
            for name in ("STAT_BOOTCNT", "STAT_FLTTIME", "STAT_RUNTIME"):
                store.own(name, 0.0)
            store.own("STAT_RESET", 1.0)
        if not self._located and now - self._booted_s > FIXED_S and store["COMPASS_AUTODEC"]:
            self._located = True
            store.live("COMPASS_DEC", DECLINATION_RAD)

    def hover(self, thrust: float, reading: SensorReading, climbing: bool, dt: float) -> None:
        """Armed and in the air: the throttle of a level hover is learned."""
        _, x, y, _ = reading.quaternion.tolist()
        tilt = 2.0 * math.asin(min(math.hypot(x, y), 1.0))
        still = not climbing and abs(float(reading.velocity[2])) < STILL_M_S
        if self._store["MOT_HOVER_LEARN"] and thrust > 0.0 and still and tilt < LEVEL_RAD:
            held = self._store["MOT_THST_HOVER"]
            held += dt / (dt + HOVER_TC_S) * (thrust - held)
            self._store.live("MOT_THST_HOVER", min(max(held, HOVER_LEAST), HOVER_MOST))

    def _flush(self, now: float) -> None:
        passed = int(now - self._flushed_s)
        self._flushed_s += passed
        self._store.own("STAT_RUNTIME", self._store["STAT_RUNTIME"] + passed)
