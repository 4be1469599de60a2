"""Whether a log's numbers can be a propeller's in the units they are taken in; if not, in which they could.

Nothing is changed here: a log that no propeller gives is refused, with the line that states the right unit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from coaxlink.constants import RAD_S_PER_RPM
from coaxlink.data.cleaning import own_sign
from coaxlink.data.columns_map import line_for
from coaxlink.data.rotors import NAMES, readings_of
from coaxlink.data.samples import Samples
from coaxlink.data.sense import MOTOR_EFFICIENCY, SHAFT_SENSOR, Reading, diameters, possible
from coaxlink.data.units import QUANTITIES, Unit
from coaxlink.errors import InputError

FEWEST = 6  # rows: with fewer nothing is identified anyway
FOLLOWS = 2.0  # times the squares left over
UNEXPLAINED = 0.5  # of a load's squares by its own rotor's speed
SIDES = ("upper", "lower")
POLES = (12, 14, 20, 24, 28, 36, 40)  # magnets of motors that carry propellers
# what a heading is likeliest to mean when it does not mean SI
_COMMON = {"thrust": ("gf", "kgf", "lbf", "ozf"), "torque": ("N cm", "kgf cm", "lbf in", "ozf in", "lbf ft")}
SUFFIXES = {"thrust": "thrust_N", "torque": "torque_Nm", "speed": "rpm"}


@dataclass(frozen=True)
class Origin:
    """Where a column of ours came from."""

    heading: str
    unit: Unit | None


def readings(samples: Samples) -> dict[str, Reading]:
    """Each driven rotor at high speed, the other one as slow as the rows have it."""
    columns = {}
    for side in SIDES:
        names = {q: f"{side}_{suffix}" for q, (suffix, _) in QUANTITIES.items()}
        own = {q: samples[name] for q, name in names.items() if samples.has(name)}
        if "voltage" not in own and samples.has("voltage_V"):
            own["voltage"] = samples["voltage_V"]
        if "thrust" in own or "torque" in own:
            columns[side] = own
    shafts = [samples[n] if samples.has(n := f"{s}_shaft_power_W") else None for s in columns]
    found = dict(zip(columns, readings_of(list(columns.values()), shafts), strict=True))
    return {side: r for side, r in found.items() if r.thrust_N is not None or r.torque_Nm is not None}


def sizes(samples: Samples, diameter_m: float | None = None) -> str:
    """In words: which propellers give these readings."""
    found = {side: diameters(r, diameter_m) for side, r in readings(samples).items()}
    ranges = [f"{side} {d[0]:.2f} to {d[1]:.2f} m" for side, d in found.items() if d is not None]
    if not ranges:
        return ""
    return f"units: these readings are those of propellers of {' and '.join(ranges)} in diameter"


def check_signs(samples: Samples) -> None:
    """Raises InputError for a load that falls with its own rotor's speed, or follows the other's instead."""
    for side in SIDES:
        effort = next((f"{side}_{w}" for w in ("rpm", "throttle") if samples.has(f"{side}_{w}")), None)
        for name in (f"{side}_thrust_N", f"{side}_torque_Nm"):
            if effort is None or not samples.has(name) or not np.any(samples[effort] > 0):
                continue
            if _follows_other(samples, name, effort):
                raise InputError(
                    samples.source,
                    f"column {name}",
                    f"goes with the other rotor's speed, not with {effort}: the columns look exchanged; "
                    "name the right ones in a map (`columns`)",
                )
            if own_sign(samples, name, effort) < 0:
                raise InputError(
                    samples.source,
                    f"column {name}",
                    "falls as its rotor speeds up: the sign is turned, or it is another column's; "
                    f'a map turns it: {name} = {{ column = "{name}", scale = -1 }}',
                )


def _follows_other(samples: Samples, load: str, effort: str) -> bool:
    """Whether the other rotor's speed alone explains a load far better than its own does."""
    side, _, what = effort.partition("_")
    other = f"{'lower' if side == 'upper' else 'upper'}_{what}"
    if not samples.has(other) or samples.rows < 12 or not np.any(samples[other] > 0):
        return False
    left = []
    for speed in (samples[effort], samples[other]):
        u = speed / max(float(speed.max()), 1e-300)
        X = np.stack([np.ones_like(u), u, u**2], axis=1)
        y = samples[load]
        left.append(float(np.sum((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) ** 2)))
    total = float(np.sum((samples[load] - samples[load].mean()) ** 2))
    return left[0] > UNEXPLAINED * total and left[0] > FOLLOWS * left[1]


def check_units(
    samples: Samples,
    origins: Mapping[str, Origin],
    diameter_m: float | None = None,
    stated: frozenset[str] = frozenset(),
) -> None:
    """Raises InputError when no pair of propellers gives these readings, naming the column and what to write.

    `origins`: heading and unit of our columns where they are not our own; `stated`: names of ours whose unit
    somebody stated, which are not suspected.
    """
    found = readings(samples)
    if samples.rows < FEWEST or not found or possible(found, diameter_m):
        return
    suspects = [n for s in found for q, n in _names(s) if samples.has(n) and n not in stated]
    if not suspects:
        return
    better = [b for b in _better(found, origins, diameter_m) if b[0] not in stated]
    side, reading = next(
        ((s, r) for s, r in found.items() if diameters(r, diameter_m) is None), next(iter(found.items()))
    )
    shown = _shown(side, reading, diameter_m)
    if not better:
        name = suspects[0]
        heading = origins[name].heading if name in origins else name
        raise InputError(
            samples.source,
            f"column {heading!r}",
            f"{shown}; no single unit mends it: state the units in a map (`columns`), as in "
            f"{line_for(name, heading, _unit(name, origins))}, or `trust_units`",
        )
    name, unit, _ = better[0]
    heading = origins[name].heading if name in origins else name
    by_quantity: dict[str, list[str]] = {}
    for _, other, what in better:
        by_quantity.setdefault(what, []).append("electrical turns (`poles`)" if other == "erpm" else other)
    first, *more = (f"{what} in {_listed(units)}" for what, units in by_quantity.items())
    raise InputError(
        samples.source,
        f"column {heading!r}",
        f"{shown}; {first} would be"
        + (f", or {', or '.join(more)}" if more else "")
        + f": state it in a map (`columns`), {line_for(name, heading, unit)}, or `trust_units`",
    )


