"""Verdict over flights: which rotor, since when, with what probability.

Hypotheses: nothing is wrong; or one rotor gives less, from before one of the flights on or from some moment
within it, to the end or until it was mended before a later one. Each beside every payload: as drawn, strapped
on otherwise in a flight, or slid within one. All are linear and Gaussian (`columns`), so each has an exact
evidence (Bishop 2006, section 3.5) and Bayes' theorem does the rest (`hypotheses`); residuals' correlation in
time counts (`share`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from coaxlink.frames import Array
from coaxlink.health.columns import THRUST_SPECIMEN, TORQUE_SPECIMEN, Flight
from coaxlink.health.hypotheses import FAULT_ODDS, KINDS, Comparison, chipped_prior, compared
from coaxlink.health.onsets import Onset
from coaxlink.health.priors import LIFT_TODAY, LOSS_SD, MATTERS, TORQUE_WITH_THRUST
from coaxlink.premises.answer import CANNOT_JUDGE, NOT_THIS_VEHICLE, NotJudged, OtherVehicle, Reason, as_json

WATCH, GROUND = 0.05, 0.5  # probabilities that a rotor lost more than MATTERS
NORMAL_95 = 1.96


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    def as_json(self) -> list[float]:
        """[value, low, high]."""
        return [self.value, self.low, self.high]


@dataclass(frozen=True)
class RotorHealth:
    """One rotor at a flight's end: shares of the model's loads, what all rotors have in common taken off."""

    number: int
    pair: int | None
    thrust: Interval
    torque: Interval


@dataclass(frozen=True)
class PairHealth:
    """Two rotors together: what a flight tells better than each alone."""

    rotors: tuple[int, int]
    thrust: Interval


@dataclass(frozen=True)
class FlightHealth:
    """All rotors at the end of one flight."""

    name: str
    seconds: float
    rotors: tuple[RotorHealth, ...]
    pairs: tuple[PairHealth, ...]


@dataclass(frozen=True)
class SuspectRotor:
    """A rotor that may have lost something: how likely, how much if so, since when."""

    number: int
    probability: float  # that it lost more than MATTERS
    loss: Interval  # share of its thrust, given that it is this one
    since: str  # the flight
    onset_s: Interval | None  # in that flight's own time; None: it was there from its start
    gradual: bool  # it came over a part of the flight and not at once
    kind: str  # the likeliest of `hypotheses.KINDS`


@dataclass(frozen=True)
class MendedRotor:
    """A rotor that had lost something and has it again: its propeller or motor was changed."""

    number: int
    probability: float
    loss: Interval  # share of its thrust
    since: str  # the flight
    until: str  # the first flight without


@dataclass(frozen=True)
class Health:
    """The answer."""

    verdict: str  # sound, watch, ground it; or one of the two that are none (`premises.answer`)
    probability: float  # that some rotor lost more than MATTERS
    suspects: tuple[SuspectRotor, ...]  # most likely first
    flights: tuple[FlightHealth, ...]
    payload: float  # probability that in one flight the centre of mass was elsewhere
    detects: float  # share of one rotor's thrust that these flights would tell from nothing, median rotor
    cannot_judge: tuple[NotJudged, ...] = ()  # premises that the answer hangs on: no rotor is named
    not_this_vehicle: tuple[OtherVehicle, ...] = ()  # likewise
    mended: tuple[MendedRotor, ...] = ()  # likelier than not
    premises: tuple[str, ...] = ()  # what the logs' readers took for granted, in words
    slid: float = 0.0  # probability that something aboard moved within a flight

    @classmethod
    def withheld(
        cls,
        flights: Sequence[FlightHealth],
        cannot_judge: Sequence[NotJudged] = (),
        not_this_vehicle: Sequence[OtherVehicle] = (),
    ) -> Health:
        """No verdict, for these reasons."""
        verdict = NOT_THIS_VEHICLE if not_this_vehicle else CANNOT_JUDGE
        lacks, differs = tuple(cannot_judge), tuple(not_this_vehicle)
        return cls(verdict, np.nan, (), tuple(flights), np.nan, np.nan, lacks, differs)

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why there is no verdict."""
        return (*self.not_this_vehicle, *self.cannot_judge)

    def as_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "verdict": self.verdict,
            **as_json(self.reasons),
            "premises": list(self.premises),
            "probability": None if self.reasons else self.probability,
            "matters": MATTERS,
            "suspects": [
                {
                    "rotor": s.number,
                    "probability": s.probability,
                    "loss": s.loss.as_json(),
                    "since": s.since,
                    "onset_s": s.onset_s.as_json() if s.onset_s else None,
                    "gradual": s.gradual,
                    "kind": s.kind,
                }
                for s in self.suspects
            ],
            "mended": [
                {
                    "rotor": m.number,
                    "probability": m.probability,
                    "loss": m.loss.as_json(),
                    "since": m.since,
                    "until": m.until,
                }
                for m in self.mended
            ],
            "payload_moved": None if self.reasons else self.payload,
            "detects": None if self.reasons else self.detects,
            "flights": [
                {
                    "name": f.name,
                    "seconds": f.seconds,
                    "rotors": [
                        {"rotor": r.number, "thrust": r.thrust.as_json(), "torque": r.torque.as_json()}
                        for r in f.rotors
                    ],
                    "pairs": [{"rotors": list(p.rotors), "thrust": p.thrust.as_json()} for p in f.pairs],
                }
                for f in self.flights
            ],
        }


