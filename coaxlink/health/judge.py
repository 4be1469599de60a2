"""Verdict over flights: which rotor, since when, with what probability.

Hypotheses: nothing is wrong; or one rotor gives less, from before one of the flights on or from some moment
within it, to the end or until it was mended before a later one. Each beside every payload: as drawn, strapped
on otherwise in a flight, or slid within one. All are linear and Gaussian (`columns`), so each has an exact
evidence (Bishop 2006, section 3.5) and Bayes' theorem does the rest (`hypotheses`); residuals' correlation in
time counts (`share`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np

from coaxlink.constants import NORMAL_95
from coaxlink.frames import Array
from coaxlink.health.columns import Flight
from coaxlink.health.evidence import together
from coaxlink.health.hypotheses import FAULT_ODDS, KINDS, LOADS, Comparison, Payload, compared, lost
from coaxlink.health.onsets import Onset
from coaxlink.health.priors import GROUND, LIFT_TODAY, MATTERS, TORQUE_WITH_THRUST, WATCH
from coaxlink.instruments.findings import Suspect
from coaxlink.premises.answer import CANNOT_JUDGE, NOT_THIS_VEHICLE, NotJudged, OtherVehicle, Reason, as_json

SLIGHT = 1e-3  # of all explanations: a less likely one moves no interval


class Interval(NamedTuple):
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class RotorHealth:
    """One rotor at a flight's end: shares of the model's loads, what all rotors have in common taken off."""

    rotor: int  # number
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

    rotor: int  # number
    probability: float  # that it lost more than MATTERS
    loss: Interval  # share of its thrust, given that it is this one
    since: str  # the flight
    onset_s: Interval | None  # in that flight's own time; None: it was there from its start
    gradual: bool  # it came over a part of the flight and not at once
    kind: str  # the likeliest of `hypotheses.KINDS`


@dataclass(frozen=True)
class MendedRotor:
    """A rotor that had lost something and has it again: its propeller or motor was changed."""

    rotor: int  # number
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
    suspect_data: tuple[Suspect, ...] = ()  # columns, or rows of them, that are no readings
    # of each rotor in the last flight, where ESCs report: its speed over what its command asks, others at 1
    speed_ratios: Mapping[int, float] = field(default_factory=dict)

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

    def __repr__(self) -> str:
        flights = "1 flight" if len(self.flights) == 1 else f"{len(self.flights)} flights"
        return f"Health({self.verdict}, {flights})"

    def __str__(self) -> str:
        """The verdict, and of every suspect its probability, its loss and since when."""
        lines = [repr(self), *(reason.line() for reason in self.reasons)]
        for s in self.suspects:
            loss = f"{100 * s.loss.value:.0f} % ({100 * s.loss.low:.0f} to {100 * s.loss.high:.0f})"
            lines.append(
                f"rotor {s.rotor}: probability {s.probability:.2f}; if so {loss} of its thrust, {s.since}"
            )
        return "\n".join(lines)

    def as_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "verdict": self.verdict,
            **as_json(self.reasons),
            "premises": list(self.premises),
            "probability": None if self.reasons else self.probability,
            "matters": MATTERS,
            "suspect_data": [asdict(s) for s in self.suspect_data],
            "suspects": [asdict(s) for s in self.suspects],
            "speed_ratios": {str(n): ratio for n, ratio in self.speed_ratios.items()},
            "mended": [asdict(m) for m in self.mended],
            "payload_moved": None if self.reasons else self.payload,
            "detects": None if self.reasons else self.detects,
            "flights": [asdict(f) for f in self.flights],
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
    found = compared(flights, slides=slides)
    suspects = tuple(
        sorted((_suspect(i, n, found, names) for i, n in enumerate(numbers)), key=lambda s: -s.probability)
    )
    probability = min(sum(s.probability for s in suspects), 1.0)
    verdict = "ground it" if probability >= GROUND else "watch" if probability >= WATCH else "sound"
    each = tuple(_of_flight(found, k, name, numbers, pairs) for k, name in enumerate(names))
    mended = tuple(_mended(found, numbers, names))
    return Health(
        verdict, probability, suspects, each, found.payload, _detects(found), mended=mended, slid=found.slid
    )


def _mended(found: Comparison, numbers: Sequence[int], names: Sequence[str]) -> Iterator[MendedRotor]:
    """Rotors that more likely than not were mended, and when."""
    gone = {when: m.sum(axis=(1, 3)) for when, m in found.faults.items() if when[1] < len(names)}  # (4, N)
    for rotor, number in enumerate(numbers):
        chance = sum(float(m[1, rotor]) for m in gone.values())
        if chance >= GROUND:
            since, until = max(gone, key=lambda when: float(gone[when][1, rotor]))
            yield MendedRotor(number, chance, _loss(gone[since, until][:, rotor]), names[since], names[until])


def _loss(moments: Array) -> Interval:
    """The lost share of thrust at the commanded speed, and that is known to LIFT_TODAY (voltage, air).

    `moments` are a probability, then (`hypotheses.Comparison`) its part that matters, and that times the lost
    share and its square.
    """
    mean, square = moments[2:] / max(float(moments[0]), 1e-300)
    half = NORMAL_95 * float(np.sqrt(max(square - mean**2, 0.0) + (LIFT_TODAY * mean) ** 2))
    return Interval(float(mean), float(mean - half), float(mean + half))


def _suspect(rotor: int, number: int, found: Comparison, names: Sequence[str]) -> SuspectRotor:
    own = [found.faults[k, len(names)][:, :, rotor] for k in range(len(names))]  # (4, R, K) a flight
    flight = int(np.argmax([m[0].sum() for m in own]))
    here, onsets = own[flight][0].sum(axis=1), found.onsets[flight]
    within = bool(here[1:].sum() > here[0])
    slow = np.array([o.over_s > 0.0 for o in onsets])
    kind = int(np.argmax(sum(m[0].sum(axis=0) for m in own)))
    return SuspectRotor(
        number, sum(float(m[1].sum()) for m in own), _loss(own[flight].sum(axis=(1, 2))), names[flight],
        _quantiles(onsets[1:], here[1:]) if within else None,
        within and bool(here[slow].sum() > here[1:].sum() / 2), KINDS[kind],
    )  # fmt: skip


def _quantiles(onsets: Sequence[Onset], weights: Array) -> Interval:
    """Median and 95 % of when it began; the grid's next times on either side belong to it."""
    starts, widths = np.array([[o.start_s, o.width_s] for o in onsets], float).T
    order = np.argsort(starts)
    share = np.cumsum(weights[order]) / np.sum(weights)
    low, middle, high = (order[np.searchsorted(share, q * share[-1])] for q in (0.025, 0.5, 0.975))
    return Interval(
        float(starts[middle]), float(starts[low] - widths[low]), float(starts[high] + widths[high])
    )


