"""Which rotor lost thrust, while it flies: a Bayesian sequential test on blocks of the residual wrench.

Nothing wrong, for each channel: residual = b lift + s wrench + t wrench' + d + noise

b is a centre of mass that is not where it was drawn, s scale (inertia, air, voltage), t a delay, d a
disturbance that comes and goes with gusts (Ornstein and Uhlenbeck); a Kalman filter follows them. How large
d is beside the noise is not known: a filter for each of RATIOS runs, their noise is learnt as they go, and
the one that predicted best of late, with forgetting, speaks (Raftery, Karny and Ettler 2010).

A rotor that lost thrust at block k shifts every later innovation by a known signature (Willsky and Jones
1976). Its likelihood ratio, the loss integrated over its prior, is summed over the last WINDOW onsets
(Shiryaev 1963, Roberts 1966). With nothing wrong the sum less the number of blocks is a martingale at most:
the mean time to a false alarm is no less than the threshold (Pollak 1987; Basseville and Nikiforov 1993,
sections 2.2 and 4.3; Lorden 1971). So the threshold is the mean time wanted, in blocks. A sudden
disturbance of any direction (a gust's edge, a contact, a load let go) is a hypothesis beside the rotors,
and takes away what fits no rotor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import FULL, GRAVITY_M_S2, TURNING
from coaxlink.frames import Array
from coaxlink.health.priors import (
    CG_DRAWN_M,
    DELAY_TODAY_S,
    DISTURBED,
    LIFT_TODAY,
    LOSS_SD,
    MATTERS,
    TILT_ARM_M,
    WATCH,
)
from coaxlink.health.stream import BLOCK_S, HealthInterval
from coaxlink.mixer.plain import PlainRotors
from coaxlink.vehicle import Vehicle

HOURS = 100.0  # mean time between false alarms
CALL = 0.95  # probability of one rotor at which it is called
JOLTS_S = 3600.0  # between sudden disturbances that are no gusts: a load let go, a contact
GUST_S = 2.5  # of d: how long a gust lasts over a hovering vehicle, MIL-F-8785C's lengths at a few m/s
RATIOS = np.array([0.0, 0.1, 0.3, 1.0, 3.0, 10.0])  # of d's standard deviation to the noise's
MEMORY = 300  # blocks over which noise and the filters' scores are forgotten
WINDOW = 25  # onsets looked back to: the two seconds that a loss may take to be named, and a little
# share of its first block for which a loss was there: it sets in anywhere within one, and the first blocks,
# which no filter has followed yet, say most of its size
WITHIN = np.array([0.2, 0.4, 0.6, 0.8, 1.0])
LASTING = 5  # blocks that an onset is old: the first holds a part of it, motors and loops settle in the next
SETTLING = 30  # blocks before anything is reported: three times what four unknowns need
SCALE = 0.10  # of the wrench: inertia as drawn, voltage, air
MODEL = 0.03  # of a rotor's load beside its usual one: what a rotor model is good to
TIMING_S = 0.006  # of a wrench's slope: a 50 Hz stream's period over root 12
COMMON = (0.5, 1.5)  # of lift: more is no pack's and no air's
FENCE = 9.0  # of a squared innovation: one farther out teaches no noise and chooses no filter (Huber 1981)
DRIFT = 1e-3  # of b's and s's prior a root block: a pack sags over some thousand blocks
FLOOR = 1e-4  # of the reference: the resolution of what is told
AIRBORNE = 0.3  # of weight: less lift is no flight
STATES = 4
TORQUES = (0.3, 0.6, 0.9, 1.25)  # of the thrust's loss: a chip 0.6, a shortened blade 1.25 (T ~ R^4, Q ~ R^5)


@dataclass(frozen=True)
class Suspicion:
    """One rotor, if it is this one."""

    rotor: int  # number
    probability: float
    loss: float  # of its thrust at the commanded speed
    loss_sd: float
    slower: bool  # a motor that turns slower fits better than a blade that lifts less


@dataclass(frozen=True)
class Verdict:
    """What is believed after a block."""

    time_s: float
    ready: bool  # enough was seen to say anything
    suspicions: tuple[Suspicion, ...]  # most likely first; empty where nothing stands out
    disturbed: float  # probability of a sudden disturbance that is no rotor's
    called: Suspicion | None = None  # a rotor, in the block in which it is called

    @property
    def word(self) -> str:
        """sound, watch, called or not known yet."""
        if self.called:
            return "called"
        if not self.ready:
            return "not known yet"
        return "watch" if self.suspicions and self.suspicions[0].probability >= WATCH else "sound"


@dataclass(frozen=True)
class Innovation:
    """What a block brings to the R filters of four channels, before they take it; S states each."""

    H: Array  # (4, S) what a unit of each state adds to the channel
    K: Array  # (4, R, S) Kalman gain; 0 in channels that are not known
    variance: Array  # (4, R) of the innovation
    innovation: Array  # (4, R)
    best: NDArray[np.intp]  # (4,) the filter that predicted best of late
    keep: float  # share of a gust's disturbance that is left after the block
    shape: Array  # (4,) lift, as a unit of a fault's effect is counted
    known: NDArray[np.bool_]  # (4,)


class SequentialTest:
    """Blocks in, verdicts out. `hours`: mean time between false alarms (at a hazard of one loss in as long).

    >>> from coaxlink.files import example
    >>> from coaxlink.vehicle import load_vehicle
    >>> SequentialTest(load_vehicle(example("x8_demo.toml"))).limit
    3600000.0
    """

    def __init__(self, vehicle: Vehicle, hours: float = HOURS) -> None:
        frame = vehicle.airframe
        weight = frame.mass_kg * GRAVITY_M_S2
        arm = max(float(np.hypot(*r.position_m[:2])) for r in frame.rotors)
        self.numbers = tuple(r.number for r in frame.rotors)
        self.limit = hours * 3600.0 / BLOCK_S
        self.vehicle, self._weight = vehicle, weight
        self._plain = PlainRotors.of(vehicle)
        self._reference = weight * np.array([1.0, arm, arm, arm])
        prior = np.array(
            [
                [LIFT_TODAY, SCALE, DELAY_TODAY_S, 0.0],
                *[[CG_DRAWN_M / arm, SCALE, DELAY_TODAY_S, 0.0]] * 2,
                [TILT_ARM_M / arm, SCALE, DELAY_TODAY_S, 0.0],
            ]
        )
        self._prior = prior**2  # (4, S)
        self.restart()

    def restart(self) -> None:
        """Forget the flight."""
        r = len(RATIOS)
        self._x = np.zeros((4, r, STATES))
        self._P = np.zeros((4, r, STATES, STATES))
        for k in range(STATES):
            self._P[:, :, k, k] = self._prior[:, k, None]
        self._noise = np.full((4, r), (10 * FLOOR) ** 2)
        self._score = np.zeros((4, r))
        self._usual = np.zeros(2 * len(self.numbers))
        self.blocks, self._observed_s = 0, 0.0
        self._forget_onsets()

    @property
    def _settled(self) -> bool:
        return self.blocks > SETTLING and self._observed_s > SETTLING * BLOCK_S

    def _forget_onsets(self) -> None:
        self._shift = np.zeros((WINDOW, 4, len(RATIOS), STATES))
        self._information = np.zeros((WINDOW, 4))  # information on a unit step in each channel
        self._correlation = np.zeros((WINDOW, 4))  # and its correlation with the innovations
        self._both = np.zeros((WINDOW, 4))  # information that a step shares with one a block later
        self._onsets = 0

    def step(self, block: HealthInterval) -> Verdict:
        """One block on."""
        lift = float(block.predicted[0]) / self._weight
        if lift < AIRBORNE:
            self.restart()
            return Verdict(block.time_s, False, (), 0.0)
        if block.after_gap:  # what began in a gap is not seen setting in
            self._forget_onsets()
        if ((block.speeds < TURNING) | (block.speeds > FULL)).any():
            self._forget_onsets()  # what changed meanwhile is not told from what changed because of it
            return Verdict(block.time_s, self._settled, (), 0.0)
        self._filter(block, lift)
        self.blocks += 1
        self._observed_s += block.seconds
        if not self._settled:
            self._forget_onsets()
            return Verdict(block.time_s, False, (), 0.0)
        return self._weigh(block, lift)

    def _filter(self, block: HealthInterval, lift: float) -> None:
        """Predict and update all filters, and the signatures of all onsets."""
        known = np.isfinite(block.measured)
        common = np.array([1.0, *[self._in_common(block)] * 3])
        wrench, slope = (common * a / self._reference for a in (block.predicted, block.slope))
        y = np.where(known, block.measured / self._reference - wrench, 0.0)
        shape = lift * common
        H = np.stack([shape, wrench, slope, np.ones(4)], axis=1)  # (4, S)
        share = 1.0 / min(self.blocks + 1, MEMORY)
        loads = np.array(self._plain.loads(block.speeds))
        self._usual = self._usual + share * (loads - self._usual)
        beside = (self._plain.per_load * (loads - self._usual)) ** 2  # (4, 2N)
        travel = TIMING_S * block.travel / block.seconds
        extra = ((MODEL**2 * beside.sum(axis=1) + travel**2) / self._reference**2)[:, None]
        keep = np.exp(-block.seconds / GUST_S)
        x, P = self._x, self._P
        x[..., 3] *= keep
        P[..., 3, :] *= keep
        P[..., :, 3] *= keep
        P[..., 3, 3] += (1.0 - keep**2) * RATIOS**2 * self._noise
        P[..., 0, 0] += (DRIFT**2 * self._prior[:, 0])[:, None]
        P[..., 1, 1] += (DRIFT**2 * self._prior[:, 1])[:, None]
        PH = (P @ H[:, None, :, None])[..., 0]
        S = (PH @ H[:, :, None])[..., 0] + self._noise + extra
        innovation = y[:, None] - (x @ H[:, :, None])[..., 0]
        K = np.where(known[:, None, None], PH / S[..., None], 0.0)
        square = innovation**2 / S
        if self.blocks > 0:
            share = 1.0 / min(self.blocks + 1, MEMORY)
            self._score += (-0.5 * (np.log(S) + np.minimum(square, FENCE)) - self._score) * share
        best = np.argmax(self._score, axis=1)
        self._onset(Innovation(H, K, S, innovation, best, float(keep), shape, known))
        x += K * innovation[..., None]
        P -= K[..., None] * PH[..., None, :]
        share = 1.0 / min(self.blocks + 3, MEMORY)
        learnt = self._noise * (1.0 + share * (np.minimum(square, FENCE) - 1.0))
        self._noise = np.where(known[:, None], np.maximum(learnt, FLOOR**2), self._noise)

    def _in_common(self, block: HealthInterval) -> float:
        """Lift over the model's: what all rotors have in common (pack, air), and moments scale with it."""
        if not math.isfinite(block.measured[0]):
            return 1.0
        return float(np.clip(block.measured[0] / block.predicted[0], *COMMON))

    def _onset(self, i: Innovation) -> None:
        if self._onsets == WINDOW:
            for a in (self._shift, self._information, self._correlation, self._both):
                a[:-1] = a[1:].copy()
        else:
            self._onsets += 1
        n = self._onsets
        for a in (self._shift, self._information, self._correlation, self._both):
            a[n - 1] = 0.0
        shift = self._shift[:n]
        shift[..., 3] *= i.keep
        rho = i.shape[:, None] - (shift @ i.H[:, :, None])[..., 0]
        shift += i.K * rho[..., None]
        rows = np.arange(4)
        sd = np.sqrt(i.variance[rows, i.best])
        z = np.where(i.known, i.innovation[rows, i.best] / sd, 0.0)
        h = np.where(i.known, rho[:, rows, i.best] / sd, 0.0)
        self._information[:n] += h * h
        self._correlation[:n] += h * z
        self._both[: n - 1] += h[:-1] * h[1:]

    def _weigh(self, block: HealthInterval, lift: float) -> Verdict:
        """Likelihood ratios of all onsets of all hypotheses, and the probabilities."""
        if self._onsets <= LASTING:
            return Verdict(block.time_s, True, (), 0.0)
        information, correlation = self._within()
        most = float((0.5 * correlation**2 / np.maximum(information, 1e-12)).sum(axis=1).max())
        if most < np.log(0.1 * WATCH * self.limit / WINDOW):  # even a step free in each channel
            return Verdict(block.time_s, True, (), 0.0)
        F = fault_shapes(self.vehicle, self._plain, block.speeds) / (self._reference * lift)
        logs, means, sds = self._rotors(F, information, correlation)  # (K, T, N) each
        N = len(self.numbers)
        logs = logs - np.log(len(F) * N * len(WITHIN) * self.limit)
        p2 = DISTURBED**2
        jolt = (0.5 * correlation**2 / (information + 1.0 / p2) - 0.5 * np.log1p(p2 * information)).sum(
            axis=1
        )
        jolt = jolt + np.log(BLOCK_S / JOLTS_S / len(WITHIN))
        top = max(float(logs.max()), float(jolt.max()), 0.0)  # the logs run to thousands
        weights, jolted = np.exp(logs - top), float(np.exp(jolt - top).sum())
        each = weights.sum(axis=(0, 1))
        total = float(np.exp(-top) + jolted + each.sum())
        found = []
        for i in np.argsort(-each):
            own = weights[:, :, i] / max(float(each[i]), 1e-300)
            mean = float(np.sum(own * means[:, :, i]))
            square = float(np.sum(own * (means[:, :, i] ** 2 + sds[:, :, i] ** 2)))
            slower = float(own[len(TORQUES)].sum()) > 0.5
            # a share of the thrust at the commanded speed, and that is known to LIFT_TODAY, as in `judge`
            sd = math.sqrt(max(square - mean**2, 0.0) + (LIFT_TODAY * mean) ** 2)
            found.append(
                Suspicion(self.numbers[i], float(each[i] / total), min(max(mean, 0.0), 1.0), sd, slower)
            )
        called = found[0] if found[0].probability >= CALL else None
        return Verdict(block.time_s, True, tuple(found), jolted / total, called)

    def _within(self) -> tuple[Array, Array]:
        """(T, 4) information and correlation of every onset that is old enough, within a block as between."""
        n = self._onsets - LASTING
        f = WITHIN[:, None, None]
        (one, next_one), (pull, next_pull) = (
            (a[:n], a[1 : n + 1]) for a in (self._information, self._correlation)
        )
        information = f**2 * one + 2 * f * (1 - f) * self._both[:n] + (1 - f) ** 2 * next_one
        correlation = f * pull + (1 - f) * next_pull
        return information.reshape(-1, 4), correlation.reshape(-1, 4)

    def _rotors(self, F: Array, information: Array, correlation: Array) -> tuple[Array, Array, Array]:
        """(K, T, N) log likelihood ratio, mean loss and its sd, for each kind of loss."""
        precision = np.einsum("tc,knc->ktn", information, F * F) + 1.0 / LOSS_SD**2
        means = np.einsum("tc,knc->ktn", correlation, F) / precision
        gain = 0.5 * means**2 * precision - 0.5 * np.log(precision * LOSS_SD**2)
        # what matters is more than a propeller's scatter: that part of the prior, and of the posterior
        sds = precision**-0.5
        return (
            gain + log_normal((means - MATTERS) / sds) - log_normal(np.array(-MATTERS / LOSS_SD)),
            means,
            sds,
        )


