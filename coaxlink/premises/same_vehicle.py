"""Is this log of this vehicle, with its outputs in this order? Asked before any verdict.

Lift against weight, commands against rpm and moments against angular accelerations are what the rotor model
and the geometry say. A rotor that lost a part of its loads turns the vehicle askew, too: what that explains
as well is no other vehicle's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import AXES, Airframe
from coaxlink.constants import RAD_S_PER_RPM
from coaxlink.data.logs.flight import MOTOR
from coaxlink.data.samples import DAMAGED, Samples
from coaxlink.frames import Array, FlightFrame
from coaxlink.premises.answer import OtherVehicle
from coaxlink.premises.magnets import miscounted, supply_of
from coaxlink.premises.moves import UNKNOWN
from coaxlink.rotor import RotorModel
from coaxlink.signals import low_pass

# of the weight: an empty pack takes 10 % off what a command lifts, a payload that is none is less
LIFT = 0.15
LEAST_LEFT = 0.7  # from a full pack to an empty one (4.2 to 3.5 V a cell), squared
# of what a moment turns, where the inertia is somebody's word; twice as much where it is an estimate
RESPONSE = 2.0
# share of the variance that one must explain of the other before their ratio means anything. With noise in
# both a gain lies between the slopes of either over the other, which are that share apart (Frisch 1934): at
# TELLS as far as what they are asked for. Of two residues of 100 independent rows (14 s), such a ratio comes
# by chance once in 3,000 (F test)
TELLS = 1.0 / RESPONSE
WORKS = 0.05  # of full command: a motor turns
SPEEDS = 0.15  # of rpm over the common curve: specimens and packs differ by less
FULL_SPEED = 1.4  # of rpm over what full throttle means: 14 magnets taken for 20
# of an ESC's current over its motor's power on the others' scale: ESCs' own sensors are good to a tenth or
# two, efficiency between hover and twice its thrust changes by a tenth
AMPERES = 1.5
FEWEST = 10  # rows with a speed: ten seconds of ESCs that report once a second
# attitude loops answer above 0.5 Hz (PX4 and ArduPilot: 4 to 7 rad/s a radian of error); what is slower, or
# changes once, is a gust or a rotor that begins to lose thrust, and moments balance it without a turn
QUICK_S = 2.0
CURVE = (0.5, 1.0)  # power of rpm over command: thrust goes with it, or speed
# nats by which another order of the motors must explain the flight better: one flight in a thousand has
# exchanged outputs (prior, judgement), and a hundred to one is sure enough to say so
EXCHANGED = float(np.log(1000.0) + np.log(100.0))
BAND_HZ = 4.0  # of what is judged (`channels.flight`): so many independent rows are two a period


@dataclass(frozen=True)
class Flown:
    """What the commands mean and what the vehicle did, row by row and in one band."""

    airframe: Airframe
    model: RotorModel
    speeds: Array  # (rows, N) normalised
    meant: Array  # (rows, 6) body loads by the rotors, N and N m
    moved: Array  # (rows, 6) by mass and inertia
    stretch: Array  # (rows,) number of the contiguous stretch
    step_s: float  # between two rows
    sagged: float = 1.0  # share of the lift that the pack may have left

    def quick(self, loads: Array) -> Array:
        """(rows, C) less their mean over QUICK_S around, within each stretch."""
        rows, half = np.arange(len(loads)), round(0.5 * QUICK_S / self.step_s)
        first, last = (np.searchsorted(self.stretch, self.stretch, side) for side in ("left", "right"))
        low, high = np.maximum(rows - half, first), np.minimum(rows + half + 1, last)
        sums = np.concatenate([np.zeros((1, loads.shape[1])), np.cumsum(loads, axis=0)])
        return np.asarray(loads - (sums[high] - sums[low]) / (high - low)[:, None])


def other_motors(logs: Sequence[Samples], airframe: Airframe) -> Iterator[OtherVehicle]:
    """Rotors of the file without a motor in the log that turned; or other motors by its parameters."""
    have, rotors = len(airframe.rotors), {r.number for r in airframe.rotors}
    for log in logs:
        own = set(log.motors)
        if own and own != rotors and DAMAGED not in log.premises:
            why = f"{log.source or 'the log'} has {len(own)} motors by its parameters, the file {have}"
            yield OtherVehicle("motors", len(own), (have, have), why)
            continue
        numbers = [int(m[1]) for name in log.columns if (m := MOTOR.fullmatch(name))]
        turned = [n for n in numbers if np.any(np.nan_to_num(log[f"motor{n}"]) > WORKS)]
        if turned and not {r.number for r in airframe.rotors} <= set(turned):
            yield OtherVehicle("motors", len(turned), (have, have), motors_differ(log, len(turned), have))


def motors_differ(log: Samples, turned: int, rotors: int) -> str:
    """In words."""
    return f"{turned} motors turn in {log.source or 'the log'}, the airframe file has {rotors} rotors"


def other_vehicle(frame: FlightFrame, logs: Sequence[Samples]) -> tuple[OtherVehicle, ...]:
    """Everything by which a flight is another vehicle's; empty for the file's own."""
    moved, meant, speeds = (_judged(frame, rows) for rows in (frame.measured, frame.predicted, frame.speeds))
    stretch, step_s = frame.stretch[frame.keep], float(np.median(np.diff(frame.time_s[frame.keep])))
    speeds = np.clip(speeds, 0.0, None)
    flown = Flown(frame.airframe, frame.model, speeds, meant, moved, stretch, step_s, _sagged(frame))
    of_escs = (d for log in logs for look in (_speeds, _currents) for d in look(log, frame))
    return (*_lift(flown), *of_escs, *_turns(flown, _left_by_one(flown)))


def differs(flown: Flown) -> tuple[OtherVehicle, ...]:
    """Of `other_vehicle` what needs no log: lift, order of the outputs, response.

    In the air, where nothing is called before it is sure: a pair whose outputs are exchanged passes for one
    weak rotor in the first seconds, so that is no rival here.
    """
    return (*_lift(flown), *_turns(flown, np.ones(3)))


def _judged(frame: FlightFrame, loads: Array) -> Array:
    """(kept, C) low-passed, judged rows."""
    out = np.zeros_like(loads)
    for number in np.unique(frame.stretch):
        rows = frame.stretch == number
        out[rows] = low_pass(loads[rows], frame.rate_hz, frame.cutoff_hz)
    return np.asarray(out[frame.keep])


def _lift(flown: Flown) -> Iterator[OtherVehicle]:
    lift, carried = -float(np.mean(flown.meant[:, 2])), -float(np.mean(flown.moved[:, 2]))
    if not np.isfinite(carried):  # no accelerometer is reported
        return
    ratio = lift / carried if carried > 0.0 else np.inf
    most = (1.0 + LIFT) / flown.sagged
    if not 1.0 - LIFT <= ratio <= most:
        mass = f"{flown.airframe.mass_kg:g} kg"
        why = f"the rotors' commands mean {lift:.0f} N of lift, and " + (
            f"{mass} hang on {carried:.0f} N ({ratio:.2f} times; within {100 * LIFT:.0f} % is expected)"
            if carried > 0.0
            else f"{mass} are pushed down with {-carried:.0f} N: it lies on its back, or falls"
        )
        yield OtherVehicle("lift", ratio, (1.0 - LIFT, most), why)


def _turns(flown: Flown, weak: Array) -> list[OtherVehicle]:
    return _exchanged(flown, weak) or _response(flown, weak)


def _sagged(frame: FlightFrame) -> float:
    """What the log's own voltage may have left of the lift: a motor's speed follows it, thrust its square."""
    if frame.voltage is None:
        return 1.0
    volts = frame.voltage[frame.keep]
    highest = float(np.max(volts))
    share = float(np.mean(volts**2)) / highest**2 if highest > 0.0 else 1.0
    return min(max(share, LEAST_LEFT), 1.0) if np.isfinite(share) else 1.0


def _speeds(log: Samples, frame: FlightFrame) -> Iterator[OtherVehicle]:
    """Commands and rpm of all motors lie on one curve, and it is the rotor model's."""
    numbers = [r.number for r in frame.airframe.rotors if log.has(f"rpm{r.number}")]
    if len(numbers) < len(frame.airframe.rotors):
        return
    given, rpm = (np.stack([log[f"{name}{n}"] for n in numbers], axis=1) for name in ("motor", "rpm"))
    commands = frame.airframe.turned(frame.model, given, supply_of(log))
    turning = np.isfinite(commands) & np.isfinite(rpm) & (commands > 2 * WORKS) & (rpm > 0.0)
    if turning.sum(axis=0).min() < FEWEST:
        return
    if other := miscounted(log, frame.airframe, frame.model):
        yield other
        return
    means = [float(np.median(rpm[t, k] / commands[t, k])) for k, t in enumerate(turning.T)]
    whole = float(np.median(means)) / frame.model.speed_max_rpm
    if not 1.0 / FULL_SPEED <= whole <= FULL_SPEED:
        why = (
            f"rpm are {whole:.2f} times what the commands mean: the number of magnets, or another rotor file"
        )
        yield OtherVehicle("speeds", whole, (1.0 / FULL_SPEED, FULL_SPEED), why)
        return
    command, speed = np.log(commands[turning]), np.log(rpm[turning])
    slope = float(np.cov(command, speed)[0, 1] / max(float(np.var(command)), 1e-12))
    power = float(np.clip(slope, *CURVE))
    apart = np.array([np.median(rpm[t, k] / commands[t, k] ** power) for k, t in enumerate(turning.T)])
    apart /= np.median(apart)
    # one slow motor is a fault; exchanged ones are off both ways
    if apart.max() > 1.0 + SPEEDS and apart.min() < 1.0 - SPEEDS:
        fast, slow = numbers[int(apart.argmax())], numbers[int(apart.argmin())]
        why = (
            f"rpm{fast} and rpm{slow} are {apart.max():.2f} and {apart.min():.2f} times what motor{fast} and "
            f"motor{slow} mean on the others' curve: outputs or ESCs exchanged"
        )
        yield OtherVehicle("speeds", float(apart.max()), (1.0 - SPEEDS, 1.0 + SPEEDS), why)