def _set_in(found: Comparison, flight: int, rotor: int) -> Onset | None:
    """When within this flight a rotor most likely failed, if it was then and not before."""
    onsets, last = found.onsets[flight], len(found.flights)
    here = sum(found.faults[flight, k][0, :, rotor].sum(axis=1) for k in range(flight + 1, last + 1))  # (R,)
    best = onsets[int(np.argmax(here))]
    late = here.sum() > 0.5 * _failed(found, flight)[rotor].sum()
    return best if best.start_s is not None and late else None


def _failed(found: Comparison, flight: int) -> Array:
    """(N, kinds) probability that a rotor has a fault of a kind, however small, at a flight's end."""
    there = [m[0].sum(axis=0) for (since, until), m in found.faults.items() if since <= flight < until]
    return np.asarray(np.sum(there, axis=0))


@dataclass(frozen=True)
class _Ends:
    """Thrust and torque gains of all rotors at a flight's end, if one of them, or none, failed."""

    mean: Array  # (2, N) less what the others have in common
    covariance: Array  # (2, N, N)
    weight: float


def _ends(found: Comparison, number: int, failed: tuple[int, int] | None, weight: float) -> _Ends:
    """If this rotor failed, in this way (`hypotheses.KINDS`)."""
    f, count = found.flights[number], found.flights[number].loads.shape[2]
    unit, losses, p = np.eye(count), [], found.best
    if failed is not None:
        rotor, kind = failed
        onset = _set_in(found, number, rotor)
        share = onset.time_profile(f.time_s, f.cutoff_hz) if onset else np.ones(len(f.time_s))
        losses = [lost(f, rotor, LOADS[kind], share)]
    aboard = {0: p.blocks(f)} if isinstance(p, Payload) and p.flight == number else {}
    fit = together([f], aboard, [losses]).fit
    # (2, N, columns) that are a gain at the flight's end: those that last, and the loss
    ends = [np.hstack([unit, 0 * unit]), np.hstack([0 * unit, unit])]
    if failed is not None:  # a blade takes its own loads, a motor that turns slower changes its pair's
        blade, motor = LOADS[kind][:2], LOADS[kind][2]
        ends = [
            np.hstack([own, np.outer(f.slowed[q][:, rotor], motor) - np.outer(unit[rotor], blade[q])])
            for q, own in enumerate(ends)
        ]
    at_end = np.pad(ends, ((0, 0), (0, 0), (len(fit.values) - ends[0].shape[1], 0)))
    others = np.ones(count) if failed is None else 1.0 - unit[rotor]
    apart = at_end - np.einsum("n,qnk->qk", others / others.sum(), at_end)[:, None]
    return _Ends(apart @ fit.values, np.einsum("qnk,kl,qml->qnm", apart, fit.covariance, apart), weight)


