"""Battery voltage: a motor driven open loop turns slower as the supply sags.

Source: brushless motor on a duty-cycle controller, no-load speed proportional to voltage (Drela,
First-Order DC Electric Motor Model, 2007). To first order u = u_cmd (V / V_ref)^k, k near 1 (0 with a
speed-governing ESC), so that the loads change by k (V / V_ref - 1) u dL/du.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import LOAD, drive, load_variants, loaded, turn, turning
from coaxlink.effects.live import LiveView, SpeedPart
from coaxlink.effects.static import LeftOut, StaticVehicle
from coaxlink.effects.tracing import Array, Shape, Tracing, one_shape, outside
from coaxlink.frames import STAND_CHANNELS, FlightFrame, StandFrame

REFERENCE = (0.5, 1.6)  # of the logged median: where a model's voltage may lie


def speed_factor(p: Numbers, voltage_V: ArrayLike) -> Array:
    """Speed over command at a voltage: (V / V_ref)^k, or the stand's own form where a `power` is given.

    Where the drive sags with its load (`load`), that of a rotor at full speed.
    """
    ratio = np.asarray(voltage_V, float) / p["reference_voltage_V"]
    k, power = p["speed_exponent"], p.get("power", 0.0)
    return np.asarray(1.0 + k * _share(ratio, power) if power else ratio**k)


def _share(ratio: Array, power: float) -> Array:
    return np.asarray((ratio**power - 1.0) / power)


def speed_sensitivity(frame: FlightFrame, relative: Array) -> Array:
    """(rows, 6) change of the body loads when every rotor's speed changes by the share `relative`."""
    step = 1e-3
    up = frame.airframe.loads(frame.model, frame.speeds * (1.0 + step))
    down = frame.airframe.loads(frame.model, frame.speeds * (1.0 - step))
    thrust, torque = ((a - b) / (2.0 * step) for a, b in zip(up, down, strict=True))
    weight = relative if relative.ndim == 2 else relative[:, None]
    return frame.airframe.body_loads(thrust * weight, torque * weight)


def _voltage(frame: FlightFrame) -> Array:
    assert frame.voltage is not None
    return frame.voltage


def _centre(frame: FlightFrame) -> float:
    return float(np.median(_voltage(frame)[frame.keep]))


def _missing(frame: FlightFrame) -> str | None:
    if frame.voltage is None:
        return (
            "voltage_V is not in the log: a sagging battery cannot be distinguished from a change of thrust"
        )
    spread = np.ptp(frame.voltage[frame.keep]) / max(_centre(frame), 1e-6)
    return None if spread > 0.01 else f"voltage_V moves by only {100 * spread:.1f} %"


def _columns(frame: FlightFrame, _: Shape) -> Array:
    v, centre = _voltage(frame), _centre(frame)
    # the second column frees the reference voltage, which the stand's supply need not have shared
    return np.stack(
        [speed_sensitivity(frame, v / centre - 1.0), speed_sensitivity(frame, np.ones_like(v))], axis=-1
    )


def _parameters(frame: FlightFrame, _: Shape, c: Array) -> dict[str, float]:
    # k (V / V_ref - 1) = c0 (V / centre - 1) + c1
    centre = _centre(frame)
    over = 1.0 - c[1] / c[0] if abs(c[0]) > 1e-9 else 1.0
    over = float(np.clip(over, *REFERENCE))
    return {"speed_exponent": float(c[0] * over), "reference_voltage_V": centre * over, "over_logged": over}


