"""Verdict over flights: which rotor, from which flight on, with what probability.

Hypotheses: nothing is wrong; or one rotor gives less from one of the flights on. Each with and without a
payload that moved the centre of mass. All are linear and Gaussian (`columns`), so each has an exact evidence
(Bishop 2006, section 3.5) and Bayes' theorem does the rest; residuals' correlation in time counts (`share`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from coaxlink.frames import Array
from coaxlink.health.columns import (
    CG_PAYLOAD_M,
    INERTIA_PAYLOAD,
    THRUST_SPECIMEN,
    TORQUE_SPECIMEN,
    Flight,
)
from coaxlink.health.priors import LOSS_SD, MATTERS, TORQUE_APART, TORQUE_WITH_THRUST

FAULT_ODDS = 1 / 50  # that a vehicle somebody wants judged has a rotor that lost something
PAYLOAD_ODDS = 1 / 5  # that its payload is not where it was
WATCH, GROUND = 0.05, 0.5  # probabilities that a rotor lost more than that
NORMAL_95 = 1.96
NONE = -1
_Key = tuple[
    int, int, int
]  # flight of a payload, rotor that lost something, flight since when; NONE for none


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
    """One rotor in one flight: shares of the model's loads, what all rotors have in common taken off."""

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
    """All rotors in one flight."""

    name: str
    seconds: float
    rotors: tuple[RotorHealth, ...]
    pairs: tuple[PairHealth, ...]


@dataclass(frozen=True)
class Suspect:
    """A rotor that may have lost something: how likely, how much if so, since when."""

    number: int
    probability: float  # that it lost more than MATTERS
    loss: Interval  # share of its thrust, given that it is this one
    since: str  # the flight


@dataclass(frozen=True)
class Health:
    """The answer."""

    verdict: str  # sound, watch, ground it
    probability: float  # that some rotor lost more than MATTERS
    suspects: tuple[Suspect, ...]  # most likely first
    flights: tuple[FlightHealth, ...]
    payload: float  # probability that in one flight the centre of mass was elsewhere
    detects: float  # share of one rotor's thrust that these flights would tell from nothing, median rotor

    def as_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "verdict": self.verdict,
            "probability": self.probability,
            "matters": MATTERS,
            "suspects": [
                {"rotor": s.number, "probability": s.probability, "loss": s.loss.as_json(), "since": s.since}
                for s in self.suspects
            ],
            "payload_moved": self.payload,
            "detects": self.detects,
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


@dataclass(frozen=True)
class _Space:
    """Sufficient statistics of all flights: unknowns are lasting, specimen gains, passing of each flight."""

    gram: Array  # (p, p) of X, the flights' rows tempered
    moment: Array  # (p,) X'y
    precision: Array  # (p,) of the prior
    faults: Array  # (p, K, N, 2) X'F: for each flight and rotor, lost thrust and torque
    own: Array  # (K, N, 2, N, 2) F'F, of one flight
    fault_moment: Array  # (K, N, 2) F'y


def judge(
    flights: Sequence[Flight], names: Sequence[str], numbers: Sequence[int], pairs: Sequence[tuple[int, int]]
) -> Health:
    """Health of the rotors over flights, oldest first. `pairs`: (upper, lower) indices into the rotors."""
    rotors, count = flights[0].thrust.shape[1], len(flights)
    weights: dict[_Key, float] = {}
    found: dict[_Key, tuple[float, float]] = {}
    for payload in range(NONE, count):
        space = _space(flights, payload)
        inverse = np.asarray(np.linalg.inv(space.gram + np.diag(space.precision)), float)
        odds = np.log(1 - PAYLOAD_ODDS if payload == NONE else PAYLOAD_ODDS / count)
        base = odds + _evidence(space, inverse)
        weights[payload, NONE, NONE] = base + np.log(1 - FAULT_ODDS)
        for rotor, first in product(range(rotors), range(count)):
            gain, mean, sd = _fault(space, inverse, rotor, first)
            weights[payload, rotor, first] = base + gain + np.log(FAULT_ODDS / rotors / count)
            found[payload, rotor, first] = mean, sd
    top = max(weights.values())
    mass = {k: float(np.exp(w - top)) for k, w in weights.items()}
    total = sum(mass.values())
    mass = {k: m / total for k, m in mass.items()}
    suspects = tuple(
        sorted(
            (_suspect(i, numbers[i], mass, found, names) for i in range(rotors)), key=lambda s: -s.probability
        )
    )
    probability = min(sum(s.probability for s in suspects), 1.0)
    verdict = "ground it" if probability >= GROUND else "watch" if probability >= WATCH else "sound"
    each = tuple(
        _of_flight(flight, name, numbers, pairs) for flight, name in zip(flights, names, strict=True)
    )
    moved = sum(m for k, m in mass.items() if k[0] != NONE)
    detects = _detects(_space(flights, NONE), rotors)
    return Health(verdict, probability, suspects, each, float(moved), detects)


