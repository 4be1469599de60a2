"""Run a stand-in autopilot on its links: one thread, paced by wall time, or as fast as it goes.

The vehicle's own clock is the plant's. A live mixer in the loop is waited for (a little) when the clock does
not run at its natural speed, for otherwise the speed itself would look like latency.

In lock-step the world waits for whoever flies it as long as that takes: for the answer to every demand, and
in offboard mode for a set-point after every position that was told, each with the stamp of what it answers.
What is flown then does not depend on how busy the machine is. One who stays silent is waited for once, until
he speaks again; a command ends the wait.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from sim.line.links import Peer, Port, wait
from sim.line.memory import Memory
from sim.line.signing import Signing
from sim.line.wire import Clock, Wire, WireFaults
from sim.px4.autopilot import RATE_HZ, Autopilot
from sim.px4.cascade import LoopDemand
from sim.px4.protocol import Conversation
from sim.px4.telemetry import stamp_us
from sim.words import spoken

PATIENCE_S = 0.020
LOCKSTEP_S = 10.0  # wall time
LOOK_UP_S = 0.2  # so often somebody may want it all to end
# set-points; motor commands; a command may say that there will be no more of either
GOALS, ANSWERS, COMMAND = (82, 84, 86), (139, 385), 76
POSITION = 32
SLIP_S = 0.25  # further behind than this, the clock gives up catching up
REBOOT_S = 1.5


class Standin:
    """An autopilot and everyone who talks to it."""

    def __init__(
        self,
        autopilot: Autopilot,
        ports: Sequence[Port],
        *,
        speed: float = 1.0,
        faults: WireFaults | None = None,
        seed: int = 0,
        manners: type[Conversation] = Conversation,
        key: bytes | None = None,
        lockstep: bool = False,
        memory: Memory | None = None,
        clock: Clock = time.monotonic,
    ) -> None:
        self._signing, self._memory = None if key is None else Signing(key), memory
        self._lockstep, self._commands = lockstep, 0
        # the newest stamps (us) that set-points and answers carried, and those at which a wait was in vain
        self._heard, self._silent = {"goal": -1, "answer": -1}, {"goal": -2, "answer": -2}
        self._manners, self._clock = manners, clock
        self._faults, self._seed = faults, seed
        self._sets, self._silent_until = 0, 0.0
        self.autopilot, self.ports, self.speed = autopilot, list(ports), speed
        self.recorder: Any = None  # `step()` is called after every step
        self.stop: Callable[[], bool] = lambda: False
        self._conversations: dict[Peer, Conversation] = {}
        self._answers = 0
        self._system, self._boots = autopilot.system, autopilot.boots
        autopilot.say = self._say
        autopilot.exchange = self._exchange

    def run(self, stop: Callable[[], bool]) -> None:
        """Step by step, until `stop()`; speed 0 is as fast as it goes."""
        tick, speed, self.stop = 1.0 / RATE_HZ, self.speed, stop
        start, done, beat = time.monotonic(), 0, 0.0
        while not stop():
            self.tick()
            done += 1
            now = time.monotonic()
            if now - beat > 1.0:
                beat = now
                self.live_sign()
            if not speed:
                continue
            ahead = start + done * tick / speed - now
            if ahead < -SLIP_S:
                start, done = now, 0
            # short naps cost more than they pace
            while ahead > 0.001:
                wait(self.ports, ahead)
                self.hear()
                ahead = start + done * tick / speed - time.monotonic()

    def live_sign(self) -> None:
        """However slow the vehicle's clock, who listens must see that it lives."""
        if self.speed and self.speed < 1.0:
            self._everyone(self._manners.builders[0](self.autopilot))

    def tick(self) -> None:
        """4 ms of the vehicle's time, with everything reported and heard in it."""
        self.hear()
        self.autopilot.step()
        if self._system != self.autopilot.system:
            self._rename()
        if self.autopilot.logger is not None:
            self.autopilot.logger.record(stamp_us(self.autopilot))
        if self.recorder is not None:
            self.recorder.step()
        if self._memory is not None:
            self._memory.step()
        if self._booting:
            return
        sent = False
        for conversation in self._conversations.values():
            sent |= conversation.stream(POSITION)
            conversation.list_on()
        if self._lockstep and sent and self.autopilot.led:
            self._await("goal", stamp_us(self.autopilot) // 1000 * 1000)

    def hear(self) -> None:
        """Deal with everything that has come."""
        for link, port in enumerate(self.ports):
            for peer, data in port.receive():
                peer.link = link
                self._heed(self._meet(peer), peer.parse(data))
            for peer in port.peers:
                conversation = self._meet(peer)
                if peer.back is not None:
                    self._heed(conversation, peer.late())
        for peer in [p for p in self._conversations if p.gone]:
            del self._conversations[peer]

    def _heed(self, conversation: Conversation, messages: list[Any]) -> None:
        for message in messages:
            number = message.get_msgId()
            self._answers += number in ANSWERS
            self._commands += number == COMMAND
            if number == 139:
                self._heard["answer"] = message.time_usec
            elif number in GOALS:
                self._heard["goal"] = 1000 * message.time_boot_ms
            if message.get_msgId() == 256:
                self._set_up_signing(message)
            if not self._booting:
                conversation.hear(message)
                if self._boots != self.autopilot.boots:
                    self._restart()
                    return
            if self._faults and message.get_msgId() == 23:
                self._sets += 1
                if self._sets == self._faults.reboot_after_sets and not self.autopilot.armed:
                    self.autopilot.boot()
                    self._restart()
                    return

    def _restart(self) -> None:
        """After a reboot: silent for a while, and what was asked for is forgotten."""
        self._boots = self.autopilot.boots
        self._silent_until = self._clock() + REBOOT_S
        for peer in self._conversations:
            self._conversations[peer] = self._manners(self.autopilot, peer, self._everyone, self._clock)

    def _set_up_signing(self, message: Any) -> None:
        """A new key for every link, or with zeros none; on the ground only."""
        if self.autopilot.armed or message.target_system not in (0, self._system):
            return
        key = bytes(message.secret_key)
        self._signing = Signing(key) if any(key) else None
        for peer in self._conversations:
            peer.sign(self._signing)

    @property
    def _booting(self) -> bool:
        return self._silent_until > 0.0 and self._clock() < self._silent_until

    def _meet(self, peer: Peer) -> Conversation:
        if peer not in self._conversations:
            if self._faults is not None and peer.faulty:
                number = 2 * len(self._conversations) + 1000 * self._seed
                peer.out, peer.back = (Wire(self._faults, number + k, self._clock) for k in (0, 1))
            if self._signing is not None:
                peer.sign(self._signing)
            peer.packer.srcSystem = self._system
            self._conversations[peer] = self._manners(self.autopilot, peer, self._everyone, self._clock)
        return self._conversations[peer]

    def _rename(self) -> None:
        """A reboot with another system id."""
        self._system = self.autopilot.system
        for peer in self._conversations:
            peer.packer.srcSystem = self._system

    def _everyone(self, message: Any) -> None:
        for conversation in self._conversations.values():
            conversation.send(message)

    def _say(self, severity: int, text: str) -> None:
        for piece in spoken(severity, text):
            self._everyone(piece)
        if self.autopilot.logger is not None:
            self.autopilot.logger.say(severity, text)

    def _exchange(self, demand: LoopDemand) -> None:
        """Send the demand to whoever mixes, and wait for the answer where that is fair."""
        due = [c for c in self._conversations.values() if c.demand_due()]
        if not due:
            return
        takes = self.autopilot.takes_live or self.autopilot.module is not None
        lockstep = (self._lockstep or self.speed != 1.0) and takes and self.autopilot.live
        if lockstep:
            self.hear()  # an answer to an older demand is not the one to wait for
        before = self._answers
        number = 140 if self.autopilot.module is None else 350
        for conversation in due:
            conversation.send(self._manners.builders[number](self.autopilot))
        if not lockstep:
            return
        if self._lockstep:
            if number == 350:
                self._until(lambda: self._answers != before, PATIENCE_S)
            else:
                self._await("answer", stamp_us(self.autopilot))
        else:
            self._until(lambda: self._answers != before, PATIENCE_S)

    def _await(self, what: str, stamp: int) -> None:
        """Until a message of that kind carries this stamp or a later one, or a command comes."""
        heard, commands = self._heard, self._commands
        if self._silent[what] == heard[what]:
            return
        if not self._until(lambda: heard[what] >= stamp or self._commands != commands, LOCKSTEP_S):
            self._silent[what] = heard[what]

    def _until(self, met: Callable[[], bool], patience_s: float) -> bool:
        """Hear what comes until then; False when that took too long."""
        end = self._clock() + patience_s
        self.hear()
        while not met():
            left = end - self._clock()
            if left <= 0 or self.stop():
                return False
            wait(self.ports, min(left, LOOK_UP_S))
            self.hear()
        return True
