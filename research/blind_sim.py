"""Hidden runs on the virtual stand of `sim`, from a truth file, sized in shares of thrust."""

from __future__ import annotations

import tempfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.physics.rotors import read_pair
from sim.stand import effects as bench
from sim.stand import laws as bench_laws

Array = NDArray[np.float64]
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
# name: size in the stand's own unit at 1 % and at 10 % of thrust, pattern, sweeps, drives
ALL: dict[str, tuple[float, float, tuple[str, ...], int, tuple[str, ...]]] = {
    "battery_voltage": (0.1, 0.9, ("ramps", "grid"), 4, ("throttle", "rpm")),
    "air_density": (1.0, 1.0, ("grid", "ramps"), 4, ("rpm", "throttle")),
    "sensor_drift": (0.08, 0.8, ("grid",), 2, ("rpm", "throttle")),
    "lower_on_upper_interference": (0.7, 7.0, ("grid", "ramps"), 1, ("rpm",)),
    "blade_speed_law": (0.015, 0.15, ("grid", "ramps"), 1, ("rpm",)),
    "hysteresis": (0.015, 0.15, ("ramps",), 1, ("rpm",)),
    "rotor_lag": (0.05, 0.4, ("ramps",), 1, ("throttle", "rpm")),
    "rotor_spacing": (0.06, 0.6, ("grid", "ramps"), 4, ("rpm",)),
    "motor_heating": (0.015, 0.15, ("ramps",), 4, ("throttle", "rpm")),
    "dead_band": (0.02, 0.1, ("ramps", "grid"), 1, ("throttle", "rpm")),
    "strange": (0.7, 6.0, ("ramps",), 1, ("rpm",)),
    "lying_tachometer": (0.03, 0.12, ("grid", "ramps"), 1, ("rpm",)),
}
DOUBLES = (
    ("air_density", "sensor_drift"),
    ("rotor_spacing", "air_density"),
    ("sensor_drift", "lower_on_upper_interference"),
    ("blade_speed_law", "rotor_spacing"),
    ("hysteresis", "lower_on_upper_interference"),
)
TORQUE_SHARE = 0.022


@dataclass(frozen=True)
class Made:
    """A run: the columns a guest sees, the model it is given, and what is true."""

    columns: dict[str, Array]
    rotor: str | None
    truth: dict[str, object]


def laws_of(name: str) -> tuple[str, ...]:
    """Laws that the stand knows beside its first one."""
    return tuple(bench_laws.LAWS.get(name, ()))[1:]


def has_law(hidden: tuple[str, ...]) -> bool:
    """Whether any of these has another law."""
    return any(laws_of(n) for n in hidden)


def make(hidden: tuple[str, ...], seed: int, worth: float, family: str) -> Made:
    """One run of the virtual stand."""
    random = np.random.default_rng([seed, zlib.crc32("+".join((family, *hidden)).encode()), 0x57A])
    patterns = [p for p in ALL[hidden[0]][2] if all(p in ALL[n][2] for n in hidden)] or [ALL[hidden[0]][2][0]]
    drives = [d for d in ALL[hidden[0]][4] if all(d in ALL[n][4] for n in hidden)] or ["rpm"]
    lines = [
        "[stand]", f'pattern = "{random.choice(patterns)}"', f'drive = "{random.choice(drives)}"',
        f"sweeps = {max(ALL[n][3] for n in hidden)}",
    ]  # fmt: skip
    for name in hidden:
        low, high = ALL[name][:2]
        size = low + (high - low) * (worth - 0.01) / 0.09
        channel = bench.CHANNELS[int(random.integers(4))]
        if name in ("sensor_drift", "strange") and channel.endswith("torque"):
            size *= TORQUE_SHARE
        lines += ["[[effects]]", f'name = "{name}"', f"size = {size:.6g}", f'channel = "{channel}"']
        laws = laws_of(name)
        if family == "law" and laws:
            lines.append(f'law = "{laws[int(random.integers(len(laws)))]}"')
    text = "\n".join(lines) + "\n"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "truth.toml"
        path.write_text(text)
        bench_file = bench.read_bench(path)
    columns = bench.measure(read_pair(EXAMPLES / "rotor_paper.toml"), bench_file, seed=seed)
    return Made(columns, "rotor_paper.toml", {"worth": worth, "told": text})
