"""The run on the stand that would tell rival explanations apart, computed from the rivals as fitted.

A plan is scored by how far each rival, as fitted to the present log, stays from everything that the nuisance
corrections and any shape and size of the other rival could make of it: the squared distance in units of
the noise, in the worse of the two directions (T-optimality, Atkinson and Fedorov 1975, with both models in
turn as the true one). Pieces are joined greedily until the distance is far beyond doubt.
Set-points stay inside what the log has already seen; supply and spacing are set only where they were logged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np

from coaxlink.channels.stand import COLUMN_OF, base_corrections, stand_frame
from coaxlink.data.samples import Samples
from coaxlink.effects.tracing import Shape, Tracing
from coaxlink.evidence.held_out import Regression
from coaxlink.frames import STAND_CHANNELS, Array, StandFrame

RATE_HZ = 10.0
ENOUGH = 900.0  # squared distance: thirty standard deviations of white noise
CLEAR = 100.0
# judgement (seconds of a search): shapes of a rival that a plan is held against, moves tried in pairs
MOST_SHAPES, MOST_PAIRED = 8, 12
LONGEST_S = {"stand": 600.0, "flight": 180.0}
LOWER_SUPPLY = 0.87  # of the highest voltage in the log
KELVIN_S = 90.0
AMBIENT = ("air_temperature_C", "air_pressure_Pa", "humidity_pct")


@dataclass(frozen=True)
class Piece:
    """Throttles from, to; what the supply and the spacing are set to, where that matters."""

    what: str
    seconds: float
    upper: tuple[float, float]
    lower: tuple[float, float]
    supply_V: float | None = None
    spacing_m: float | None = None
    shape: str = "ramp"

    @property
    def reported(self) -> str:
        """In words."""
        at = "" if self.supply_V is None else f" at {self.supply_V:.1f} V"
        apart = "" if self.spacing_m is None else f" at {self.spacing_m:.3g} m spacing"
        return f"{self.what}{at}{apart}"

    def table(self) -> dict[str, Any]:
        """As a table of a schedule file."""
        out: dict[str, Any] = {"what": self.what, "seconds": round(self.seconds, 2)}
        for name, ends in (("upper", self.upper), ("lower", self.lower)):
            out[name] = round(ends[0], 4) if ends[0] == ends[1] else [round(e, 4) for e in ends]
        if self.supply_V is not None:
            out["supply_V"] = round(self.supply_V, 2)
        if self.spacing_m is not None:
            out["spacing_m"] = round(self.spacing_m, 4)
        return out if self.shape == "ramp" else out | {"shape": self.shape}


@dataclass(frozen=True)
class Experiment:
    """A schedule and what it is expected to show."""

    names: tuple[str, ...]
    pieces: tuple[Any, ...]
    distance: float  # standard deviations between the rivals, the nearer way
    channel: str  # that tells most
    kind: str = "stand"
    rate_hz: float = RATE_HZ
    height_m: float = 3.0  # a flight starts there

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return _seconds(self.pieces)

    @property
    def text(self) -> str:
        """In words, one line."""
        kind = "flight" if self.kind == "flight" else "run"
        counted = Counter(p.reported if isinstance(p, Piece) else p.what for p in self.pieces)
        steps = [f"{n} x {what}" if n > 1 and kind == "flight" else what for what, n in counted.items()]
        return (
            f"a {kind} of {self.seconds:.0f} s: {'; '.join(steps)}: the rivals are then {self.distance:.0f} "
            f"standard deviations of the noise apart, most of it in {self.channel}"
        )

    def document(self) -> dict[str, Any]:
        """As a schedule file's document."""
        rate = {"rate_hz": self.rate_hz} if self.kind == "stand" else {"height_m": round(self.height_m, 2)}
        return {
            "kind": self.kind,
            "separates": list(self.names),
            **rate,
            "pieces": [p.table() for p in self.pieces],
        }


@dataclass(frozen=True)
class Rival:
    """An explanation as fitted: its effect and the physical numbers it took."""

    effect: Tracing[Any]
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class View:
    """A planned log as the regression sees it."""

    nuisance: Array  # (rows, C, B) nuisance corrections
    bounds: Array  # (B,)
    added: tuple[Array, ...]  # what each rival adds, (rows, C)
    shapes: tuple[tuple[Array, ...], ...]  # of each rival: the columns (rows, C, K) of every shape


