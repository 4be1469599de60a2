"""Flight logs as instruments, loggers and links damage them, column by column: a part of `premises.py`.

What is damaged, by how much and when is drawn, never chosen: the column evenly among a log's own, sizes over
what is met (a factor from 1.05 to 20, a delay from 5 to 300 ms, a hold from 0.2 to 5 s), and whether from the
first row on or from some moment within the flight.
"""

from __future__ import annotations

import random
import re
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from coaxlink.data.resolution import resolution_of
from coaxlink.data.samples import Samples
from coaxlink.health.turning import APART

FAMILY = re.compile(r"(motor|rpm|accel|gyro|vel|roll|pitch|yaw|height|voltage)")
# a family whose columns may stand in one another's place
KINDS = {"motor": "motor", "rpm": "rpm", "accel": "accel", "gyro": "gyro", "vel": "vel", "roll": "angle",
         "pitch": "angle", "yaw": "angle", "height": "height", "voltage": "voltage"}  # fmt: skip
Way = Callable[[Samples, str, np.ndarray, random.Random], tuple[Samples, str]]
WEAK = "a command that is off from the first row on is a weak rotor to its log: rpm or another log tell"
FAST = "an rpm that is off by no more than motors of one type differ by is a motor of another winding"
FINER = "it changes the column by less than the steps that it is logged in"


def untold(way: str, column: str, log: Samples, damaged: Samples) -> str:
    """Why nothing in a log can tell; nothing where something can."""
    was, now = log[column], damaged[column]
    if len(was) != len(now) or way in ("exchange", "dead ESC"):
        return ""
    if np.sqrt(np.nanmean((now - was) ** 2)) < resolution_of(was):
        return FINER
    if way not in ("scale", "bias") or np.any(now == was):  # from some moment on: before it tells
        return ""
    if kind_of(column) == "rpm" and abs(np.nanmedian(now / was) - 1.0) < APART:
        return FAST
    return WEAK if kind_of(column) == "motor" else ""


# what a doubt must speak of to be one about a column of this kind: the sensor, or a premise that it enters
SENSORS = {
    "motor": "command|output|motor|lift|lag|response|stamps", "rpm": "rpm|speed|magnets|ESC",
    "accel": "accel|lift|weight|mass|stamps", "gyro": "gyro|turn|inertia|response|lag|stamps",
    "vel": "vel|height", "angle": "roll|pitch|yaw|attitude|angle|gyros|heading", "height": "height|vel",
    "voltage": "volt|pack|supply",
}  # fmt: skip
CLOCKS = r"\btime\b|clock|stamps|stretch|gap|missing|ends in|begins in|restart"  # of damage to rows
NUMBERED = re.compile(r"\b(?:motor|rpm|rotor|ESC|output)s? ?(\d)")


def concerns(reported: str, way: str, columns: str) -> bool:
    """Whether a doubt speaks of what is damaged: a column of "motor3, motor5", its sensor, a premise of it.

    A doubt that names rotors names one of the damaged ones.
    """
    if way in ("drop", "time back"):
        return re.search(CLOCKS, reported) is not None
    names = [n for n in re.findall(r"[a-z]\w+", columns) if kind_of(n)]
    if any(re.search(rf"\b{re.escape(n)}\b", reported) for n in names):
        return True
    rotors, determined = {n[-1] for n in names if n[-1].isdigit()}, set(NUMBERED.findall(reported))
    if rotors and determined:
        return bool(rotors & determined)
    return any(re.search(SENSORS[kind_of(n)], reported) for n in names)


def kind_of(column: str) -> str:
    """motor, rpm, accel, gyro, vel, angle, height, voltage."""
    found = FAMILY.match(column)
    return KINDS[found[1]] if found else ""


def columns_of(log: Samples) -> list[str]:
    """What may be damaged."""
    return [n for n in log.columns if kind_of(n)]


def moments(log: Samples, dice: random.Random) -> np.ndarray:
    """(rows,) where: the whole log, or from a moment in its middle half on."""
    if dice.random() < 0.5:
        return np.ones(log.rows, bool)
    time = log["time_s"]
    start = time[0] + dice.uniform(0.25, 0.75) * (time[-1] - time[0])
    return np.asarray(time >= start)


def _set(log: Samples, column: str, rows: np.ndarray, values: np.ndarray) -> Samples:
    return log.with_columns(**{column: np.where(rows, values, log[column])})


