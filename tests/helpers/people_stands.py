"""Files of stands as people have them: Tyto and RCbenchmark of every model, home-made rigs, makers' sheets.

Headings after the makers' manuals and public examples; every number is our own pair's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from stand_files import SIDES, UNITS, Array, G, Pair, grid, readings, table, write

PAIR = Pair(0.38, 0.09, 0.65, 6500.0)
U, V = grid()
SEEN = readings(PAIR, U, V, 7, noise=0.004)
ALONE_U = np.linspace(0.25, 1, 30)
ALONE = readings(PAIR, ALONE_U, 0 * ALONE_U, 3, noise=0.004)
Columns = dict[str, Array | list[str]]


def us(side: str, of: dict[str, Array] = SEEN) -> Array:
    return 1000 + 1000 * of[f"{side}_throttle"]


def watts(side: str, of: dict[str, Array] = SEEN) -> Array:
    return of[f"{side}_voltage"] * of[f"{side}_current"]


def total(quantity: str, of: dict[str, Array] = SEEN) -> Array:
    """What one cell reads: thrusts added, torques against one another."""
    a, b = of[f"upper_{quantity}"], of[f"lower_{quantity}"]
    return a + b if quantity == "thrust" else a - b


def tyto_1780(thrust: str = "kgf", torque: str = "N m", sums: bool = True) -> Columns:
    """Series 1780, log of the coaxial stand: A above."""
    torque_written = {"N m": "N·m", "ozf in": "ozf·in", "lbf in": "lbf·in"}[torque]
    out: Columns = {"Time (s)": 0.5 * np.arange(len(U))}
    for letter, side in zip("AB", SIDES, strict=True):
        out[f"ESC {letter} (µs)"] = us(side)
    for letter, side, sign in (("A", "upper", 1), ("B", "lower", -1)):
        out[f"Torque {letter} ({torque_written})"] = sign * SEEN[f"{side}_torque"] * UNITS["torque"][torque]
    for letter, side in zip("AB", SIDES, strict=True):
        out[f"Thrust {letter} ({thrust})"] = SEEN[f"{side}_thrust"] * UNITS["thrust"][thrust]
    for letter, side in zip("AB", SIDES, strict=True):
        out |= {
            f"Voltage {letter} (V)": SEEN[f"{side}_voltage"],
            f"Current {letter} (A)": SEEN[f"{side}_current"],
            f"Motor Electrical Speed {letter} (RPM)": 0 * U,
            f"Motor Optical Speed {letter} (RPM)": SEEN[f"{side}_speed"],
            f"Electrical Power {letter} (W)": watts(side),
        }
    if sums:
        out[f"Thrust A + B ({thrust})"] = total("thrust") * UNITS["thrust"][thrust]
        out["Electrical Power A + B (W)"] = watts("upper") + watts("lower")
        out["Propeller Efficiency A + B (kgf/W)"] = 0.01 + 0 * U
    out["App message"] = ["", "ramp, step 1"] + [""] * (len(U) - 2)
    return out


def only_sum_and_a() -> Columns:
    """The same without the lower cell's own column."""
    return {k: x for k, x in tyto_1780().items() if k != "Thrust B (kgf)"}


def rcbenchmark_1520() -> Columns:
    """Thrust alone, no torque: one rotor."""
    return {
        "Time (s)": np.arange(30.0),
        "ESC signal (µs)": us("upper", ALONE),
        "Thrust (kgf)": ALONE["upper_thrust"] / G,
        "Voltage (V)": ALONE["upper_voltage"],
        "Current (A)": ALONE["upper_current"],
        "Motor Electrical Speed (RPM)": ALONE["upper_speed"],
        "Electrical Power (W)": watts("upper", ALONE),
        "Overall Efficiency (kgf/W)": 0.01 + 0 * ALONE_U,
    }


def rcbenchmark_1580(torque: str, written: str) -> Columns:
    out = {"Time (s)": np.arange(30.0), "ESC signal (µs)": us("upper", ALONE)}
    out |= {f"Servo {i} (µs)": [""] * 30 for i in (1, 2, 3)}
    out |= {
        "AccX (g)": 0 * ALONE_U, "AccY (g)": 0 * ALONE_U, "AccZ (g)": 1 + 0 * ALONE_U,
        f"Torque ({written})": ALONE["upper_torque"] * FACTORS[torque],
        "Thrust (kgf)": -ALONE["upper_thrust"] / G,
        "Voltage (V)": ALONE["upper_voltage"], "Current (A)": ALONE["upper_current"],
        "Motor Electrical Speed (rpm)": 0 * ALONE_U, "Motor Optical Speed (rpm)": ALONE["upper_speed"],
        "Electrical Power (W)": watts("upper", ALONE),
        "Mechanical Power (W)": ALONE["upper_torque"] * ALONE["upper_speed"] * np.pi / 30,
        "Motor Efficiency (%)": 78 + 0 * ALONE_U, "Vibration (g)": 0.2 + 0 * ALONE_U,
        "App message": [""] * 30,
    }  # fmt: skip
    return out


FACTORS = UNITS["torque"] | {"gf cm": 1e5 / G, "kgf m": 1 / G, "lbf ft": 8.8507458 / 12}


def both(form: str, rows: dict[str, tuple[str, float]], names: tuple[str, str] = SIDES) -> Columns:
    """Headings of both rotors by a form with {name} and {what}; rows: what: (quantity, factor)."""
    return {
        form.format(name=name, what=what): SEEN[f"{side}_{quantity}"] * factor
        for name, side in zip(names, SIDES, strict=True)
        for what, (quantity, factor) in rows.items()
    }


