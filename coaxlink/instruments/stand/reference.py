"""What the columns of a stand log should read, and how far they are from it.

Yardstick of the chain: the given rotor model, or the polynomials that the rows of the log agree on, and a
curve of speed over throttle. A sound reading may be off by the tolerance, or by whatever physics may do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from coaxlink.channels.stand import dictionary_of
from coaxlink.frames import Array, StandFrame
from coaxlink.instruments.chain import BEGINS, SURE, log_evidence_of
from coaxlink.instruments.findings import Mask
from coaxlink.instruments.stand.states import Readings, State, readings_of
from coaxlink.rotor.model import LOADS
from coaxlink.rotor.polynomial import design_matrix

# priors: name = value  # unit, source
TOLERANCE = 0.03  # of the reference load or speed: what a map of another day or a curve of throttle errs by
FINEST = 0.003  # of the reference: cells of stands are linear to that
PHYSICS = (0.6, 1.6)  # times a load or a speed over throttle: no effect of physics changes one by more
PLAY = 0.1  # of the reference, judgement: nor by more where little is due; play, stiction, a motor's start
EFFECT = np.log(10.0)  # nats: an effect as large as that is in one of ten rows
LOADED, FAIR = 0.25, (0.2, 5.0)  # of the reference: less load tells no ratio; beyond, a tenth of that does
BEARS_LOAD = 0.2  # of full speed: a rotor near rest has no load to lose, whatever wake it stands in
GONE = 0.05  # of the load: what a cell reads whose plug is off
QUIETEST = 0.25  # of the rows say what noise is: the others may be of another gain
FIT_ROWS, RICH = 4000, 100  # effort; places that a polynomial of third order wants


@dataclass(frozen=True)
class Reference:
    """What loads and speeds should be, and how far each state leaves them from it."""

    frame: StandFrame
    fits: dict[int, tuple[list[str], Array]]  # of loads (terms, coefficients); none: the given model's
    curves: dict[int, Array]  # of speeds over throttle
    level: Array  # (4,) of another day, times the given model's loads
    reference: Array  # (6,)
    tolerance: Array  # (6,) what sound rows are off by

    def due(self, log: Readings) -> Array:
        """(rows, 6) loads at these speeds, and speeds at these throttles."""
        out = np.zeros((len(log.speeds), 6))
        if not self.frame.free_nuisance:
            out[:, :4] = self.level * self.frame.loads_at(log.speeds)
        for c, (names, fit) in self.fits.items():
            out[:, c] = design_matrix(names, log.speeds[:, 0], log.speeds[:, 1]) @ fit
        for side, fit in self.curves.items():
            out[:, 4 + side] = curves_of(log.throttles, side, len(fit) > 4) @ fit
        return out

    def misses(self, log: Readings, due: Array) -> Array:
        """(rows, 6) in tolerances; of what the log has not, none."""
        off = (np.concatenate([log.loads, log.speeds], axis=1) - due) / self.tolerance
        off[:, [c for c in range(6) if c not in self.frame.present]] = 0.0
        return np.asarray(off)

    def sound(self, log: Readings) -> tuple[Array, Mask]:
        """(rows, 6) nats against what is read, as labelled, and whether physics may have changed it so."""
        due = self.due(log)
        read = np.concatenate([log.loads, log.speeds], axis=1)
        low, high = np.sort([PHYSICS[0] * due, PHYSICS[1] * due], axis=0)
        play = PLAY * self.reference
        low, high = np.minimum(low, due - play), np.maximum(high, due + play)
        possible = (read >= low) & (read <= high)
        spread = (high - low) / self.tolerance
        effect = EFFECT + np.log(np.maximum(spread / np.sqrt(2.0 * np.pi), 1.0))
        plain = log_evidence_of(self.misses(log, due))
        return np.where(possible, np.minimum(plain, effect), plain), possible

    def undone(self, state: State, due: Array) -> Readings:
        """The readings as they should be, where a tachometer reads anything by what throttle gives."""
        log = readings_of(self.frame)
        if state.side < 0 or state.ratio:
            return state.undo(log)
        speeds = log.speeds.copy()
        speeds[:, state.side] = due[:, 4 + state.side]
        return replace(log, speeds=speeds)

    def won(self, state: State, sound: Array, possible: Mask, due: Array) -> Array:
        """(rows,) nats by which a state explains the readings better."""
        log, read = readings_of(self.frame), self.undone(state, due)
        expected = due if state.one_cell else self.due(read)
        off = self.misses(read, expected)
        cost = log_evidence_of(off)
        if state.side >= 0:
            c = 4 + state.side
            if not state.ratio:  # anything up to twice full speed
                cost[:, c] = np.log(2.0 / self.tolerance[c])
            elif c in self.frame.present:
                cost[:, c] += np.log(state.ratio)
        if not state.factor:
            (c,) = state.channels
            cost[:, c] = log_evidence_of(
                log.loads[:, c] / np.clip(GONE * np.abs(due[:, c]), 1e-9, self.tolerance[c])
            )
        elif state.factor != 1.0:
            cost[:, list(state.channels)] += max(np.log(abs(state.factor)), 0.0)
        won = np.sum(sound - cost, axis=1)
        if state.one_cell:
            (c,) = state.channels
            # both loads of a rotor are off alike where it turns at another speed, or another rotor is on it
            partner = c ^ 1
            loaded = np.abs(due) > LOADED * self.reference
            alone: Mask = possible[:, partner] | ~loaded[:, partner]
            if partner not in self.frame.present:
                alone = np.full(len(won), not self.frame.driven)
            fair = not state.factor or FAIR[0] < abs(state.factor) < FAIR[1]
            bears = self.frame.speeds[:, c // 2] > BEARS_LOAD
            determined: Mask = loaded[:, c] & (bears | (state.factor != 0.0))
            determined |= (np.abs(due[:, c]) > LOADED / 10.0 * self.reference[c]) & (not fair)
            won = np.where(determined, np.where(alone, won, -BEGINS), 0.0)
        return np.where(np.isfinite(won), won, -SURE)


def curves_of(throttles: Array, side: int, fine: bool) -> Array:
    """(rows, K) what a motor's speed may follow: its throttle, and within some per cent the other's load."""
    mine, rival = throttles[:, side], throttles[:, 1 - side]
    beside = [mine * rival, rival] if fine else []
    return np.stack([mine**0, mine, mine**2, mine**3, *beside], axis=1)


def reference_of(
    frame: StandFrame, trusted: Mask, read: Sequence[tuple[State, Mask]] = (), fine: bool = False
) -> Reference:
    """What trusted rows agree on, some of them read in another way."""
    log = readings_of(frame)
    for state, mine in read:
        log = state.undo(log, mine)
    rows = np.flatnonzero(trusted)
    few = np.zeros(len(trusted), bool)
    few[rows[:: max(1, len(rows) // FIT_ROWS)]] = True
    fits: dict[int, tuple[list[str], Array]] = {}
    curves: dict[int, Array] = {}
    for c in frame.present:
        if c > 3:
            curves[c - 4] = robust_fit(curves_of(log.throttles, c - 4, fine), log.speeds[:, c - 4], few)
        elif frame.free_nuisance:
            names = dictionary_of(LOADS[c], 3 if places(log.speeds[few]) >= RICH else 2)
            x = design_matrix(names, log.speeds[:, 0], log.speeds[:, 1])
            fits[c] = (names, robust_fit(x, log.loads[:, c], few))
    draft = Reference(frame, fits, curves, np.ones(4), np.ones(6), np.ones(6))
    due = draft.due(log)
    size = np.maximum(np.quantile(np.abs(due), 0.95, axis=0), 1e-9)
    if not fine:
        return replace(draft, reference=size, tolerance=TOLERANCE * size)
    if not frame.free_nuisance:
        level = np.ones(4)
        for c in [c for c in frame.present if c < 4]:
            loaded = few & (np.abs(due[:, c]) > LOADED * size[c])
            level[c] = np.median(log.loads[loaded, c] / due[loaded, c]) if loaded.any() else 1.0
        draft = replace(draft, level=level)
        due = draft.due(log)
    off = np.abs(np.concatenate([log.loads, log.speeds], axis=1) - due)[few]
    own = np.quantile(off, QUIETEST, axis=0) / float(norm.ppf(0.5 + 0.5 * QUIETEST))
    return replace(draft, reference=size, tolerance=np.clip(own, FINEST * size, TOLERANCE * size))


def robust_fit(x: Array, y: Array, weights: Mask) -> Array:
    """(K,) coefficients of columns x (rows, K) for y (rows,) on the rows of a mask; a few outliers do not
    count (squares first, then ever more like absolute values)."""
    use = weights & np.isfinite(y)
    x, y = x[use], y[use]
    scale = np.sqrt(np.mean(x**2, axis=0)) + 1e-12
    fit = np.linalg.lstsq(x / scale, y, rcond=1e-6)[0]
    for _ in range(12):
        miss = np.abs(y - x / scale @ fit)
        spread = max(1.4826 * float(np.median(miss)), 1e-9 * (float(np.abs(y).max()) + 1e-12))
        w = np.sqrt(1.0 / np.maximum(miss / spread, 1.0))
        fit = np.linalg.lstsq(x / scale * w[:, None], y * w, rcond=1e-6)[0]
    return np.asarray(fit / scale)


def places(values: Array) -> int:
    """How many places rows (rows, 2) of speeds or throttles take, a fiftieth of full speed apart."""
    return len(np.unique(np.round(values * 50.0), axis=0))