def log_normal(x: Array) -> Array:
    """Log of the standard normal distribution, without SciPy (below -20: Abramowitz, Stegun 26.2.12).

    >>> log_normal(np.array([-30.0, -20.0, 0.0])).round(4).tolist()
    [-454.3212, -203.9172, -0.6931]
    """
    near = np.maximum(x, -20.0)
    share = np.vectorize(math.erfc, otypes=[float])(-near / math.sqrt(2.0))
    far = np.minimum(x, -20.0)
    tail = -0.5 * far**2 - np.log(-far * math.sqrt(2.0 * math.pi)) + np.log1p(-1.0 / far**2 + 3.0 / far**4)
    return np.asarray(np.where(x > -20.0, np.log(0.5 * share), tail))


def fault_shapes(vehicle: Vehicle, rotors: PlainRotors, speeds: Array) -> Array:
    """(K, N, 4) added to the wrench by the loss of each rotor's whole thrust, for each kind of loss.

    Blades lose TORQUES as much torque; a motor that turns slower unloads its own and the rotor under it as
    the model says, at the slope that the loss begins with.
    """
    frame = vehicle.airframe
    per_thrust, per_torque = (a.T for a in np.split(rotors.per_load, 2, axis=1))  # (N, 4)
    thrust, torque, slow = np.zeros(len(speeds)), np.zeros(len(speeds)), np.zeros((len(speeds), 4))
    lost = np.zeros(len(speeds))
    pairs = [*frame.pairs, *((i, -1) for i in frame.singles)]
    for a, b in pairs:
        u, v = float(speeds[a]), float(speeds[b]) if b >= 0 else 0.0
        loads = [
            s.at(u, v)
            for s in (rotors.upper_thrust, rotors.upper_torque, rotors.lower_thrust, rotors.lower_torque)
        ]
        effect = [
            [per_thrust[a], per_torque[a]],
            [per_thrust[b], per_torque[b]] if b >= 0 else [np.zeros(4)] * 2,
        ]
        columns = [*effect[0], *effect[1]]
        thrust[a], torque[a] = loads[0][0], loads[1][0]
        slow[a] = -u * sum(load[1] * c for load, c in zip(loads, columns, strict=True))
        lost[a] = u * loads[0][1]
        if b >= 0:
            thrust[b], torque[b] = loads[2][0], loads[3][0]
            slow[b] = -v * sum(load[2] * c for load, c in zip(loads, columns, strict=True))
            lost[b] = v * loads[2][2]
    motor = slow * (thrust / np.maximum(lost, 1e-9))[:, None]
    lift, drag = per_thrust * thrust[:, None], per_torque * torque[:, None]
    return np.stack([*(-(lift + share * drag) for share in TORQUES), motor])
