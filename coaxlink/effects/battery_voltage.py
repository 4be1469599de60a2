"""Battery voltage: a motor driven open loop turns slower as the supply sags.

Source: brushless motor on a duty-cycle controller, no-load speed proportional to voltage (Drela,
First-Order DC Electric Motor Model, 2007). To first order u = u_cmd (V / V_ref)^k, k near 1 (0 with a
speed-governing ESC), so that the loads change by k (V / V_ref - 1) u dL/du.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import LOAD, drive, load_further, loaded, turn, turning
from coaxlink.effects.live import LiveView, SpeedPart
from coaxlink.effects.parameter import Linear, per
from coaxlink.effects.static import LeftOut, StaticVehicle
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import STAND_CHANNELS, FlightFrame, StandFrame


def speed_factor(p: Numbers, voltage_V: ArrayLike) -> Array:
    """Speed over command at a voltage: (V / V_ref)^k, or the stand's own form where a `power` is given.

    Where the drive sags with its load (`load`), that of a rotor at full speed.
    """
    ratio = np.asarray(voltage_V, float) / p["reference_voltage_V"]
    k, power = p["speed_exponent"], p.get("power", 0.0)
    return np.asarray(1.0 + k * _share(ratio, power) if power else ratio**k)


def _share(ratio: Array, power: float) -> Array:
    return np.asarray((ratio**power - 1.0) / power)


def _voltage(frame: FlightFrame) -> Array:
    assert frame.voltage is not None
    return frame.voltage


def _missing(frame: FlightFrame) -> str | None:
    if frame.voltage is None:
        return (
            "voltage_V is not in the log: a sagging battery cannot be distinguished from a change of thrust"
        )
    spread = np.ptp(frame.voltage[frame.keep]) / max(_usual(frame), 1e-6)
    return None if spread > 0.01 else f"voltage_V moves by only {100 * spread:.1f} %"


def _flight_starts(frame: FlightFrame) -> Sequence[Numbers]:
    if why := _missing(frame):
        raise NotShown(why)
    return [{"speed_exponent": 1.0, "reference_voltage_V": _usual(frame)}]


def _changes(frame: FlightFrame, p: Numbers) -> FlightFrame:
    ratio = np.maximum(_voltage(frame), 1e-3)[:, None]
    if "cap" in p:
        lost = lost_to_cap(p, frame.speeds, ratio / p["reference_voltage_V"])
        return frame.turning_at(frame.speeds - p["speed_exponent"] * lost)
    return frame.turning_at(frame.speeds * speed_factor(p, ratio))


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
    return None if spread > LEAST_MOVE else f"the voltage moves by only {100 * spread:.2f} %"


LEAST_MOVE = 1e-3  # of the voltage: two tenths of a per cent of thrust, what a cell of class C3 may err by
POWERS, CAPS, SOFT = (0.4, 0.7, 1.0), (0.75, 0.85, 0.95, 1.05), 0.03  # starts; of normalised speed


def lost_to_cap(p: Numbers, command: ArrayLike, ratio: ArrayLike) -> Array:
    """Normalised speed that a governor cannot hold at a voltage over the usual one: from `cap` on, softly."""
    over = np.asarray(command, float) - p["cap"] * (1.0 + p["reach"] * (np.asarray(ratio, float) - 1.0))
    return np.asarray(p["soft"] * np.logaddexp(0.0, over / p["soft"]))


def _starts(frame: StandFrame) -> Sequence[Numbers]:
    """By a power of the voltage; or a governor holds the speed until its duty cycle is full."""
    if why := _no_voltage(frame):
        raise NotShown(why)
    # the voltage at which a given model holds need not be this run's
    reference = {} if frame.free_nuisance else {"reference_voltage_V": _usual(frame)}
    return [
        *({"speed_exponent": 1.0, **reference, "power": power} for power in POWERS),
        *({"speed_exponent": 1.0, "cap": cap, "soft": SOFT, "reach": 1.0} for cap in CAPS),
    ]


def _further(_: StandFrame, p: Numbers) -> Sequence[Numbers]:
    return [] if "cap" in p else load_further(p)


def _adds(frame: StandFrame, p: Numbers) -> Array:
    v, u = voltages(frame), drive(frame)
    assert v is not None
    if "cap" in p:
        lost = lost_to_cap(p, u, v / p["reference_voltage_V"])
        return frame.slowed(-p["speed_exponent"] * lost)
    # about the log's own voltage; what the reference is off by moves every speed alike, loaded or not
    usual, power = _usual(frame), p.get("power", 1.0)
    moved = p["speed_exponent"] * _share(v / usual, power)
    level = p["speed_exponent"] * float(_share(np.asarray(usual / p["reference_voltage_V"]), power))
    return frame.slowed(loaded(u, p) * moved + u * level)


def _usual(frame: FlightFrame | StandFrame) -> float:
    """The log's median voltage."""
    if _usual not in frame.memo:  # a fit asks for it at every step
        v = _voltage(frame)[frame.keep] if isinstance(frame, FlightFrame) else voltages(frame)
        assert v is not None
        frame.memo[_usual] = float(np.median(v))
    return float(frame.memo[_usual])


