"""Whether a log's numbers can be a propeller's in the units they are taken in.

Nothing is changed here: a log that no propeller gives is refused, with what to look at (`stand_questions`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from coaxlink.data.aliases import LOADS_AND_SPEED, PAIR, QUANTITIES, SIDES, Unit
from coaxlink.data.cleaning import drive_of, own_sign
from coaxlink.data.headings import Heading
from coaxlink.data.propeller import Reading, diameters, possible, readings_of
from coaxlink.data.samples import FEWEST_ROWS, Samples
from coaxlink.data.stand_questions import USUAL_POLES, factors, questions
from coaxlink.errors import InputError

SHAFT = "shaft_power_W"  # a rotor's column that serves to check units and is no part of a log
WORSE = 2.0  # times the squares left over
BOTH = 0.2  # of what goes with its own speed: half of the least that a lower rotor in a wake gives
UNEXPLAINED = 0.5  # of a load's squares by its own rotor's speed
POLES = (12, 14, 20, 24, 28, 36, 40)  # magnets of motors that carry propellers
# what a heading is likeliest to mean when it does not mean SI
_COMMON = {"thrust": ("gf", "kgf", "lbf", "ozf"), "torque": ("N cm", "kgf cm", "lbf in", "ozf in", "lbf ft")}


class UnitsUnclear(InputError):
    """Readings that no propeller gives; `scales` of our columns would mend it, `upper` is the upper label."""

    def __init__(self, samples: Samples, where: str, problem: str, scales: Mapping[str, float]) -> None:
        self.scales, self.upper = scales, samples.upper_label
        super().__init__(samples.source, where, problem)


def readings(samples: Samples) -> dict[str, Reading]:
    """Each driven rotor at high speed, the other one as slow as the rows have it."""
    columns = {}
    for side in SIDES:
        names = {q: f"{side}_{about.suffix}" for q, about in QUANTITIES.items()}
        own = {q: samples[name] for q, name in names.items() if samples.has(name)}
        if "voltage" not in own and samples.has("voltage_V"):
            own["voltage"] = samples["voltage_V"]
        if "thrust" in own or "torque" in own:
            columns[side] = own
    shafts = {side: samples[n] for side in SIDES if samples.has(n := f"{side}_{SHAFT}")}
    found = readings_of(columns, shafts)
    return {side: r for side, r in found.items() if r.thrust_N is not None or r.torque_Nm is not None}


def sizes(samples: Samples, diameter_m: float | None = None) -> str:
    """In words: which propellers give these readings."""
    ranges = _ranges(readings(samples), diameter_m)
    return f"units: these readings are those of propellers of {ranges} in diameter" if ranges else ""


def _ranges(found: Mapping[str, Reading], diameter_m: float | None) -> str:
    sizes = {side: diameters(r, diameter_m) for side, r in found.items()}
    return " and ".join(f"{s} {d[0]:.2f} to {d[1]:.2f} m" for s, d in sizes.items() if d is not None)


def check_signs(samples: Samples) -> None:
    """Raises InputError for a load that falls with its own rotor's speed, or follows the other's instead."""
    for side in SIDES:
        effort = drive_of(samples, side)
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


def refuse_sums(samples: Samples) -> None:
    """Raises InputError for a rotor's thrust that is both rotors' together."""
    for side in SIDES:
        effort, name = drive_of(samples, side), f"{side}_thrust_N"
        if effort is not None and samples.has(name) and _reads_both(samples, name, effort):
            raise InputError(
                samples.source,
                f"column {name}",
                "rises with the other rotor's speed as with its own: thrust of both rotors together? "
                f"identify takes it as {PAIR}_thrust_N",
            )


def _reads_both(samples: Samples, load: str, effort: str) -> bool:
    """Whether a thrust rises with the speed of the other rotor, whose own is not there: no wake lifts."""
    side, _, what = effort.partition("_")
    other = "lower" if side == "upper" else "upper"
    speeds = effort, f"{other}_{what}"
    if samples.has(f"{other}_thrust_N") or not samples.has(*speeds) or samples.rows < 12:
        return False
    X = np.stack(
        [np.ones(samples.rows), *((samples[n] / max(samples[n].max(), 1e-300)) ** 2 for n in speeds)], 1
    )
    _, own, beside = np.linalg.lstsq(X, samples[load], rcond=None)[0]
    return bool(np.linalg.matrix_rank(X) == 3 and own > 0 and beside > BOTH * own)


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
    return left[0] > UNEXPLAINED * total and left[0] > WORSE * left[1]


def check_units(
    samples: Samples,
    headings: Mapping[str, Heading],
    diameter_m: float | None = None,
    stated: frozenset[str] = frozenset(),
) -> None:
    """Raises InputError when no pair of propellers gives these readings, with what to look at first.

    `headings`: by names of ours what a column came from, where it is not our own; `stated`: names of ours
    whose unit somebody stated, which are not suspected.
    """
    found = readings(samples)
    if samples.rows < FEWEST_ROWS or not found or possible(found, diameter_m):
        return
    suspects = [
        n for s in found for q in LOADS_AND_SPEED if samples.has(n := _name(s, q)) and n not in stated
    ]
    if not suspects:
        return
    asked = next(questions(samples, found, diameter_m, stated), None)
    shown = _shown(found, diameter_m)
    name = suspects[0] if asked is None else asked.column
    text = headings[name].text if name in headings else name
    if asked is not None:
        ask = asked.text
    elif fits := ", or ".join(factors(found, diameter_m)):
        ask = f"is one scaled otherwise than its heading says? A propeller's would be {fits}"
    else:
        ask = "no single quantity times any number is a propeller's: are these columns of one rotor?"
    problem = f"{shown}; {ask} (`trust_units` takes them as they stand)"
    raise UnitsUnclear(samples, f"column {text!r}", problem, asked.scales if asked else {})


def _name(side: str, quantity: str) -> str:
    return f"{side}_{QUANTITIES[quantity].suffix}"


def _listed(words: Sequence[str]) -> str:
    *most, last = dict.fromkeys(words)
    return f"{', '.join(most)} or {last}" if most else last


def electrical_turns(samples: Samples, diameter_m: float | None = None) -> str:
    """A line where speeds in electrical turns would be a propeller's as well, "" where they would not.

    Loggers write the turns of the field under "rpm"; with a measured power that is refused, without one
    nothing but the propeller's size tells.
    """
    found = readings(samples)
    if not found or not all(r.rpm for r in found.values()) or not possible(found, diameter_m):
        return ""
    for poles in POLES:
        turned = {side: r.scaled(speed=2.0 / poles) for side, r in found.items()}
        if possible(turned, diameter_m):
            return (
                "the speeds may be electrical turns (ERPM): with a motor of "
                f"{poles} poles these readings are propellers' as well, of {_ranges(turned, diameter_m)} in "
                "diameter; `diameter_m` M decides, a map states it (unit erpm, with `poles`)"
            )
    return ""


def other_units(samples: Samples, diameter_m: float | None = None) -> str:
    """In words: the units in which a log without speeds would be propellers' as well, "" where none would."""
    found = readings(samples)
    if not found or any(r.rpm for r in found.values()) or not possible(found, diameter_m):
        return ""
    fitting = []
    for quantity, common in _COMMON.items():
        units = [
            word
            for word, factor in _other_units(quantity, None)
            if word in common
            and possible({s: r.scaled(**{quantity: factor}) for s, r in found.items()}, diameter_m)
        ]
        if units:
            fitting.append(f"{quantity} in {_listed(units)}")
    return ", or with ".join(fitting)


