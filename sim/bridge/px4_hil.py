"""PX4's simulator interface: we listen on TCP 4560, it connects, HIL_SENSOR sets its clock.

Free-running until its first HIL_ACTUATOR_CONTROLS, then lockstep one to one: a step of 4 ms, a HIL_SENSOR,
and nothing moves until the controls for it are there. IMU at 250 Hz, magnetometer, barometer 50, GPS 10;
every reading is noisy, for more than a hundred equal ones are a dead sensor to it.
"""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as m

from sim.errors import PortError
from sim.place import HOME
from sim.plant import STEP_S, Plant
from sim.sensors import Sensors
from sim.truth import Truth

STEPS = 4
ACCEL, GYRO, MAG, BARO = 0x7, 0x38, 0x1C0, 0x1A00
SILENCE_S = 2.0  # wall time after which a step counts as late
SEND_S = 10.0
LAG_S = 0.1
FREE_RUN_S = 0.004
QUIET_S = 0.05  # wall time without a word after which controls with a clock of their own are taken


class Px4Bridge:
    """One vehicle behind one TCP port.

    In lockstep a step waits for its controls however long they take (it may be stopped in a debugger),
    until the link ends; `late` counts those that took over 2 s. Controls carry the stamp of the reading they
    answer: those that answer an earlier one (`stale`) are passed over, or the backlog of the free run would
    stay between readings and controls for good. `speed` paces by wall time; 0 is as fast as it answers.
    """

    def __init__(
        self,
        plant: Plant,
        truth: Truth,
        *,
        host: str = "127.0.0.1",
        port: int = 4560,
        seed: int = 0,
        speed: float = 0.0,
    ) -> None:
        self.plant, self.truth = plant, truth
        self._speed, self._due = speed, 0.0
        self._sensors = Sensors(plant, seed)
        self._random = np.random.default_rng([seed, 0x411])
        self.steps = self.late = self.stale = 0
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind((host, port))
            self._listener.listen(1)
        except OSError as error:
            self._listener.close()
            raise PortError(f"tcpin:{host}:{port}", f"cannot be opened ({error.strerror})") from error
        self._listener.settimeout(0.1)
        self.name = "tcpin:{}:{}".format(*self._listener.getsockname())

    def close(self) -> None:
        """Let go of the port."""
        self._listener.close()

    def run(self, stop: Callable[[], bool]) -> None:
        """Serve one autopilot after another until `stop()`."""
        while not stop():
            try:
                stream, _ = self._listener.accept()
            except TimeoutError:
                continue
            with stream:
                stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                stream.settimeout(0.1)
                try:
                    self._serve(stream, stop)
                except (ConnectionError, BrokenPipeError):
                    continue

    def _serve(self, stream: socket.socket, stop: Callable[[], bool]) -> None:
        mav, parser = m.MAVLink(None, srcSystem=1, srcComponent=200), m.MAVLink(None)
        parser.robust_parsing = True
        command: NDArray[np.float64] = np.zeros(self.plant.vehicle.rotors)
        lockstep = False
        while not stop():
            self.truth.act(self.plant)
            stamp = self._send(stream, mav)
            patience = SILENCE_S if lockstep else FREE_RUN_S
            controls = self._controls(stream, parser, stamp, patience, stop)
            while controls is None and lockstep and not stop():
                self.late += 1
                controls = self._controls(stream, parser, stamp, math.inf, stop)
            if controls is not None:
                lockstep = True
                command = controls[: len(command)]
            self.plant.advance(command, STEPS)
            self.steps += 1
            self._pace()

    def _pace(self) -> None:
        """Hold the world to `speed` times real time; what was lost by waiting is not caught up in a burst."""
        if not self._speed:
            return
        now = time.monotonic()
        self._due = max(self._due, now - LAG_S) + STEPS * STEP_S / self._speed
        if self._due > now:
            time.sleep(self._due - now)

    def _controls(
        self, stream: socket.socket, parser: Any, stamp: int, patience_s: float, stop: Callable[[], bool]
    ) -> NDArray[np.float64] | None:
        """Controls in answer to the reading of `stamp`, 0..1 a motor; None when they do not come."""
        end = time.monotonic() + patience_s
        old: NDArray[np.float64] | None = None
        while not stop():
            left = QUIET_S if old is not None else max(min(end - time.monotonic(), 0.1), 1e-4)
            stream.settimeout(left)
            try:
                data = stream.recv(65536)
            except TimeoutError:
                if old is not None:
                    return old
                if time.monotonic() >= end:
                    return None
                continue
            if not data:
                raise ConnectionError("it hung up")
            for message in parser.parse_buffer(data) or []:
                if message.get_msgId() != m.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS:
                    continue
                found = np.clip(np.nan_to_num(np.array(message.controls, float)), 0.0, 1.0)
                if message.time_usec >= stamp:
                    return found
                old, self.stale = found, self.stale + 1
        return None

    def _send(self, stream: socket.socket, mav: Any) -> int:
        """A reading; returns its stamp, us."""
        now = round(1e6 * self.plant.time_s) + 1_000_000
        tick = self.plant.steps // STEPS
        r = self._sensors.read()
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
        if tick % 25 == 0:
            messages.append(self._gps(now, r.position, r.velocity))
        messages.append(self._state(now))
        data = b""
        for message in messages:
            data += message.pack(mav)
            mav.seq = (mav.seq + 1) % 256
        stream.settimeout(SEND_S)
        stream.sendall(data)
        return now

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
        vn, ve, vd = (round(100 * v) for v in velocity.tolist())
        lat, lon = (round(1e7 * degrees) for degrees in HOME.geodetic(n, e))
        course = round(100 * math.degrees(math.atan2(ve, vn))) % 36000
        alt, speed = round(1000 * (HOME.alt - d)), round(math.hypot(vn, ve))
        return m.MAVLink_hil_gps_message(now, 3, lat, lon, alt, 70, 90, speed, vn, ve, vd, course, 14)

    def _state(self, now: int) -> Any:
        """Ground truth: PX4 logs it, and does not fly by it."""
        p = self.plant
        n, e, d = p.position.tolist()
        lat, lon = (round(1e7 * degrees) for degrees in HOME.geodetic(n, e))
        speeds = [round(100 * v) for v in p.velocity.tolist()]
        accel = [round(1000 * a / 9.80665) for a in p.specific_force.tolist()]
        quaternion, rates = p.quaternion.tolist(), p.rates.tolist()
        alt = round(1000 * (HOME.alt - d))
        return m.MAVLink_hil_state_quaternion_message(
            now, quaternion, *rates, lat, lon, alt, *speeds, 0, 0, *accel
        )