def _reference(frame: FlightFrame | StandFrame, p: Numbers, per_unit: float) -> float:
    """The voltage at which the model holds; one that no pack of this log had would be no voltage."""
    usual = _usual(frame)
    return float(np.clip(BY_EXPONENT.value(frame, p, per_unit), 0.5 * usual, 1.6 * usual))


def _as_logged(frame: FlightFrame | StandFrame, p: Numbers) -> float | None:
    """The reference voltage where a stand's nuisance model holds at this log's, or a governor at its own."""
    fitted = isinstance(frame, FlightFrame) or not (frame.free_nuisance or "cap" in p)
    return None if fitted else _usual(frame)


def _over_logged(frame: FlightFrame | StandFrame, p: Numbers) -> float | None:
    return p["reference_voltage_V"] / _usual(frame) if isinstance(frame, FlightFrame) else None


BY_EXPONENT = per("speed_exponent", origin=_usual)


def _cause(frame: StandFrame, _: Numbers, channel: str) -> tuple[str, Array]:
    v = voltages(frame)
    assert v is not None
    return "voltage_V", v[:, 1 if channel.startswith("lower") else 0]


STAND: Tracing[StandFrame] = Tracing(
    needs=("voltage_V",),
    channels=STAND_CHANNELS,
    starts=_starts,
    further=_further,
    adds=_adds,
    cause=_cause,
)
FLIGHT: Tracing[FlightFrame] = Tracing(
    needs=("voltage_V",),
    channels=("force_z", "torque_x", "torque_y", "torque_z"),
    starts=_flight_starts,
    changes=_changes,
    cause=lambda frame, *_: ("voltage_V", _voltage(frame)),
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
    place=1,
    physics="rotor speed follows the supply voltage: u = u_cmd (V / V_ref)^k",
    source="no-load speed of a duty-cycle driven brushless motor (Drela 2007)",
    parameters=(
        Parameter("speed_exponent", "1", 0.02, 2.5, (1.0, 0.4), amount=True, nil=0.0,
            source="Drela 2007: 1 without load and open loop, less under load, 0 with a governor"),
        Parameter("reference_voltage_V", "V", 1.0, 1000.0, follows=_as_logged,
            amount=Linear(BY_EXPONENT.amount, _reference),
            source="wide: any value between the bounds; cells in series are the builder's choice"),
        Parameter("power", "1", 0.2, 4.0, moves=True,
            source="wide: any value between the bounds; a loaded motor's speed bends with the voltage by "
                   "its own resistance"),
        LOAD,
        Parameter("cap", "1", 0.4, 1.5, moves=True,
            source="wide: any value between the bounds; speed over full speed that a governor holds at the "
                   "usual voltage goes with the motor's Kv"),
        Parameter("soft", "1", 0.002, 0.15, moves=True,
            source="wide: any value between the bounds; how gradually a full duty cycle is felt goes with "
                   "the controller"),
        Parameter("reach", "1", 0.2, 3.0, moves=True,
            source="wide: any value between the bounds; 1 where speed goes with the supply, more where its "
                   "current makes it sag"),
        Parameter("over_logged", "1", 0.6, 1.48, follows=_over_logged,
            source="wide: any value between the bounds; beyond, no pack of this log: another name for more "
                   "or less thrust"),
    ),
    flight=FLIGHT,
    stand=STAND,
    static=_static,
    live_speed=_live,
    required=("speed_exponent", "reference_voltage_V"),
    messages={"BATTERY_STATUS": 10.0},
)  # fmt: skip
