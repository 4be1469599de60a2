"""What the mixer sees: the rotors of an airframe with the effects of the rotor file in them.

The one place that turns [[effects]] into what laws, tables and the allocator work with: a rotor model whose
u is the *command* at stated conditions, a gain for every rotor, places from the true centre of mass. Effects
that no static mixer can hold stay outside and are named with the reason. The formulas are those of
`coaxlink.residual.effects`, whose sources they share, and what live mixing computes from telemetry.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.errors import InputError
from coaxlink.mixer.bent import FIELDS, Loads, bent, scaled_speed
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.fitted import GRAVITY
from coaxlink.mixer.physics import climb_loss, ground_gain, speed_factor
from coaxlink.rotor import RotorModel
from coaxlink.rotor.model import Effect

SPEED_FACTOR = (0.5, 1.5)  # of a speed over its command; beyond, the stated voltage is a slip
LEAST_GAIN = 0.05
LIVE_ONLY = {  # name -> what a static table lacks
    "ground_effect": "thrust follows the height: a static mixer needs it stated (--height), "
    "live mixing measures it",
    "axial_inflow": "thrust follows the climb speed: a static mixer needs it stated (--climb), "
    "live mixing measures it",
    "battery_voltage": "speed follows the supply: a static mixer needs its voltage stated (--voltage), "
    "live mixing measures it",
    "air_density": "loads follow the air's density: a static mixer needs it stated (--density), live mixing "
    "takes it from the barometer and an air temperature",
}
CANNOT = {
    "rotor_drag": "a force in the rotors' plane, which no rotor speed can take back; feed-forward can",
    "wind": "a force of the air on the body, no property of the vehicle; the position loop carries it",
    "rotor_lag": "a mixer is static: declare motor_lag_s and tune the loops for the slower rotor",
    "rotor_inertia_torque": "the reaction lasts only while speeds change: a static mixer cannot hold it",
    "motor_heating": "speed follows the winding's temperature, which no mixer is told",
    "dead_band": "no mixer turns a motor below its start: raise the outputs' minimum to the band "
    "(PWM_MAIN_MINn, MOT_SPIN_MIN)",
    "hysteresis": "the mixer does not know which way the speed came",
    "sensor_drift": "a property of the stand's cells, not of the rotors",
    "air_density": "the file does not say at which density its base holds",
    "rotor_spacing": "the file does not say at which spacing its base holds",
}


@dataclass(frozen=True)
class Conditions:
    """Where a static mixer shall be right. None: not stated, and what depends on it is left out."""

    voltage_V: float | None = None
    height_m: float | None = None  # above ground
    climb_m_s: float | None = None
    motor_temperature_C: float | None = None
    air_density_kg_m3: float | None = None


@dataclass(frozen=True)
class Seen:
    """An airframe and a rotor model that hold the effects they can."""

    airframe: Airframe
    model: RotorModel  # without the effects that are in it now
    done: Mapping[str, str]  # effect -> what was done, in words
    cannot: Mapping[str, str]  # effect -> why nothing was
    speed_per_command: float = 1.0  # what u = 1 of `model` means in the speeds of the file

    def to_json(self) -> dict[str, dict[str, str]]:
        """The keys that every verb adds to its JSON."""
        return {"compensated": dict(self.done), "not_compensated": dict(self.cannot)}


@dataclass
class _Bench:
    """What is being put together."""

    airframe: Airframe
    model: RotorModel
    at: Conditions
    thrust: NDArray[np.float64]  # (N,) gains
    torque: NDArray[np.float64]
    speed: float = 1.0
    changes: list[Callable[[RotorModel, Loads], Loads]] = field(default_factory=list)


class _Left(Exception):
    """Why nothing is done about an effect."""


def see(
    airframe: Airframe, model: RotorModel, at: Conditions | None = None, *, surfaces_only: bool = False
) -> Seen:
    """Put the effects of `model` into it and its airframe, as far as a mixer at `at` can hold them.

    `surfaces_only` takes those that change the rotors' surfaces alone and leaves the others in
    `model.effects`: live mixing measures what they depend on. Raises InputError on effects whose numbers are
    missing or that no rotor here can have, and on conditions that cannot be.
    """
    at = at or Conditions()
    bench = _Bench(airframe, model, at, *airframe.gains)
    done: dict[str, str] = {}
    cannot: dict[str, str] = {}
    kept: list[Effect] = []
    for effect in sorted(model.effects, key=_turn):
        if surfaces_only and effect.name not in SURFACES:
            kept.append(effect)
            continue
        try:
            maker = MAKERS.get(effect.name)
            if maker is None:
                raise _Left(CANNOT.get(effect.name, "not known to the mixers"))
            done[effect.name] = maker(bench, effect.parameters)
        except _Left as reason:
            cannot[effect.name] = str(reason)
        except KeyError as missing:
            where = f"effects.{effect.name}.{missing.args[0]}"
            raise InputError("rotor model", where, "this number of the effect is missing") from missing
    return Seen(_airframe(bench), _model(bench, tuple(kept)), done, cannot, bench.speed)


def _sure(key: str, value: float, sound: bool, wanted: str) -> None:
    """Raises InputError on a number of an effect that no motor or rotor can have."""
    if not sound:
        raise InputError("rotor model", f"effects.{key}", f"{wanted}, found {value:g}")


def _turn(effect: Effect) -> int:
    return SURFACES.index(effect.name) if effect.name in SURFACES else -1


def _airframe(b: _Bench) -> Airframe:
    rotors = tuple(
        replace(r, thrust_gain=float(f), torque_gain=float(q))
        for r, f, q in zip(b.airframe.rotors, b.thrust, b.torque, strict=True)
    )
    return replace(b.airframe, rotors=rotors)


def _model(b: _Bench, kept: tuple[Effect, ...]) -> RotorModel:
    model = b.model
    if b.changes:
        model = bent(model, b.changes)
    return replace(scaled_speed(model, b.speed), effects=kept)


def usual_lift(airframe: Airframe, model: RotorModel) -> float:
    """Thrust over speed squared (N) of the middle one of an airframe's rotors in hover."""
    law = ExactLaw(airframe, model)
    u = np.maximum(law.speeds([GRAVITY * airframe.mass_kg, 0.0, 0.0, 0.0]), 0.1)
    return max(float(np.median(airframe.loads(model, u)[0] / u**2)), 1e-9)


