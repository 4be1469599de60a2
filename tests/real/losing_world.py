"""The plant behind a real autopilot's simulation, whose rotor loses thrust in the air or when told."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim.bridge.ardupilot_json import ArduPilotBridge
from sim.bridge.px4_hil import Px4Bridge
from sim.effects import FORMS, HiddenEffect
from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.truth import Truth
from sim.vehicle import read_vehicle


@dataclass(frozen=True)
class Loss:
    """Rotor `rotor` loses `share` of its thrust `after_s` in the air, or when `told` (an event)."""

    rotor: int
    share: float
    after_s: float = math.inf
    determined: Any = None

    @classmethod
    def by_word(cls, rotor: int, share: float) -> Loss:
        """One that waits for its event."""
        return cls(rotor, share, determined=multiprocessing.get_context("spawn").Event())


class Losing(Truth):
    """A world in which that happens."""

    def __init__(self, loss: Loss) -> None:
        super().__init__()
        self.loss, self.air_s, self.last_s, self.happened = loss, 0.0, 0.0, False

    def act(self, plant: Plant) -> None:
        super().act(plant)
        since, self.last_s = plant.time_s - self.last_s, plant.time_s
        self.air_s += 0.0 if plant.height < 0.5 else since
        due = self.air_s >= self.loss.after_s or (
            self.loss.determined is not None and self.loss.determined.is_set()
        )
        if due and not self.happened:
            self.happened = True
            effect = HiddenEffect("degraded_rotor", self.loss.share, 0.0, {"rotor": self.loss.rotor})
            FORMS[effect.name].apply(plant, effect)


def _losing_world(to: str, airframe: Path, port: int, speed: float, loss: Loss, over: Any, pipe: Any) -> None:
    vehicle = read_vehicle(airframe)
    assert vehicle.rotor_file is not None
    plant, truth = Plant(vehicle, read_pair(vehicle.rotor_file)), Losing(loss)
    world: Any = (
        Px4Bridge(plant, truth, port=port, seed=0, speed=speed)
        if to == "px4"
        else ArduPilotBridge(plant, truth, port=port)
    )
    pipe.send(int(world.name.rpartition(":")[2]))
    try:
        world.run(over.is_set)
    finally:
        world.close()


@contextmanager
def losing_bridge(to: str, airframe: Path, loss: Loss, speed: float = 0.0, port: int = 0) -> Iterator[int]:
    """As `bridge`, of a vehicle to which that happens."""
    context = multiprocessing.get_context("spawn")
    over, (ours, theirs) = context.Event(), context.Pipe()
    given = (to, airframe, port, speed, loss, over, theirs)
    process = context.Process(target=_losing_world, args=given, daemon=True)
    process.start()
    try:
        assert ours.poll(120.0)
        yield ours.recv()
    finally:
        over.set()
        process.join(20.0)