def _inverse(frame: FlightFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    centre, reference, k = _centre(frame), p["reference_voltage_V"], p["speed_exponent"]
    return {}, np.array([k * centre / reference, k * (centre / reference - 1.0)])


def _refuse(p: Mapping[str, float]) -> str | None:
    # a reference that no pack of this log had would only be another name for more or less thrust
    low, high = (1.0 + 0.8 * (limit - 1.0) for limit in REFERENCE)
    return outside("speed_exponent", p["speed_exponent"], 0.02, 2.0) or outside(
        "reference_voltage_V over the logged", p.get("over_logged", 1.0), low, high
    )


def _apply(frame: FlightFrame, p: Mapping[str, float]) -> FlightFrame:
    if "cap" in p:
        ratio = (_voltage(frame) / p["reference_voltage_V"])[:, None]
        return frame.turning_at(frame.speeds - p["speed_exponent"] * lost_to_cap(p, frame.speeds, ratio))
    return frame.turning_at(frame.speeds * speed_factor(p, np.maximum(_voltage(frame), 1e-3))[:, None])


def voltages(frame: StandFrame) -> Array | None:
    """(rows, 2) supply of each motor, V."""
    sides = [frame.context(f"{side}_voltage_V") for side in ("upper", "lower")]
    common = frame.context("voltage_V")
    chosen = [s if s is not None else common for s in sides]
    if chosen[0] is None or chosen[1] is None:
        return None
    return np.stack([chosen[0], chosen[1]], axis=1)


def _no_voltage(frame: StandFrame) -> str | None:
    v = voltages(frame)
    if v is None:
        return "voltage_V is not in the log"
    if float(np.median(v)) <= 0.0:
        return "the voltage reads nothing in most rows"
    nothing = int(np.sum(np.any(v[frame.keep] <= 0.0, axis=1)))
    if nothing:
        return f"the voltage reads nothing in {nothing} rows"
    spread = float(np.ptp(np.quantile(v, [0.02, 0.98])) / max(float(np.median(v)), 1e-6))
    return None if spread > 0.005 else f"the voltage moves by only {100 * spread:.1f} %"


# Starts and bounds of the fit, judgement: governors run out of volts between 40 % of full speed and never.
GOVERNED = {"cap": (0.4, 1.5), "soft": (0.002, 0.15), "reach": (0.2, 3.0)}
CAPS, SOFT = (0.75, 0.85, 0.95, 1.05), 0.03  # of normalised speed, at the usual voltage


def governed_shapes(_: StandFrame) -> Sequence[Shape]:
    """A governor holds the speed until its duty cycle is full; from there on speed goes with the supply."""
    return [{"cap": cap, "soft": SOFT, "reach": 1.0} for cap in CAPS]


def lost_to_cap(p: Numbers, command: ArrayLike, ratio: ArrayLike) -> Array:
    """Normalised speed that a governor cannot hold at a voltage over the usual one: from `cap` on, softly."""
    over = np.asarray(command, float) - p["cap"] * (1.0 + p["reach"] * (np.asarray(ratio, float) - 1.0))
    return np.asarray(p["soft"] * np.logaddexp(0.0, over / p["soft"]))


def _voltage_columns(frame: StandFrame, shape: Shape) -> Array:
    v = voltages(frame)
    assert v is not None
    u, centre = drive(frame), float(np.median(v))
    if "cap" in shape:
        return frame.slowed(-lost_to_cap(shape, u, v / centre))[..., None]
    power = shape["power"]
    columns = [frame.slowed(loaded(u, shape) * _share(v / centre, power))]
    if not frame.free_nuisance:
        columns.append(frame.slowed(u))  # the voltage at which the model holds need not be this run's
    return np.stack(columns, axis=-1)


def _voltage_parameters(frame: StandFrame, shape: Shape, c: Array) -> dict[str, float]:
    v = voltages(frame)
    assert v is not None
    centre = float(np.median(v))
    if "cap" in shape:
        return {"speed_exponent": float(c[0]), "reference_voltage_V": centre, **shape}
    level = float(c[1]) if len(c) > 1 else 0.0
    reference = centre * (1.0 - level / c[0]) if abs(c[0]) > 1e-9 else centre
    return {"speed_exponent": float(c[0]), "reference_voltage_V": float(reference), **shape}


def _voltage_inverse(frame: StandFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    v = voltages(frame)
    assert v is not None
    k, centre = p["speed_exponent"], float(np.median(v))
    if "cap" in p:
        return {name: p[name] for name in GOVERNED}, np.array([k])
    level = k * (1.0 - p["reference_voltage_V"] / centre)
    shape = {name: p[name] for name in ("power", "load") if name in p}
    return shape, np.array([k] if frame.free_nuisance else [k, level])


def _voltage_free(_: StandFrame, shape: Shape) -> Mapping[str, tuple[float, float]]:
    if "cap" in shape:
        return GOVERNED
    return {"power": (0.2, 4.0)} | ({"load": LOAD} if "load" in shape else {})


def _voltage_cause(frame: StandFrame, _: Shape, channel: str) -> tuple[str, Array]:
    v = voltages(frame)
    assert v is not None
    return "voltage_V", v[:, 1 if channel.startswith("lower") else 0]


STAND: Tracing[StandFrame] = Tracing(
    name="battery_voltage",
    stage=1,
    physics="rotor speed follows the supply voltage: u = throttle (V / V_ref)^k",
    source="no-load speed of a duty-cycle driven brushless motor (Drela 2007)",
    needs=("voltage_V",),
    channels=STAND_CHANNELS,
    units={"speed_exponent": "1", "reference_voltage_V": "V", "power": "1", "load": "1"}
    | dict.fromkeys(GOVERNED, "1"),
    missing=_no_voltage,
    shapes=lambda frame: [*({"power": p} for p in (0.4, 0.7, 1.0)), *governed_shapes(frame)],
    columns=_voltage_columns,
    parameters=_voltage_parameters,
    inverse=_voltage_inverse,
    refuse=lambda p: outside("speed_exponent", p["speed_exponent"], 0.02, 2.5),
    cause=_voltage_cause,
    free=_voltage_free,
    variants=lambda frame, shape, c: [] if "cap" in shape else load_variants(frame, shape, c),
)


FLIGHT: Tracing[FlightFrame] = Tracing(
    name="battery_voltage",
    physics="rotor speed follows the supply voltage: u = u_cmd (V / V_ref)^k",
    source="no-load speed of a duty-cycle driven brushless motor (Drela 2007)",
    needs=("voltage_V",),
    channels=("force_z", "torque_x", "torque_y", "torque_z"),
    units={"speed_exponent": "1", "reference_voltage_V": "V", "over_logged": "1"},
    missing=_missing,
    shapes=one_shape,
    columns=_columns,
    parameters=_parameters,
    inverse=_inverse,
    refuse=_refuse,
    cause=lambda frame, _, channel: ("voltage_V", _voltage(frame)),
    nil=lambda _: {"speed_exponent": 0.0},
    stage=1,
    apply=_apply,
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    volts = vehicle.at.voltage_V
    if volts is None:
        raise LeftOut(_NEEDS_VOLTAGE)
    if "cap" in p:
        ratio = volts / p["reference_voltage_V"]
        vehicle.turn_at(lambda u: u - p["speed_exponent"] * lost_to_cap(p, u, ratio))
        return f"commands for {volts:.2f} V, where no rotor turns faster than {p['cap'] * ratio:.3f}"
    factor = float(speed_factor(p, volts)) if volts > 0 else 0.0
    turn(vehicle, factor, p, "voltage_V", volts)
    return f"commands for {volts:.2f} V, where rotors turn at {factor:.3f} of them"


def _live(view: LiveView, p: Numbers) -> SpeedPart:
    def factor() -> float | None:
        volts = view.reading("voltage")
        if volts is None:
            return None
        u = max(view.usual_speed, 0.1)
        if "cap" in p:
            lost = lost_to_cap(p, u, volts / p["reference_voltage_V"])
            return float(1.0 - p["speed_exponent"] * lost / u)
        return float(turning(np.array(u), float(speed_factor(p, volts)) - 1.0, p)) / u

    return factor


_NEEDS_VOLTAGE = (
    "speed follows the supply: a static mixer needs its voltage stated (`voltage_V`), live mixing measures it"
)
EFFECT = PhysicalEffect(
    name="battery_voltage",
    stage=Stage.DRIVE,
    parameters=(
        Parameter("speed_exponent", "1", 0.02, 2.5, (1.0, 0.4),
            source="Drela 2007: 1 without load and open loop, less under load, 0 with a governor"),
        Parameter("reference_voltage_V", "V", 1.0, 1000.0,
            source="wide: any value between the bounds; cells in series are the builder's choice"),
        Parameter("power", "1", 0.2, 4.0,
            source="wide: any value between the bounds; a loaded motor's speed bends with the voltage by "
                   "its own resistance"),
        Parameter("load", "1", *LOAD,
            source="wide: any value between the bounds; how resistance and load share the fall of speed "
                   "goes with the motor"),
        Parameter("cap", "1", *GOVERNED["cap"],
            source="wide: any value between the bounds; speed over full speed that a governor holds at the "
                   "usual voltage goes with the motor's Kv"),
        Parameter("soft", "1", *GOVERNED["soft"],
            source="wide: any value between the bounds; how gradually a full duty cycle is felt goes with "
                   "the controller"),
        Parameter("reach", "1", *GOVERNED["reach"],
            source="wide: any value between the bounds; 1 where speed goes with the supply, more where its "
                   "current makes it sag"),
        Parameter("over_logged", "1", *REFERENCE,
            source="wide: any value between the bounds; a model may be of a full pack and a log of an "
                   "empty one"),
    ),
    flight=FLIGHT,
    stand=STAND,
    static=_static,
    live_speed=_live,
    required=("speed_exponent", "reference_voltage_V"),
    messages={"BATTERY_STATUS": 10.0},
)  # fmt: skip
