"""PX4's simulator interface: we listen on TCP 4560, it connects, HIL_SENSOR sets its clock.

Free-running until its first HIL_ACTUATOR_CONTROLS, then lockstep one to one: a step of 4 ms, a HIL_SENSOR,
and nothing moves until the controls for it are there, or PATIENCE_S of wall time is over.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as m

from sim.bridge.hil_messages import STEPS, HilMessages
from sim.errors import PortError
from sim.physics.plant import STEP_S, Plant
from sim.truth import Truth

# PX4 sends controls when its outputs are computed, not when a reading came (SimulatorMavlink::send), and its
# clock stands still until the next reading: a simulator that waits for ever stops both. Its own step on after
# a time-out too (`poll` in mavlink_interface.cpp): jsbsim-bridge and sitl_gazebo-classic 1 s, the latter
# 10 ms since 2026.
PATIENCE_S = 0.2
LAG_S = 0.1
FREE_RUN_S = 0.004
QUIET_S = 0.05  # wall time without a word after which controls with a clock of their own are taken
POLL_S = 0.1
BACKLOG = 65536  # bytes of readings, a second or two of flight, that one which reads nothing is left with
FIRST_PORT, BATTERY_PORT, INSTANCES = 4560, 14280, 100  # of the simulator, of its MAVLink line to a payload
GIVE_WAY_S = 3.0  # wall time without a byte after which another autopilot is heard (jMAVSim's reset, too)


class Px4Bridge:
    """One vehicle behind one TCP port.

    In lockstep a step waits `patience_s` of wall time for its controls; then the last ones are held and the
    next step is sent (`timeouts` counts those, `say` hears of the first of each link). Controls carry the
    stamp of the reading they answer: those that answer an earlier one (`stale`) are passed over, or the
    backlog of the free run would stay between readings and controls for good. `speed` paces by wall time; 0
    is as fast as it answers. An autopilot that hung up may come again; a silent one gives way to another.

    With `battery` the pack is sent to the payload's MAVLink line of the instance that connects to `port`, as
    a smart battery of its own system would: where PX4 listens is known by that number alone. PX4's own
    simulation of one is to be off (SIM_BAT_ENABLE 0): both would write one topic. Its failsafe for the flight
    time left is to warn only (COM_FLTT_LOW_ACT 1; even with 0 it holds for 5 s): it takes a battery sent by
    MAVLink for one with 0 s left (mavlink_receiver.cpp of 1.16, handle_message_battery_status).
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
        battery: bool = False,
        patience_s: float = PATIENCE_S,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.plant, self.truth = plant, truth
        self.patience_s, self._say = patience_s, say
        self._speed, self._due = speed, 0.0
        self._messages = HilMessages(plant, seed)
        self.steps = self.timeouts = self.stale = self.links = 0
        self._warned, self._heard = False, 0.0
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BACKLOG)
        try:
            self._listener.bind((host, port))
            self._listener.listen(1)
        except OSError as error:
            self._listener.close()
            raise PortError(f"tcpin:{host}:{port}", f"cannot be opened ({error.strerror})") from error
        self._listener.settimeout(POLL_S)
        self._smart = m.MAVLink(None, srcSystem=0, srcComponent=m.MAV_COMP_ID_BATTERY)
        self._battery = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        instance = port - FIRST_PORT
        known = battery and 0 <= instance < INSTANCES
        self._battery_at = (host, BATTERY_PORT + instance) if known else None
        self.name = "tcpin:{}:{}".format(*self._listener.getsockname())

    def close(self) -> None:
        """Let go of the port."""
        self._listener.close()
        self._battery.close()

    def status(self) -> str:
        """One line of counts."""
        return (
            f"{self.steps} steps on {self.links} link{'' if self.links == 1 else 's'}, "
            f"{self.timeouts} by the lock-step time-out of {self.patience_s:g} s, {self.stale} old controls"
        )

    def run(self, stop: Callable[[], bool]) -> None:
        """Serve one autopilot after another until `stop()`; says at the end what `status` says."""
        while not stop():
            try:
                stream, _ = self._listener.accept()
            except (TimeoutError, ConnectionAbortedError):
                continue
            self.links, self._warned, self._heard = self.links + 1, False, time.monotonic()
            with stream:
                stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                try:
                    self._serve(stream, stop)
                except OSError as gone:
                    self._say(f"PX4's link ended ({gone.strerror or gone}), listening again: {self.status()}")
        self._say(self.status())

    def _serve(self, stream: socket.socket, stop: Callable[[], bool]) -> None:
        mav, parser = m.MAVLink(None, srcSystem=1, srcComponent=200), m.MAVLink(None)
        parser.robust_parsing = True
        command: NDArray[np.float64] = np.zeros(self.plant.vehicle.rotors)
        lockstep = False
        while not stop():
            self.truth.act(self.plant)
            stamp, data = self._messages.pack(mav)
            self._send(stream, data, stop)
            self._tell_battery()
            patience = self.patience_s if lockstep else FREE_RUN_S
            controls = self._controls(stream, parser, stamp, patience, stop)
            if controls is not None:
                lockstep = True
                command = controls[: len(command)]
            elif not stop():
                self._give_way()
                self._count(lockstep)
            self.plant.advance(command, STEPS)
            self.steps += 1
            self._pace()

    def _count(self, lockstep: bool) -> None:
        """A step without its answer; a lock-step that was left is told once a link."""
        if not lockstep:
            return
        self.timeouts += 1
        if not self._warned:
            self._warned = True
            self._say(
                f"lock-step: no HIL_ACTUATOR_CONTROLS {self.patience_s:g} s after the reading at "
                f"{self.plant.time_s:.3f} s: the last are held, the next is sent (further ones are counted)"
            )

    def _give_way(self) -> None:
        """Raises ConnectionError when this autopilot has been silent long and another one is at the door."""
        if time.monotonic() - self._heard > GIVE_WAY_S and select.select([self._listener], [], [], 0.0)[0]:
            raise ConnectionError("silent, and another one has come")

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
            left = end - time.monotonic()
            stream.settimeout(max(min(left, POLL_S if old is None else QUIET_S), 1e-4))
            try:
                data = stream.recv(65536)
            except TimeoutError:
                if old is not None or left <= 0.0:
                    return old
                continue
            if not data:
                raise ConnectionError("it hung up")
            self._heard = time.monotonic()
            for message in parser.parse_buffer(data) or []:
                if message.get_msgId() != m.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS:
                    continue
                self._smart.srcSystem = message.get_srcSystem()
                found = np.clip(np.nan_to_num(np.array(message.controls, float)), 0.0, 1.0)
                if message.time_usec >= stamp:
                    return found
                old, self.stale = found, self.stale + 1
            if left <= 0.0:
                return old  # whatever else keeps coming
        return None

    def _tell_battery(self) -> None:
        """Once the system's number is known; nobody may be there to hear it."""
        if self._battery_at and self._smart.srcSystem and (data := self._messages.battery(self._smart)):
            with suppress(OSError):
                self._battery.sendto(data, self._battery_at)

    def _send(self, stream: socket.socket, data: bytes, stop: Callable[[], bool]) -> None:
        """All of it, however long the other end is stopped; what it has not read yet stands in its way."""
        stream.settimeout(POLL_S)
        rest = memoryview(data)
        while rest and not stop():
            try:
                rest = rest[stream.send(rest) :]
            except TimeoutError:
                self._give_way()
