"""Faults on the wire come as often as they say, by seed; and flights repeat byte by byte."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from sim.flights import fly, write_flight
from sim.line.wire import Wire, WireFaults, parse_faults
from sim.simulation import Simulation, build

EXAMPLES = Path(__file__).parents[2] / "examples"
DATA = [bytes([k % 256, k // 256, 7, 9]) for k in range(20000)]


class Clock:
    """Time by hand."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def carried(faults: WireFaults, seed: int = 1) -> list[bytes]:
    clock = Clock()
    wire, out = Wire(faults, seed, clock), []
    for data in DATA:
        out += wire.carry(data)
        clock.now += 0.001
        out += wire.due()
    clock.now += 10.0
    return out + wire.due()


def test_a_sound_wire_carries_everything_in_order() -> None:
    assert carried(WireFaults()) == DATA


@pytest.mark.parametrize("chance", [0.01, 0.2])
def test_faults_come_as_often_as_they_say(chance: float) -> None:
    lost = carried(WireFaults(loss=chance))
    assert len(lost) == pytest.approx((1 - chance) * len(DATA), rel=0.02) and set(lost) <= set(DATA)
    copied = Counter(carried(WireFaults(copies=chance)))
    assert sum(n == 2 for n in copied.values()) == pytest.approx(chance * len(DATA), rel=0.2)
    flipped = carried(WireFaults(corruption=chance))
    changed = [
        bin(int.from_bytes(a) ^ int.from_bytes(b)).count("1") for a, b in zip(flipped, DATA, strict=True)
    ]
    assert set(changed) == {0, 1} and sum(changed) == pytest.approx(chance * len(DATA), rel=0.2)
    moved = carried(WireFaults(disorder=chance))
    assert sorted(moved) == sorted(DATA) and moved != DATA


def test_delay_and_a_dead_link() -> None:
    clock = Clock()
    wire = Wire(WireFaults(delay_s=0.1, dead_s=((1.0, 2.0),)), 1, clock)
    assert wire.carry(b"a") == [] and wire.due() == []
    clock.now = 0.11
    assert wire.due() == [b"a"]
    clock.now = 1.5
    wire.carry(b"b")
    clock.now = 2.5
    assert wire.due() == []
    wire.carry(b"c")
    clock.now = 2.7
    assert wire.due() == [b"c"]


def test_the_seed_decides() -> None:
    faults = parse_faults("loss=0.1,copies=0.1,disorder=0.1,corruption=0.1,dead=3:5")
    assert faults == WireFaults(0.1, 0.1, 0.1, 0.1, 0.0, ((3.0, 5.0),))
    assert carried(faults, 4) == carried(faults, 4) != carried(faults, 5)


@pytest.mark.slow
def test_the_same_seed_flies_the_same_bytes(tmp_path: Path) -> None:
    logs = []
    for name in ("a", "b"):
        standin_ = build(Simulation(EXAMPLES / "x8_demo.toml", hidden_seed=2, seed=3), [])
        log = fly(standin_.autopilot, "paper")
        write_flight(tmp_path / name, log)
        logs.append((tmp_path / name).read_bytes())
    assert logs[0] == logs[1]
    other = build(Simulation(EXAMPLES / "x8_demo.toml", hidden_seed=2, seed=4), []).autopilot
    assert other.step().accel[0] != log["accel_x_m_s2"][0]
    assert log["height_m"].max() == pytest.approx(4.7, abs=0.3) and log["height_m"][-1] < 0.3
    assert np.diff(log["time_s"]) == pytest.approx(0.008)
    assert log["motor1"].max() < 1.0 and 25.0 < log["voltage_V"].min() < 33.6
