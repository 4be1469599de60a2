"""What is true of this world and written nowhere the guest reads: effects, their sizes, when they set in.

A truth file holds [[effects]] with `name`, `size` and optionally `onset_s` and the keys an effect knows
(see FORMS).
A hidden world draws one effect from its seed, worth 3 to 10 % of thrust where the demo flies.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sim.errors import WorldError
from sim.rotors import read_document, read_number

if TYPE_CHECKING:
    from sim.plant import Plant


@dataclass(frozen=True)
class Effect:
    """One thing that is true: `size` in the unit its form names, further numbers in `extra`."""

    name: str
    size: float
    onset_s: float = 0.0
    extra: dict[str, float] = field(default_factory=dict)


def _battery(plant: Plant, e: Effect) -> None:
    plant.parameters[plant.index.VOLT_POWER] = e.size
    if "reference_V" in e.extra:
        plant.parameters[plant.index.VOLT_REF] = e.extra["reference_V"]


def _ground(plant: Plant, e: Effect) -> None:
    plant.parameters[plant.index.GROUND_GAIN] = e.size
    plant.parameters[plant.index.GROUND_SCALE] = e.extra.get("scale_m", 0.8)


def _drag(plant: Plant, e: Effect) -> None:
    plant.parameters[plant.index.DRAG] += e.size


def _inflow(plant: Plant, e: Effect) -> None:
    plant.parameters[plant.index.INFLOW] += e.size


def _degraded(plant: Plant, e: Effect) -> None:
    rotor = int(e.extra.get("rotor", 1)) - 1
    plant.geometry[plant.index.G_THRUST, rotor] *= 1.0 - e.size
    # a chipped blade loses less torque than thrust
    plant.geometry[plant.index.G_TORQUE, rotor] *= 1.0 - 0.6 * e.size


def _offset(plant: Plant, e: Effect) -> None:
    angle = math.radians(e.extra.get("direction_deg", 0.0))
    plant.parameters[plant.index.CX] = e.size * math.cos(angle)
    plant.parameters[plant.index.CY] = e.size * math.sin(angle)


def _mass(plant: Plant, e: Effect) -> None:
    plant.parameters[plant.index.MASS] += e.size


def _lag(plant: Plant, e: Effect) -> None:
    plant.parameters[plant.index.LAG] += e.size


def _wind(plant: Plant, e: Effect) -> None:
    angle = math.radians(e.extra.get("direction_deg", 0.0))
    wind = plant.index.WIND
    plant.parameters[wind : wind + 2] = e.size * math.cos(angle), e.size * math.sin(angle)
    plant.parameters[plant.index.BODY_DRAG] = e.extra.get("body_drag_kg_m", 0.12)


def _inertia(plant: Plant, e: Effect) -> None:
    plant.parameters[plant.index.ROTOR_INERTIA] = e.size


@dataclass(frozen=True)
class Form:
    """How an effect acts, what `size` means, which further keys it knows."""

    apply: Callable[[Plant, Effect], None]
    size: str
    extra: tuple[str, ...] = ()


FORMS = {
    "battery_voltage": Form(
        _battery, "power p of speed = command (V / reference_V)^p: unregulated ESCs", ("reference_V",)
    ),
    "ground_effect": Form(
        _ground, "thrust gain at height 0, falling as exp(-height / scale_m)", ("scale_m",)
    ),
    "rotor_drag": Form(_drag, "N s/m a rotor at full speed, in its plane"),
    "axial_inflow": Form(_inflow, "thrust lost per climb speed through the disc / blade tip speed"),
    "degraded_rotor": Form(_degraded, "share of thrust lost by one rotor", ("rotor",)),
    "cg_offset": Form(_offset, "m, towards direction_deg (0 forward, 90 right)", ("direction_deg",)),
    "mass_change": Form(_mass, "kg added"),
    "rotor_lag": Form(_lag, "s added to the time constant"),
    "wind": Form(
        _wind,
        "m/s towards direction_deg (0 north), with gusts and body drag",
        ("direction_deg", "body_drag_kg_m", "gust_m_s"),
    ),
    "rotor_inertia_torque": Form(_inertia, "kg m^2 of one rotor"),
}
HIDDEN = ("battery_voltage", "rotor_drag", "degraded_rotor", "cg_offset", "ground_effect", "axial_inflow")


class Gusts:
    """Turbulence around the mean wind: first-order Dryden forms of one length, passed at hover."""

    LENGTH_S = 2.5  # how long a gust lasts over a hovering vehicle

    def __init__(self, size_m_s: float) -> None:
        self._size, self._random = size_m_s, np.random.default_rng(0x6057)
        self._mean: np.ndarray | None = None
        self._state, self._then = np.zeros(3), 0.0

    def start(self, plant: Plant) -> None:
        """Around the wind that blows now."""
        wind = plant.index.WIND
        self._mean, self._then = plant.parameters[wind : wind + 3].copy(), plant.time_s

    def blow(self, plant: Plant) -> None:
        """Move the air on to the plant's time; up and down it moves half as much."""
        if self._mean is None or self._size == 0.0:
            return
        keep = math.exp(-max(plant.time_s - self._then, 0.0) / self.LENGTH_S)
        self._then = plant.time_s
        kick = self._size * np.array([1.0, 1.0, 0.5]) * math.sqrt(1.0 - keep * keep)
        self._state = keep * self._state + kick * self._random.standard_normal(3)
        wind = plant.index.WIND
        plant.parameters[wind : wind + 3] = self._mean + self._state


