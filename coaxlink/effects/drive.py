"""What effects between throttle and speed share on a stand.

They bend the speed that a throttle gives. Where the log has rpm they show there (channels upper_speed,
lower_speed) and not in the loads; where it has throttles only, in every load.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.effects.parameter import Numbers, Parameter
from coaxlink.effects.static import StaticVehicle, refuse_speed
from coaxlink.effects.tracing import Array
from coaxlink.frames import StandFrame

SETTLED_S = 0.6  # s from row to row, judgement: a lag has settled in between, and nothing moves within a row
LOAD = Parameter("load", "1", -0.8, 2.0, moves=True,
    source="wide: any value between the bounds; how resistance and load share the fall of speed goes with "
           "the motor")  # fmt: skip


def drive(frame: StandFrame) -> Array:
    """(rows, 2) the throttles."""
    return frame.speeds if frame.throttles is None else frame.throttles


def drivable(frame: StandFrame) -> str | None:
    if frame.driven or frame.throttles is not None:
        return None
    return "the log has no throttle: speeds were measured, so the drive cannot be judged"


def loaded(u: Array, p: Numbers) -> Array:
    """Of speeds, how much a change of the drive is felt: as the speed, or more where the motor is loaded."""
    return np.asarray(u * np.maximum(u, 1e-3) ** p["load"] if "load" in p else u)


def load_further(p: Numbers) -> Sequence[Numbers]:
    """The same with a share that goes with the load."""
    return [] if "load" in p else [{**p, "load": 0.2}]


def changed_by(frame: StandFrame, speeds: Array) -> Array:
    """(rows, 6) what other speeds than the throttles' do, in full."""
    out = np.zeros((len(speeds), 6))
    u = drive(frame)
    if frame.driven or frame.throttles is None:
        out[:, :4] = frame.loads_at(speeds) - frame.loads_at(u)
    else:
        out[:, 4:] = speeds - u
    return out


def turning(command: Array, share: float, numbers: Numbers) -> Array:
    """Speeds of commands that a change of the drive by `share` (0 is none) leaves."""
    return np.asarray(command + share * loaded(np.asarray(command, float), numbers))


def turn(vehicle: StaticVehicle, factor: float, numbers: Numbers, condition: str, value: float) -> None:
    """Let rotors turn at `factor` of their commands, or at another share where the motor is loaded (`load`).

    Raises InputError where no drive does that at this condition.
    """
    if "load" not in numbers:
        vehicle.turn(factor, condition, value)
        return
    refuse_speed(factor, condition, value)
    vehicle.turn_at(lambda u: turning(u, factor - 1.0, numbers))


def remembered(power: Array, time_s: Array, memory_s: float) -> Array:
    """(rows, K) what first-order memories that begin with nothing hold of powers (rows, K).

    Between runs, a gap in time, it falls to nothing as fast.
    """
    step = np.diff(time_s, prepend=time_s[:1])
    usual = float(np.median(step))
    keep = np.exp(-np.maximum(step, 0.0) / memory_s)
    took = 1.0 - np.exp(-np.clip(step, 0.0, 2.0 * usual) / memory_s)
    out = np.empty_like(power)
    for k, added in enumerate((took[:, None] * power).T):  # by plain numbers: a search asks for it often
        now, states = 0.0, []
        for share, more in zip(keep.tolist(), added.tolist(), strict=True):
            now = now * share + more
            states.append(now)
        out[:, k] = states
    return out
