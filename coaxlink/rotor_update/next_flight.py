"""The flight that would tell most of a table: A-optimal design on the posterior of what was flown.

    criterion = mean variance of the model's wrench, each axis in its own range, over the wrenches of every
                table that may yet be chosen = trace(A C A')

C is the coefficients' covariance behind the flight. Which table will be chosen is not known before the flight
either: models are drawn from the posterior of now, and each gets its own table. Manoeuvres are added one by
one, each the one that takes most from the criterion in its time (Atkinson, Donev and Tobias 2007, *Optimum
Experimental Designs*, chapters 10 and 12), among hovers, climbs, yaw doublets and swings of several speeds,
sized to the vehicle's own yaw and within a box that `coaxlink fly` flies in. Each manoeuvre's rows are worked
out from its path alone (`residual.experiments`); what is otherwise on another day is unknown again, and
eliminated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.channels.flight import flight_frame
from coaxlink.constants import FULL, GRAVITY_M_S2, TURNING
from coaxlink.errors import CoaxlinkError, InputError
from coaxlink.evidence.blocks import joined
from coaxlink.frames import Array, FlightFrame
from coaxlink.health.accelerometer import USUAL_M_S2, VELOCITY_M_S
from coaxlink.mixer.authority import doublet_acceleration, doublet_deg
from coaxlink.mixer.fitted import FittedLaw, envelope
from coaxlink.residual.experiments.manoeuvres import SETTLE_S, Manoeuvre, flown
from coaxlink.rotor.model import LOADS, RotorModel
from coaxlink.rotor_update.coefficients import Known, Update
from coaxlink.rotor_update.regressors import regressors, unit_loads
from coaxlink.vehicle import Vehicle
from firmware_params.errors import TableError

SECONDS = 60.0  # of a flight: as one of those that were flown
REACH_M, RISE_M = 2.0, 1.0  # from the place of take-off, `coaxlink fly --reach`; above the flight's height
LOWEST_M = 2.5  # above what the ground does to rotors of half a metre
PULLS = (0.1, 0.2, 0.35)  # of gravity, to the sides and up: 0.35 leans by 19 degrees, the limit is 30
FASTEST_M_S = 3.0  # half of what `coaxlink fly` allows
DOUBLETS = (2, 3, 4)  # in PIECE_S
PIECE_S = 12.0  # five in a flight; a frame needs 8 s
ROOM = 0.05  # of full speed, left for gusts and the loops at either end
ROWS = 100  # of the envelope of wrenches that a table is judged by
MODELS, SEED = 8, 1  # drawn from the posterior: their tables' shares differ by more than eight do in the mean
RANGE_PRICE = np.array([1.0, 3.0, 3.0, 5.0])  # of each axis' range, as a table is fitted (`mixer.fitted`)
UNFLYABLE = (CoaxlinkError, TableError)  # the rotors cannot fly the vehicle, or PX4 cannot hold its table


@dataclass(frozen=True)
class Expected:
    """One coefficient's standard deviation now, behind the planned flight and behind a hover as long."""

    load: str
    term: str
    now: float
    after: float
    hover: float


@dataclass(frozen=True)
class NextFlight:
    """A plan, and what it is expected to tell."""

    pieces: tuple[Manoeuvre, ...]
    height_m: float
    coefficients: tuple[Expected, ...]
    before: Array  # (2,) the model's error over a table's wrenches now, N and N m (worst axis), one sd
    after: Array  # (2,) behind this flight
    hover: Array  # (2,) behind a hover of the same length
    table: TableNeeds  # what these errors are of

    @property
    def seconds(self) -> float:
        """Without the settling before."""
        return sum(piece.seconds for piece in self.pieces)

    def document(self) -> dict[str, Any]:
        """As a plan file's document: `coaxlink fly --plan FILE` and `coaxlink sim --fly FILE` fly it."""
        return {"height_m": round(self.height_m, 2), "pieces": [piece.table() for piece in self.pieces]}

    def as_json(self) -> dict[str, Any]:
        """Plain numbers, and the plan."""
        errors = {"now": self.before, "after": self.after, "after_a_hover": self.hover}
        return {
            "plan": self.document(),
            "seconds": self.seconds,
            "table_error_N_Nm": {name: list(map(float, e)) for name, e in errors.items()},
            "coefficients": [
                {
                    "load": c.load,
                    "term": c.term,
                    "sd": c.now,
                    "sd_after": c.after,
                    "sd_after_a_hover": c.hover,
                }
                for c in self.coefficients
            ],
        }

    def words(self) -> Iterator[str]:
        """What to fly, and what it would tell."""
        counts: dict[str, int] = {}
        for piece in self.pieces:
            counts[piece.what] = counts.get(piece.what, 0) + 1
        what = "; ".join(f"{n} x {name}" if n > 1 else name for name, n in counts.items())
        (a, b), (c, d), (e, f) = self.before, self.after, self.hover
        yield (
            f"the most informative flight, {self.seconds:.0f} s within {REACH_M:g} m of the take-off and "
            f"{self.height_m:.1f} to {self.height_m + RISE_M:.1f} m high: {what}"
        )
        yield (
            f"expected of it: the model's error over a table's wrenches (one sd) from {a:.2g} N and "
            f"{b:.2g} N m to {c:.2g} and {d:.2g}; a hover as long would leave {e:.2g} and {f:.2g}"
        )


