"""What comes between throttle and speed on a stand: supply, heat, lag, dead band.

They bend the speed that a throttle gives. Where the log has rpm they show there (channels upper_speed,
lower_speed) and not in the loads; where it has throttles only, in every load.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from coaxlink.residual.effects.base import Array, Effect, Shape, outside
from coaxlink.residual.frames import STAND_CHANNELS, StandFrame
from coaxlink.residual.signals import lagged

LAGS_S = tuple(round(0.02 * 1.2**k, 4) for k in range(25))
AT_REST, TREMOR = 0.05, 0.005  # of the throttle; of normalised speed: no more is no turning
BANDS = (0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2)
LOAD = (-0.8, 2.0)
BEND = (1.0, 12.0)
HEAT_S = (30.0, 100.0, 300.0, 1000.0)


def drive(frame: StandFrame) -> Array:
    """(rows, 2) the throttles."""
    return frame.speeds if frame.throttles is None else frame.throttles


def _drivable(frame: StandFrame) -> str | None:
    if frame.driven or frame.throttles is not None:
        return None
    return "the log has no throttle: speeds were measured, so the drive cannot be judged"


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
    spread = float(np.ptp(np.quantile(v, [0.02, 0.98])) / max(float(np.median(v)), 1e-6))
    return None if spread > 0.005 else f"the voltage moves by only {100 * spread:.1f} %"


def _loaded(u: Array, shape: Shape) -> Array:
    """(rows, 2) how much a change of the drive is felt: as the speed, or more where the motor is loaded."""
    return np.asarray(u * np.maximum(u, 1e-3) ** shape["load"] if "load" in shape else u)


def _load_finer(_: StandFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    return [] if "load" in shape else [({**shape, "load": 0.2}, c)]


def _voltage_columns(frame: StandFrame, shape: Shape) -> Array:
    v = voltages(frame)
    assert v is not None
    u, centre = drive(frame), float(np.median(v))
    power = shape["power"]
    columns = [frame.slowed(_loaded(u, shape) * ((v / centre) ** power - 1.0) / power)]
    if not frame.free_base:
        columns.append(frame.slowed(u))  # the voltage at which the model holds need not be this run's
    return np.stack(columns, axis=-1)


def _voltage_parameters(frame: StandFrame, shape: Shape, c: Array) -> dict[str, float]:
    v = voltages(frame)
    assert v is not None
    centre = float(np.median(v))
    level = float(c[1]) if len(c) > 1 else 0.0
    reference = centre * (1.0 - level / c[0]) if abs(c[0]) > 1e-9 else centre
    return {"speed_exponent": float(c[0]), "reference_voltage_V": float(reference), **shape}


def _voltage_inverse(frame: StandFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    v = voltages(frame)
    assert v is not None
    k, centre = p["speed_exponent"], float(np.median(v))
    level = k * (1.0 - p["reference_voltage_V"] / centre)
    shape = {name: p[name] for name in ("power", "load") if name in p}
    return shape, np.array([k] if frame.free_base else [k, level])


def _voltage_cause(frame: StandFrame, _: Shape, channel: str) -> tuple[str, Array]:
    v = voltages(frame)
    assert v is not None
    return "voltage_V", v[:, 1 if channel.startswith("lower") else 0]


BATTERY_VOLTAGE: Effect[StandFrame] = Effect(
    name="battery_voltage",
    stage=1,
    physics="rotor speed follows the supply voltage: u = throttle (V / V_ref)^k",
    source="no-load speed of a duty-cycle driven brushless motor (Drela 2007)",
    needs=("voltage_V",),
    channels=STAND_CHANNELS,
    units={"speed_exponent": "1", "reference_voltage_V": "V", "power": "1", "load": "1"},
    missing=_no_voltage,
    shapes=lambda _: [{"power": p} for p in (0.4, 0.7, 1.0)],
    columns=_voltage_columns,
    parameters=_voltage_parameters,
    inverse=_voltage_inverse,
    refuse=lambda p: outside("speed_exponent", p["speed_exponent"], 0.02, 2.5),
    cause=_voltage_cause,
    free=lambda _, shape: {"power": (0.2, 4.0)} | ({"load": LOAD} if "load" in shape else {}),
    finer=_load_finer,
)


def _heat(frame: StandFrame, shape: Shape) -> Array:
    """(rows,) winding temperature over 25 C in 100 K, or a first-order answer to u^3 if none was logged."""
    if "memory_s" not in shape:
        logged = frame.context("motor_temperature_C")
        assert logged is not None
        return (logged - 25.0) / 100.0
    power = np.sum(drive(frame) ** 3, axis=1)
    step = float(np.median(np.diff(frame.time_s)))
    share = 1.0 - np.exp(-step / shape["memory_s"])
    return np.asarray(lfilter([share], [1.0, share - 1.0], power))


def _no_heat(frame: StandFrame) -> str | None:
    logged = frame.context("motor_temperature_C")
    if logged is not None and np.ptp(logged) < 3.0:
        return f"motor_temperature_C moves by only {np.ptp(logged):.1f} K"
    # heat that was not logged is worked out from the throttle
    return None if logged is not None else _drivable(frame)


def _heat_shapes(frame: StandFrame) -> Sequence[Shape]:
    if frame.context("motor_temperature_C") is not None:
        return [{}]
    span = float(np.ptp(frame.time_s))
    return [{"memory_s": s} for s in HEAT_S if s < span] or [{"memory_s": HEAT_S[0]}]


def _heat_columns(frame: StandFrame, shape: Shape) -> Array:
    heat = _heat(frame, shape)
    heat = heat / (1.0 + shape.get("fading", 0.0) * heat)  # resistance in series: each kelvin tells less
    return frame.slowed(-_loaded(drive(frame), shape) * heat[:, None])[..., None]


def _heat_free(_: StandFrame, shape: Shape) -> Mapping[str, tuple[float, float]]:
    return {"load": LOAD, "fading": (-0.5, 2.0)} if "load" in shape else {}


def _heat_finer(_: StandFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    return [] if "load" in shape else [({**shape, "load": 0.1, "fading": 0.1}, c)]


MOTOR_HEATING: Effect[StandFrame] = Effect(
    name="motor_heating",
    stage=1,
    physics="a warm winding has more resistance and its motor turns slower at the same throttle",
    source="copper's temperature coefficient in the first-order motor model (Drela 2007)",
    needs=("motor_temperature_C",),
    channels=STAND_CHANNELS,
    units={"speed_loss_per_100K": "1", "memory_s": "s", "load": "1", "fading": "1"},
    missing=_no_heat,
    shapes=_heat_shapes,
    columns=_heat_columns,
    parameters=lambda _, shape, c: {"speed_loss_per_100K": float(c[0]), **shape},
    inverse=lambda _, p: (
        {k: v for k, v in p.items() if k in ("memory_s", "load", "fading")},
        np.array([p["speed_loss_per_100K"]]),
    ),
    refuse=lambda p: outside("speed_loss_per_100K", p["speed_loss_per_100K"], 0.0, 1.0),
    cause=lambda frame, shape, _: (
        "heat put in" if "memory_s" in shape else "motor_temperature_C",
        _heat(frame, shape) if "memory_s" in shape else 25.0 + 100.0 * _heat(frame, shape),
    ),
    free=_heat_free,
    finer=_heat_finer,
)


def _no_time(frame: StandFrame) -> str | None:
    step = float(np.median(np.diff(frame.time_s))) if len(frame.time_s) > 2 else np.inf
    if not step < 0.6:
        return f"rows are {step:.1f} s apart: a lag has settled between them"
    return _drivable(frame)


def _stepped(u: Array, step_s: float, lag_s: float) -> Array:
    """(rows, 2) behind a throttle that jumps right after a row and stands until the next one."""
    keep = float(np.exp(-step_s / lag_s))
    out, _ = lfilter([1.0 - keep], [1.0, -keep], u, axis=0, zi=u[:1] * keep)
    return np.asarray(out)


def _both_ways(target: Array, step_s: float, up_s: float, down_s: float) -> Array:
    """(rows, 2) behind targets that stand from row to row: one lag up, another down."""
    rise, fall = float(np.exp(-step_s / up_s)), float(np.exp(-step_s / down_s))
    out = np.empty_like(target)
    for side in (0, 1):
        now, mine = float(target[0, side]), []
        for asked in target[:, side].tolist():  # which lag it is, the speed before says
            now = asked + (now - asked) * (rise if asked > now else fall)
            mine.append(now)
        out[:, side] = mine
    return out


def _late(frame: StandFrame, shape: Shape) -> Array:
    """(rows, 2) speeds behind the throttles: one lag, a second stage before it, other lags up and down."""
    u, step = drive(frame), float(np.median(np.diff(frame.time_s)))
    lag = shape["lag_s"]
    follow = _stepped if "stepped" in shape else lagged
    if "second_s" in shape:
        u = follow(u, step, shape["second_s"])
    if "down" not in shape:
        return follow(u, step, lag)
    target = u if "stepped" in shape else 0.5 * (u + np.concatenate([u[:1], u[:-1]]))
    return _both_ways(target, step, lag, lag * shape["down"])


def _bent(frame: StandFrame, speeds: Array) -> Array:
    """(rows, 6) what other speeds than the throttles' do, in full."""
    out = np.zeros((len(speeds), 6))
    u = drive(frame)
    if frame.driven:
        out[:, :4] = frame.loads_at(speeds) - frame.loads_at(u)
    else:
        out[:, 4:] = speeds - u
    return out