def home(torque: str, written: str) -> Columns:
    """A home-made rig whose torque is in some unit, written in some way."""
    rows = {"rpm": ("speed", 1.0), "thrust [g]": ("thrust", 1000 / G)}
    return both(
        "{name} {what}", rows | {f"torque [{written}]": ("torque", FACTORS[torque])}, ("top", "bottom")
    )


def one_cell(thrust: str = "Thrust (N)", torque: str = "Torque (N·m)", factor: float = 1.0) -> Columns:
    return {
        "Time (ms)": 250.0 * np.arange(len(U)),
        "Top Motor Speed (rpm)": SEEN["upper_speed"],
        "Bottom Motor Speed (rpm)": SEEN["lower_speed"],
        "Battery Voltage (V)": SEEN["upper_voltage"],
        thrust: total("thrust") * factor,
        torque: total("torque"),
    }


def one_cell_alone_too() -> Columns:
    """The same with rows in which the upper rotor turns alone."""
    first = one_cell()
    more = {
        "Time (ms)": 250.0 * (len(U) + np.arange(30.0)),
        "Top Motor Speed (rpm)": ALONE["upper_speed"],
        "Bottom Motor Speed (rpm)": 0 * ALONE_U,
        "Battery Voltage (V)": ALONE["upper_voltage"],
        "Thrust (N)": ALONE["upper_thrust"],
        "Torque (N·m)": ALONE["upper_torque"],
    }
    return {k: np.concatenate([np.asarray(first[k]), more[k]]) for k in first}


def power_only() -> Columns:
    rows = {"RPM": ("speed", 1.0), "Thrust (g)": ("thrust", 1000 / G), "Current (A)": ("current", 1.0),
            "Voltage (V)": ("voltage", 1.0)}  # fmt: skip
    return both("{name} {what}", rows)


def signal(percent: bool) -> Columns:
    rows = {"Thrust (N)": ("thrust", 1.0), "Torque (Nm)": ("torque", 1.0), "RPM": ("speed", 1.0)}
    out = both("{name} {what}", rows)
    for side in SIDES:
        out[f"{side} ESC signal ({'%' if percent else 'us'})"] = (
            100 * SEEN[f"{side}_throttle"] if percent else us(side)
        )
    return out


def words() -> Columns:
    out = signal(False)
    n = len(U)
    return {"Test": ["run 3"] * n, **out, "Propeller": ["15x5 CF"] * n, "Remarks": [""] * (n - 1) + ["gust?"]}


PROSE = """Coaxial test, July
Operator: A. Student; stand 2, room at 21,5 C
Propellers 15 x 5 in, distance 0.15 m. Cells were tared before each run.

"""


def sheet(kind: str) -> Columns:
    """A maker's table of one rotor, eight rows."""
    share = np.linspace(0.3, 1, 8)
    alone = readings(PAIR, share, 0 * share, 2, noise=0.003)
    volts, amps, rpm = alone["upper_voltage"], alone["upper_current"], np.round(alone["upper_speed"])
    grams, power = np.round(1000 / G * alone["upper_thrust"]), watts("upper", alone)
    percent = [f"{v:.0f}%" for v in 100 * alone["upper_throttle"]]
    first = ["MN501 KV300"] + [""] * 7
    if kind == "T-Motor":
        return {
            "Item No.": first, "Voltage (V)": volts, "Prop": ["15*5CF"] + [""] * 7, "Throttle": percent,
            "Current (A)": amps, "Power (W)": power, "Thrust (G)": grams, "RPM": rpm,
            "Efficiency (G/W)": grams / power, "Operating Temperature (°C)": ["55"] + [""] * 7,
        }  # fmt: skip
    if kind == "T-Motor with torque":
        return {
            "Type": first, "Propeller": ["15*5CF"] + [""] * 7, "Throttle": percent, "Thrust (g)": grams,
            "Torque (N*m)": alone["upper_torque"], "Voltage (V)": volts, "Current (A)": amps, "RPM": rpm,
            "Power (W)": power, "Efficiency (g/W)": grams / power,
        }  # fmt: skip
    if kind == "KDE":
        return {
            "Throttle (%)": 100 * alone["upper_throttle"], "Motor Speed (RPM)": rpm,
            "Amperage (A)": amps, "Power Input (W)": power, "Thrust Output (g)": grams,
            "Thrust Output (N)": alone["upper_thrust"], "Thrust Output (oz)": grams / 28.349523,
            "Efficiency (g/W)": grams / power,
        }  # fmt: skip
    if kind == "MAD":
        return {
            "Propeller": ["15x5"] * 8, "Voltage(V)": volts, "Throttle(%)": percent, "Thrust(gf)": grams,
            "Torque(N.m)": alone["upper_torque"], "Current(A)": amps, "RPM": rpm, "Power(W)": power,
            "Efficiency(gf/W)": grams / power, "Motor temp.(℃)": [""] * 7 + ["61"],
        }  # fmt: skip
    return {  # Chinese makers' usual form
        "Voltage(V)": volts, "Prop": ["1505"] * 8, "Amps(A)": amps, "Pull(g)": grams, "Watts(W)": power,
        "RPM": rpm, "Efficiency(g/W)": grams / power,
    }  # fmt: skip


def file(
    folder: Path,
    columns: Columns,
    mark: str = ",",
    comma: bool = False,
    before: str = "",
    name: str = "log.csv",
) -> Path:
    """The columns as a file, under some lines of prose."""
    return write(folder / name, before + table(columns, mark, comma))