def _space(flights: Sequence[Flight], payload: int) -> _Space:
    """`payload`: the flight in which something else may hang there, NONE for none."""
    rotors = flights[0].thrust.shape[1]
    lasting = flights[0].lasting.shape[1] + 2 * rotors
    sizes = [f.passing.shape[1] for f in flights]
    starts = lasting + np.concatenate([[0], np.cumsum(sizes)])
    p = int(starts[-1])
    gram, moment = np.zeros((p, p)), np.zeros(p)
    sd = np.ones(p)
    faults = np.zeros((p, len(flights), rotors, 2))
    own = np.zeros((len(flights), rotors, 2, rotors, 2))
    fault_moment = np.zeros((len(flights), rotors, 2))
    for k, f in enumerate(flights):
        gains = np.concatenate([f.thrust, f.torque], axis=1)
        X = np.concatenate([f.lasting, gains, f.passing], axis=1) * np.sqrt(f.share)
        y = f.y * np.sqrt(f.share)
        index = np.concatenate([np.arange(lasting), np.arange(starts[k], starts[k + 1])])
        gram[np.ix_(index, index)] += X.T @ X
        moment[index] += X.T @ y
        F = -np.stack([f.thrust, f.torque], axis=-1) * np.sqrt(f.share)  # (n, N, 2)
        flat = F.reshape(len(F), -1)
        faults[index, k] = (X.T @ flat).reshape(len(index), rotors, 2)
        own[k] = (flat.T @ flat).reshape(rotors, 2, rotors, 2)
        fault_moment[k] = (flat.T @ y).reshape(rotors, 2)
        specimen = np.repeat([THRUST_SPECIMEN, TORQUE_SPECIMEN], rotors)
        sd[:lasting] = np.concatenate([f.lasting_sd, specimen])
        today = f.passing_sd.copy()
        for i, name in enumerate(f.passing_names):
            if k == payload and name.startswith(("cg_", "imu_place")):
                today[i] = CG_PAYLOAD_M
            elif k == payload and name.startswith("inertia"):
                today[i] = INERTIA_PAYLOAD
        sd[starts[k] : starts[k + 1]] = today
    return _Space(gram, moment, 1 / sd**2, faults, own, fault_moment)


def _evidence(space: _Space, inverse: Array) -> float:
    """log p(y), less what is the same for all hypotheses."""
    _, log_det = np.linalg.slogdet(space.gram + np.diag(space.precision))
    return 0.5 * float(space.moment @ inverse @ space.moment - log_det + np.sum(np.log(space.precision)))


def _prior(rotor_sd: float = LOSS_SD) -> Array:
    """(2, 2) covariance of a fault's lost thrust and torque."""
    a = rotor_sd**2
    return np.array(
        [[a, TORQUE_WITH_THRUST * a], [TORQUE_WITH_THRUST * a, TORQUE_WITH_THRUST**2 * a + TORQUE_APART**2]]
    )


def _fault(space: _Space, inverse: Array, rotor: int, first: int) -> tuple[float, float, float]:
    """log of the evidence gained by a fault of a rotor from a flight on; mean and sd of its thrust's loss."""
    cross = space.faults[:, first:, rotor].sum(axis=1)  # (p, 2)
    own = space.own[first:, rotor, :, rotor].sum(axis=0)
    fault_moment = space.fault_moment[first:, rotor].sum(axis=0)
    S = own - cross.T @ inverse @ cross
    r = fault_moment - cross.T @ inverse @ space.moment
    prior = _prior()
    posterior = np.linalg.inv(S + np.linalg.inv(prior))
    mean = posterior @ r
    gain = 0.5 * float(r @ mean - np.linalg.slogdet(np.eye(2) + prior @ S)[1])
    sd = float(np.sqrt(posterior[0, 0]))
    # a fault takes thrust away: half of the prior's plane, and what of the posterior lies there
    return gain + np.log(2 * _above(float(mean[0]), sd, 0.0) + 1e-300), float(mean[0]), sd


