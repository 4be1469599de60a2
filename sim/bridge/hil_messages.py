"""What PX4 hears in one step of its simulator interface: HIL_SENSOR, HIL_GPS and the ground truth.

IMU at 250 Hz, magnetometer and barometer at 50, GPS at 10. Every reading is noisy: more than a hundred equal
ones are a dead sensor to it. The interface has no battery: BATTERY_STATUS, at 10 Hz, goes to a MAVLink line.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as m

from sim.physics.plant import Plant
from sim.physics.sensors import SensorReading, Sensors
from sim.place import HOME

STEPS = 4  # of the plant, 1 ms each, from reading to reading
ACCEL, GYRO, MAG, BARO = 0x7, 0x38, 0x1C0, 0x1A00
TEN_HZ = 25  # readings from one to the next


class HilMessages:
    """Readings of one plant, from one seed."""

    def __init__(self, plant: Plant, seed: int) -> None:
        self.plant = plant
        self._sensors = Sensors(plant, seed)
        self._random = np.random.default_rng([seed, 0x411])
        self._reading: SensorReading | None = None

    def pack(self, mav: Any) -> tuple[int, bytes]:
        """The step's stamp (us) and its messages, numbered by `mav`."""
        now = round(1e6 * self.plant.time_s) + 1_000_000
        tick = self.plant.steps // STEPS
        self._reading = r = self._sensors.read()
        fields = ACCEL | GYRO | (MAG | BARO if tick % 5 == 0 else 0)
        noise = self._random.standard_normal(6)
        alt = HOME.alt - float(self.plant.position[2]) + 0.05 * noise[3]
        pressure = 1013.25 * (1 - 2.25577e-5 * alt) ** 5.25588
        messages = [
            m.MAVLink_hil_sensor_message(
                now,
                *r.accel.tolist(),
                *r.rates.tolist(),
                *(self._field() + 0.001 * noise[:3]).tolist(),
                pressure,
                0.0,
                alt,
                25.0 + 0.01 * noise[4],
                fields,
                0,
            )
        ]
        if tick % TEN_HZ == 0:
            messages.append(self._gps(now, r.position, r.velocity))
        messages.append(self._state(now))
        data = b""
        for message in messages:
            data += message.pack(mav)
            mav.seq = (mav.seq + 1) % 256
        return now, data

    def battery(self, mav: Any) -> bytes:
        """BATTERY_STATUS of the step that `pack` made last, as a smart battery has it; mostly nothing."""
        p, r = self.plant, self._reading
        if r is None or p.steps // STEPS % TEN_HZ:
            return b""
        count = min(p.battery.cells, 10)  # PX4 adds up as many
        cells = [round(1000 * r.voltage / count) if k < count else 0xFFFF for k in range(10)]
        used = max(round((p.battery.charge - p.charge) * p.battery.capacity_Ah * 1000), 0)
        data: bytes = m.MAVLink_battery_status_message(
            0, 0, 1, 0x7FFF, cells, _short(100 * r.current), used, -1, round(100 * p.charge)
        ).pack(mav)
        mav.seq = (mav.seq + 1) % 256
        return data

    def _field(self) -> NDArray[np.float64]:
        """Magnetic field in body axes, gauss."""
        w, x, y, z = self.plant.quaternion.tolist()
        n, d = 0.21, 0.43
        return np.array(
            [
                n * (1 - 2 * (y * y + z * z)) + d * 2 * (x * z - w * y),
                n * 2 * (x * y - w * z) + d * 2 * (y * z + w * x),
                n * 2 * (x * z + w * y) + d * (1 - 2 * (x * x + y * y)),
            ]
        )

    def _gps(self, now: int, position: NDArray[np.float64], velocity: NDArray[np.float64]) -> Any:
        n, e, d = position.tolist()
        vn, ve, vd = (_short(100 * v) for v in velocity.tolist())
        lat, lon = (round(1e7 * degrees) for degrees in HOME.geodetic(n, e))
        course = round(100 * math.degrees(math.atan2(ve, vn))) % 36000
        alt, speed = round(1000 * (HOME.alt - d)), _short(math.hypot(vn, ve))
        return m.MAVLink_hil_gps_message(now, 3, lat, lon, alt, 70, 90, speed, vn, ve, vd, course, 14)

    def _state(self, now: int) -> Any:
        """Ground truth: PX4 logs it, and does not fly by it."""
        p = self.plant
        n, e, d = p.position.tolist()
        lat, lon = (round(1e7 * degrees) for degrees in HOME.geodetic(n, e))
        speeds = [_short(100 * v) for v in p.velocity.tolist()]
        accel = [_short(1000 * a / 9.80665) for a in p.specific_force.tolist()]
        quaternion, rates = p.quaternion.tolist(), p.rates.tolist()
        alt = round(1000 * (HOME.alt - d))
        return m.MAVLink_hil_state_quaternion_message(
            now, quaternion, *rates, lat, lon, alt, *speeds, 0, 0, *accel
        )


def _short(value: float) -> int:
    """As the message carries it: what hits the ground at more than 32 g, or falls faster, is at its end."""
    return max(-32768, min(32767, round(value)))