class Truth:
    """The effects of one world, applied to its plant as their time comes."""

    def __init__(self, effects: tuple[Effect, ...] = ()) -> None:
        self.effects = effects
        self._gusts = Gusts(sum(e.extra.get("gust_m_s", 0.0) for e in effects))
        self._waiting = sorted(effects, key=lambda e: e.onset_s)

    def act(self, plant: Plant) -> None:
        """Switch on what has come due."""
        while self._waiting and self._waiting[0].onset_s <= plant.time_s + 1e-9:
            effect = self._waiting.pop(0)
            FORMS[effect.name].apply(plant, effect)
            if "gust_m_s" in effect.extra:
                self._gusts.start(plant)
        self._gusts.blow(plant)


def read_truth(path: Path) -> Truth:
    """Read a truth file. Raises WorldError naming the key."""
    effects = []
    tables = read_document(path).get("effects", [])
    if not isinstance(tables, list):
        raise WorldError(path, "effects", "an array of tables [[effects]] is expected")
    for number, table in enumerate(tables, 1):
        where = f"effects[{number}]"
        form = FORMS.get(str(table.get("name"))) if isinstance(table, dict) else None
        if form is None:
            raise WorldError(path, f"{where}.name", f"one of {', '.join(FORMS)} is expected")
        extra = {}
        for key, value in table.items():
            if key in form.extra:
                extra[key] = read_number(path, f"{where}.{key}", value)
            elif key not in ("name", "size", "onset_s"):
                raise WorldError(path, f"{where}.{key}", f"{table['name']} knows no such key")
        size = read_number(path, f"{where}.size", table.get("size"))
        onset = read_number(path, f"{where}.onset_s", table.get("onset_s", 0.0))
        effects.append(Effect(table["name"], size, onset, extra))
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
    return Truth((Effect(name, round(size, 5), 0.0, extra),))


def truth_text(truth: Truth) -> str:
    """The truth as a truth file, for a judge."""
    blocks = []
    for e in truth.effects:
        lines = ["[[effects]]", f'name = "{e.name}"', f"size = {e.size!r}", f"onset_s = {e.onset_s!r}"]
        blocks.append("\n".join(lines + [f"{key} = {value!r}" for key, value in e.extra.items()]))
    return "\n\n".join(blocks) + "\n"
