"""The C++ of the PX4 module, compiled for this machine: its law beside Python's, for tests and research."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.live.onboard.description import BoardLaw, board_law
from coaxlink.live.onboard.px4 import module_files
from coaxlink.mixer.exact import ExactLaw
from coaxlink.vehicle import Vehicle

Array = NDArray[np.float64]
BUDGET = 400  # as CoaxMixer.hpp
WARNINGS = (
    "-std=c++14", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Wfloat-equal",
    "-Werror",
)  # fmt: skip
DEAD = 3
RESOLVED = 5e-6  # of the authority: a wrench in single precision


@dataclass(frozen=True)
class Answers:
    """Of the law on board, a row a demand."""

    speeds: Array  # (rows, 2K)
    commands: Array  # (rows, 2K)
    settled: NDArray[np.bool_]
    fell_back: NDArray[np.bool_]
    passes: Array  # over the arms
    micros: Array
    looks: Array  # all round, since start


def demands(rows: int, seed: int = 1) -> dict[str, Array]:
    """{kind: (rows, 4)} by rank (roll, pitch, thrust, yaw), of the vehicle's authority."""
    draw = np.random.default_rng(seed)
    t = np.arange(rows) / 250.0

    def wave() -> Array:
        size, hertz, phase = draw.uniform([[0.2], [0.05], [0]], [[1], [4], [2 * np.pi]], (3, 4))
        return np.asarray(np.sin(2 * np.pi * np.outer(t, hertz) + phase) @ size / 4)

    def smooth() -> Array:
        return np.stack([wave() for _ in range(4)], axis=1) * [0.25, 0.25, 0.28, 0.15] + [0, 0, 0.33, 0]

    held = draw.uniform([-0.2, -0.2, 0.1, -0.2], [0.2, 0.2, 0.6, 0.2], (rows // 50 + 1, 4))
    return {
        "smooth": smooth(),
        "steps": np.repeat(held, 50, axis=0)[:rows],
        "beyond": 4.0 * smooth(),
        "jumps": draw.uniform([-0.3, -0.3, 0.0, -0.2], [0.3, 0.3, 0.8, 0.2], (rows, 4)),
    }


def build(
    folder: Path, about: BoardLaw, *flags: str, source: str = "board_law.cpp", compiler: str = "g++"
) -> Path:
    """A host's program around the module's headers, compiled in `folder`; the program."""
    for name, text in module_files(about, "tests").items():
        if name.endswith(".hpp"):
            (folder / Path(name).name).write_text(text)
    program = folder / Path(source).stem
    main = Path(__file__).with_name(source)
    subprocess.run([compiler, *WARNINGS, *flags, f"-I{folder}", "-o", program, main], check=True)
    return program


def on_board(
    program: Path, rows: Array, failed_slots: int = 0, budget: int = BUDGET, lean: float = 0.0
) -> Answers:
    """What the program answers."""
    run = subprocess.run(
        [program, str(failed_slots), str(budget), f"{lean:.9g}"],
        input=np.ascontiguousarray(rows, float).tobytes(), capture_output=True, check=True,
    )  # fmt: skip
    table = np.frombuffer(run.stdout).reshape(len(rows), -1)
    settled, fell_back, passes, micros, looks = table[:, -5:].T
    speeds, commands = np.split(table[:, :-5], 2, axis=1)
    return Answers(speeds, commands, settled > 0, fell_back > 0, passes, micros, looks)


def in_python(vehicle: Vehicle, rows: Array, failed: tuple[int, ...] = ()) -> tuple[Array, NDArray[np.bool_]]:
    """(rows, 2K) speeds of the Python law, and whether it settled."""
    law = ExactLaw(vehicle, failed=failed, compiled=None)
    wrenches = np.zeros_like(rows)
    wrenches[:, law.units.order] = rows * law.units.scale
    speeds, settled = np.zeros((len(rows), 2 * law.arms.size)), np.zeros(len(rows), bool)
    for n, wrench in enumerate(wrenches.tolist()):
        settled[n] = law.solve(wrench) > 0
        speeds[n, law.units.slots] = law._speeds()
    return speeds, settled


def merit(about: BoardLaw, speeds: Array, rows: Array) -> Array:
    """(rows,) power and the price of what is missing beyond single precision, in full powers."""
    arms, total = about.arms, np.zeros(len(rows))
    left = rows.copy()
    for k in range(arms.size):
        u, v = speeds[:, 2 * k], speeds[:, 2 * k + 1]
        a, b, c, d = arms.line[k]
        low, span = a + b * u, c - a + (d - b) * u
        s = np.divide(v - low, span, out=np.zeros_like(u), where=span > 0)

        def powers(orders: tuple[int, int], u: Array = u, s: Array = s) -> Array:
            p, q = (range(order + 1) for order in orders)
            return np.stack([u**i * s**j for i in p for j in q], axis=1)

        left -= powers((arms.order_u, arms.order_s)) @ arms.surface[k].T @ arms.gain[k]
        total += powers((arms.power_u, arms.power_s)) @ arms.power[k]
    return np.asarray(total + np.maximum(np.abs(left) - RESOLVED, 0.0) @ arms.cap)


def reduced_speeds(about: BoardLaw, rows: Array, failed_slots: int) -> Array:
    """(rows, 2K) of the reduced mixer, clipped."""
    arms = about.arms
    found = np.sqrt(np.clip(rows @ arms.squares.T, 0.0, None))
    for k in range(arms.size):
        a, b, c, d = arms.line[k]
        u = np.clip(found[:, 2 * k], arms.lo[2 * k], arms.hi[2 * k])
        found[:, 2 * k], found[:, 2 * k + 1] = u, np.clip(found[:, 2 * k + 1], a + b * u, c + d * u)
    still = [failed_slots >> i & 1 for i in range(2 * arms.size)]
    return np.where(still, 0.0, found)


def compare(vehicle: Vehicle, program: Path, rows: int, seed: int = 1) -> list[dict[str, Any]]:
    """One finding a kind of demand, with all rotors and with DEAD one."""
    about, found = board_law(vehicle), []
    for kind, given in demands(rows, seed).items():
        for failed in ((), (DEAD,)):
            slots = sum(1 << int(about.units.slots[n - 1]) for n in failed)
            ours, (theirs, settled) = on_board(program, given, slots), in_python(vehicle, given, failed)
            both = ours.settled & settled
            off = np.abs(ours.speeds - theirs).max(axis=1)
            cost, other = merit(about, ours.speeds, given), merit(about, theirs, given)
            floor = merit(about, reduced_speeds(about, given, slots), given)
            found.append({
                "kind": kind, "dead": list(failed), "rows": rows, "settled": float(ours.settled.mean()),
                "worst": float(off[both].max()), "within": float((off[both] < 1e-4).mean()),
                # where it is another optimum than Python's: how many are worse
                "worse": int((both & (off > 1e-4) & (cost > other + 1e-3 * np.maximum(other, 1.0))).sum()),
                "worse_than_reduced": int((cost > floor + 1e-4 * np.maximum(floor, 1.0)).sum()),
                "passes": [float(v) for v in np.percentile(ours.passes, [50, 99, 100])],
                "micros": [float(v) for v in np.percentile(ours.micros, [50, 99, 100])],
            })  # fmt: skip
    return found
