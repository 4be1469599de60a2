"""The test in the air beside what nobody measured: the vehicle as its file has it, and with each guess moved.

One sequential test a vehicle, each given the same. A rotor is flagged once each has held it for the
likeliest within the last WEIGHED_S; where they differ for so long the answer hangs on that guess, and that is
said in its place. A mass is not moved: what all rotors have in common is unknown here to a tenth
(`LIFT_TODAY`). Before any call it is asked whether this is the vehicle (`premises.differs`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from coaxlink.frames import Array
from coaxlink.health.sequential import WINDOW, SequentialTest, Suspicion, Verdict
from coaxlink.health.stream import BLOCK_S, HealthInterval, Stream
from coaxlink.premises.answer import NotJudged, OtherVehicle
from coaxlink.premises.moves import moves, not_judged
from coaxlink.premises.rotation import pairs_unmeasured
from coaxlink.premises.same_vehicle import LEAST_LEFT, Flown, differs
from coaxlink.vehicle import Vehicle

HELD = 0.5  # probability: likelier than not
WEIGHED_S = WINDOW * BLOCK_S  # a test looks back so far; what it has not held by then it will not
LEAST_S = 5.0  # of flight before any call: two and a half swings of the slowest attitude loop (`QUICK_S`)
MOST_S = 60.0  # looked back to
FULL = 0.8  # of its charge: the pack's voltage is known well enough to weigh the vehicle by its lift
LOOK_S = 10.0  # between looks whether this is the vehicle


@dataclass
class Premised:
    """One vehicle and what its test believes."""

    premise: str  # that was moved; "" for the vehicle as its file has it
    words: str
    stream: Stream
    test: SequentialTest
    verdict: Verdict | None = None
    held: dict[int, tuple[float, Suspicion]] = field(default_factory=dict)  # rotor -> when last

    def step(self, block: HealthInterval) -> Verdict:
        """One block on."""
        self.verdict = self.test.step(block)
        for s in self.verdict.suspicions[:1]:
            if s.probability >= HELD:
                self.held[s.rotor] = self.verdict.time_s, s
        return self.verdict

    def holds(self, rotor: int, since_s: float) -> bool:
        """Whether it held that rotor for the likeliest since then."""
        return rotor in self.held and self.held[rotor][0] >= since_s


class Weighed:
    """`command` and `reading` as of `Stream`; a verdict a block, of the vehicle as its file has it."""

    def __init__(self, vehicle: Vehicle, hours: float, before: Weighed | None = None) -> None:
        """`before`: of the same vehicle until now; why nothing could be reported then goes on."""
        moved = [m for m in moves(vehicle.declared) if m.premise != "mass_kg"]
        bodies = [
            ("", "", vehicle),
            *((m.premise, m.words, replace(vehicle, declared=m.airframe)) for m in moved),
        ]
        self._tests = [Premised(p, words, Stream(v), SequentialTest(v, hours)) for p, words, v in bodies]
        self._vehicle = vehicle
        self._named: tuple[int, float] | None = None  # a rotor that some test called, and when first
        self._blocks: deque[HealthInterval] = deque(maxlen=round(MOST_S / BLOCK_S))
        self._looked_s = 0.0
        # premise -> why nothing can be reported
        self.doubts: dict[str, NotJudged] = before.doubts if before else {}
        unmeasured = pairs_unmeasured(vehicle.declared, vehicle.rotors)
        self.doubts |= {doubt.premise: doubt for doubt in unmeasured}
        self.differs: tuple[OtherVehicle, ...] = before.differs if before else ()
        self.charge: float | None = before.charge if before else None  # of the pack, 0..1, where reported
        self._weight: tuple[OtherVehicle, ...] = ()  # what its lift reported while the pack was full

    def command(self, time_s: float, commands: Sequence[float]) -> None:
        """As `Stream.command`."""
        for test in self._tests:
            test.stream.command(time_s, commands)

    def reading(
        self, time_s: float, rates: Sequence[float], accel_z: float
    ) -> Iterator[tuple[Verdict, Suspicion | None]]:
        """Verdicts, and the rotor that all premises agree on in the block in which they first do."""
        rows = [test.stream.reading(time_s, rates, accel_z) for test in self._tests]
        for blocks in zip(*rows, strict=True):
            verdict, *_ = [test.step(block) for test, block in zip(self._tests, blocks, strict=True)]
            self._blocks.append(blocks[0])
            if verdict.time_s - self._looked_s >= LOOK_S:
                self._look(verdict.time_s)
            yield verdict, self._agreed(verdict.time_s)

    def _agreed(self, now_s: float) -> Suspicion | None:
        own = self._tests[0]
        if "rotation" in self.doubts:
            return None
        if self._named is None:
            called = (t.verdict.called for t in self._tests if t.verdict and t.verdict.called)
            named = next(called, None)
            if named is None:
                return None
            self._named = named.rotor, now_s
        rotor, since = self._named
        held = own.holds(rotor, since - WEIGHED_S)
        apart = [t for t in self._tests if t.holds(rotor, since - WEIGHED_S) != held]
        if held and not apart:
            if len(self._blocks) * BLOCK_S < LEAST_S:
                return None
            self._named = None
            self._look(now_s)
            return None if self.differs else own.held[rotor][1]
        if apart and now_s - since >= WEIGHED_S:
            self._named = None
            reported, other = (f"rotor {rotor}", "no rotor") if held else ("no rotor", f"rotor {rotor}")
            for test in apart:
                why = f"{test.words} it is {other} that loses thrust in place of {reported}"
                self.doubts.setdefault(test.premise, not_judged(test.premise, why))
        return None

    def _look(self, now_s: float) -> None:
        """Is this the vehicle? Its lift weighs it while the pack is full; later that may be empty."""
        self._looked_s = now_s
        blocks = [b for b in self._blocks if np.isfinite(b.measured[0])] or list(self._blocks)
        if len(blocks) * BLOCK_S < LEAST_S:
            return
        meant, moved = (_body(np.array([getattr(b, n) for b in blocks])) for n in ("predicted", "measured"))
        speeds = np.array([b.speeds for b in blocks])
        stretch = np.cumsum([b.after_gap for b in blocks]).astype(float)
        body, model = self._vehicle.airframe, self._vehicle.model
        full = self.charge is not None and self.charge > FULL and len(blocks) < (self._blocks.maxlen or 0)
        left = LEAST_LEFT + (1.0 - LEAST_LEFT) * (self.charge or 0.0) if full else LEAST_LEFT
        found = differs(Flown(body, model, speeds, meant, moved, stretch, BLOCK_S, left))
        if full:
            self._weight = tuple(d for d in found if d.check == "lift")
        self.differs = (*self._weight, *(d for d in found if d.check != "lift" or not self._weight))


def _body(wrench: Array) -> Array:
    """(rows, 6) body loads, FRD, of wrenches (rows, 4) with the thrust up."""
    forces = np.zeros((len(wrench), 3))
    forces[:, 2] = -wrench[:, 0]
    return np.concatenate([forces, wrench[:, 1:]], axis=1)
