"""What may be true in flight: each effect's laws, and the numbers each law puts into the plant.

An effect's first law is the one it follows unless the truth file says `law = "..."`. The others are other
accepted laws of the same physics, of the same size where the demo flies, so that whoever finds an effect has
found the physics and not the formula. docs/sim.md gives them with their sources.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from sim.physics.plant import Plant

LEVEL_SPEED = 0.55  # where the laws of one effect agree: rotors of the hovering demo


@dataclass(frozen=True)
class Effect:
    """One thing that is true: `size` in the unit its form names, further numbers in `extra`."""

    name: str
    size: float
    onset_s: float = 0.0
    extra: dict[str, float] = field(default_factory=dict)
    law: str = ""  # the form's first

    def number(self) -> int:
        """Of its law, as the kernel counts them."""
        return FORMS[self.name].laws.index(self.law) if self.law else 0


def _battery(plant: Plant, e: Effect) -> None:
    k, p = plant.index, plant.parameters
    p[k.VOLT_POWER], p[k.VOLT_LAW] = e.size, e.number()
    p[k.PACK_LAW] = e.number()  # a law of the drive comes with a pack of its own kind
    p[k.VOLT_REF] = e.extra.get("reference_V", p[k.VOLT_REF])
    p[k.VOLT_SHARE] = e.extra.get("resistive_share", 0.25)


def _ground(plant: Plant, e: Effect) -> None:
    k, p = plant.index, plant.parameters
    scale = e.extra.get("scale_m", 0.8)
    gain = e.size / math.e  # of every law at height scale_m
    p[k.GROUND_GAIN], p[k.GROUND_SCALE], p[k.GROUND_LAW] = e.size, scale, e.number()
    if e.law == "cheeseman":
        p[k.GROUND_SCALE] = scale**2 * gain / (1.0 + gain)
    elif e.law == "hayden":
        p[k.GROUND_SCALE] = scale**2 * ((1.0 + gain) ** 1.5 - 1.0)


def _drag(plant: Plant, e: Effect) -> None:
    k, p = plant.index, plant.parameters
    p[k.DRAG] += e.size
    p[k.DRAG_LAW] = e.number()
    thrust = plant.vehicle.mass_kg * p[k.GRAVITY] / plant.vehicle.rotors
    u = LEVEL_SPEED
    p[k.DRAG_SCALE] = {"speed": 1.0, "momentum": u / math.sqrt(thrust), "flapping": u * u / thrust}[
        e.law or "speed"
    ]


def _inflow(plant: Plant, e: Effect) -> None:
    k, p = plant.index, plant.parameters
    if not e.law or e.law == "linear":
        p[k.INFLOW] += e.size
        return
    thrust, radius = plant.vehicle.mass_kg * p[k.GRAVITY] / plant.vehicle.rotors, plant.radius_m
    hover = math.sqrt(thrust / (2.0 * 1.225 * math.pi * radius**2)) / (p[k.TIP_SPEED] * LEVEL_SPEED)
    share = min(e.size * hover, 0.9)
    p[k.INFLOW_HOVER], p[k.INFLOW_LIFT] = hover, 2.0 * share * hover / (1.0 - share)


def _degraded(plant: Plant, e: Effect) -> None:
    k, rotor = plant.index, int(e.extra.get("rotor", 1)) - 1
    thrust = 1.0 - e.size
    if e.law == "weak_motor":
        plant.geometry[k.G_SPEED, rotor] *= math.sqrt(max(thrust, 0.0))
        return
    # a chipped blade loses less torque than thrust; a shortened one more (T ~ R^4, Q ~ R^5)
    torque = max(thrust, 0.0) ** 1.25 if e.law == "tip" else 1.0 - 0.6 * e.size
    plant.geometry[k.G_THRUST, rotor] *= thrust
    plant.geometry[k.G_TORQUE, rotor] *= torque


BALLAST_KG = 1.5


def _offset(plant: Plant, e: Effect) -> None:
    k, p = plant.index, plant.parameters
    angle = math.radians(e.extra.get("direction_deg", 0.0))
    x, y = e.size * math.cos(angle), e.size * math.sin(angle)
    p[k.CX], p[k.CY] = x, y
    if e.law == "ballast":  # something of 1.5 kg was moved: the inertia grows with it
        reach = (p[k.MASS] / BALLAST_KG) ** 2 * BALLAST_KG - p[k.MASS]
        p[k.IXX] += reach * y * y
        p[k.IYY] += reach * x * x
        p[k.IZZ] += reach * (x * x + y * y)


def _mass(plant: Plant, e: Effect) -> None:
    k, p = plant.index, plant.parameters
    before = p[k.MASS]
    p[k.MASS] += e.size
    if e.law == "hung":
        below = e.extra.get("below_m", 0.15)
        p[k.CZ] += below * e.size / p[k.MASS]
        turned = before * e.size / p[k.MASS] * below**2
        p[k.IXX] += turned
        p[k.IYY] += turned


def _lag(plant: Plant, e: Effect) -> None:
    k, p = plant.index, plant.parameters
    p[k.LAG] += e.size
    p[k.LAG_LAW] = e.number()
    p[k.LAG_RATIO] = e.extra.get("down_over_up", 1.8)


def _wind(plant: Plant, e: Effect) -> None:
    k, p = plant.index, plant.parameters
    angle = math.radians(e.extra.get("direction_deg", 0.0))
    p[k.WIND : k.WIND + 2] = e.size * math.cos(angle), e.size * math.sin(angle)
    drag = e.extra.get("body_drag_kg_m", 0.12)
    if e.law == "linear":
        p[k.BODY_LINEAR] = drag * e.size  # the same push when the vehicle stands still
    else:
        p[k.BODY_DRAG] = drag


def _inertia(plant: Plant, e: Effect) -> None:
    plant.parameters[plant.index.ROTOR_INERTIA] = e.size


def _ceiling(plant: Plant, e: Effect) -> None:
    k, p = plant.index, plant.parameters
    p[k.CEILING_GAIN], p[k.CEILING_LAW] = e.size, e.number()
    p[k.CEILING_Z] = e.extra.get("ceiling_m", 6.0)


def _heating(plant: Plant, e: Effect) -> None:
    k, p = plant.index, plant.parameters
    p[k.HEAT_SHARE], p[k.HEAT_LAW] = e.size, e.number()
    p[k.WINDING] *= e.extra.get("resistance_share", 1.0)


def _air(plant: Plant, e: Effect) -> None:
    kelvin = 273.15 + e.extra.get("temperature_C", 15.0)
    height = e.extra.get("altitude_m", 0.0)
    pressure = (1.0 - 2.25577e-5 * height) ** 5.25588  # the standard atmosphere's
    plant.parameters[plant.index.AIR] = (pressure * 288.15 / kelvin) ** e.size


def _swap(plant: Plant, e: Effect) -> None:
    plant.swap_battery(e.size)
    if "resistance_ohm" in e.extra:
        plant.parameters[plant.index.RESISTANCE] = e.extra["resistance_ohm"]


def _delay(plant: Plant, e: Effect) -> None:
    plant.sensing.delay_s = e.size


def _vibration(plant: Plant, e: Effect) -> None:
    plant.sensing.vibration_m_s2 = e.size
    plant.sensing.blades = e.number() + 1


def _strange(plant: Plant, e: Effect) -> None:
    """Nothing yet: `Truth` pushes as time passes."""


@dataclass(frozen=True)
class Form:
    """How an effect acts, what `size` means, which further keys and which laws it knows."""

    apply: Callable[[Plant, Effect], None]
    size: str
    extra: tuple[str, ...] = ()
    laws: tuple[str, ...] = ("exact",)


FORMS = {
    "battery_voltage": Form(
        _battery,
        "power p of speed = command (V / reference_V)^p: unregulated ESCs",
        ("reference_V", "resistive_share"),
        ("power", "motor", "shepherd"),
    ),
    "ground_effect": Form(
        _ground,
        "thrust gain at height 0, falling as exp(-height / scale_m)",
        ("scale_m",),
        ("exponential", "cheeseman", "hayden"),
    ),
    "rotor_drag": Form(
        _drag, "N s/m a rotor at full speed, in its plane", (), ("speed", "momentum", "flapping")
    ),
    "axial_inflow": Form(
        _inflow, "thrust lost per climb speed through the disc / blade tip speed", (), ("linear", "momentum")
    ),
    "degraded_rotor": Form(
        _degraded, "share of thrust lost by one rotor", ("rotor",), ("share", "tip", "weak_motor")
    ),
    "cg_offset": Form(
        _offset,
        "m, towards direction_deg (0 forward, 90 right)",
        ("direction_deg",),
        ("shift", "ballast"),
    ),
    "mass_change": Form(_mass, "kg added", ("below_m",), ("point", "hung")),
    "rotor_lag": Form(
        _lag,
        "s added to the time constant",
        ("down_over_up",),
        ("first_order", "second_order", "asymmetric"),
    ),
    "wind": Form(
        _wind,
        "m/s towards direction_deg (0 north), with gusts and body drag",
        ("direction_deg", "body_drag_kg_m", "gust_m_s"),
        ("steady", "shear", "linear", "dryden"),
    ),
    "rotor_inertia_torque": Form(_inertia, "kg m^2 of one rotor"),
    "ceiling_effect": Form(
        _ceiling,
        "a in T (1 + sqrt(1 + a (R / d)^2)) / 2, d under the ceiling: 1/8 for one rotor",
        ("ceiling_m",),
        ("momentum", "image"),
    ),
    "motor_heating": Form(
        _heating,
        "share of speed lost with the winding 100 K over the air, at u = 0.7",
        ("resistance_share",),
        ("resistance", "linear"),
    ),
    "air_density": Form(
        _air, "power of the density's ratio that loads follow: 1", ("temperature_C", "altitude_m")
    ),
    "battery_swap": Form(
        _swap, "charge (0..1) of the pack put in, once landed after onset_s", ("resistance_ohm",)
    ),
    "sensor_delay": Form(_delay, "s by which every reading is late"),
    "vibration": Form(
        _vibration,
        "m/s^2 a rotor at full speed, as its square, at its own rate",
        (),
        ("unbalance", "blade_pass"),
    ),
    "strange": Form(_strange, "N that push down and let go with no physics"),
}


GUST_SEED = 0x6057


class Gusts:
    """Turbulence around the mean wind, passed at hover.

    First-order Dryden forms of one length; by law "dryden" the second-order ones across the wind and up
    (MIL-F-8785C); by law "shear" the mean grows with height as (h / 4 m)^0.2.
    """

    LENGTH_S = 2.5  # how long a gust lasts over a hovering vehicle
    SHEAR, SHEAR_M = 0.2, 4.0

    def __init__(self, size_m_s: float, law: str = "", seed: int = GUST_SEED) -> None:
        self._size, self._law, self._random = size_m_s, law, np.random.default_rng(seed)
        self._mean: np.ndarray | None = None
        self._state, self._slow, self._then = np.zeros(3), np.zeros(3), 0.0

    def start(self, plant: Plant) -> None:
        """Around the wind that blows now."""
        wind = plant.index.WIND
        self._mean, self._then = plant.parameters[wind : wind + 3].copy(), plant.time_s

    def blow(self, plant: Plant) -> None:
        """Move the air on to the plant's time; up and down it moves half as much."""
        if self._mean is None or (self._size == 0.0 and self._law != "shear"):
            return
        keep = math.exp(-max(plant.time_s - self._then, 0.0) / self.LENGTH_S)
        self._then = plant.time_s
        kick = self._size * np.array([1.0, 1.0, 0.5]) * math.sqrt(1.0 - keep * keep)
        self._slow = keep * self._slow + (1.0 - keep) * self._state
        self._state = keep * self._state + kick * self._random.standard_normal(3)
        air, mean = self._state, self._mean
        if self._law == "dryden":  # (1 + sqrt 3 T s) / (1 + T s)^2 of white noise, but for the wind's own way
            across = (math.sqrt(3.0) * air + (1.0 - math.sqrt(3.0)) * self._slow) / math.sqrt(2.0)
            along = mean / (float(np.linalg.norm(mean)) or 1.0)
            air = across + along * float(along @ (air - across))
        elif self._law == "shear":
            mean = mean * (max(plant.height, 0.1) / self.SHEAR_M) ** self.SHEAR
        wind = plant.index.WIND
        plant.parameters[wind : wind + 3] = mean + air
