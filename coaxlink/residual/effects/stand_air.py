"""What happens between the blades and the air on a stand: density, blade speed, interference, spacing."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, outside
from coaxlink.residual.frames import STAND_LOADS, StandFrame

GAS_CONSTANT = 287.05
SLOWEST = 0.025  # of full speed: a slower blade has no law of speed
POWERS = (-0.5, -0.25, -0.1, 0.1, 0.25, 0.5)  # of Reynolds number: told from full speed down
RISES = (2.0, 4.0, 7.0)  # of Mach number: nothing at rest
ARM_M = 0.3  # torque over thrust: a rotor of a metre has some 0.05
OVER = (-0.12, -0.06, 0.0, 0.06, 0.12)  # of the log's median density: where a given model holds
APART = (-0.3, -0.15, 0.0, 0.15, 0.3)  # of the log's median spacing
SPACING = {"decay": (0.05, 8.0), "apart": (-0.5, 0.5)}
TIPS = (0.4, 0.55, 0.7)  # from where a stall or a wave takes lift off
BLADES = {"power": (-0.8, 1.0), "rise": (1.2, 12.0), "tip": (0.2, 0.9)}
SOFT = {"soft": (0.0, 2.0), "power": (-9.0, 1.0)}  # at low Reynolds numbers the loads fall no further


def _rows(frame: StandFrame) -> int:
    return len(frame.time_s)


def density(frame: StandFrame) -> Array | None:
    """(rows,) air density in kg/m^3 from temperature and pressure; a missing one is the standard's."""
    t, p = frame.context("air_temperature_C"), frame.context("air_pressure_Pa")
    if t is None and p is None:
        return None
    kelvin = 288.15 if t is None else t + 273.15
    return np.broadcast_to((101325.0 if p is None else p) / (GAS_CONSTANT * kelvin), (_rows(frame),))


def _no_air(frame: StandFrame) -> str | None:
    rho = density(frame)
    if rho is None:
        return "neither air_temperature_C nor air_pressure_Pa is in the log"
    spread = float(np.ptp(np.quantile(rho, [0.02, 0.98])) / np.median(rho))
    return None if spread > 0.004 else f"the air's density moves by only {100 * spread:.1f} %"


def _air_columns(frame: StandFrame, shape: Shape) -> Array:
    """Thrust and torque alike, or, `apart`, each by its own power: profile drag has a Reynolds number too."""
    rho = density(frame)
    assert rho is not None
    change = frame.predicted[:, :4] * (rho / np.median(rho) - 1.0 - shape.get("over", 0.0))[:, None]
    out = np.zeros((_rows(frame), 6, 2 if "apart" in shape else 1))
    out[:, :4:2, 0] = change[:, ::2]
    out[:, 1:4:2, -1] = change[:, 1::2]
    return out


def _air_cause(frame: StandFrame, _: Shape, __: str) -> tuple[str, Array]:
    rho = density(frame)
    assert rho is not None
    return "air density, kg/m3", rho


def _air_parameters(frame: StandFrame, shape: Shape, c: Array) -> dict[str, float]:
    rho = density(frame)
    assert rho is not None
    torque = {"torque_exponent": float(c[1])} if "apart" in shape else {}
    # where the base holds
    reference = float(np.median(rho)) * (1.0 + shape.get("over", 0.0))
    return {"density_exponent": float(c[0]), **torque, **shape, "reference_density_kg_m3": reference}


