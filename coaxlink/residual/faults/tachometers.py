"""Tachometer faults: in a stretch of rows one reads another speed than throttle and loads show.

A slipping marker, a second reflection or a changed pole count multiplies the reading from one moment on.
Where the log has throttle and speed, the stretch shows as a step in speed over throttle; the loads then say
whether the rotor or its reading changed. (One that lies above some speed is an option of the fit, in
`effects.stand_rig`.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.frames import Array, StandFrame
from coaxlink.load import Load
from coaxlink.residual.channels.stand import fitted_model
from coaxlink.residual.faults.row_ranges import largest_excursion, largest_run, robust_fit

Mask = NDArray[np.bool_]
LEAST_SHARE, MOST_SHARE = 0.04, 0.5  # of the rows: more than half of them cannot be told from the other half
LEAST_ROWS = 12
MOST_ABOVE, PLACES = 0.75, 24  # of the rows; thresholds of throttle
LEAST_BIAS, LOWEST = 0.01, -0.9  # of the speed; a reading of nothing is a rotor at rest or a dead sensor
SURE = 8.0  # standard errors of the step
CLEARED = 0.25  # of the squares that the loads leave, once the reading is mended
RARE, MOVES = 0.1, 0.15  # of the runs of equal readings; of the reference load
AMONG = 0.7  # of the rows that lie: at speeds that a nuisance model fitted to the other rows has seen
LEAST_FITTED = 24  # rows: as a stand log needs for a nuisance model of its own
FAR_OFF, ALIKE = 0.1, 0.05  # of the speed: a reading that counts wrongly; how well such readings agree
# rows that must lie, SURE says how sure; of the rows, judgement: the throttle's curve is that of the others
LEAST_SPIKES, MOST_SPIKES = 3, 0.2
COARSE = 0.02  # of the speed
LOADED = 0.25  # of the fastest: slower motors do not follow a curve of throttle
ROUNDS = 4


@dataclass(frozen=True)
class BiasedReading:
    """What one tachometer says in some rows."""

    side: int  # 0 upper, 1 lower
    rows: Mask
    times: Array  # (rows,) the reading over the speed, 1 where it is right

    @classmethod
    def by_one_factor(cls, side: int, rows: Mask, reads_high_by: float) -> BiasedReading:
        """What reads high by the same share of the speed in all of these rows."""
        return cls(side, rows, np.where(rows, 1.0 + reads_high_by, 1.0))

    @property
    def why(self) -> str:
        """In words."""
        low, high = (100.0 * (f(self.times[self.rows]) - 1.0) for f in (np.min, np.max))
        by = f"{low:+.1f} %" if high - low < 0.1 else f"{low:+.0f} to {high:+.0f} %"
        return f"reads {by} here: throttle and loads agree on what it shows in the other rows"


def biased_readings(frame: StandFrame) -> list[BiasedReading]:
    """Stretches in which a tachometer contradicts throttle and loads alike, at most one a side."""
    found = []
    for side in (0, 1):
        if frame.driven or frame.throttles is None or np.ptp(frame.throttles[:, side]) < 0.05:
            continue
        # a stretch of time or of throttle; a sagging supply may hide a step, and be confounded with one
        ways = [(order, supply) for order in _orders(frame, side) for supply in (False, True)]
        steps = [step for way in ways if (step := _step(frame, side, *way)) is not None]
        steps += [step for supply in (False, True) for step in _beyond(frame, side, supply)]
        steps += _scattered(frame, side)
        ranked = sorted(steps, key=lambda bias: _left(frame, bias))
        # a factor of its own for every row fits best always: only where no single one is it
        clear = (bias for bias in (*ranked, *_spikes(frame, side)) if _loads_clear(frame, bias))
        found += [bias for bias in (next(clear, None),) if bias is not None]
    return found


def _left(frame: StandFrame, bias: BiasedReading) -> float:
    """Squares that the curves of throttle leave of the speed, once the reading is mended."""
    x = _curves(frame, bias.side, True)
    speed = frame.speeds[:, bias.side] / bias.times
    return float(np.sum((speed - x @ np.linalg.lstsq(x, speed, rcond=1e-10)[0]) ** 2))


def coarse_step(frame: StandFrame, side: int) -> float | None:
    """The step, as a share of full speed, in which a tachometer reads where the throttle moves far finer."""
    if frame.driven or frame.throttles is None:
        return None
    read = np.unique(frame.speeds[:, side])
    commanded = np.unique(np.round(frame.throttles[:, side], 3))
    if len(read) < 3 or len(commanded) < 2 * len(read) + 4:
        return None
    step = float(np.min(np.diff(read)))
    return step if step > COARSE * float(read[-1]) else None


def stuck_readings(frame: StandFrame, side: int) -> Mask:
    """(rows,) where a tachometer that else never repeats itself does, while the rotor's load moves."""
    read, out = frame.speeds[:, side], np.zeros(len(frame.time_s), bool)
    load = next((c for c in (2 * side, 2 * side + 1) if c in frame.present), None)
    if frame.driven or load is None:
        return out
    start = np.flatnonzero(np.concatenate([[True], np.diff(read) != 0.0]))
    least = max(LEAST_ROWS, len(read) // 50)
    runs = list(zip(start, np.append(start[1:], len(read)), strict=True))
    if sum(1 for first, end in runs if 1 < end - first < least) > RARE * len(runs):
        return out
    long = [(a, b) for a, b in runs if b - a >= least and read[a] > 0.0]
    if not long:
        return out
    rest = np.logical_not(
        np.logical_or.reduce([(np.arange(len(read)) >= a) & (np.arange(len(read)) < b) for a, b in long])
    )
    model = frame.model
    if (
        frame.free_nuisance and rest.sum() > LEAST_FITTED
    ):  # what these rows bent to themselves tells nothing of them
        model = fitted_model(frame.speeds[rest], frame.measured[rest], [load], model.speed_max_rpm)
    off = frame.measured[:, load] - model.loads(frame.speeds[:, 0], frame.speeds[:, 1])[Load(load)]
    for first, end in long:
        if np.ptp(np.quantile(off[first:end], [0.05, 0.95])) > MOVES * frame.reference[load]:
            out[first:end] = True
    return out


def _orders(frame: StandFrame, side: int) -> list[NDArray[np.intp]]:
    assert frame.throttles is not None
    return [np.arange(len(frame.time_s)), np.argsort(frame.throttles[:, side], kind="stable")]


def _step(frame: StandFrame, side: int, order: NDArray[np.intp], supply: bool) -> BiasedReading | None:
    """The stretch of rows, in that order, whose speed is furthest from what the throttle gives elsewhere."""
    order = order[_loaded(frame, side)[1][order]]
    if len(order) < LEAST_FITTED:
        return None
    speed = frame.speeds[order, side]
    x = _curves(frame, side, supply)[order]
    rows = len(speed)
    inside = np.zeros(rows, bool)
    for number in range(ROUNDS):
        usual = x @ np.linalg.lstsq(x[~inside], speed[~inside], rcond=1e-10)[0]
        off = speed - usual
        now = np.zeros(rows, bool)
        if number == 0:
            now[slice(*largest_excursion(off))] = True
            if now.mean() > MOST_SHARE:  # the step seen from its other end
                now = ~now
        else:  # the stretch whose squares the step lowers most
            step = float(np.sum(off[inside] * usual[inside]) / np.sum(usual[inside] ** 2))
            now[slice(*largest_run(off**2 - (off - step * usual) ** 2))] = True
        if not LEAST_SHARE * rows <= now.sum() >= LEAST_SPIKES or now.mean() > MOST_SHARE:
            return None
        if np.array_equal(now, inside):
            break
        inside = now
    usual = x @ np.linalg.lstsq(x[~inside], speed[~inside], rcond=1e-10)[0]
    bias = float(np.sum(speed[inside] * usual[inside]) / np.sum(usual[inside] ** 2)) - 1.0
    noise = float(np.std(speed[~inside] - usual[~inside]))
    shift = abs(bias) * float(np.mean(np.abs(usual[inside])))
    if abs(bias) < LEAST_BIAS or bias < LOWEST or shift * np.sqrt(inside.sum()) < SURE * noise:
        return None
    rows_of = np.zeros(len(frame.time_s), bool)
    rows_of[order[inside]] = True
    return BiasedReading.by_one_factor(side, rows_of, bias)


def _beyond(frame: StandFrame, side: int, supply: bool) -> list[BiasedReading]:
    """A share that comes in above some throttle, fitted beside the curves, which would else bend to it.

    Which of the two parts of the rows lies, where neither is clearly the smaller, the loads must say.
    """
    assert frame.throttles is not None
    speed, throttle = frame.speeds[:, side], frame.throttles[:, side]
    curves = _curves(frame, side, supply)
    best: tuple[float, float, Mask] | None = None
    plain = float(np.sum((speed - curves @ np.linalg.lstsq(curves, speed, rcond=1e-10)[0]) ** 2))
    for edge in np.unique(np.quantile(throttle, np.linspace(LEAST_SHARE, 1.0 - LEAST_SHARE, PLACES))):
        above = throttle > edge
        if not LEAST_SHARE * len(speed) <= above.sum() >= LEAST_ROWS or (~above).sum() < LEAST_ROWS:
            continue
        x = np.concatenate([curves, (speed * above)[:, None]], axis=1)
        fit = np.linalg.lstsq(x, speed, rcond=1e-10)[0]
        left = float(np.sum((speed - x @ fit) ** 2))
        if best is None or left < best[0]:
            best = left, float(fit[-1]), above
    if best is None:
        return []
    left, part, above = best  # part of the reading that the curves do not give
    noise = left / max(len(speed) - curves.shape[1] - 1, 1)
    if plain - left < (SURE**2) * noise or abs(part) > 0.9:
        return []
    bias = part / (1.0 - part)
    parts = ((above, bias), (~above, -bias / (1.0 + bias)))
    return [
        BiasedReading.by_one_factor(side, r, by)
        for r, by in parts
        if r.mean() <= MOST_ABOVE and abs(by) >= LEAST_BIAS
    ]


def _scattered(frame: StandFrame, side: int) -> list[BiasedReading]:
    """Rows here and there that read one multiple of what throttle gives: pulses counted half, or twice."""
    times, far = _far_off(frame, side)
    if far.sum() < LEAST_ROWS:
        return []
    factor = float(np.median(times[far]))
    rows = far & (np.abs(times / max(factor, 1e-9) - 1.0) < ALIKE)
    if rows.sum() < max(LEAST_ROWS, AMONG * far.sum()) or rows.mean() > MOST_SHARE or factor - 1.0 < LOWEST:
        return []
    return [BiasedReading.by_one_factor(side, rows, float(np.mean(times[rows])) - 1.0)]


def _spikes(frame: StandFrame, side: int) -> list[BiasedReading]:
    """Rows here and there that read anything: pulses lost or added, each by its own factor."""
    times, far = _far_off(frame, side)
    far &= times - 1.0 > LOWEST
    if not LEAST_SPIKES <= far.sum() <= MOST_SPIKES * len(far):
        return []
    return [BiasedReading(side, far, np.where(far, times, 1.0))]


def _far_off(frame: StandFrame, side: int) -> tuple[Array, Mask]:
    """(rows,) readings over what throttle gives, and which are further from 1 than noise brings them."""
    usual, loaded = _loaded(frame, side)
    times = np.where(loaded, frame.speeds[:, side] / np.where(loaded, usual, 1.0), 1.0)
    noise = 1.4826 * float(np.median(np.abs(times[loaded] - 1.0))) if loaded.any() else 0.0
    return times, np.abs(times - 1.0) > max(FAR_OFF, SURE * noise)


def _loaded(frame: StandFrame, side: int) -> tuple[Array, Mask]:
    """(rows,) what most rows' throttle gives, and where a motor is so fast that it follows a curve of it."""
    speed, x = frame.speeds[:, side], _curves(frame, side, True)
    usual = x @ robust_fit(x, speed, np.ones(len(speed), bool))
    return usual, usual > LOADED * float(np.max(usual))


def _curves(frame: StandFrame, side: int, supply: bool) -> Array:
    """(rows, K) what a motor's speed may follow: its throttle, its load, the other's load, its supply."""
    assert frame.throttles is not None
    mine, rival = frame.throttles[:, side], frame.throttles[:, 1 - side]
    columns = [mine**0, mine, mine**2, mine**3, mine * rival, rival]
    for name in ("voltage_V", f"{('upper', 'lower')[side]}_voltage_V") if supply else ():
        volts = frame.context(name)
        if volts is not None and np.all(np.isfinite(volts)) and np.ptp(volts) > 0.0:
            columns.append(mine * (volts / np.mean(volts) - 1.0))
    return np.stack(columns, axis=1)


def _between(speed: Array, bias: BiasedReading) -> bool:
    """Whether the mended speeds lie among those of the other rows."""
    low, high = np.quantile(speed[~bias.rows], [0.02, 0.98])
    mended = (speed / bias.times)[bias.rows]
    return bool(np.mean((mended > low) & (mended < high)) > AMONG)


def _loads_clear(frame: StandFrame, bias: BiasedReading) -> bool:
    """Whether the rotor's own loads fit clearly better with the reading mended than as it stands."""
    loads = [c for c in (2 * bias.side, 2 * bias.side + 1) if c in frame.present]
    if not loads:
        return False
    model = frame.model
    if frame.free_nuisance:
        rest = ~bias.rows
        if not _between(frame.speeds[:, bias.side], bias):
            return False  # polynomials fitted to slow rows tell nothing of fast ones
        model = fitted_model(frame.speeds[rest], frame.measured[rest], loads, frame.model.speed_max_rpm)
    left = []
    for times in (1.0, bias.times):
        u = frame.speeds.copy()
        u[:, bias.side] /= times
        pair = model.loads(u[:, 0], u[:, 1])
        predicted = [pair[load] for load in Load]
        squares = 0.0
        for c in loads:
            p, m, rest = predicted[c], frame.measured[:, c], ~bias.rows
            level = float(p[rest] @ m[rest]) / max(float(p[rest] @ p[rest]), 1e-12)  # another day's level
            squares += float(np.mean((m[bias.rows] - level * p[bias.rows]) ** 2)) / frame.reference[c] ** 2
        left.append(squares)
    return left[1] < CLEARED * left[0]
