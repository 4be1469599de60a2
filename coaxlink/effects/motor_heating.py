"""Motor heating: a warm winding has more resistance, and its motor turns slower at the same throttle.

Source: copper's temperature coefficient in the first-order motor model (Drela, First-Order DC Electric Motor
Model, 2007). Heat that was not logged is worked out from the throttle: a first-order answer to its cube.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import LOAD, drivable, drive, loaded, turn
from coaxlink.effects.parameter import Range
from coaxlink.effects.static import LeftOut, StaticVehicle
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import STAND_CHANNELS, StandFrame

HEAT_S = (30.0, 100.0, 300.0, 1000.0)
# of speed in 100 K: remanence falls by 0.12 % a kelvin (NdFeB) to 0.2 % (ferrite; IEC 60404-8-1), and speed
# without load goes with its inverse; a case is cooler than what is inside by up to a third (judgement)
MAGNETS = -0.3
OWN_S = (20.0, 60.0, 180.0)  # starts of the fit: windings of motors of 0.1 to 1 kg (judgement)


def _heat(frame: StandFrame, p: Numbers) -> Array:
    """(rows,) winding temperature over 25 C in 100 K, or a first-order answer to u^3 if none was logged."""
    if "memory_s" not in p:
        logged = frame.context("motor_temperature_C")
        assert logged is not None
        return (logged - 25.0) / 100.0
    from scipy.signal import lfilter

    power = np.sum(drive(frame) ** 3, axis=1)
    step = float(np.median(np.diff(frame.time_s)))
    share = 1.0 - np.exp(-step / p["memory_s"])
    return np.asarray(lfilter([share], [1.0, share - 1.0], power))


def _no_heat(frame: StandFrame) -> str | None:
    logged = frame.context("motor_temperature_C")
    if logged is not None and np.ptp(logged) < 3.0:
        return f"motor_temperature_C moves by only {np.ptp(logged):.1f} K"
    # heat that was not logged is worked out from the throttle
    return None if logged is not None else drivable(frame)


def _starts(frame: StandFrame) -> Sequence[Numbers]:
    """Both motors; windings above the case that carries the thermometer, each motor's by its own power; one.

    Two nodes, winding and case (Mellor, Roberts and Turner 1991). One motor of the pair: a worn bearing's, or
    a short one's.
    """
    if why := _no_heat(frame):
        raise NotShown(why)
    loss: Numbers = {"speed_loss_per_100K": 0.05}
    if frame.context("motor_temperature_C") is not None:
        both, windings = [loss], [{**loss, "own_speed_loss": 0.05, "own_s": s} for s in OWN_S]
    else:
        span = float(np.ptp(frame.time_s))
        memories = [s for s in HEAT_S if s < span] or [HEAT_S[0]]
        both, windings = [{**loss, "memory_s": s} for s in memories], []
    return [*both, *windings, *({**p, "side": float(side)} for p in both for side in (0, 1))]


def _further(_: StandFrame, p: Numbers) -> Sequence[Numbers]:
    if "load" in p:
        return []
    return [{**p, "load": 0.1} if "own_s" in p else {**p, "load": 0.1, "fading": 0.1}]


def _own_heat(frame: StandFrame, memory_s: float) -> Array:
    """(rows, 2) what each motor is above the case, of the most at full throttle: lags behind its power, u^3.

    Between runs, a gap in time, it falls to nothing as fast.
    """
    known, states_then = frame.memo.get(_own_heat, (None, None))
    if known == memory_s:  # a cause is asked for of every channel
        return np.asarray(states_then)
    power, step = drive(frame) ** 3, np.diff(frame.time_s, prepend=frame.time_s[:1])
    usual = float(np.median(step))
    keep = np.exp(-np.maximum(step, 0.0) / memory_s)
    took = 1.0 - np.exp(-np.clip(step, 0.0, 2.0 * usual) / memory_s)
    out = np.empty_like(power)
    for side in (0, 1):  # by plain numbers: a search asks for it hundreds of times
        now, states = 0.0, []
        for k, added in zip(keep.tolist(), (took * power[:, side]).tolist(), strict=True):
            now = now * k + added
            states.append(now)
        out[:, side] = states
    frame.memo[_own_heat] = memory_s, out
    return out


def _cause(frame: StandFrame, p: Numbers, channel: str) -> tuple[str, Array]:
    if "memory_s" in p:
        return "heat put in", _heat(frame, p)
    if "own_s" in p:
        own = _own_heat(frame, p["own_s"])
        return "motor_temperature_C", own[:, 1 if channel.startswith("lower") else 0]
    return "motor_temperature_C", 25.0 + 100.0 * _heat(frame, p)


def _felt(p: Numbers, heat: Array) -> Array:
    """Of heat in 100 K over 25 C: resistance in series, each kelvin tells less."""
    return np.asarray(heat / (1.0 + p.get("fading", 0.0) * heat))


def _adds(frame: StandFrame, p: Numbers) -> Array:
    lost = p["speed_loss_per_100K"] * np.tile(_felt(p, _heat(frame, p))[:, None], 2)
    if "own_s" in p:
        lost = lost + p["own_speed_loss"] * _own_heat(frame, p["own_s"])
    if "side" in p:
        lost[:, 1 - round(p["side"])] = 0.0
    return frame.slowed(-loaded(drive(frame), p) * lost)


def _losses(_: StandFrame | None, p: Numbers) -> Range:
    """Windings resist; magnets weaken, and their motor turns faster. A case shows the mean of both."""
    return (0.0 if {"memory_s", "side"} & set(p) else MAGNETS), 1.0


STAND: Tracing[StandFrame] = Tracing(
    needs=("motor_temperature_C",),
    channels=STAND_CHANNELS,
    starts=_starts,
    further=_further,
    adds=_adds,
    cause=_cause,
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    degrees = vehicle.at.motor_temperature_C
    if degrees is None or "memory_s" in p:
        raise LeftOut(_TEMPERATURE_UNKNOWN)
    if "side" in p:
        raise LeftOut(_ONE_MOTOR)
    felt = float(_felt(p, np.array((degrees - 25.0) / 100.0)))
    factor = 1.0 - p["speed_loss_per_100K"] * felt
    turn(vehicle, factor, p, "motor_temperature_C", degrees)
    return f"commands for windings at {degrees:.0f} C, where rotors turn at {factor:.3f} of them"


_ONE_MOTOR = "one motor of the stand's pair is hot: a fault of that motor, not of its kind"
_TEMPERATURE_UNKNOWN = "speed follows the winding's temperature, which no mixer knows"
EFFECT = PhysicalEffect(
    name="motor_heating",
    stage=Stage.DRIVE,
    place=1,
    physics="a warm winding has more resistance and its motor turns slower at the same throttle",
    source="copper's temperature coefficient in the first-order motor model (Drela 2007)",
    parameters=(
        Parameter("speed_loss_per_100K", "1", MAGNETS, 1.0, (0.05, 0.05), amount=True, within=_losses,
            source="39 % more resistance of copper for 100 K, times the tenth of the voltage assumed to "
                   "fall over it; less than nothing where magnets weaken more (IEC 60404-8-1)"),
        Parameter("own_speed_loss", "1", MAGNETS, 1.0, (0.0, 0.05), amount=True,
            source="as for the case, of a winding at most 100 K above it"),
        Parameter("own_s", "s", 5.0, 1000.0, moves=True,
            source="wide: any value between the bounds; windings follow their current within minutes"),
        Parameter("side", "1", 0.0, 1.0,
            source="a number of the pair's rotors (0 upper, 1 lower), each as likely"),
        Parameter("memory_s", "s", 1.0, 10_000.0,
            source="wide: any value between the bounds; windings warm within a minute, cases within a "
                   "quarter of an hour"),
        LOAD,
        Parameter("fading", "1", -0.5, 2.0, moves=True,
            source="wide: any value between the bounds; current falls with the speed, and heat with it"),
    ),
    stand=STAND,
    static=_static,
    required=("speed_loss_per_100K",),
    no_static=_TEMPERATURE_UNKNOWN,
    no_live=_TEMPERATURE_UNKNOWN,
)  # fmt: skip