def _currents(log: Samples, frame: FlightFrame) -> Iterator[OtherVehicle]:
    """Currents go with the power on the shafts, of all motors by the same voltage and efficiency."""
    body, model = frame.airframe, frame.model
    numbers = [r.number for r in body.rotors if log.has(f"current{r.number}_A")]
    if len(numbers) < len(body.rotors):
        return
    given, amperes = (
        np.stack([log[n.format(k)] for k in numbers], axis=1) for n in ("motor{}", "current{}_A")
    )
    speeds = body.turned(model, np.clip(given, 0.0, 1.0), supply_of(log))
    power = body.loads(model, speeds)[1] * speeds * model.speed_max_rpm * RAD_S_PER_RPM
    flying = power > 0.5 * np.nanmedian(power, axis=0)  # idling says nothing
    logged = np.isfinite(power) & np.isfinite(amperes) & flying & (amperes > 0.0)
    if logged.sum(axis=0).min() < FEWEST:
        return
    drawn, worked = (np.array([np.median(x[t, k]) for k, t in enumerate(logged.T)]) for x in (amperes, power))
    each, ranked = drawn / worked, np.sort(drawn) / np.sort(worked)
    each, ranked = each / np.median(each), ranked / np.median(ranked)
    # one alone is a fault; and the same currents have to fit the motors in some other order
    fits = ranked.min() > 1.0 / AMPERES and ranked.max() < AMPERES
    if fits and each.max() > AMPERES and each.min() < 1.0 / AMPERES:
        most, least = numbers[int(each.argmax())], numbers[int(each.argmin())]
        why = (
            f"current{most} and current{least} are {each.max():.2f} and {each.min():.2f} times what their "
            f"motors draw on the others' scale: outputs or ESCs exchanged"
        )
        yield OtherVehicle("currents", float(each.max()), (1.0 / AMPERES, AMPERES), why)


