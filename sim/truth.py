"""What is true of this world and written nowhere the guest reads: effects, their sizes, when they set in.

A truth file holds [[effects]] with `name`, `size` and optionally `onset_s`, `law` and the keys an effect
knows (`effects.FORMS`).
A hidden world draws one effect from its seed, worth 3 to 10 % of thrust where the demo flies.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sim.documents import read_document, read_number, refuse_unknown
from sim.effects import FORMS, HiddenEffect
from sim.errors import SimulationError
from sim.physics.wind import GUSTS, W_LAW, W_ON, W_SIZE, blow, rise

if TYPE_CHECKING:
    from sim.physics.plant import Plant


GUST_SEED = 0x6057
HIDDEN = ("battery_voltage", "rotor_drag", "degraded_rotor", "cg_offset", "ground_effect", "axial_inflow")


class Truth:
    """The effects of one world, applied to its plant as their time comes."""

    def __init__(self, effects: tuple[HiddenEffect, ...] = (), gust_seed: int = GUST_SEED) -> None:
        self.effects = effects
        self._gusts, self._random = gusts_of(effects), np.random.default_rng(gust_seed)
        self._blown_s = 0.0
        self._waiting = sorted(effects, key=lambda e: e.onset_s)
        self._strange = [e for e in effects if e.name == "strange"]

    def act(self, plant: Plant) -> None:
        """Switch on what has come due; a battery is swapped on the ground."""
        due = [e for e in self._waiting if e.onset_s <= plant.time_s + 1e-9] if self._waiting else []
        for effect in due:
            if effect.name == "battery_swap" and not plant.resting:
                continue
            self._waiting.remove(effect)
            FORMS[effect.name].apply(plant, effect)
            if effect.name == "wind":
                rise(self._gusts, plant.parameters)
                self._blown_s = plant.time_s
        if self._gusts[W_ON]:
            since, self._blown_s = plant.time_s - self._blown_s, plant.time_s
            blow(self._gusts, plant.parameters, plant.height, since, self._random.standard_normal(3))
        if self._strange:
            plant.parameters[plant.index.PUSH + 2] = sum(_push(e, plant.time_s) for e in self._strange)


def _push(e: HiddenEffect, t: float) -> float:
    """N downwards: pulses of uneven length, tied to nothing."""
    since = t - e.onset_s
    return e.size * (math.sin(2.3 * since) * math.sin(0.37 * since) > 0.2) if since >= 0.0 else 0.0


def gusts_of(effects: tuple[HiddenEffect, ...]) -> NDArray[np.float64]:
    """(GUSTS,) the gusts that these effects ask for, still off."""
    wind = next((e for e in effects if e.name == "wind"), HiddenEffect("wind", 0.0))
    size = sum(e.extra.get("gust_m_s", 0.0) for e in effects)
    if wind.law == "dryden" and "gust_m_s" not in wind.extra:
        size += abs(wind.size) / 4.0
    w = np.zeros(GUSTS)
    w[W_SIZE], w[W_LAW] = size, {"dryden": 1.0, "shear": 2.0}.get(wind.law, 0.0)
    return w


def read_truth(path: Path) -> Truth:
    """Read a truth file. Raises WorldError naming the key."""
    effects = []
    document = read_document(path)
    refuse_unknown(path, "", document, ("effects", "stand"))
    tables = document.get("effects", [])
    if not isinstance(tables, list):
        raise SimulationError(path, "effects", "an array of tables [[effects]] is expected")
    for number, table in enumerate(tables, 1):
        where = f"effects[{number}]"
        form = FORMS.get(str(table.get("name"))) if isinstance(table, dict) else None
        if form is None:
            raise SimulationError(path, f"{where}.name", f"one of {', '.join(FORMS)} is expected")
        refuse_unknown(path, where, table, ("name", "size", "onset_s", "law", *form.extra))
        extra = {key: read_number(path, f"{where}.{key}", table[key]) for key in table if key in form.extra}
        size = read_number(path, f"{where}.size", table.get("size"))
        onset = read_number(path, f"{where}.onset_s", table.get("onset_s", 0.0))
        law = table.get("law", "")
        if law and law not in form.laws:
            raise SimulationError(path, f"{where}.law", f"one of {', '.join(form.laws)} is expected")
        effects.append(HiddenEffect(table["name"], size, onset, extra, law))
    return Truth(tuple(effects))


def hidden_truth(seed: int, rotors: int) -> Truth:
    """One effect drawn from the seed, worth 3 to 10 % of thrust."""
    random = np.random.default_rng([seed, 0xC0A1])
    name = HIDDEN[int(random.integers(len(HIDDEN)))]
    worth = float(random.uniform(0.03, 0.10))
    extra: dict[str, float] = {}
    if name == "battery_voltage":
        size = worth / 0.18  # a loaded pack sits about 9 % under its reference, thrust goes as speed squared
    elif name == "rotor_drag":
        size = 22.0 * worth  # at 2 m/s, eight rotors at 0.55, 196 N
    elif name == "axial_inflow":
        size = worth / 0.02  # climbing at 1.5 m/s, tips at 73 m/s
    elif name == "ground_effect":
        size = worth / 0.39  # hovering with the discs 0.75 m up
    elif name == "degraded_rotor":
        size = min(worth * rotors, 0.6)  # of one rotor's share; with less left it could not hold attitude
        extra["rotor"] = float(random.integers(1, rotors + 1))
    else:
        size = 0.18 * worth  # of the arm
        extra["direction_deg"] = float(random.uniform(0.0, 360.0))
    return Truth((HiddenEffect(name, round(size, 5), 0.0, extra),))


def truth_text(truth: Truth) -> str:
    """The truth as a truth file, for a judge."""
    blocks = []
    for e in truth.effects:
        lines = ["[[effects]]", f'name = "{e.name}"', f"size = {e.size!r}", f"onset_s = {e.onset_s!r}"]
        lines += [f'law = "{e.law}"'] if e.law else []
        blocks.append("\n".join(lines + [f"{key} = {value!r}" for key, value in e.extra.items()]))
    return "\n\n".join(blocks) + "\n"