def _above(mean: float, sd: float, least: float) -> float:
    """P(x > least) of a normal."""
    from scipy.special import ndtr

    return float(ndtr((mean - least) / sd))


def _suspect(
    rotor: int,
    number: int,
    mass: dict[_Key, float],
    found: dict[_Key, tuple[float, float]],
    names: Sequence[str],
) -> Suspect:
    own = {k: m for k, m in mass.items() if k[1] == rotor}
    likely = 0.0
    for key, m in own.items():
        mean, sd = found[key]
        likely += m * _above(mean, sd, MATTERS) / max(_above(mean, sd, 0.0), 1e-300)
    best = max(own, key=lambda k: own[k])
    mean, sd = found[best]
    loss = Interval(mean, mean - NORMAL_95 * sd, mean + NORMAL_95 * sd)
    return Suspect(number, float(likely), loss, names[best[2]])


def _of_flight(
    flight: Flight, name: str, numbers: Sequence[int], pairs: Sequence[tuple[int, int]]
) -> FlightHealth:
    """Every rotor's gains in one flight with nobody accused: all may be off, by LOSS_SD."""
    rotors = flight.thrust.shape[1]
    X = np.concatenate([flight.thrust, flight.torque, flight.lasting, flight.passing], axis=1)
    precision = np.concatenate([np.zeros(2 * rotors), 1 / flight.lasting_sd**2, 1 / flight.passing_sd**2])
    prior = _prior() + np.diag([THRUST_SPECIMEN**2, TORQUE_SPECIMEN**2])
    A = flight.share * X.T @ X + np.diag(precision)
    block = np.linalg.inv(prior)
    for i in range(rotors):
        place = np.ix_([i, rotors + i], [i, rotors + i])
        A[place] += block
    covariance = np.linalg.inv(A)
    mean = covariance @ (flight.share * X.T @ flight.y)

    alike = np.zeros((2, len(mean)))
    alike[0, :rotors] = alike[1, rotors : 2 * rotors] = 1.0 / rotors

    def interval(weights: Array, quantity: int) -> Interval:
        apart = weights - alike[quantity]  # what all share is the pack's and the air's, not a rotor's
        value = 1.0 + float(apart @ mean)
        half = NORMAL_95 * float(np.sqrt(apart @ covariance @ apart))
        return Interval(value, value - half, value + half)

    unit = np.eye(len(mean))
    partner = {i: j for a, b in pairs for i, j in ((a, b), (b, a))}
    found = tuple(
        RotorHealth(
            numbers[i], numbers[partner[i]] if i in partner else None,
            interval(unit[i], 0), interval(unit[rotors + i], 1),
        )
        for i in range(rotors)
    )  # fmt: skip
    lift = np.abs(flight.thrust).sum(axis=0)
    together = []
    for upper, lower in pairs:
        share = lift[upper] / max(lift[upper] + lift[lower], 1e-300)
        weights = share * unit[upper] + (1 - share) * unit[lower]
        together.append(PairHealth((numbers[upper], numbers[lower]), interval(weights, 0)))
    return FlightHealth(name, flight.seconds, found, tuple(together))


def _detects(space: _Space, rotors: int) -> float:
    """The loss of thrust that would bring the verdict `watch` in the median rotor, all else as expected.

    Its evidence must outweigh the prior odds of one rotor: 0.5 (loss / sd)^2 = log(rotors / FAULT_ODDS).
    """
    inverse = np.linalg.inv(space.gram + np.diag(space.precision))
    last = space.own.shape[0] - 1
    sds = []
    for i in range(rotors):
        cross = space.faults[:, last, i]
        S = space.own[last, i, :, i] - cross.T @ inverse @ cross
        ratio = np.array([1.0, TORQUE_WITH_THRUST])
        sds.append(1 / np.sqrt(max(float(ratio @ S @ ratio), 1e-300)))
    return float(np.median(sds) * np.sqrt(2 * np.log(rotors / FAULT_ODDS * WATCH)))