# -- one function an effect: (bench, its numbers) -> what was done ------------------------------------------


def _rotor(b: _Bench, p: Mapping[str, float]) -> str:
    number = int(p["rotor"])
    if not 1 <= number <= len(b.thrust):
        problem = f"this airframe has rotors 1 to {len(b.thrust)}, found {number}"
        raise InputError("rotor model", "effects.degraded_rotor.rotor", problem)
    thrust, torque = 1.0 - p["thrust_loss"], 1.0 - p.get("torque_loss", 0.0)
    b.thrust[number - 1] *= max(thrust, LEAST_GAIN)
    b.torque[number - 1] *= max(torque, LEAST_GAIN)
    return (
        f"rotor {number} counts for {100 * thrust:.1f} % of its thrust and {100 * torque:.1f} % of its torque"
    )


def _offset(b: _Bench, p: Mapping[str, float]) -> str:
    x, y = p["offset_x_m"], p["offset_y_m"]
    moved = (
        replace(r, position_m=(r.position_m[0] - x, r.position_m[1] - y, r.position_m[2]))
        for r in b.airframe.rotors
    )
    b.airframe = replace(b.airframe, rotors=tuple(moved))
    forward, right = (round(1e3 * d, 1) + 0.0 for d in (x, y))
    return f"rotor places from the true centre of mass, {forward:+.1f} mm forward, {right:+.1f} mm right"


def _mass(b: _Bench, p: Mapping[str, float]) -> str:
    declared, b.airframe = b.airframe.mass_kg, replace(b.airframe, mass_kg=p["mass_kg"])
    return f"{p['mass_kg']:.2f} kg instead of {declared:.2f}: hover thrust and envelope follow"