@dataclass(frozen=True)
class TableNeeds:
    """What of the coefficients the tables' wrenches need."""

    wrench: Array  # (rows, 4, K) of a unit of each coefficient
    price: Array  # (4,) N, N m that count as one

    def cost(self, covariance: Array) -> float:
        """Mean variance, each axis in its own range."""
        scaled = self.wrench / self.price[:, None]
        return float(np.einsum("rck,kl,rcl->", scaled, covariance, scaled, optimize=True)) / len(scaled)

    def errors(self, covariance: Array) -> Array:
        """(2,) N, and N m of the worst axis: root mean square of one standard deviation."""
        each = np.einsum("rck,kl,rcl->c", self.wrench, covariance, self.wrench, optimize=True)
        sd = np.sqrt(each / len(self.wrench))
        return np.array([sd[0], sd[1:].max()])


def next_flight(update: Update, airframe: Airframe) -> NextFlight:
    """The plan for the vehicle's next flight, on a table made of `update.model`.

    SECONDS are filled with pieces of PIECE_S. Raises InputError where the vehicle cannot fly any.
    """
    known, model = update.known, replace(update.model, effects=())
    vehicle = Vehicle(airframe, model)
    frame = replace(known.frame, model=model)
    high = LOWEST_M
    if frame.height is not None:
        high = max(high, float(np.median(frame.height[frame.keep])))
    options = candidates(high, doublet_acceleration(vehicle))
    table = _tables(airframe, model, known)
    design = Design(frame, known, update.measured_speeds, high, SECONDS, table, options, FittedLaw(vehicle))
    pieces, _ = design.chosen()
    hovers = [piece for piece in options if piece.cycles == 0] * round(SECONDS / PIECE_S)
    count = len(known.names)
    now, then, still = (
        known.covariance[:count, :count],
        design.posterior(pieces),
        design.posterior(hovers),
    )
    sds = (np.sqrt(np.diag(c)) for c in (now, then, still))
    return NextFlight(
        tuple(pieces), high,
        tuple(Expected(*name, *map(float, row)) for name, *row in zip(known.names, *sds, strict=True)),
        table.errors(now), table.errors(then), table.errors(still), table,
    )  # fmt: skip


def candidates(high: float, yaw_rad_s2: float) -> list[Manoeuvre]:
    """Pieces within REACH_M, RISE_M, FASTEST_M_S and the largest of PULLS; doublets of up to `yaw_rad_s2`."""
    out = [Manoeuvre(f"hover at {high:.1f} m", PIECE_S)]
    aside = REACH_M / np.sqrt(2.0)
    ways: list[tuple[str, float, dict[str, float]]] = [
        ("climb and sink", RISE_M, {"height_m": high + RISE_M}),
        ("to and fro, north", REACH_M, {"north_m": REACH_M}),
        ("to and fro, east", REACH_M, {"east_m": REACH_M}),
        ("to and fro, north-east", REACH_M, {"north_m": aside, "east_m": aside}),
    ]
    for what, far, there in ways:
        for count in sorted({_cycles(far, pull) for pull in PULLS}):
            out.append(Manoeuvre(f"{what}, {count} in {PIECE_S:.0f} s", PIECE_S, cycles=count, **there))
    for count in DOUBLETS:
        turn = round(doublet_deg(yaw_rad_s2, PIECE_S, count), 1)
        if turn > 0.0:
            what = f"yaw doublets of {turn:.0f} degrees, {count} in {PIECE_S:.0f} s"
            out.append(Manoeuvre(what, PIECE_S, yaw_deg=turn, cycles=count))
            what = f"climb and turn by {turn:.0f} degrees, {count} in {PIECE_S:.0f} s"
            out.append(Manoeuvre(what, PIECE_S, height_m=high + RISE_M, yaw_deg=turn, cycles=count))
    return out


def _cycles(far: float, pull: float) -> int:
    """There and back along a cosine within PIECE_S: w^2 / 2 far is its acceleration, w / 2 far its speed."""
    rate = min(np.sqrt(2.0 * pull * GRAVITY_M_S2 / far), 2.0 * FASTEST_M_S / far)
    return max(int(rate * PIECE_S / (2.0 * np.pi)), 1)