def _listed(words: Sequence[str]) -> str:
    *most, last = dict.fromkeys(words)
    return f"{', '.join(most)} or {last}" if most else last


def electrical_turns(samples: Samples, diameter_m: float | None = None) -> str:
    """A line where speeds in electrical turns would be a propeller's as well, "" where they would not.

    Loggers write the turns of the field under "rpm"; with a measured power that is refused, without one
    nothing but the propeller's size tells.
    """
    found = readings(samples)
    speeds = [r.rpm for r in found.values()]
    if not found or not all(speeds) or not possible(found, diameter_m):
        return ""
    for poles in POLES:
        turned = {side: r.scaled(rpm=2.0 / poles) for side, r in found.items()}
        if possible(turned, diameter_m):
            size = {side: diameters(r, diameter_m) for side, r in turned.items()}
            shown = " and ".join(f"{s} {d[0]:.2f} to {d[1]:.2f} m" for s, d in size.items() if d is not None)
            return (
                "the speeds may be electrical turns (ERPM): with a motor of "
                f"{poles} poles these readings are propellers' as well, of {shown} in diameter; "
                "`diameter_m` M decides, a map states it (unit erpm, with `poles`)"
            )
    return ""


def other_units(samples: Samples, diameter_m: float | None = None) -> str:
    """In words: the units in which a log without speeds would be propellers' as well, "" where none would."""
    found = readings(samples)
    if not found or any(r.rpm for r in found.values()) or not possible(found, diameter_m):
        return ""
    fitting = []
    for quantity in ("thrust", "torque"):
        units = []
        for word, factor in _others(quantity, None):
            scaled = {s: r.scaled(**{NAMES[quantity]: factor}) for s, r in found.items()}
            if word in _COMMON[quantity] and possible(scaled, diameter_m):
                units.append(word)
        if units:
            fitting.append(f"{quantity} in {_listed(units)}")
    return ", or with ".join(fitting)


def _unit(name: str, origins: Mapping[str, Origin]) -> str:
    unit = origins[name].unit if name in origins else None
    return unit.name if unit else {"N": "N", "Nm": "N m"}.get(name.rpartition("_")[2], "rpm")


def _names(side: str) -> list[tuple[str, str]]:
    return [(q, f"{side}_{suffix}") for q, suffix in SUFFIXES.items()]


def _shown(side: str, reading: Reading, diameter_m: float | None) -> str:
    parts = [
        f"{value:.3g} {unit}"
        for value, unit in (
            (reading.thrust_N, "N"),
            (reading.torque_Nm, "N m"),
            (reading.rpm, "rpm"),
            (reading.shaft_W, "W at the shaft"),
            (reading.power_W, "W"),
        )
        if value is not None
    ]
    size = "" if diameter_m is None else f" of {diameter_m:g} m"
    why = ""
    if reading.rpm and reading.torque_Nm:
        shaft = abs(reading.torque_Nm) * reading.rpm * RAD_S_PER_RPM
        if reading.shaft_W and not SHAFT_SENSOR[0] <= shaft / reading.shaft_W <= SHAFT_SENSOR[1]:
            why = f": torque times speed is {100 * shaft / reading.shaft_W:.3g} % of the mechanical power"
        elif reading.power_W and not MOTOR_EFFICIENCY[0] <= shaft / reading.power_W <= MOTOR_EFFICIENCY[1]:
            why = f": torque times speed is {100 * shaft / reading.power_W:.3g} % of the electrical power"
    return f"no propeller{size} reads {', '.join(parts)} together ({side} rotor){why}"


def _better(
    found: Mapping[str, Reading], origins: Mapping[str, Origin], diameter_m: float | None
) -> Iterator[tuple[str, str, str]]:
    """(our name, unit, whose in words) of single columns, or one quantity of both rotors, that mend it."""
    for sides in (tuple(found), *((s,) for s in found if len(found) > 1)):
        for quantity, suffix in SUFFIXES.items():
            first = f"{sides[0]}_{suffix}"
            taken = origins[first].unit if first in origins else None
            for word, factor in _others(quantity, taken):
                scaled = {
                    s: r.scaled(**{NAMES[quantity]: factor}) if s in sides else r for s, r in found.items()
                }
                if possible(scaled, diameter_m):
                    whose = f"the {quantity}" + (
                        f" of the {sides[0]} rotor" if len(sides) < len(found) else ""
                    )
                    yield first, word, whose


def _others(quantity: str, taken: Unit | None) -> Iterator[tuple[str, float]]:
    """Other units, and what a reading would be multiplied by."""
    units = {u.name: u for u in QUANTITIES[quantity][1].values()}
    # ahead of deg/s, which is nearly the same number and written by nobody
    units = dict(sorted(units.items(), key=lambda u: not u[1].electrical))
    now = taken.scale if taken is not None and not taken.electrical else 1.0
    for name, unit in units.items():
        if unit.electrical:
            yield from ((name, 2.0 / poles / now) for poles in POLES[1:2])
        elif abs(unit.scale / now - 1) > 0.01:
            yield name, unit.scale / now