def judge(
    flights: Sequence[Flight],
    names: Sequence[str],
    numbers: Sequence[int],
    pairs: Sequence[tuple[int, int]],
    *,
    slides: bool = True,
) -> Health:
    """Health of the rotors over flights, oldest first. `pairs`: (upper, lower) indices into the rotors;
    without `slides` nothing aboard is believed to move within a flight."""
    rotors = flights[0].thrust.shape[1]
    found = compared(flights, slides=slides)
    suspects = tuple(
        sorted((_suspect(i, numbers[i], found, names) for i in range(rotors)), key=lambda s: -s.probability)
    )
    probability = min(sum(s.probability for s in suspects), 1.0)
    verdict = "ground it" if probability >= GROUND else "watch" if probability >= WATCH else "sound"
    each = tuple(
        _of_flight(flight, name, numbers, pairs, _set_in(found, k))
        for k, (flight, name) in enumerate(zip(flights, names, strict=True))
    )
    mended = tuple(_mended(found, numbers, names))
    detects = _detects(found, rotors)
    return Health(
        verdict, probability, suspects, each, found.payload, detects, mended=mended, slid=found.slid
    )


def _mended(found: Comparison, numbers: Sequence[int], names: Sequence[str]) -> Iterator[MendedRotor]:
    """Rotors that more likely than not were mended, and when."""
    for rotor, number in enumerate(numbers):
        if sum(float(m.chance[rotor]) for m in found.mended) < GROUND:
            continue
        best = max(found.mended, key=lambda m: float(m.chance[rotor]))
        loss = _loss(float(best.mean[rotor]), float(best.sd[rotor]))
        chance = sum(float(m.chance[rotor]) for m in found.mended)
        yield MendedRotor(number, chance, loss, names[best.since], names[best.until])


def _loss(mean: float, sd: float) -> Interval:
    """A share of the thrust at the commanded speed, and that is known to LIFT_TODAY (voltage, air)."""
    half = NORMAL_95 * float(np.hypot(sd, LIFT_TODAY * mean))
    return Interval(mean, mean - half, mean + half)


def _suspect(rotor: int, number: int, found: Comparison, names: Sequence[str]) -> SuspectRotor:
    own = [f[:, rotor] for f in found.chances]  # (R, kinds) a flight
    matters = sum(float(np.sum(c * m[:, rotor])) for c, m in zip(own, found.matters, strict=True))
    flight = int(np.argmax([c.sum() for c in own]))
    here, onsets = own[flight], found.onsets[flight]
    within = here[1:].sum() > here[0].sum()
    onset = None
    if within:
        onset = _quantiles(onsets[1:], here[1:].sum(axis=1))
    slow = np.array([o.over_s > 0.0 for o in onsets])
    total = max(float(here.sum()), 1e-300)
    mean, square = (
        float(np.sum(here * m[:, rotor]) / total) for m in (found.mean[flight], found.square[flight])
    )
    loss = _loss(mean, float(np.sqrt(max(square - mean**2, 0.0))))
    kind = KINDS[int(np.argmax(sum(c.sum(axis=0) for c in own)))]
    gradual = bool(within and here[slow].sum() > here[1:].sum() / 2)
    return SuspectRotor(number, matters, loss, names[flight], onset, gradual, kind)