def _tables(airframe: Airframe, model: RotorModel, known: Known) -> TableNeeds:
    """The wrenches of the tables that models of the posterior would get, this model's own first.

    Raises InputError where this model flies nothing; drawn ones that fly nothing are left out.
    """
    demands = envelope(airframe, ROWS)
    count = len(known.names)
    covariance = known.covariance[:count, :count]
    own = np.linalg.cholesky(covariance + 1e-12 * np.diag(np.diag(covariance)))
    mean = np.array([model.terms()[load][term] for load, term in known.names])
    drawn = mean + np.random.default_rng(SEED).standard_normal((MODELS - 1, count)) @ own.T
    parts = []
    for number, values in enumerate((mean, *drawn)):
        terms: dict[str, dict[str, float]] = {load: {} for load in LOADS}
        for (load, term), value in zip(known.names, values, strict=True):
            terms[load][term] = float(value)
        try:
            law = FittedLaw(Vehicle(airframe, replace(model.having(terms), effects=())))
        except UNFLYABLE:
            if number == 0:
                raise
            continue
        speeds = np.array([law.speeds(w) for w in demands])
        thrust, torque = (np.moveaxis(part, -1, 0) for part in unit_loads(airframe, speeds, known.names))
        parts.append(np.moveaxis(airframe.wrench(thrust, torque), 0, -1))
    return TableNeeds(np.concatenate(parts), np.ptp(demands, axis=0) * RANGE_PRICE)


class Design:
    """Information of manoeuvres on tables, and the criterion of plans made of them."""

    def __init__(
        self,
        frame: FlightFrame,
        known: Known,
        measured: bool,
        high: float,
        seconds: float,
        table: TableNeeds,
        options: Sequence[Manoeuvre],
        law: FittedLaw,
    ) -> None:
        self.frame, self.known, self.high, self.seconds = frame, known, high, seconds
        self.table, self.options, self.law = table, options, law
        own = (seconds / (np.sqrt(12.0) * VELOCITY_M_S)) ** 2  # of a slope over the flight: `accelerometer`
        self._zero_sd = float((USUAL_M_S2**-2 + own) ** -0.5)
        self._measured = measured
        self._prior = np.asarray(np.linalg.inv(known.covariance))
        self._grams: dict[Manoeuvre, Array | None] = {}
        self._passing: Array = np.zeros(0)

    def chosen(self) -> tuple[list[Manoeuvre], float]:
        """Pieces one by one until the time is up, and the criterion behind them. Raises InputError."""
        options = [p for p in self.options if self._gram(p) is not None]
        if not options:
            raise InputError("next flight", "", "no piece of a plan keeps these rotors within their range")
        pieces: list[Manoeuvre] = []
        now = self._cost(self._prior)
        total: Array | None = None
        while True:
            left = self.seconds - sum(p.seconds for p in pieces)
            fits = [p for p in options if p.seconds <= left + 1e-9]
            if not fits:
                return pieces, now
            tried = []
            for piece in fits:
                gram = self._gram(piece)
                assert gram is not None
                whole = gram if total is None else total + gram
                tried.append((self._cost(self._with(whole)), piece, whole))
            now, piece, total = min(tried, key=lambda t: t[0])
            pieces.append(piece)

    def posterior(self, pieces: Sequence[Manoeuvre]) -> Array:
        """(K, K) covariance of the coefficients behind a flight of these pieces. Raises InputError."""
        grams = [g for p in pieces if (g := self._gram(p)) is not None]
        if len(grams) < len(pieces):
            raise InputError("next flight", "", "a piece of this plan leaves the rotors' range")
        count = len(self.known.names)
        return np.asarray(np.linalg.inv(self._with(np.sum(grams, axis=0)))[:count, :count])

    def _cost(self, precision: Array) -> float:
        count = len(self.known.names)
        return self.table.cost(np.asarray(np.linalg.inv(precision)[:count, :count], float))

    def _with(self, gram: Array) -> Array:
        """(L, L) precision of what lasts behind one more flight, what is of that flight alone eliminated."""
        L = len(self._prior)
        own = gram[L:, L:] + np.diag(self._passing)
        cross = gram[:L, L:]
        return np.asarray(self._prior + gram[:L, :L] - cross @ np.linalg.solve(own, cross.T))

    def _gram(self, piece: Manoeuvre) -> Array | None:
        """X'X of a piece, whitened as the past flights' rows; None where the rotors leave their range."""
        if piece not in self._grams:
            self._grams[piece] = self._made(piece)
        return self._grams[piece]

    def _made(self, piece: Manoeuvre) -> Array | None:
        try:
            log = flown(self.frame, [piece], self.high, self.law)
            planned = flight_frame([log], self.frame.airframe, self.frame.model)
        except CoaxlinkError:
            return None
        planned = replace(planned, keep=planned.keep[planned.time_s[planned.keep] >= SETTLE_S])
        speeds = planned.speeds[planned.keep]
        if speeds.min() < TURNING + ROOM or speeds.max() > FULL - ROOM:
            return None
        _, seen, parts = regressors(planned, self.known.names, self._measured, self._zero_sd)
        columns = np.concatenate(seen, axis=-1) * self.known.scale[None, :, None]
        flat = columns.reshape(-1, columns.shape[-1])
        self._passing = joined(parts[1])[1] ** -2.0
        return np.asarray(flat.T @ flat)