def _battery(b: _Bench, p: Mapping[str, float]) -> str:
    volts = b.at.voltage_V
    if volts is None:
        raise _Left(LIVE_ONLY["battery_voltage"])
    factor = speed_factor(p, volts) if volts > 0 else 0.0
    if not SPEED_FACTOR[0] <= factor <= SPEED_FACTOR[1]:
        problem = f"at this voltage rotors would turn at {factor:.2f} of their commands: no such supply"
        raise InputError("--voltage", f"{volts:g}", problem)
    b.speed *= factor
    return f"commands for {volts:.2f} V, where rotors turn at {factor:.3f} of them"


def _heat(b: _Bench, p: Mapping[str, float]) -> str:
    degrees = b.at.motor_temperature_C
    if degrees is None or "memory_s" in p:
        raise _Left(CANNOT["motor_heating"])
    factor = 1.0 - p["speed_loss_per_100K"] * (degrees - 25.0) / 100.0
    if not SPEED_FACTOR[0] <= factor <= SPEED_FACTOR[1]:
        problem = f"rotors would turn at {factor:.2f} of their commands: no such motor"
        raise InputError("motor temperature", f"{degrees:g}", problem)
    b.speed *= factor
    return f"commands for windings at {degrees:.0f} C, where rotors turn at {factor:.3f} of them"


def _ground(b: _Bench, p: Mapping[str, float]) -> str:
    height = b.at.height_m
    if height is None:
        raise _Left(LIVE_ONLY["ground_effect"])
    gains = np.array([ground_gain(p, height - r.position_m[2]) for r in b.airframe.rotors])
    b.thrust *= 1.0 + gains
    return f"thrust {100 * float(gains.mean()):+.1f} % at {height:.2f} m above ground"


def _inflow(b: _Bench, p: Mapping[str, float]) -> str:
    climb = b.at.climb_m_s
    if climb is None:
        raise _Left(LIVE_ONLY["axial_inflow"])
    usual = usual_lift(b.airframe, b.model)

    def change(_: RotorModel, loads: Loads) -> Loads:
        upper = climb_loss(p, climb, loads.upper, loads.upper_thrust, usual)
        lower = climb_loss(p, climb, loads.lower, loads.lower_thrust, usual)
        return loads.plus(upper_thrust=-upper, lower_thrust=-lower)

    b.changes.append(change)
    lost = climb_loss(p, climb, 0.5, 0.25 * usual, usual)
    return f"{-float(lost):+.2f} N a rotor at half speed, climbing at {climb:.2f} m/s"


def _interference(b: _Bench, p: Mapping[str, float]) -> str:
    thrust, torque = p["thrust_loss_N"], p["torque_loss_Nm"]
    a, c = p["lower_power"], p["upper_power"]

    def change(_: RotorModel, loads: Loads) -> Loads:
        term = loads.lower**a * loads.upper**c
        return loads.plus(upper_thrust=-thrust * term, upper_torque=-torque * term)

    b.changes.append(change)
    return f"the upper rotor loses {thrust:.2f} N u_l^{a:g} u_u^{c:g} to the lower one"


def _blade(b: _Bench, p: Mapping[str, float]) -> str:
    name = "loss" if "tip" in p else "exponent_change"
    _sure("blade_speed_law.rise", p.get("rise", 1.0), p.get("rise", 1.0) > 0.0, "a power above 0")
    _sure("blade_speed_law.soft", p.get("soft", 0.0), p.get("soft", 0.0) >= 0.0, "a speed, 0 or more")

    def bend(u: NDArray[np.float64]) -> NDArray[np.float64]:
        if "tip" in p:
            return np.asarray(-(np.maximum(u - p["tip"], 0.0) ** 2))
        if "rise" in p:
            return np.asarray(np.maximum(u, 0.0) ** p["rise"] / p["rise"])
        power = p["power"] if abs(p["power"]) > 1e-4 else 1e-4
        soft = p.get("soft", 0.0)
        return np.asarray(np.expm1(power * np.log((np.maximum(u, 1e-3) + soft) / (1.0 + soft))) / power)

    lift = p[name]
    drag = p[f"torque_{name}"] if "apart" in p else lift

    def change(_: RotorModel, loads: Loads) -> Loads:
        upper, lower = bend(loads.upper), bend(loads.lower)
        return loads.plus(
            upper_thrust=loads.upper_thrust * lift * upper, upper_torque=loads.upper_torque * drag * upper,
            lower_thrust=loads.lower_thrust * lift * lower, lower_torque=loads.lower_torque * drag * lower,
        )  # fmt: skip

    b.changes.append(change)
    if "tip" in p:
        return f"loads fall off above speed {p['tip']:g}"
    return f"loads grow with another power of speed ({lift:+.3f} at full speed)"


