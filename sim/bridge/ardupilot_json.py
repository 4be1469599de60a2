"""ArduPilot's JSON simulator interface: servo packets to UDP 9002, each answered with a state.

A packet is `<HHI16H>` (magic 18458; 32 channels: 29569): magic, frame rate, frame count, pulse widths.
One reply a frame; the same frame again means the reply was lost: it is sent again and nothing moves; a count
that starts over means a new autopilot, and the vehicle is on the ground again. The time-out of this lock-step
is the autopilot's: it asks again after 1 s without a reply (SIM_JSON.cpp, recv_fdm), and nothing here waits
for one frame; a packet that will never be answered is told, for it would be asked again for ever.
"""

from __future__ import annotations

import json
import math
import socket
import struct
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sim.errors import PortError
from sim.physics.plant import STEP_S, Plant
from sim.truth import Truth

MAGIC = {18458: 16, 29569: 32}
HEAD = struct.Struct("<HHI")
SLOWEST_HZ = 10  # a step of 0.1 s or more is no step to it


class ArduPilotBridge:
    """One vehicle behind one UDP port.

    `steps` counts frames flown, `repeats` those asked for again, `lost` those that never came, `refused`
    packets without an answer; `say` hears of the first of these.
    """

    def __init__(
        self,
        plant: Plant,
        truth: Truth,
        *,
        host: str = "127.0.0.1",
        port: int = 9002,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.plant, self.truth, self._say = plant, truth, say
        self._fresh = plant.state.copy()
        self.steps = self.repeats = self.lost = self.refused = 0
        self.time_s = self._amps = 0.0
        self._count: int | None = None
        self._answer = b""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise PortError(f"udpin:{host}:{port}", f"cannot be opened ({error.strerror})") from error
        self._socket.settimeout(0.1)
        self.name = "udpin:{}:{}".format(*self._socket.getsockname())

    def close(self) -> None:
        """Let go of the port."""
        self._socket.close()

    def status(self) -> str:
        """One line of counts."""
        return (
            f"{self.steps} frames, {self.repeats} asked for again, {self.lost} lost, "
            f"{self.refused} packets not answered"
        )

    def run(self, stop: Callable[[], bool]) -> None:
        """Answer until `stop()`; says at the end what `status` says."""
        while not stop():
            try:
                data, address = self._socket.recvfrom(4096)
                answer = self.answer(data)
                if answer:
                    self._socket.sendto(answer, address)
            except OSError:  # nothing came; or the reply cannot be sent, and it asks again
                continue
        self._say(self.status())

    def answer(self, packet: bytes) -> bytes:
        """Fly one packet; nothing for what is no servo packet."""
        magic, rate, count = HEAD.unpack_from(packet) if len(packet) >= HEAD.size else (0, 0, 0)
        channels = MAGIC.get(magic, 0)
        if not channels or len(packet) < HEAD.size + 2 * channels:
            return self._refuse(f"{len(packet)} bytes that are no servo packet")
        if rate < SLOWEST_HZ:
            return self._refuse(f"a frame rate of {rate} Hz, {SLOWEST_HZ} at least is expected")
        if count == self._count:
            self.repeats += 1
            return self._answer
        if self._count is not None and count < self._count:
            self.plant.state[:] = self._fresh
            self.time_s = 0.0
        elif self._count is not None:
            self.lost += count - self._count - 1
        self._count = count
        pulses = np.array(struct.unpack_from(f"<{channels}H", packet, HEAD.size), float)
        self._fly(pulses, 1.0 / rate)
        self._answer = self._reply()
        return self._answer

    def _refuse(self, why: str) -> bytes:
        self.refused += 1
        if self.refused == 1:
            self._say(f"not answered: {why} (further ones are counted)")
        return b""

    def _fly(self, pulses: NDArray[np.float64], dt: float) -> None:
        command = np.clip((pulses[: self.plant.vehicle.rotors] - 1000.0) / 1000.0, 0.0, 1.0)
        self.truth.act(self.plant)
        steps = max(math.ceil(dt / STEP_S - 1e-9), 1)
        self.plant.advance(command, steps, dt / steps)
        self.time_s += dt
        self.plant.steps = round(self.time_s / STEP_S)  # the truth's clock counts milliseconds
        self.steps += 1
        module = self.plant.sensing.power_module
        self._amps = self.plant.current if module is None else module.read(self.plant.current, dt)

    def _reply(self) -> bytes:
        """A line of JSON for a reader that searches for words and takes what stands two characters behind.

        So `velocity` must stay the first with that name, and no blank may stand between `:` and `[`.
        """
        p = self.plant
        state = {
            "timestamp": round(self.time_s, 6),
            "imu": {"gyro": p.rates.tolist(), "accel_body": p.specific_force.tolist()},
            "position": p.position.tolist(),
            "quaternion": p.quaternion.tolist(),
            "velocity": p.velocity.tolist(),
            "rng_1": p.height,
            "battery": {"voltage": p.voltage, "current": self._amps},
        }
        return b"\n" + json.dumps(state, separators=(",", ":")).encode() + b"\n"
