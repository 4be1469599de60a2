"""Motor heating: a warm winding has more resistance, and its motor turns slower at the same throttle.

Source: copper's temperature coefficient in the first-order motor model (Drela, First-Order DC Electric Motor
Model, 2007). Without a thermometer nothing has this name: what follows the power of the rows before is as
well the room's air, set turning, or a pack's charge.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import LOAD, drive, loaded, remembered, turn
from coaxlink.effects.parameter import Range
from coaxlink.effects.static import LeftOut, StaticVehicle
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import STAND_CHANNELS, StandFrame

# of speed in 100 K: remanence falls by 0.12 % a kelvin (NdFeB) to 0.2 % (ferrite; IEC 60404-8-1), and speed
# without load goes with its inverse; a case is cooler than what is inside by up to a third (judgement)
MAGNETS = -0.3
# of speed in 100 K: copper resists 39 % more; of a supply's voltage half falls over a winding at the most
# power that a motor turns out, and where current goes with speed squared that is 0.13 of the speed; a case
# is cooler by up to a third
COPPER = 0.2
LEAST_K = 3.0  # twice what a thermocouple of class 1 is off by (IEC 60584-1)
OWN_S = (20.0, 60.0, 180.0)  # starts of the fit: windings of motors of 0.1 to 1 kg (judgement)


def _heat(frame: StandFrame, p: Numbers) -> Array:
    """(rows,) temperature over 25 C in 100 K; of an earlier version's file, what the throttles put in."""
    if "memory_s" in p:
        power = np.sum(drive(frame) ** 3, axis=1, keepdims=True)
        return remembered(power, frame.time_s, p["memory_s"])[:, 0]
    logged = frame.context("motor_temperature_C")
    assert logged is not None
    return (logged - 25.0) / 100.0


def _no_heat(frame: StandFrame) -> str | None:
    logged = frame.context("motor_temperature_C")
    if logged is None:
        return "motor_temperature_C is not in the log"
    if np.ptp(logged) < LEAST_K:
        return f"motor_temperature_C moves by only {np.ptp(logged):.1f} K"
    return None


def _starts(frame: StandFrame) -> Sequence[Numbers]:
    """Both motors; windings above the case that carries the thermometer, each motor's by its own power; one.

    Two nodes, winding and case (Mellor, Roberts and Turner 1991). One motor of the pair: a worn bearing's, or
    a short one's.
    """
    if why := _no_heat(frame):
        raise NotShown(why)
    loss: Numbers = {"speed_loss_per_100K": 0.05}
    windings: list[Numbers] = [{**loss, "own_speed_loss": 0.05, "own_s": s} for s in OWN_S]
    return [loss, *windings, *({**loss, "side": float(side)} for side in (0, 1))]


def _further(_: StandFrame, p: Numbers) -> Sequence[Numbers]:
    if "load" in p:
        return []
    return [{**p, "load": 0.1} if "own_s" in p else {**p, "load": 0.1, "fading": 0.1}]


def _own_heat(frame: StandFrame, memory_s: float) -> Array:
    """(rows, 2) what each motor is above the case, of the most at full throttle: lags behind its power,
    u^3."""
    known, states = frame.memo.get(_own_heat, (None, None))
    if known != memory_s:  # a cause is asked for of every channel
        states = remembered(drive(frame) ** 3, frame.time_s, memory_s)
        frame.memo[_own_heat] = memory_s, states
    return np.asarray(states)


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
    return (0.0 if "side" in p else MAGNETS), COPPER


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
        Parameter("speed_loss_per_100K", "1", MAGNETS, COPPER, (0.05, 0.05), amount=True, within=_losses,
            source="39 % more resistance of copper for 100 K, times the tenth of the voltage assumed to "
                   "fall over it; less than nothing where magnets weaken more (IEC 60404-8-1)"),
        Parameter("own_speed_loss", "1", MAGNETS, COPPER, (0.0, 0.05), amount=True,
            source="as for the case, of a winding at most 100 K above it"),
        Parameter("own_s", "s", 5.0, 1000.0, moves=True,
            source="wide: any value between the bounds; windings follow their current within minutes"),
        Parameter("side", "1", 0.0, 1.0,
            source="a number of the pair's rotors (0 upper, 1 lower), each as likely"),
        Parameter("memory_s", "s", 1.0, 10_000.0,
            source="wide: any value between the bounds; only in older rotor files, no search has it"),
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
