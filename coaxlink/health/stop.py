"""Which rotor stopped altogether: what changed within the last half second, by the model of `sequential`.

A rotor that gives nothing is twenty times what that test looks for, and leaves a fiftieth of the time.
Blocks are one period of the telemetry; noise, bias, scale and gusts are followed as there. The filter of
BACK_S ago says what should be seen now, and how surely; what is seen beside it, over two blocks, is a step

    nothing           e ~ N(0, V)            V: the filter's own, gusts since, noise, the model in manoeuvres
    rotor i stops     e ~ N(f_i, V + E_i)    f_i: all of what the model gives the rotor, as the speeds are now
    it loses a part   the same of every tenth of f_i
    a sudden push     e ~ N(0, V + D)        as in `sequential`

So large a signal makes the model's own errors the noise that counts: E_i. How a rotor runs down need not be
known: on its way it is a rotor that loses a part, and no part is called here, nor what one verdict alone
says: a pair on its way passes through the other rotor's pattern. Two things may have happened: the motor
stopped (its loads go, and the wake under it) or the propeller left (its loads go, the wake stays).

Measured rpm, where ESCs tell it, is a witness beside: a rotor whose rpm followed its commands and now is at
less than half of them, alone of all, is as much likelier to have stopped as telemetry seldom loses a value
(DROPPED). Rpm alone calls nobody: a wire that came off reads 0 too.

CALL is where one rotor is likelier than all else together. Pushes are taken to come once in JOLTS_S, stops
once in HOURS: such odds need a likelihood ratio of 100, which a push reaches at most once in 100 (Markov's
inequality), so that a push is taken for a stop at most once in HOURS.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coaxlink.frames import Array
from coaxlink.health.priors import DISTURBED, LOSS_SD
from coaxlink.health.sequential import (
    GUST_S,
    JOLTS_S,
    RATIOS,
    Innovation,
    SequentialTest,
    Suspicion,
    Verdict,
)
from coaxlink.health.stream import HealthInterval
from coaxlink.mixer.plain import PlainRotors
from coaxlink.vehicle import Vehicle

BLOCK_S = 0.02  # a period of 50 Hz
BACK_S = 0.5  # a rotor that runs down by its own drag has lost nine tenths of its thrust by then
HOURS = 100.0  # mean time between false alarms
CALL = 0.5  # probability of one rotor, in two verdicts on end, at which it is called
SIZE = 0.10  # of a fault's effect, all axes alike: the rotor in its place, by pack, inflow and wake
AXIS = 0.05  # and about each axis: inertia 5 %, mass 3 %, arms 1 %
CROSS = 0.03  # of its whole effect, about any axis: what a rotor model is good to
TORQUE = 0.5  # of its torque: gone at once with the motor's current, or with the speed, or braked
BEYOND = 0.2  # of its load: a motor at its end in a pack's last third
PARTS = np.arange(1, 9) / 10.0  # shares lost of a rotor that did not stop
WHOLE = 1.0 + SIZE * np.array([-1.5, -0.75, 0.0, 0.75, 1.5])  # and of one that did
SIZES = np.concatenate([PARTS, WHOLE])
HALF = 0.5  # of the speed commanded: no sound motor under load is as slow
ALIKE, BELIEVED = 0.25, 10  # rpm follows commands within a pack's sag; so often, and it is believed
FRESH_S, RUNNING = 0.25, 0.1  # of rpm, at 10 Hz twice; speed from which on a motor must turn
DROPPED = 0.01  # share of telemetry's values that are lost or 0: bidirectional DShot's error counts


class StopTest(SequentialTest):
    """Blocks of BLOCK_S in, verdicts out: `called` is a rotor that stopped, and no other.

    >>> from coaxlink.files import example
    >>> from coaxlink.vehicle import load_vehicle
    >>> StopTest(load_vehicle(example("x8_demo.toml"))).limit
    18000000.0
    """

    beyond = BEYOND

    def __init__(self, vehicle: Vehicle, hours: float = HOURS, block_s: float = BLOCK_S) -> None:
        self._back = round(BACK_S / block_s)
        self._past: deque[tuple[float, Array, Array]] = deque(maxlen=self._back + 1)
        self._lifts: deque[float] = deque(maxlen=self._back + 1)
        self._scale, self._now_s = 1.0, 0.0
        self._likely = 0  # the rotor of the verdict before
        self._steps: deque[tuple[Array, Array, Array, NDArray[np.bool_]]] = deque(maxlen=2)
        super().__init__(vehicle, hours, block_s)
        self.witness = np.zeros(len(self.numbers))  # log likelihood ratio of each rotor's rpm
        partly, stopped = np.exp(-0.5 * (PARTS / LOSS_SD) ** 2), np.exp(-0.5 * ((WHOLE - 1.0) / SIZE) ** 2)
        shares = np.concatenate([partly / partly.sum(), stopped / stopped.sum()])
        self._odds = np.log(shares * BACK_S / (hours * 3600.0))

    def _forget_onsets(self) -> None:
        self._past.clear()
        self._lifts.clear()
        self._steps.clear()

    def _skip(self, block: HealthInterval) -> None:
        """A short gap hides nothing: what was before it is what the vehicle is held against."""
        if self._past and block.time_s - self._past[-1][0] > GUST_S:
            self._forget_onsets()

    def _in_common(self, block: HealthInterval) -> float:
        """Of BACK_S ago: a stopped rotor is no pack."""
        self._now_s = block.time_s
        self._lifts.append(super()._in_common(block))
        return self._lifts[0]

    def _onset(self, i: Innovation) -> None:
        """Before the filters take the block: what the one of BACK_S ago says of it."""
        rows = np.arange(4)
        x, P = self._x[rows, i.best], self._P[rows, i.best]  # (4, S), (4, S, S)
        own = np.einsum("cs,cst,ct->c", i.H, P, i.H)
        noise = i.variance[rows, i.best] - own
        y = i.innovation[rows, i.best] + (x * i.H).sum(axis=1)
        self._past.append((self._now_s, x.copy(), P.copy()))
        then_s, x, P = self._past[0]
        x, P, since = x.copy(), P.copy(), np.exp((then_s - self._now_s) / GUST_S)
        x[:, 3] *= since
        P[:, 3, :] *= since
        P[:, :, 3] *= since
        P[:, 3, 3] += (1.0 - since**2) * RATIOS[i.best] ** 2 * self._noise[rows, i.best]
        # of the model's lift, before anything happened
        self._scale = float(1.0 + (x[0] @ i.H[0]) / i.H[0, 1])
        off = np.where(i.known, y - (x * i.H).sum(axis=1), 0.0)
        self._steps.append((off, np.einsum("cs,cst,ct->c", i.H, P, i.H), noise, i.known))

    def _weigh(self, block: HealthInterval, lift: float) -> Verdict:
        nothing, before, self._likely = Verdict(block.time_s, True, (), 0.0), self._likely, 0
        if len(self._past) <= self._back or len(self._steps) < 2:
            return nothing
        (e1, _, r1, _), (e2, v, r2, known) = self._steps
        e, V = 0.5 * (e1 + e2), v + 0.25 * (r1 + r2)
        if 0.5 * float((e**2 / V)[known].sum()) < -self._odds.max() - self.witness.max():
            return nothing  # even a step free in each channel is too small
        F = stop_shapes(self._plain, block.speeds) * self._scale / self._reference  # (2, N, 4)
        centre = SIZES[:, None, None, None] * F  # (A, 2, N, 4)
        spread = (AXIS * centre) ** 2 + (CROSS**2) * (centre**2).sum(axis=-1, keepdims=True)
        spread[..., 3] += (TORQUE * centre[..., 3]) ** 2
        gain = _gain(e, V, centre, spread)[..., known].sum(axis=-1) + self._odds[:, None, None]
        gain -= np.log(F.shape[0] * F.shape[1])
        gain[len(PARTS) :, 0] += self.witness
        jolt = _gain(e, V, np.zeros(4), np.full(4, DISTURBED**2))[known].sum() + np.log(BACK_S / JOLTS_S)
        top = max(float(gain.max()), float(jolt), 0.0)
        jolted = float(np.exp(jolt - top))
        weight = np.exp(gain - top).sum(axis=1)  # (A, N)
        total = float(np.exp(-top) + jolted + weight.sum())
        stopped = weight[len(PARTS) :].sum(axis=0) / total
        i = int(np.argmax(stopped))
        found = Suspicion(self.numbers[i], float(stopped[i]), 1.0, SIZE, True)
        self._likely = found.rotor if found.probability >= CALL else 0
        called = found if before == self._likely == found.rotor else None
        return Verdict(block.time_s, True, (found,), jolted / total, called)


class RpmWitness:
    """What the ESCs' rpm says of each rotor: log odds that it stopped, 0 where it says nothing.

    >>> import numpy as np
    >>> from coaxlink.files import example
    >>> from coaxlink.vehicle import load_vehicle
    >>> vehicle = load_vehicle(example("y6.toml"), example("rotor_paper.toml"))
    >>> witness, top = RpmWitness(vehicle), vehicle.speed_model.speed_max_rpm
    >>> for k in range(20):
    ...     witness.heard(0.1 * k, 0, [0.6 * top] * 4, np.full(6, 0.6))
    >>> witness.heard(2.0, 0, [0.6 * top, 0.1 * top, 0.6 * top, 0.6 * top], np.full(6, 0.6))
    >>> witness.odds(2.05).round(1).tolist()
    [0.0, 4.6, 0.0, 0.0, 0.0, 0.0]
    """

    def __init__(self, vehicle: Vehicle) -> None:
        n = len(vehicle.airframe.rotors)
        self._top = vehicle.speed_model.speed_max_rpm
        self._low, self._right, self._when = np.zeros(n, bool), np.zeros(n, int), np.full(n, -np.inf)

    def heard(self, time_s: float, first: int, rpm: Sequence[float], speeds: Array) -> None:
        """Four ESCs' rpm, the first that of rotor `first` (from 0); (N,) speeds that were commanded."""
        for i, value in enumerate(rpm, first):
            if i >= len(self._when) or not speeds[i] > RUNNING:
                continue
            ratio = abs(value) / (self._top * speeds[i])
            self._low[i] = ratio < HALF
            if 1.0 - ALIKE < ratio < 1.0 + ALIKE:
                self._right[i] += 1
            elif not ratio < HALF:
                self._right[i] = 0
            self._when[i] = time_s

    def odds(self, time_s: float) -> Array:
        """(N,) now. Two at once are a bus that lost its words."""
        low = self._low & (self._right >= BELIEVED) & (np.abs(time_s - self._when) < FRESH_S)
        return np.where(low & (low.sum() == 1), -np.log(DROPPED), 0.0)


def _gain(e: Array, V: Array, centre: Array, spread: Array) -> Array:
    """Log likelihood ratio of e ~ N(centre, V + spread) to e ~ N(0, V), channel by channel."""
    wide = V + spread
    return np.asarray(0.5 * (e**2 / V - (e - centre) ** 2 / wide - np.log(wide / V)))


def stop_shapes(rotors: PlainRotors, speeds: Array) -> Array:
    """(2, N, 4) added to the wrench by a stopped motor of each rotor, and by its lost propeller."""
    n = len(speeds)
    loads = np.array(rotors.loads(speeds))
    now = rotors.per_load @ loads
    out = np.zeros((2, n, 4))
    for i in range(n):
        still = np.array(speeds, float)
        still[i] = 0.0
        out[0, i] = rotors.wrench(still) - now
        out[1, i] = -rotors.per_load[:, [i, n + i]] @ loads[[i, n + i]]
    return out
