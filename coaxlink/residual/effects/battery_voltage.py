"""Battery voltage: a motor driven open loop turns slower as the supply sags.

Source: brushless motor on a duty-cycle controller, no-load speed proportional to voltage (Drela,
First-Order DC Electric Motor Model, 2007). To first order u = u_cmd (V / V_ref)^k, k near 1 (0 with a
speed-governing ESC), so that the loads change by k (V / V_ref - 1) u dL/du.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, one_shape, outside
from coaxlink.residual.frames import FlightFrame

REFERENCE = (0.5, 1.6)  # of the logged median: where a model's voltage may lie


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
        return "voltage_V is not in the log: a sagging battery cannot be told from a change of thrust"
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
    gain = (np.maximum(_voltage(frame), 1e-3) / p["reference_voltage_V"]) ** p["speed_exponent"]
    return frame.turning_at(frame.speeds * gain[:, None])


FLIGHT: Effect[FlightFrame] = Effect(
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