def _quantiles(onsets: Sequence[Onset], weights: Array) -> Interval:
    """Median and 95 % of when it began; the grid's next times on either side belong to it."""
    starts, widths = np.array([[o.start_s, o.width_s] for o in onsets], float).T
    order = np.argsort(starts)
    share = np.cumsum(weights[order]) / np.sum(weights)
    low, middle, high = (order[np.searchsorted(share, q * share[-1])] for q in (0.025, 0.5, 0.975))
    return Interval(
        float(starts[middle]), float(starts[low] - widths[low]), float(starts[high] + widths[high])
    )


def _set_in(found: Comparison, flight: int) -> dict[int, Onset]:
    """Rotors that may have lost something within this flight, from WATCH on, and when most likely."""
    onsets, chances = found.onsets[flight], found.chances[flight].sum(axis=2)  # (R, N)
    when = np.argmax(chances, axis=0)
    return {
        i: onsets[r]
        for i, r in enumerate(when)
        if onsets[r].start_s is not None and chances[:, i].sum() >= WATCH
    }


def _of_flight(
    flight: Flight,
    name: str,
    numbers: Sequence[int],
    pairs: Sequence[tuple[int, int]],
    set_in: Mapping[int, Onset],
) -> FlightHealth:
    """Every rotor's gains at the end of one flight with nobody flagged: all may be off, by LOSS_SD, and those
    of `set_in` by as much more from then on."""
    rotors = flight.thrust.shape[1]
    loads = (flight.thrust, flight.torque)
    time_profiles = {i: o.time_profile(flight.time_s, flight.cutoff_hz) for i, o in set_in.items()}
    steps = [load[:, [i]] * w[:, None] for load in loads for i, w in time_profiles.items()]
    X = np.concatenate([*loads, flight.lasting, flight.passing, *steps], axis=1)
    precision = np.concatenate(
        [
            np.zeros(2 * rotors),
            1 / flight.lasting_sd**2,
            1 / flight.passing_sd**2,
            np.full(len(steps), LOSS_SD**-2.0),
        ]
    )
    prior = chipped_prior() + np.diag([THRUST_SPECIMEN**2, TORQUE_SPECIMEN**2])
    A = flight.share * X.T @ X + np.diag(precision)
    block = np.linalg.inv(prior)
    for i in range(rotors):
        place = np.ix_([i, rotors + i], [i, rotors + i])
        A[place] += block
    covariance = np.linalg.inv(A)
    mean = covariance @ (flight.share * X.T @ flight.y)

    at_end = np.eye(len(mean))[: 2 * rotors]  # of each rotor's thrust, then torque
    first = len(mean) - len(steps)
    for n, i in enumerate(time_profiles):
        at_end[i, first + n] = at_end[rotors + i, first + len(time_profiles) + n] = 1.0
    alike = at_end.reshape(2, rotors, -1).mean(axis=1)

    def interval(weights: Array, quantity: int) -> Interval:
        apart = weights - alike[quantity]  # what all share is the pack's and the air's, not a rotor's
        value = 1.0 + float(apart @ mean)
        half = NORMAL_95 * float(np.sqrt(apart @ covariance @ apart))
        return Interval(value, value - half, value + half)

    partner = {i: j for a, b in pairs for i, j in ((a, b), (b, a))}
    found = tuple(
        RotorHealth(
            numbers[i], numbers[partner[i]] if i in partner else None,
            interval(at_end[i], 0), interval(at_end[rotors + i], 1),
        )
        for i in range(rotors)
    )  # fmt: skip
    lift = np.abs(flight.thrust).sum(axis=0)
    together = []
    for upper, lower in pairs:
        share = lift[upper] / max(lift[upper] + lift[lower], 1e-300)
        weights = share * at_end[upper] + (1 - share) * at_end[lower]
        together.append(PairHealth((numbers[upper], numbers[lower]), interval(weights, 0)))
    return FlightHealth(name, flight.seconds, found, tuple(together))


def _detects(found: Comparison, rotors: int) -> float:
    """The loss of thrust that would bring the verdict `watch` in the median rotor, all else as expected.

    Of a chipped blade before the last flight. Its evidence must outweigh the prior odds of one rotor:
    0.5 (loss / sd)^2 = log(rotors / FAULT_ODDS).
    """
    ratio = np.array([1.0, TORQUE_WITH_THRUST])
    information = np.maximum(np.einsum("a,nab,b->n", ratio, found.last[:, :2, :2], ratio), 1e-300)
    return float(np.median(information**-0.5) * np.sqrt(2 * np.log(rotors / FAULT_ODDS * WATCH)))
