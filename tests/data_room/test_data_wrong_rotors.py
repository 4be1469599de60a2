"""A sound log with rotors, units and signs exchanged at random: the right rotor or a refusal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stand_files import SIDES, UNITS, Pair, equal, grid, readings, table, write

from coaxlink.cli.shared.stand import StandOptions, doubts, read_stand
from coaxlink.data import Samples
from coaxlink.errors import InputError

DRAWS = 500
SHOWN = {
    "own": {
        "speed": "{side}_rpm",
        "thrust": "{side}_thrust_N",
        "torque": "{side}_torque_Nm",
        "current": "{side}_current_A",
        "voltage": "{side}_voltage_V",
    },
    "words": {
        "speed": "{Side} speed [rpm]",
        "thrust": "{Side} thrust [N]",
        "torque": "{Side} torque [N.m]",
        "current": "{Side} current [A]",
        "voltage": "{Side} voltage [V]",
    },
    "letters": {
        "speed": "Motor Optical Speed {letter} (RPM)",
        "thrust": "Thrust {letter} (N)",
        "torque": "Torque {letter} (N·m)",
        "current": "Current {letter} (A)",
        "voltage": "Voltage {letter} (V)",
    },
    "numbers": {
        "speed": "Powertrain {number} - rotation speed (rpm)",
        "thrust": "Powertrain {number} - force Fz (thrust) (N)",
        "torque": "Powertrain {number} - torque MZ (torque) (N⋅m)",
        "current": "Powertrain {number} - current (A)",
        "voltage": "Powertrain {number} - voltage (V)",
    },
}


def draw(folder: Path, seed: int) -> tuple[Path, dict[str, np.ndarray], str]:
    """A file, the truth of its rows, and what was done to it."""
    random = np.random.default_rng(seed)
    diameter = random.uniform(0.2, 0.75)
    pair = Pair(
        diameter,
        random.uniform(0.05, 0.14),
        random.uniform(0.5, 0.75),
        60 * random.uniform(60, 170) / (np.pi * diameter),
        random.uniform(0.25, 0.45),
    )
    u, v = grid(int(random.integers(5, 9))) if random.random() < 0.75 else equal()
    true = readings(pair, u, v, seed)
    logged = dict(true)
    done = []
    if random.random() < 0.5:  # whole rotors under each other's name
        turned = {"upper": "lower", "lower": "upper"}
        logged = {turned[k[:5]] + k[5:]: x for k, x in true.items()}
        done.append("rotors")
    if random.random() < 0.5:
        quantity = str(random.choice(list(UNITS)))
        unit = str(random.choice([u for u in UNITS[quantity] if u not in ("N", "N m", "rpm")]))
        sides = SIDES if random.random() < 0.6 else (str(random.choice(SIDES)),)
        for side in sides:
            logged[f"{side}_{quantity}"] = logged[f"{side}_{quantity}"] * UNITS[quantity][unit]
        done.append(f"{quantity} of {' and '.join(sides)} in {unit}")
    for name in [f"{s}_{q}" for s in SIDES for q in ("thrust", "torque")]:
        if random.random() < 0.25:
            logged[name] = -logged[name]
            done.append(f"-{name}")
    style = str(random.choice(list(SHOWN)))
    columns = {}
    for side, letter, number in (("upper", "A", "1"), ("lower", "B", "2")):
        for quantity, heading in SHOWN[style].items():
            text = heading.format(side=side, Side=side.title(), letter=letter, number=number)
            columns[text] = logged[f"{side}_{quantity}"]
    if random.random() < 0.5:
        columns = dict(reversed(columns.items()))
    path = write(folder / f"{seed}.csv", table(columns))
    kind = "equal speeds" if np.array_equal(u, v) else "grid"
    return path, true, f"{style}, {kind}: {', '.join(done) or 'nothing'}"


def wrong(log: Samples, true: dict[str, np.ndarray]) -> list[str]:
    """The columns of a log that are not the truth's within 2 per cent of their greatest."""
    names = {"rpm": "speed", "thrust_N": "thrust", "torque_Nm": "torque"}
    found = []
    for side in SIDES:
        for ours, theirs in names.items():
            x = true[f"{side}_{theirs}"]
            if np.abs(log[f"{side}_{ours}"] - x).max() > 0.02 * np.abs(x).max():
                found.append(f"{side}_{ours}")
    return found


