"""What may be true in flight: each effect's laws, and the numbers each law puts into the plant.

An effect's first law is the one it follows unless the truth file says `law = "..."`. The others are other
accepted laws of the same physics, of the same size where the demo flies, so that whoever finds an effect has
found the physics and not the formula. sim/effects.md gives them with their sources.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sim.physics.power_module import PowerModule

if TYPE_CHECKING:
    from sim.physics.plant import Plant

LEVEL_SPEED = 0.55  # where the laws of one effect agree: rotors of the hovering demo


@dataclass(frozen=True)
class HiddenEffect:
    """One thing that is true: `size` in the unit its form names, further numbers in `extra`."""

    name: str
    size: float
    onset_s: float = 0.0
    extra: dict[str, float] = field(default_factory=dict)
    law: str = ""  # the form's first

    def number(self) -> int:
        """Of its law, as the kernel counts them."""
        return FORMS[self.name].laws.index(self.law) if self.law else 0


def _battery(plant: Plant, e: HiddenEffect) -> None:
    k, p = plant.index, plant.parameters
    p[k.VOLT_POWER], p[k.VOLT_LAW] = e.size, e.number()
    p[k.PACK_LAW] = e.number()  # a law of the drive comes with a pack of its own kind
    p[k.VOLT_REF] = e.extra.get("reference_V", p[k.VOLT_REF])
    p[k.VOLT_SHARE] = e.extra.get("resistive_share", 0.25)


def _ground(plant: Plant, e: HiddenEffect) -> None:
    k, p = plant.index, plant.parameters
    scale = e.extra.get("scale_m", 0.8)
    gain = e.size / math.e  # of every law at height scale_m
    p[k.GROUND_GAIN], p[k.GROUND_SCALE], p[k.GROUND_LAW] = e.size, scale, e.number()
    if e.law == "cheeseman":
        p[k.GROUND_SCALE] = scale**2 * gain / (1.0 + gain)
    elif e.law == "hayden":
        p[k.GROUND_SCALE] = scale**2 * ((1.0 + gain) ** 1.5 - 1.0)


def _drag(plant: Plant, e: HiddenEffect) -> None:
    k, p = plant.index, plant.parameters
    p[k.DRAG] += e.size
    p[k.DRAG_LAW] = e.number()
    thrust = plant.vehicle.mass_kg * p[k.GRAVITY] / plant.vehicle.rotors
    u = LEVEL_SPEED
    p[k.DRAG_SCALE] = {"speed": 1.0, "momentum": u / math.sqrt(thrust), "flapping": u * u / thrust}[
        e.law or "speed"
    ]


def _inflow(plant: Plant, e: HiddenEffect) -> None:
    k, p = plant.index, plant.parameters
    if not e.law or e.law == "linear":
        p[k.INFLOW] += e.size
        return
    thrust, radius = plant.vehicle.mass_kg * p[k.GRAVITY] / plant.vehicle.rotors, plant.radius_m
    hover = math.sqrt(thrust / (2.0 * 1.225 * math.pi * radius**2)) / (p[k.TIP_SPEED] * LEVEL_SPEED)
    share = min(e.size * hover, 0.9)
    p[k.INFLOW_HOVER], p[k.INFLOW_LIFT] = hover, 2.0 * share * hover / (1.0 - share)


def _degraded(plant: Plant, e: HiddenEffect) -> None:
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


def _offset(plant: Plant, e: HiddenEffect) -> None:
    k, p = plant.index, plant.parameters
    angle = math.radians(e.extra.get("direction_deg", 0.0))
    x, y = e.size * math.cos(angle), e.size * math.sin(angle)
    p[k.CX], p[k.CY] = x, y
    if e.law == "ballast":  # something of 1.5 kg was moved: the inertia grows with it
        reach = (p[k.MASS] / BALLAST_KG) ** 2 * BALLAST_KG - p[k.MASS]
        p[k.IXX] += reach * y * y
        p[k.IYY] += reach * x * x
        p[k.IZZ] += reach * (x * x + y * y)


def _mass(plant: Plant, e: HiddenEffect) -> None:
    k, p = plant.index, plant.parameters
    before = p[k.MASS]
    p[k.MASS] += e.size
    if e.law == "hung":
        below = e.extra.get("below_m", 0.15)
        p[k.CZ] += below * e.size / p[k.MASS]
        turned = before * e.size / p[k.MASS] * below**2
        p[k.IXX] += turned
        p[k.IYY] += turned


def _lag(plant: Plant, e: HiddenEffect) -> None:
    k, p = plant.index, plant.parameters
    p[k.LAG] += e.size
    p[k.LAG_LAW] = e.number()
    p[k.LAG_RATIO] = e.extra.get("down_over_up", 1.8)


def _wind(plant: Plant, e: HiddenEffect) -> None:
    k, p = plant.index, plant.parameters
    angle = math.radians(e.extra.get("direction_deg", 0.0))
    p[k.WIND : k.WIND + 2] = e.size * math.cos(angle), e.size * math.sin(angle)
    drag = e.extra.get("body_drag_kg_m", 0.12)
    if e.law == "linear":
        p[k.BODY_LINEAR] = drag * e.size  # the same push when the vehicle stands still
    else:
        p[k.BODY_DRAG] = drag


def _inertia(plant: Plant, e: HiddenEffect) -> None:
    plant.parameters[plant.index.ROTOR_INERTIA] = e.size


def _ceiling(plant: Plant, e: HiddenEffect) -> None:
    k, p = plant.index, plant.parameters
    p[k.CEILING_GAIN], p[k.CEILING_LAW] = e.size, e.number()
    p[k.CEILING_Z] = e.extra.get("ceiling_m", 6.0)


def _heating(plant: Plant, e: HiddenEffect) -> None:
    k, p = plant.index, plant.parameters
    p[k.HEAT_SHARE], p[k.HEAT_LAW] = e.size, e.number()
    p[k.WINDING] *= e.extra.get("resistance_share", 1.0)


def _air(plant: Plant, e: HiddenEffect) -> None:
    kelvin = 273.15 + e.extra.get("temperature_C", 15.0)
    height = e.extra.get("altitude_m", 0.0)
    pressure = (1.0 - 2.25577e-5 * height) ** 5.25588  # the standard atmosphere's
    plant.parameters[plant.index.AIR] = (pressure * 288.15 / kelvin) ** e.size


def _swap(plant: Plant, e: HiddenEffect) -> None:
    plant.swap_battery(e.size)
    if "resistance_ohm" in e.extra:
        plant.parameters[plant.index.RESISTANCE] = e.extra["resistance_ohm"]


def _delay(plant: Plant, e: HiddenEffect) -> None:
    plant.sensing.delay_s = e.size


def _vibration(plant: Plant, e: HiddenEffect) -> None:
    plant.sensing.vibration_m_s2 = e.size
    plant.sensing.blades = e.number() + 1


def _power_module(plant: Plant, e: HiddenEffect) -> None:
    x = e.extra.get
    plant.sensing.power_module = PowerModule(
        1.0 + e.size, x("offset_A", 0.0), x("delay_s", 0.0), x("noise_A", 0.0), x("step_A", 0.0)
    )


def _strange(plant: Plant, e: HiddenEffect) -> None:
    """Nothing yet: `Truth` pushes as time passes."""


@dataclass(frozen=True)
class EffectForm:
    """How an effect acts, what `size` means, which further keys and which laws it knows."""

    apply: Callable[[Plant, HiddenEffect], None]
    size: str
    extra: tuple[str, ...] = ()
    laws: tuple[str, ...] = ("exact",)


FORMS = {
    "battery_voltage": EffectForm(
        _battery,
        "power p of speed = command (V / reference_V)^p: unregulated ESCs",
        ("reference_V", "resistive_share"),
        ("power", "motor", "shepherd"),
    ),
    "ground_effect": EffectForm(
        _ground,
        "thrust gain at height 0, falling as exp(-height / scale_m)",
        ("scale_m",),
        ("exponential", "cheeseman", "hayden"),
    ),
    "rotor_drag": EffectForm(
        _drag, "N s/m a rotor at full speed, in its plane", (), ("speed", "momentum", "flapping")
    ),
    "axial_inflow": EffectForm(
        _inflow, "thrust lost per climb speed through the disc / blade tip speed", (), ("linear", "momentum")
    ),
    "degraded_rotor": EffectForm(
        _degraded, "share of thrust lost by one rotor", ("rotor",), ("share", "tip", "weak_motor")
    ),
    "cg_offset": EffectForm(
        _offset,
        "m, towards direction_deg (0 forward, 90 right)",
        ("direction_deg",),
        ("shift", "ballast"),
    ),
    "mass_change": EffectForm(_mass, "kg added", ("below_m",), ("point", "hung")),
    "rotor_lag": EffectForm(
        _lag,
        "s added to the time constant",
        ("down_over_up",),
        ("first_order", "second_order", "asymmetric"),
    ),
    "wind": EffectForm(
        _wind,
        "m/s towards direction_deg (0 north), with gusts and body drag",
        ("direction_deg", "body_drag_kg_m", "gust_m_s"),
        ("steady", "shear", "linear", "dryden"),
    ),
    "rotor_inertia_torque": EffectForm(_inertia, "kg m^2 of one rotor"),
    "ceiling_effect": EffectForm(
        _ceiling,
        "a in T (1 + sqrt(1 + a (R / d)^2)) / 2, d under the ceiling: 1/8 for one rotor",
        ("ceiling_m",),
        ("momentum", "image"),
    ),
    "motor_heating": EffectForm(
        _heating,
        "share of speed lost with the winding 100 K over the air, at u = 0.7",
        ("resistance_share",),
        ("resistance", "linear"),
    ),
    "air_density": EffectForm(
        _air, "power of the density's ratio that loads follow: 1", ("temperature_C", "altitude_m")
    ),
    "battery_swap": EffectForm(
        _swap, "charge (0..1) of the pack put in, once landed after onset_s", ("resistance_ohm",)
    ),
    "sensor_delay": EffectForm(_delay, "s by which every reading is late"),
    "power_module": EffectForm(
        _power_module,
        "share by which the pack's current is read too high",
        ("offset_A", "delay_s", "noise_A", "step_A"),
    ),
    "vibration": EffectForm(
        _vibration,
        "m/s^2 a rotor at full speed, as its square, at its own rate",
        (),
        ("unbalance", "blade_pass"),
    ),
    "strange": EffectForm(_strange, "N that push down and let go with no physics"),
}