def _lag_free(_: StandFrame, shape: Shape) -> Mapping[str, tuple[float, float]]:
    limits = {"lag_s": (0.005, 3.0), "second_s": (0.002, 1.0), "down": (0.4, 2.5)}
    return {name: limit for name, limit in limits.items() if name in shape}


def _lag_finer(_: StandFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    second, down = {"second_s": 0.2 * shape["lag_s"]}, {"down": 1.2}
    if "second_s" in shape or "down" in shape:
        return [({**shape, **more}, np.ones(1)) for more in (second, down) if not set(more) & set(shape)]
    other = {"lag_s": shape["lag_s"]} | ({} if "stepped" in shape else {"stepped": 1.0})
    one = np.ones(1)
    return [
        *(({**shape, **more}, c) for more in (second, down, second | down)),
        *(({**other, **more}, one) for more in (second, down, second | down)),
    ]


ROTOR_LAG: Effect[StandFrame] = Effect(
    name="rotor_lag",
    stage=0,
    physics="the speed follows the throttle as a first-order lag",
    source="first-order motor dynamics (Hamandi, Tognon and Franchi 2020)",
    needs=("time_s", "upper_throttle"),
    channels=STAND_CHANNELS,
    units={"lag_s": "s", "share": "1", "second_s": "s", "down": "1", "stepped": "1"},
    missing=_no_time,
    shapes=lambda _: [{"lag_s": s, **form} for s in LAGS_S for form in ({}, {"stepped": 1.0})],
    columns=lambda frame, shape: _bent(frame, _late(frame, shape))[..., None],
    parameters=lambda _, shape, c: {**shape, "share": float(c[0])},
    inverse=lambda _, p: ({k: v for k, v in p.items() if k != "share"}, np.array([p["share"]])),
    refuse=lambda p: outside("share", p["share"], 0.7, 1.4),
    cause=lambda frame, _, channel: (
        "throttle_rate_1_s",
        np.gradient(drive(frame)[:, 1 if channel.startswith("lower") else 0], frame.time_s),
    ),
    free=_lag_free,
    finer=_lag_finer,
)


def _dead(frame: StandFrame, shape: Shape) -> Array:
    """(rows, 2) speeds: none, then as the throttle says; all stretched; or idling taken off.

    With a `start` a rotor at rest waits for that throttle, and then turns until the band stops it.
    """
    u, band = drive(frame), shape["band"]
    if "start" in shape:
        running = _running(u, band, shape["start"])
        return np.where(running, _dead(frame, {k: v for k, v in shape.items() if k != "start"}), 0.0)
    if "bend" in shape:
        power = shape["bend"]
        return np.asarray(np.maximum(u**power - band**power, 0.0) ** (1.0 / power))
    if "stretched" in shape:
        return np.maximum(u - band, 0.0) / (1.0 - band)
    return np.where(u < band, 0.0, u)


def _running(u: Array, band: float, start: float) -> Array:
    """(rows, 2) whether rotors turn that start above one throttle and stop below another."""
    row = np.arange(len(u))[:, None]
    started = np.maximum.accumulate(np.where(u > start, row, -1), axis=0)
    stopped = np.maximum.accumulate(np.where(u <= band, row, -1), axis=0)
    return np.asarray(started > stopped)


def _dead_apply(frame: StandFrame, parameters: Mapping[str, float]) -> StandFrame:
    """The frame with its rotors at rest below the band, where a supply or a warm winding changes nothing.

    What these take off on the average stays in: it is the scale of the throttle, which the base has too.
    """
    shape, c = DEAD_BAND.inverse(frame, parameters)
    predicted = frame.predicted + DEAD_BAND.columns(frame, shape) @ c
    if not frame.driven:
        u = drive(frame)
        stands = _dead(frame, shape) <= 0.0
        for side in (0, 1):
            rest, turns = stands[:, side] & (u[:, side] > 0.0), ~stands[:, side]
            if rest.any() and turns.any():
                usual = float(np.mean(frame.predicted[turns, 4 + side] / u[turns, side]))
                predicted[rest, 4 + side] = (usual - c[0]) * u[rest, side]
    return replace(frame, predicted=predicted)


def _no_low(frame: StandFrame) -> str | None:
    return None if float(np.mean(drive(frame) < 0.2)) > 0.01 else "no rows at low throttle"


def _dead_shapes(frame: StandFrame) -> Sequence[Shape]:
    # where no row is low, a band shows only if it stretches the whole scale
    forms: list[Shape] = [{"stretched": 1.0}] if _no_low(frame) else [{}, {"stretched": 1.0}, {"bend": 2.0}]
    return [{"band": b, **form} for b in BANDS for form in forms]


def _dead_free(_: StandFrame, shape: Shape) -> Mapping[str, tuple[float, float]]:
    # a start threshold stands between two set-points: nothing continuous to move
    if "bend" in shape:
        return {"band": (0.005, 0.4), "bend": BEND}
    return {"band": (0.005, 0.4)} if "stretched" in shape else {}


def _start(frame: StandFrame) -> tuple[float, float] | None:
    """The highest throttle that leaves a rotor at rest, and the lowest that turns one."""
    sides = [c - 4 for c in frame.present if c > 3]
    if frame.driven or not sides:
        return None
    u, speed = drive(frame)[:, sides], frame.measured[:, [4 + s for s in sides]]
    turning = speed >= np.maximum(AT_REST * u, TREMOR)
    rests, turns = ~turning & (u > 0.0), turning & (u > 0.0)
    if not rests.any() or not turns.any():
        return None
    return float(np.max(u[rests])), float(np.min(u[turns]))


def _dead_finer(frame: StandFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    bare, seen = {"band": shape["band"]}, _start(frame)
    forms: list[tuple[Shape, Array]] = []
    if seen is not None:
        rests, turns = seen
        forms.append(({"band": 0.5 * (rests + turns)}, np.ones(1)))
        if "bend" in shape:  # it begins below the lowest that turns, and steeply
            forms.append(({"band": 0.99 * turns, "bend": shape["bend"]}, c))
        if rests > turns:  # at one throttle it stands or turns, as it came there
            late = {"band": min(shape["band"], turns), "start": rests + 1e-6}
            forms += [({**late, **form}, c) for form in ({"stretched": 1.0}, {"bend": 1.5}, {})]
    if "bend" not in shape:
        forms += [({**bare, "bend": b}, c) for b in (1.5, 3.0)]
    return [form for form in forms if form[0] != shape]


DEAD_BAND: Effect[StandFrame] = Effect(
    name="dead_band",
    stage=2,
    physics="below a throttle the motor does not turn",
    source="speed controllers' start threshold",
    needs=("upper_throttle",),
    channels=STAND_CHANNELS,
    units={"band": "1", "share": "1", "stretched": "1", "bend": "1", "start": "1"},
    missing=_drivable,
    shapes=_dead_shapes,
    columns=lambda frame, shape: _bent(frame, _dead(frame, shape))[..., None],
    parameters=lambda _, shape, c: {**shape, "share": float(c[0])},
    inverse=lambda _, p: ({k: v for k, v in p.items() if k != "share"}, np.array([p["share"]])),
    refuse=lambda p: outside("share", p["share"], 0.6, 1.5),
    cause=lambda frame, _, channel: (
        "throttle",
        drive(frame)[:, 1 if channel.startswith("lower") else 0],
    ),
    apply=_dead_apply,
    free=_dead_free,
    finer=_dead_finer,
)