def _possible(column: str, values: np.ndarray) -> np.ndarray:
    return np.clip(values, 0.0, 1.0) if kind_of(column) == "motor" else values


def exchange(log: Samples, column: str, rows: np.ndarray, dice: random.Random) -> tuple[Samples, str]:
    """With another of its family."""
    mates = [n for n in columns_of(log) if n != column and kind_of(n) == kind_of(column)]
    if not mates:
        return log, ""
    other = dice.choice(mates)
    out = log.with_columns(**{column: log[other], other: log[column]})  # labels: from the first row on
    return out, f"with {other}"


def sign(log: Samples, column: str, rows: np.ndarray, dice: random.Random) -> tuple[Samples, str]:
    """Reversed."""
    return _set(log, column, rows, -log[column]), ""


def scale(log: Samples, column: str, rows: np.ndarray, dice: random.Random) -> tuple[Samples, str]:
    """Times a factor."""
    factor = float(np.exp(dice.uniform(np.log(1.05), np.log(20.0)) * dice.choice((-1, 1))))
    if kind_of(column) == "motor":  # within what a reader lets pass
        factor = float(np.exp(dice.uniform(np.log(1.03), np.log(1.3)) * dice.choice((-1, 1))))
    values = factor * log[column]
    return _set(
        log, column, rows, np.clip(values, 0, 1) if kind_of(column) == "motor" else values
    ), f"x {factor:.3g}"


def bias(log: Samples, column: str, rows: np.ndarray, dice: random.Random) -> tuple[Samples, str]:
    """Plus a part of what it usually moves by."""
    off = dice.choice((-1, 1)) * dice.uniform(0.2, 3.0) * float(np.nanstd(log[column]))
    values = log[column] + off
    return _set(
        log, column, rows, np.clip(values, 0, 1) if kind_of(column) == "motor" else values
    ), f"{off:+.3g}"


def freeze(log: Samples, column: str, rows: np.ndarray, dice: random.Random) -> tuple[Samples, str]:
    """Its last reading to the end."""
    if rows.all():
        rows = np.arange(log.rows) >= dice.randrange(log.rows)
    first = int(np.argmax(rows))
    return _set(log, column, rows, np.full(log.rows, log[column][first])), f"from row {first + 1}"


def hold(log: Samples, column: str, rows: np.ndarray, dice: random.Random) -> tuple[Samples, str]:
    """One reading for a while, once to four times."""
    out, time = log, log["time_s"]
    seconds = float(np.exp(dice.uniform(np.log(0.2), np.log(5.0))))
    many = dice.randint(1, 4)
    for _ in range(many):
        start = time[0] + dice.random() * (time[-1] - time[0])
        at = (time >= start) & (time < start + seconds)
        if at.any():
            out = _set(out, column, at, np.full(log.rows, log[column][int(np.argmax(at))]))
    return out, f"{many} x {seconds:.2g} s"


def delay(log: Samples, column: str, rows: np.ndarray, dice: random.Random) -> tuple[Samples, str]:
    """Late."""
    late = float(np.exp(dice.uniform(np.log(0.005), np.log(0.3))))
    time, values = log["time_s"], log[column]
    values = np.unwrap(values) if kind_of(column) == "angle" else values
    known = np.isfinite(values)
    later = np.interp(time - late, time[known], values[known])
    return _set(log, column, rows, later), f"{1e3 * late:.0f} ms"


def quantise(log: Samples, column: str, rows: np.ndarray, dice: random.Random) -> tuple[Samples, str]:
    """In steps of a part of what it moves by."""
    step = float(np.exp(dice.uniform(np.log(0.02), np.log(2.0)))) * float(np.nanstd(log[column]))
    return _set(log, column, rows, step * np.round(log[column] / max(step, 1e-12))), f"steps of {step:.2g}"


def drop(log: Samples, column: str, rows: np.ndarray, dice: random.Random) -> tuple[Samples, str]:
    """Rows that were never written, all columns: some stretches, or one in so many."""
    keep = np.ones(log.rows, bool)
    if dice.random() < 0.5:
        keep = np.array([dice.random() < 0.7 for _ in range(log.rows)])
        return log.take(keep), "three rows in ten"
    many, seconds = dice.randint(1, 6), dice.uniform(0.1, 3.0)
    time = log["time_s"]
    for _ in range(many):
        start = time[0] + dice.random() * (time[-1] - time[0])
        keep &= ~((time >= start) & (time < start + seconds))
    return log.take(keep), f"{many} x {seconds:.2g} s"