def _left(flown: Flown, order: Sequence[int]) -> Array:
    """(3,) share of each moment's variance that commands in this order leave, whatever the inertia."""
    body, moved = flown.airframe, flown.moved[:, 3:]
    loads = body.body_loads(*body.loads(flown.model, flown.speeds[:, list(order)]))[:, 3:]
    x, y = flown.quick(loads), flown.quick(moved)
    along = np.maximum(np.sum(x * y, axis=0), 0.0)
    explained = along**2 / np.maximum(np.sum(x * x, axis=0) * np.sum(y * y, axis=0), 1e-300)
    return np.asarray(np.maximum(1.0 - explained, 1e-6))


def _left_by_one(flown: Flown) -> Array:
    """(3,) share of each moment's variance that is left if one rotor gives less than its command means.

    Each axis has its own inertia and its own share of what the rotor lost, from nothing to all.
    """
    from scipy.optimize import nnls  # takes a third of a second, and a companion has none

    body = flown.airframe
    thrust, torque = body.loads(flown.model, flown.speeds)
    y = flown.quick(flown.moved[:, 3:])
    whole = flown.quick(body.body_loads(thrust, torque)[:, 3:])
    power = np.maximum(np.sum(y * y, axis=0), 1e-300)
    tried = []
    for one in np.eye(flown.speeds.shape[1]):
        own = flown.quick(body.body_loads(thrust * one, torque * one)[:, 3:])
        left = []
        for k in range(3):
            # a (whole - lost own): a share of it with the rotor whole, the rest without
            fit = nnls(np.stack([whole[:, k], whole[:, k] - own[:, k]], axis=1), y[:, k])[1]
            left.append(fit**2 / power[k])
        tried.append(np.maximum(left, 1e-6))
    return np.asarray(min(tried, key=lambda t: float(np.sum(np.log(t)))))