def _spacing(b: _Bench, p: Mapping[str, float]) -> str:
    if "reference_spacing_m" not in p:
        raise _Left(CANNOT["rotor_spacing"])
    places = np.array([r.position_m for r in b.airframe.rotors])
    gaps = [float(np.linalg.norm(places[u] - places[w])) for u, w in b.airframe.pairs]
    if not gaps:
        raise _Left("this airframe has no pairs")
    gap = float(np.mean(gaps))
    off = gap / p["reference_spacing_m"] - 1.0

    def change(model: RotorModel, loads: Loads) -> Loads:
        alone = model.loads(np.zeros_like(loads.lower), loads.lower)
        wake, drag = loads.lower_thrust - alone.lower_thrust, loads.lower_torque - alone.lower_torque
        return loads.plus(
            upper_thrust=p.get("upper_gain_N", 0.0) * off * loads.lower**2,
            lower_thrust=-p["wake_thrust_share"] * off * wake,
            lower_torque=-p.get("wake_torque_share", 0.0) * off * drag,
        )

    b.changes.append(change)
    return f"pairs {1e3 * gap:.0f} mm apart where the base holds at {1e3 * p['reference_spacing_m']:.0f} mm"


def _dead_band(b: _Bench, p: Mapping[str, float]) -> str:
    if "stretched" not in p and "bend" not in p:  # above the band the command is the speed
        raise _Left(CANNOT["dead_band"])
    band, share = p["band"], p.get("share", 1.0)
    _sure("dead_band.band", band, 0.0 <= band < 1.0, "a throttle from 0 to below 1")
    _sure("dead_band.bend", p.get("bend", 1.0), p.get("bend", 1.0) > 0.0, "a power above 0")

    def turns(command: NDArray[np.float64]) -> NDArray[np.float64]:
        if "bend" in p:
            over = np.maximum(np.maximum(command, 0.0) ** p["bend"] - band ** p["bend"], 0.0)
            alone = over ** (1.0 / p["bend"])
        else:
            alone = (command - band) / (1.0 - band)
        return np.asarray(np.maximum(command + share * (alone - command), 0.0))

    def change(model: RotorModel, loads: Loads) -> Loads:
        told, turned = (model.loads(f(loads.upper), f(loads.lower)) for f in (lambda u: u, turns))
        return loads.plus(**{name: getattr(turned, name) - getattr(told, name) for name in FIELDS})

    b.changes.append(change)
    half = float(turns(np.array(0.5)))
    return f"commands count from {band:g} on, where motors start: at 0.5 they turn at {half:.3f}"


def _air(b: _Bench, p: Mapping[str, float]) -> str:
    rho, reference = b.at.air_density_kg_m3, p.get("reference_density_kg_m3")
    if reference is None:
        raise _Left(CANNOT["air_density"])
    if rho is None:
        raise _Left(LIVE_ONLY["air_density"])
    gain = (rho / reference) ** p["density_exponent"]
    b.thrust *= gain
    b.torque *= gain
    return f"loads {100 * (gain - 1):+.1f} % in air of {rho:.3f} kg/m3"


# in the order in which they act on one another, as `refine` fits them
SURFACES = ("rotor_spacing", "blade_speed_law", "lower_on_upper_interference", "dead_band")
MAKERS: dict[str, Callable[[_Bench, Mapping[str, float]], str]] = {
    "lower_on_upper_interference": _interference,
    "blade_speed_law": _blade,
    "rotor_spacing": _spacing,
    "dead_band": _dead_band,
    "degraded_rotor": _rotor,
    "cg_offset": _offset,
    "mass_change": _mass,
    "battery_voltage": _battery,
    "motor_heating": _heat,
    "ground_effect": _ground,
    "axial_inflow": _inflow,
    "air_density": _air,
}