def _of_flight(
    found: Comparison, number: int, name: str, numbers: Sequence[int], pairs: Sequence[tuple[int, int]]
) -> FlightHealth:
    """Every rotor's gains at one flight's end, if it or another or none failed, less what the others have in
    common: the pack's and the air's. What was aboard is as is likeliest.

    Each of these counts by the flights' evidence alone: how rare faults are tells a fleet, and no interval
    of a rotor that lost something and is not distinguished from sound ones would hold that.
    """
    chance = _failed(found, number)
    prior = FAULT_ODDS * (number + 1) / len(found.flights) / chance.size  # of a fault by then, each
    sound = max(1.0 - float(chance.sum()), 0.0) / (1.0 - FAULT_ODDS)
    evidence = np.concatenate([[sound], chance.ravel() / prior / chance.shape[1]])
    weights = evidence / evidence.sum()
    may = [None, *np.ndindex(*chance.shape)]
    cases = [_ends(found, number, i, w) for i, w in zip(may, weights, strict=True) if w > SLIGHT]

    def interval(of: Array, quantity: int) -> Interval:
        """The moments of all cases together."""
        total = sum(c.weight for c in cases)
        means = [float(of @ c.mean[quantity]) for c in cases]
        mean = float(sum(c.weight * m for c, m in zip(cases, means, strict=True))) / total
        variance = sum(
            c.weight / total * (float(of @ c.covariance[quantity] @ of) + (m - mean) ** 2)
            for c, m in zip(cases, means, strict=True)
        )
        half = NORMAL_95 * float(np.sqrt(float(variance)))
        return Interval(1.0 + mean, 1.0 + mean - half, 1.0 + mean + half)

    unit = np.eye(len(numbers))
    partner = {i: j for a, b in pairs for i, j in ((a, b), (b, a))}
    each = tuple(
        RotorHealth(
            n, numbers[partner[i]] if i in partner else None, interval(unit[i], 0), interval(unit[i], 1)
        )
        for i, n in enumerate(numbers)
    )
    f = found.flights[number]
    lift = np.abs(f.loads[:, 0, :, 0]).sum(axis=0)
    share = {(a, b): lift[a] / max(lift[a] + lift[b], 1e-300) for a, b in pairs}
    both = tuple(
        PairHealth((numbers[a], numbers[b]), interval(s * unit[a] + (1 - s) * unit[b], 0))
        for (a, b), s in share.items()
    )
    return FlightHealth(name, f.seconds, each, both)


def _detects(found: Comparison) -> float:
    """The loss of thrust that would bring the verdict `watch` in the median rotor, all else as expected.

    Of a chipped blade before the last flight. Its evidence must outweigh the prior odds of one rotor:
    0.5 (loss / sd)^2 = log(rotors / FAULT_ODDS).
    """
    ratio = np.array([1.0, TORQUE_WITH_THRUST])
    information = np.maximum(np.einsum("a,nab,b->n", ratio, found.last[:, :2, :2], ratio), 1e-300)
    return float(np.median(information**-0.5) * np.sqrt(2 * np.log(len(information) / FAULT_ODDS * WATCH)))