def _exchanged(flown: Flown, weak: Array) -> list[OtherVehicle]:
    """Outputs in another order that explain what moves the body far better, by the likelihood ratio.

    Two are exchanged at a time, the best first, as long as it helps. n independent rows of a normal residue
    weigh a share left of `best` against `first` by n/2 ln(first / best), axes added; each pair tried is one
    more chance. An axis must be explained, too, and half of what it left be gone: models are not exact. So
    much must it explain beyond one rotor that gives less, which leaves `weak` (3,).
    """
    order = list(range(flown.speeds.shape[1]))
    labelled = best = _left(flown, order)
    first = np.minimum(labelled, weak)
    while True:
        tried = []
        for i, j in combinations(range(len(order)), 2):
            other = list(order)
            other[i], other[j] = other[j], other[i]
            tried.append((_left(flown, other), other))
        now, other = min(tried, key=lambda t: float(np.sum(np.log(t[0]))))
        if float(np.sum(np.log(now / best))) > -1e-3:
            break
        best, order = now, other
    n = min(len(flown.speeds), 2.0 * BAND_HZ * len(flown.speeds) * flown.step_s)
    log_evidence = 0.5 * n * float(np.sum(np.log(first / best)))
    helps: NDArray[np.bool_] = (best < 1.0 - TELLS) & (best < TELLS * first)
    if log_evidence < EXCHANGED + np.log(comb(len(order), 2)) or not helps.any():
        return []
    wrong = [k for k, n in enumerate(order) if k != n]
    numbers = [r.number for r in flown.airframe.rotors]
    named = ", ".join(f"rotor {numbers[k]} by motor{numbers[order[k]]}" for k in wrong)
    axis = int(np.argmax(np.where(helps, first - best, -1.0)))
    why = (
        f"outputs exchanged, or rotors stand elsewhere: {AXES[axis + 1]} follows the commands in "
        f"{100 * (1 - labelled[axis]):.0f} % of its variance as they are named, in "
        f"{100 * (1 - best[axis]):.0f} % with {named}"
    )
    return [OtherVehicle("outputs", 1.0 - float(labelled[axis]), (1.0 - float(best[axis]), 1.0), why)]


def _response(flown: Flown, weak: Array) -> list[OtherVehicle]:
    """Every axis turns as its own moment says: sign and size, where one explains the other."""
    guessed = flown.airframe.source_of("inertia_kg_m2") in UNKNOWN
    most = RESPONSE**2 if guessed else RESPONSE
    x, y = (flown.quick(loads[:, 3:]) for loads in (flown.meant, flown.moved))
    size = np.maximum(np.sqrt(np.sum(x * x, axis=0)), 1e-9)
    gains = np.linalg.lstsq(x / size, y, rcond=None)[0] / size[:, None]  # (of a moment, on an axis)
    jointly = 1.0 - np.sum((y - x @ gains) ** 2, axis=0) / np.maximum(np.sum(y * y, axis=0), 1e-300)
    found = []
    for k, axis in enumerate(AXES[1:]):
        along, power, answer = float(x[:, k] @ y[:, k]), float(x[:, k] @ x[:, k]), float(y[:, k] @ y[:, k])
        explained = along**2 / max(power * answer, 1e-300)
        other = int(np.argmax([abs(g) if j != k else 0.0 for j, g in enumerate(gains[:, k])]))
        crosses = abs(float(gains[other, k])) > abs(float(gains[k, k])) / RESPONSE
        if crosses and jointly[k] > TELLS and 1.0 - jointly[k] < TELLS * min(1.0 - explained, weak[k]):
            gain = float(gains[other, k])
            why = (
                f"{axis} answers {gain:.2f} times the moment of {AXES[other + 1]} and {gains[k, k]:.2f} "
                "times its own: rotors stand elsewhere, or outputs are exchanged"
            )
            found.append(OtherVehicle("response", gain, (-1.0 / RESPONSE, 1.0 / RESPONSE), why))
        elif explained > TELLS and along < 0.0:
            why = f"{axis} turns against its moment ({along / power:.2f} times): spins, outputs or a sensor"
            found.append(OtherVehicle("response", along / power, (1.0 / most, most), why))
        elif explained > TELLS and (along / power > most or answer / along < 1.0 / most):
            why = f"{axis} answers {along / power:.2f} times its moment (within {most:g} times is expected)"
            found.append(OtherVehicle("response", along / power, (1.0 / most, most), why))
    return found