def test_no_draw_gives_a_wrong_rotor(tmp_path: Path) -> None:
    read = refused = 0
    silent = []
    for seed in range(DRAWS):
        path, true, done = draw(tmp_path, seed)
        try:
            log = read_stand([path], StandOptions(), lambda text: None)[0]
            assert doubts(log, None) == []
        except InputError as error:
            assert "\n" not in str(error)
            refused += 1
            continue
        read += 1
        if names := wrong(log, true):
            silent.append(f"{seed} {done}: {', '.join(names)}")
    assert not silent, "\n".join(silent)
    assert read > 0.25 * DRAWS, f"{read} read, {refused} refused"


def test_a_sound_log_is_read(tmp_path: Path) -> None:
    """The refusals above must not come from refusing everything."""
    for seed in range(DRAWS, DRAWS + 400):
        path, true, done = draw(tmp_path, seed)
        if not done.endswith("nothing"):
            continue
        log = read_stand([path], StandOptions(), lambda text: None)[0]
        assert doubts(log, None) == [] and not wrong(log, true), done


def real_pair(seed: int) -> tuple[dict[str, np.ndarray], str, str]:
    """Letters on sparse or one-sided logs of unequal propellers that feel each other both ways."""
    random = np.random.default_rng(10_000 + seed)
    diameter = random.uniform(0.1, 0.8)
    rpm = 60 * random.uniform(50, 180) / (np.pi * diameter)
    pair = Pair(
        diameter, random.uniform(0.045, 0.16), random.uniform(0.4, 0.78), rpm, random.uniform(0.15, 0.5)
    )
    kind = int(random.integers(4))
    if kind == 0:
        u, v = grid(int(random.integers(3, 6)))
    elif kind == 1:
        u, v = equal(int(random.integers(8, 40)))
    elif kind == 2:
        u = np.linspace(0.3, 1, 25)
        v = np.clip(u * random.uniform(0.8, 1.25) + 0.02 * random.standard_normal(25), 0.05, 1)
    else:
        u, v = random.uniform(0.2, 1, (2, int(random.integers(15, 120))))
    true = readings(pair, u, v, seed, float(random.choice([0.003, 0.01, 0.03])))
    true["upper_thrust"] = true["upper_thrust"] * (1 - random.uniform(0, 0.08) * v / np.maximum(u, 0.2))
    size = random.uniform(0.8, 1.25)  # of the lower propeller
    for name, power in (("lower_thrust", 4), ("lower_torque", 5), ("lower_current", 5)):
        true[name] = true[name] * size**power
    first, second = SIDES if random.random() < 0.5 else SIDES[::-1]
    return true, first, second


def test_letters_on_poor_logs_are_right_or_asked_for(tmp_path: Path) -> None:
    decided = 0
    for seed in range(200):
        true, first, second = real_pair(seed)
        columns = {
            heading.format(letter=letter): true[f"{side}_{quantity}"]
            for letter, side in (("A", first), ("B", second))
            for quantity, heading in SHOWN["letters"].items()
        }
        try:
            path = write(tmp_path / "log.csv", table(columns))
            log = read_stand([path], StandOptions(), lambda text: None)[0]
        except InputError:
            continue
        decided += 1
        assert not wrong(log, true), seed
    assert decided > 100


@pytest.mark.parametrize("quantity, unit", [(q, u) for q, units in UNITS.items() for u in units])
def test_every_unit_is_read_from_its_heading(tmp_path: Path, quantity: str, unit: str) -> None:
    pair = Pair(0.4, 0.09, 0.65, 6000.0)
    true = readings(pair, *grid(), 1)
    names = {"speed": "rpm", "thrust": "N", "torque": "N m"} | {quantity: unit}
    columns = {
        f"{q} {side} ({names[q]})": true[f"{side}_{q}"] * UNITS[q][names[q]]
        for side in SIDES
        for q in ("speed", "thrust", "torque")
    }
    path = write(tmp_path / "log.csv", table(columns))
    log = read_stand([path], StandOptions(poles=14), lambda text: None)[0]
    assert wrong(log, true) == []