def _air_inverse(_: StandFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    names = ("density_exponent", "torque_exponent") if "apart" in p else ("density_exponent",)
    return {k: p[k] for k in ("apart", "over") if k in p}, np.array([p[k] for k in names])


def _air_refuse(p: Mapping[str, float]) -> str | None:
    return outside("density_exponent", p["density_exponent"], 0.3, 1.8) or outside(
        "torque_exponent", p.get("torque_exponent", 1.0), 0.3, 1.8
    )


AIR_DENSITY: Effect[StandFrame] = Effect(
    name="air_density",
    stage=6,
    physics="thrust and torque are proportional to the density of the air",
    source="blade element theory; ideal gas",
    needs=("air_temperature_C", "air_pressure_Pa"),
    channels=STAND_LOADS,
    units={"density_exponent": "1", "torque_exponent": "1", "apart": "1", "over": "1",
           "reference_density_kg_m3": "kg/m3"},
    missing=_no_air,
    shapes=lambda frame: [{}] if frame.free_base else [{"over": o} for o in OVER],
    columns=_air_columns,
    parameters=_air_parameters,
    inverse=_air_inverse,
    refuse=_air_refuse,
    cause=_air_cause,
    free=lambda _, shape: {"over": (-0.25, 0.25)} if "over" in shape else {},
    finer=lambda _, shape, c: (
        [] if "apart" in shape else [({**shape, "apart": 1.0}, np.array([c[0], c[0]]))]
    ),
)  # fmt: skip


def _blade_columns(frame: StandFrame, shape: Shape) -> Array:
    out = np.zeros((_rows(frame), 6, 2 if "apart" in shape else 1))
    for side in (0, 1):
        u = np.maximum(frame.speeds[:, side], SLOWEST)
        if "tip" in shape:
            factor = -(np.maximum(u - shape["tip"], 0.0) ** 2)
        elif "rise" in shape:
            factor = u ** shape["rise"] / shape["rise"]
        else:
            power = shape["power"] if abs(shape["power"]) > 1e-4 else 1e-4
            soft = shape.get("soft", 0.0)
            factor = np.expm1(power * np.log((u + soft) / (1.0 + soft))) / power
        for k, load in enumerate((2 * side, 2 * side + 1)):
            out[:, load, k if "apart" in shape else 0] = frame.predicted[:, load] * factor
    return out


def _blade_names(shape: Shape) -> tuple[str, ...]:
    name = "loss" if "tip" in shape else "exponent_change"
    return (name, f"torque_{name}") if "apart" in shape else (name,)


def _blade_inverse(_: StandFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    shape = {k: v for k, v in p.items() if k in (*BLADES, "soft", "apart")}
    return shape, np.array([p[name] for name in _blade_names(shape)])


def _blade_refuse(p: Mapping[str, float]) -> str | None:
    for name in ("exponent_change", "torque_exponent_change"):
        if why := outside(name, p.get(name, 0.0), -1.0, 1.0):
            return why
    return outside("loss", p.get("loss", 0.1), 0.0, 10.0)


def _blade_finer(_: StandFrame, shape: Shape, c: Array) -> list[tuple[Shape, Array]]:
    """The same bend at the other end of the speeds; torque by a change of its own."""
    forms: dict[str, tuple[Shape, Array]] = {
        "soft": ({**shape, "soft": 0.2, "power": min(shape.get("power", 0.0), -1.0)}, c),
        "power": ({"power": -0.4}, 0.5 * c[:1]),
        "rise": ({"rise": 4.0}, -c[:1] if "tip" in shape else c[:1]),
    }
    out = [form for name, form in forms.items() if name not in shape and (name != "soft" or "power" in shape)]
    return out if "apart" in shape else [*out, ({**shape, "apart": 1.0}, np.array([c[0], c[0]]))]


BLADE_SPEED_LAW: Effect[StandFrame] = Effect(
    name="blade_speed_law",
    stage=3,  # behind the wake, which the blades meet at their own speed
    physics="the loads grow with another power of speed than the model's (Reynolds number, tip Mach number)",
    source="Deters, Ananda and Selig 2014, Reynolds number effects on small propellers; Glauert 1928",
    needs=("upper_rpm",),
    channels=STAND_LOADS,
    units=dict.fromkeys(
        (
            "exponent_change",
            "torque_exponent_change",
            "loss",
            "torque_loss",
            "power",
            "rise",
            "tip",
            "soft",
            "apart",
        ),
        "1",
    ),
    missing=lambda frame: (
        "no rotor model is given: the power of speed is the fitted base's own" if frame.free_base else None
    ),
    shapes=lambda _: [
        *({"power": p} for p in POWERS),
        *({"rise": p} for p in RISES),
        *({"tip": t} for t in TIPS),
        # slow blades have less lift and more drag: torque need not follow thrust
        *({"power": p, "apart": 1.0} for p in (-0.5, -0.1)),
    ],
    columns=_blade_columns,
    parameters=lambda _, shape, c: {**dict(zip(_blade_names(shape), map(float, c), strict=True)), **shape},
    inverse=_blade_inverse,
    refuse=_blade_refuse,
    cause=lambda frame, _, channel: (
        f"u_{channel[0]}",
        frame.speeds[:, 1 if channel.startswith("lower") else 0],
    ),
    free=lambda _, shape: {
        name: limit for name, limit in (BLADES | (SOFT if "soft" in shape else {})).items() if name in shape
    },
    finer=_blade_finer,
)


def _interference_columns(frame: StandFrame, shape: Shape) -> Array:
    upper, lower = frame.speeds.T
    term = np.maximum(lower, 0.0) ** shape["lower_power"] * np.maximum(upper, 1e-6) ** shape["upper_power"]
    out = np.zeros((_rows(frame), 6, 2))
    out[:, 0, 0], out[:, 1, 1] = -term, -term
    return out


def _interference_refuse(p: Mapping[str, float]) -> str | None:
    """It takes thrust; torque goes with it, by no more of an arm than rotors have."""
    arm = p["torque_loss_Nm"] / max(p["thrust_loss_N"], 1e-9)
    return outside("thrust_loss_N", p["thrust_loss_N"], 0.0, 1e4) or outside("arm", arm, -ARM_M, ARM_M, "m")


INTERFERENCE: Effect[StandFrame] = Effect(
    name="lower_on_upper_interference",
    stage=4,
    physics="the lower rotor draws air through the upper one, which loses thrust",
    source="coaxial momentum theory at finite spacing (Leishman and Ananthan 2006)",
    needs=("upper_rpm", "lower_rpm"),
    channels=("upper_thrust", "upper_torque"),
    units={"thrust_loss_N": "N", "torque_loss_Nm": "N m", "lower_power": "1", "upper_power": "1"},
    missing=lambda frame: (
        None if float(np.ptp(frame.speeds[:, 1])) > 0.2 else "the lower rotor's speed hardly varies"
    ),
    shapes=lambda _: [
        {"lower_power": a, "upper_power": b} for a in (1.0, 1.5, 2.0) for b in (0.0, 0.5, 1.0, 2.0)
    ],
    columns=_interference_columns,
    parameters=lambda _, shape, c: {"thrust_loss_N": float(c[0]), "torque_loss_Nm": float(c[1]), **shape},
    inverse=lambda _, p: (
        {k: v for k, v in p.items() if k.endswith("power")},
        np.array([p["thrust_loss_N"], p["torque_loss_Nm"]]),
    ),
    refuse=_interference_refuse,
    cause=lambda frame, _, __: ("u_l", frame.speeds[:, 1]),
    free=lambda _, __: {"lower_power": (0.4, 5.0), "upper_power": (0.0, 4.0)},
)


def _spacing(frame: StandFrame) -> Array:
    z = frame.context("rotor_spacing_m")
    assert z is not None
    return z / float(np.median(z)) - 1.0


def _no_spacing(frame: StandFrame) -> str | None:
    z = frame.context("rotor_spacing_m")
    if z is None:
        return "rotor_spacing_m is not in the log"
    return None if np.ptp(z) > 0.02 * np.median(z) else "rotor_spacing_m does not vary"


def _spacing_course(frame: StandFrame, shape: Shape) -> Array:
    """(rows,) of the relative spacing: straight, or what is left of the wake dies away as the rotors part.

    It is nought where the model holds: at the log's middle, or `apart` from it.
    """
    change = _spacing(frame)
    if "decay" in shape:
        change = np.asarray(-np.expm1(-shape["decay"] * change) / shape["decay"])
    return change - shape.get("apart", 0.0)


def _spacing_columns(frame: StandFrame, shape: Shape) -> Array:
    base = frame.loads_at(frame.speeds)[:, 2:4]
    alone = frame.loads_at(np.stack([np.zeros(_rows(frame)), frame.speeds[:, 1]], axis=1))[:, 2:4]
    wake = base - alone  # negative: what the lower rotor loses
    out = np.zeros((_rows(frame), 6, 3))
    change = _spacing_course(frame, shape)
    out[:, 2, 0], out[:, 3, 1] = -wake[:, 0] * change, -wake[:, 1] * change
    out[:, 0, 2] = frame.speeds[:, 1] ** 2 * change
    return out


def _spacing_finer(frame: StandFrame, shape: Shape, c: Array) -> list[tuple[Shape, Array]]:
    levels = len(np.unique(np.round(_spacing(frame), 2)))
    return [({**shape, "decay": 1.0}, c)] if "decay" not in shape and levels > 2 else []


ROTOR_SPACING: Effect[StandFrame] = Effect(
    name="rotor_spacing",
    stage=2,
    physics="further apart, the wake has contracted more and the rotors disturb each other less",
    source="wake contraction (Leishman 2006, ch. 2); bench maps of Buzzatto and Liarokapis 2022",
    needs=("rotor_spacing_m",),
    channels=("upper_thrust", "lower_thrust", "lower_torque"),
    units={
        "wake_thrust_share": "1",
        "wake_torque_share": "1",
        "upper_gain_N": "N",
        "reference_spacing_m": "m",
        "decay": "1",
        "apart": "1",
    },
    missing=_no_spacing,
    shapes=lambda frame: [{}] if frame.free_base else [{"apart": a} for a in APART],
    columns=_spacing_columns,
    parameters=lambda frame, shape, c: {
        **shape,
        "wake_thrust_share": float(c[0]),
        "wake_torque_share": float(c[1]),
        "upper_gain_N": float(c[2]),
        "reference_spacing_m": float(np.median(frame.columns["rotor_spacing_m"])),  # where the base holds
    },
    inverse=lambda _, p: (
        {k: v for k, v in p.items() if k in SPACING},
        np.array([p["wake_thrust_share"], p["wake_torque_share"], p["upper_gain_N"]]),
    ),
    refuse=lambda p: outside("wake_thrust_share", p["wake_thrust_share"], -3.0, 3.0),
    cause=lambda frame, _, __: ("rotor_spacing_m", frame.columns["rotor_spacing_m"]),
    free=lambda _, shape: {name: limit for name, limit in SPACING.items() if name in shape},
    finer=_spacing_finer,
)