def _shown(found: Mapping[str, Reading], diameter_m: float | None) -> str:
    """Of the first rotor that no propeller is, or of the first where they are but no pair."""
    side, reading = next(
        ((s, r) for s, r in found.items() if diameters(r, diameter_m) is None), next(iter(found.items()))
    )
    values = {
        "N": reading.thrust_N,
        "N m": reading.torque_Nm,
        "rpm": reading.rpm,
        "W at the shaft": reading.shaft_W,
        "W": reading.power_W,
    }
    parts = [f"{value:.3g} {unit}" for unit, value in values.items() if value is not None]
    size = "" if diameter_m is None else f" of {diameter_m:g} m"
    fault = reading.shaft_fault()
    why = f": torque times speed is {100 * fault[0]:.3g} % of the {fault[1]} power" if fault else ""
    return f"no propeller{size} reads {', '.join(parts)} together ({side} rotor){why}"


def _other_units(quantity: str, taken: Unit | None) -> Iterator[tuple[str, float]]:
    """Other units, and what a reading would be multiplied by."""
    units = {u.name: u for u in QUANTITIES[quantity].units.values()}
    now = taken.scale if taken is not None and not taken.electrical else 1.0
    # electrical turns ahead of deg/s, which is nearly the same number and written by nobody
    for name, unit in sorted(units.items(), key=lambda u: not u[1].electrical):
        if unit.electrical:
            yield name, 2.0 / USUAL_POLES / now
        elif abs(unit.scale / now - 1) > 0.01:
            yield name, unit.scale / now