def time_back(log: Samples, column: str, rows: np.ndarray, dice: random.Random) -> tuple[Samples, str]:
    """The clock set back within the log."""
    at, by = dice.randrange(log.rows // 4, 3 * log.rows // 4), dice.uniform(0.5, 30.0)
    return log.with_columns(time_s=log["time_s"] - by * (np.arange(log.rows) >= at)), f"{by:.1f} s"


def dead_esc(log: Samples, column: str, rows: np.ndarray, dice: random.Random) -> tuple[Samples, str]:
    """An ESC that fell off the bus: its last speed to the end, or none."""
    speeds = [n for n in log.columns if n.startswith("rpm")]
    if not speeds:
        return log, ""
    name = dice.choice(speeds)
    first = dice.randrange(log.rows)
    last = dice.choice((log[name][first], np.nan))
    return _set(
        log, name, np.arange(log.rows) >= first, np.full(log.rows, last)
    ), f"{name} from row {first + 1}"


WAYS: dict[str, Way] = {
    "exchange": exchange, "sign": sign, "scale": scale, "bias": bias, "freeze": freeze, "hold": hold,
    "delay": delay, "quantise": quantise, "drop": drop, "time back": time_back, "dead ESC": dead_esc,
}  # fmt: skip

PLANS, LAWS = ("hover", "circle", "wander", "steps"), ("standard", "curved", "fitted")
# what physics may do to a sound log, and by how much at most (`sim.effects.FORMS`)
TRUE = {"": 0.0, "degraded_rotor": 0.3, "cg_offset": 0.02, "mass_change": 3.0, "wind": 6.0, "rotor_lag": 0.05,
        "ground_effect": 0.3, "rotor_drag": 0.3, "battery_voltage": 0.5, "vibration": 3.0}  # fmt: skip
STEPS = {"motor": (0.0, 1e-3, 1e-4), "accel": (0.0, 9.81e-3), "gyro": (0.0, 1e-3), "vel": (0.0, 1e-2),
         "angle": (0.0, 1e-3, 1.7e-4), "height": (0.0, 1e-2), "voltage": (0.0, 1e-2)}  # fmt: skip


def undamaged(count: int, examples: Path, first: int = 0) -> int:
    """Sound logs of drawn flights, effects and resolutions: print each that is doubted; how many are."""
    from coaxlink.instruments.flight.inputs import checked
    from coaxlink.tables.px4 import report_px4
    from coaxlink.vehicle import load_vehicle
    from sim.effects import HiddenEffect
    from sim.physics.rotors import read_pair
    from sim.quick.flight import FlightWorld, fly_quick, make_design
    from sim.vehicle import read_vehicle

    frame, rotors = examples / "x8_demo.toml", examples / "rotor_paper.toml"
    vehicle = load_vehicle(frame, rotors)
    designs = {
        law: make_design(read_vehicle(frame), read_pair(rotors), report_px4(vehicle, law).params)
        for law in LAWS
    }
    doubted = 0
    for n in range(first, first + count):
        dice = random.Random(n)
        law, plan, name = dice.choice(LAWS), dice.choice(PLANS), dice.choice(list(TRUE))
        seconds = dice.uniform(20.0, 90.0)
        extra = {"rotor": float(dice.randint(1, 8))} if name == "degraded_rotor" else {}
        onset = dice.choice((0.0, 0.5 * seconds)) if name != "battery_voltage" else 0.0
        effect = HiddenEffect(name, TRUE[name] * dice.random(), onset, extra)
        world = FlightWorld((effect,) if name else (), n, plan, seconds)
        log = Samples(fly_quick(designs[law], world, dice.choice((4, 8, 16)))[1], f"undamaged {n}")
        for kind, steps in STEPS.items():
            if step := dice.choice(steps):
                own = [c for c in columns_of(log) if kind_of(c) == kind]
                log = log.with_columns(**{c: step * np.round(log[c] / step) for c in own})
        found = checked([log], vehicle.declared).suspects
        doubted += bool(found)
        print(f"\r{n}, {doubted} doubted", end="", file=sys.stderr, flush=True)
        for suspect in found:
            print(f"{n}: {law}, {plan}, {name or 'no effect'}, {seconds:.0f} s: {suspect.line()}", flush=True)
    print(f"{doubted} of {count} sound logs are doubted", flush=True)
    return doubted