def view(
    frame: Any, rivals: Sequence[Rival], nuisance: Array, bounds: Array, reduce: Callable[[Array], Array]
) -> View:
    """What rivals add on a planned frame."""
    return View(
        nuisance,
        bounds,
        tuple(reduce(r.effect.contribution(frame, r.parameters)) for r in rivals),
        tuple(
            tuple(reduce(r.effect.columns(frame, s)) for s in _thinned(r.effect.shapes(frame)))
            for r in rivals
        ),
    )


def _thinned(shapes: Sequence[Shape]) -> Sequence[Shape]:
    """At most so many of a grid of shapes, evenly: its neighbours say much the same."""
    step = -(-len(shapes) // MOST_SHAPES)
    return shapes[:: max(step, 1)]


def joined(views: Sequence[View]) -> View:
    """Views one after the other, of the same rivals."""
    first = views[0]
    shapes = []
    for k, mine in enumerate(first.shapes):
        shapes.append(tuple(np.concatenate([v.shapes[k][i] for v in views]) for i in range(len(mine))))
    return View(
        np.concatenate([v.nuisance for v in views]),
        first.bounds,
        tuple(np.concatenate([v.added[k] for v in views]) for k in range(len(first.added))),
        tuple(shapes),
    )


Look = Callable[[Sequence[Any]], View | None]


@dataclass(frozen=True)
class Bench:
    """What of the present log a plan on the stand is judged by."""

    frame: StandFrame
    rivals: tuple[Rival, ...]
    heat: tuple[float, float, float]


def distance(predicted: View, sigma: Array, channels: Sequence[str]) -> tuple[float, str]:
    """Squared distance of the nearest two rivals on a planned log, and the channel that tells most."""
    one = np.zeros(len(predicted.nuisance), np.intp)
    nearest, channel = np.inf, ""
    for true, other in permutations(range(len(predicted.added)), 2):
        y = predicted.added[true]
        left, where = np.inf, 0
        for columns in predicted.shapes[other]:
            design = np.concatenate([predicted.nuisance, columns], axis=-1)
            deviation = np.concatenate([0.5 * predicted.bounds, np.full(columns.shape[-1], np.inf)])
            taken = Regression(design, y, np.zeros(len(deviation)), deviation, sigma, one)
            by_channel = np.sum(((y - design @ taken.values) / sigma) ** 2, axis=0)
            if float(by_channel.sum()) < left:
                left, where = float(by_channel.sum()), int(np.argmax(by_channel))
        if left < nearest:
            nearest, channel = left, channels[where]
    return nearest, channel


def separated(
    rivals: Sequence[Rival],
    moves: Sequence[tuple[Any, ...]],
    look: Look,
    sigma: Array,
    channels: Sequence[str],
    kind: str = "stand",
    enough: float = ENOUGH,
) -> Experiment | None:
    """Join moves until the rivals are `enough` apart; None where no run within reach separates them."""

    def far(pieces: Sequence[Any]) -> tuple[float, str]:
        predicted = look(pieces)
        return (0.0, "") if predicted is None else distance(predicted, sigma, channels)

    def best_of(plans: Sequence[tuple[Any, ...]]) -> tuple[tuple[float, str], tuple[Any, ...]]:
        return max(((far(p), p) for p in plans), key=lambda x: _worth(x[0][0], x[1]))

    alone = [(far(m), m) for m in moves]
    (best, channel), chosen = max(alone, key=lambda x: _worth(x[0][0], x[1]))
    if best < CLEAR:  # alone, no move tells: some need another to be seen against
        first = [m for _, m in sorted(alone, key=lambda x: -_worth(x[0][0], x[1]))[:MOST_PAIRED]]
        (best, channel), chosen = best_of([(*a, *b) for i, a in enumerate(first) for b in first[i + 1 :]])
    if best < 1.0:
        return None
    while best < enough and _seconds(chosen) < LONGEST_S[kind]:
        tried = [(far((*chosen, *m)), (*chosen, *m)) for m in moves]
        (now, where), plan = max(tried, key=lambda x: _worth(x[0][0] - best, x[1][len(chosen) :]))
        if now < 1.02 * best:
            break
        best, channel, chosen = now, where, plan
    names = tuple(r.effect.name for r in rivals)
    return Experiment(names, chosen, float(np.sqrt(best)), channel, kind)


def stand_experiment(
    frame: StandFrame, sigma: Array, rivals: Sequence[Rival], enough: float = ENOUGH
) -> Experiment | None:
    """The schedule that separates rivals best; None where no run within reach does.

    `sigma` (channels present,) is the noise of one row; `enough` the squared distance that is looked for.
    """
    bench = Bench(frame, tuple(rivals), _heat_of(frame))
    present = list(frame.present)

    def look(pieces: Sequence[Any]) -> View | None:
        if not any(max(*p.upper, *p.lower) > 0.0 for p in pieces):
            return None  # a rest by itself shows nothing
        plan = planned(bench, pieces)
        if any(r.effect.missing(plan) is not None for r in rivals):
            return None
        nuisance = base_corrections(plan)
        columns = np.stack([v[:, present] for _, _, v in nuisance], axis=-1)
        bounds = np.array([b for _, b, _ in nuisance])
        return view(plan, rivals, columns, bounds, lambda values: values[:, present])

    channels = [STAND_CHANNELS[c] for c in present]
    return separated(rivals, _moves(bench), look, sigma, channels, enough=enough)


def planned(bench: Bench, pieces: Sequence[Piece]) -> StandFrame:
    """The frame that a plan's log would give, its loads as the nuisance model model predicts them."""
    frame = bench.frame
    parts = [_rows(p) for p in pieces]
    upper, lower, supply, spacing = np.concatenate(parts).T
    rows = len(upper)
    columns: dict[str, Array] = {"time_s": np.arange(1, rows + 1) / RATE_HZ}
    for name, values in (("upper", upper), ("lower", lower)):
        if not frame.driven:
            columns[f"{name}_rpm"] = values * frame.model.speed_max_rpm
        if frame.driven or frame.throttles is not None:
            columns[f"{name}_throttle"] = values
    for name, values in frame.columns.items():
        if name.endswith("voltage_V"):
            usual = float(np.quantile(values, 0.98))
            columns[name] = np.where(np.isfinite(supply), supply, usual)
        elif name == "rotor_spacing_m":
            columns[name] = np.where(np.isfinite(spacing), spacing, float(np.median(values)))
        elif name == "motor_temperature_C":
            columns[name] = _warmed(bench.heat, upper**3 + lower**3)
        elif name in AMBIENT:
            columns[name] = np.full(rows, float(values[-1]))
    for c in frame.present:
        if c < 4:
            columns[COLUMN_OF[STAND_CHANNELS[c]]] = np.zeros(rows)
    out = stand_frame(Samples(columns, "planned"), frame.model, extrapolated=True)
    return replace(
        out,
        free_nuisance=frame.free_nuisance,
        driven=frame.driven,
        present=frame.present,
        reference=frame.reference,
    )


def _rows(piece: Piece) -> Array:
    """(rows, 4) upper, lower, supply, spacing of a piece."""
    count = max(round(piece.seconds * RATE_HZ), 1)
    share = np.arange(1, count + 1) / count
    if piece.shape == "steps":
        share = np.floor(np.arange(count) / RATE_HZ) % 2
    out = np.full((count, 4), np.nan)
    for column, (first, last) in enumerate((piece.upper, piece.lower)):
        out[:, column] = first + (last - first) * share
    out[:, 2] = np.nan if piece.supply_V is None else piece.supply_V
    out[:, 3] = np.nan if piece.spacing_m is None else piece.spacing_m
    return out


def _moves(bench: Bench) -> list[tuple[Piece, ...]]:
    """What a plan may be joined from."""
    frame = bench.frame
    throttles = frame.speeds if frame.throttles is None else frame.throttles
    full = np.quantile(throttles, 0.98, axis=0)
    supplies: list[float | None] = [None]
    volts = next((v for n, v in frame.columns.items() if n.endswith("voltage_V")), None)
    if volts is not None:
        top = float(np.quantile(volts, 0.98))
        supplies = [top, LOWER_SUPPLY * top]
    apart: list[float | None] = [None]
    z = frame.columns.get("rotor_spacing_m")
    if z is not None and any(r.effect.name == "rotor_spacing" for r in bench.rivals):
        apart = [float(z.min()), float(max(z.max(), 1.3 * z.min()))]
    out: list[tuple[Piece, ...]] = [(_hold("rest", 60.0, 0.0 * full),)]
    for volt in supplies:
        for gap in apart:
            made = [
                (_hold("full load", 20.0, full),),
                (_hold("long full load", 90.0, full),),
                (_hold("half load", 20.0, 0.6 * full),),
                _there_and_back("both up and down", 12.0, full, full),
                _there_and_back("upper up and down", 10.0, full * [1, 0], full * [0, 0.6], full * [0, 0.6]),
                _there_and_back("lower up and down", 10.0, full * [0, 1], full * [0.6, 0], full * [0.6, 0]),
                (_steps("steps", 12.0, 0.35 * full, full),),
                _levels(full),
            ]
            out += [tuple(replace(p, supply_V=volt, spacing_m=gap) for p in move) for move in made]
    return out


def _hold(what: str, seconds: float, at: Array) -> Piece:
    return Piece(f"{what} {at[0]:.2f}/{at[1]:.2f}", seconds, (at[0], at[0]), (at[1], at[1]))


def _there_and_back(
    what: str, seconds: float, swing: Array, top: Array, held: Array | None = None
) -> tuple[Piece, ...]:
    low = np.zeros(2) if held is None else held
    high = swing if held is None else held + swing
    there = Piece(what, seconds, (low[0], high[0]), (low[1], high[1]))
    return there, Piece(what, seconds, (high[0], low[0]), (high[1], low[1]))


def _steps(what: str, seconds: float, low: Array, high: Array) -> Piece:
    name = f"{what} {low[0]:.2f}-{high[0]:.2f}"
    return Piece(name, seconds, (low[0], high[0]), (low[1], high[1]), shape="steps")


def _levels(full: Array) -> tuple[Piece, ...]:
    """Nine pairs of speeds out of order: neither time nor direction goes with either."""
    order = ((1, 0), (0, 2), (2, 1), (0, 0), (1, 2), (2, 0), (0, 1), (2, 2), (1, 1))
    level = (0.35, 0.65, 1.0)
    what = "nine levels out of order"
    return tuple(
        Piece(what, 3.0, (level[i] * full[0], level[i] * full[0]), (level[j] * full[1], level[j] * full[1]))
        for i, j in order
    )


def _seconds(pieces: Sequence[Any]) -> float:
    return float(sum(p.seconds for p in pieces))


def _worth(gain: float, pieces: Sequence[Any]) -> float:
    """What is beyond doubt is worth no more; time costs."""
    return min(gain, ENOUGH) / (30.0 + _seconds(pieces))


def _heat_of(frame: StandFrame) -> tuple[float, float, float]:
    """(K/s at u^3 = 1, 1/s, C) of the winding: first order, fitted to the logged temperature."""
    logged = frame.columns.get("motor_temperature_C")
    if logged is None or len(logged) < 10:
        return 0.0, 1.0 / KELVIN_S, 25.0
    throttles = frame.speeds if frame.throttles is None else frame.throttles
    power = np.sum(throttles**3, axis=1)
    step = np.diff(frame.time_s)
    # integrated once: differences of a noisy reading say nothing
    rise = logged[1:] - logged[0]
    heat, above = np.cumsum(power[1:] * step), np.cumsum((logged[1:] - logged[0]) * step)
    solution = np.linalg.lstsq(np.stack([heat, -above], axis=1), rise, rcond=None)[0]
    rate, loss = (float(max(v, 0.0)) for v in solution)
    return rate, loss, float(np.median(logged[:5]))


def _warmed(heat: tuple[float, float, float], power: Array) -> Array:
    """(rows,) temperature over a plan."""
    rate, loss, at = heat
    now, out = at, np.empty(len(power))
    for k, p in enumerate(power):
        now += (rate * p - loss * (now - at)) / RATE_HZ
        out[k] = now
    return out
