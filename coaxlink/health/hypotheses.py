"""Every hypothesis of a rotor's fault weighed: which rotor, of which kind, since when, until which flight if
it was mended before that, beside which payload.

Kinds are what a fault does to loads at the commanded speed: a blade that lost a part gives less thrust and
torque, a rough one (ice, erosion, a nicked edge) less thrust and takes more torque, a motor that turns slower
does to both rotors of its pair what the model's derivatives say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from coaxlink.frames import Array
from coaxlink.health.columns import Flight, louder
from coaxlink.health.evidence import FlightSums, Seen, evidence, lasting_precision, left, seen
from coaxlink.health.onsets import ROUNDS, Onset, variants
from coaxlink.health.priors import LOSS_SD, MATTERS, MENDED, ROUGH_TORQUE, TORQUE_APART, TORQUE_WITH_THRUST

FAULT_ODDS = 1 / 50  # that a vehicle somebody wants judged has a rotor that lost something
PAYLOAD_ODDS = 1 / 5  # that its payload is not where it was
KINDS = ("a blade that lost a part", "a rough blade", "a motor that turns slower")
# beside faults so many ways to slide are weighed at most, and none below this share of the odds of no payload
SLID, NEGLIGIBLE = 8, 1e-4
LOOKS = 3  # at most, at what the likeliest hypothesis leaves
NODES = 12  # of Gauss and Legendre, for a quadrant of two normal variables


@dataclass(frozen=True)
class Mended:
    """A fault that was there from one flight on, and before another one was no more; (N,) each."""

    since: int
    until: int
    chance: Array  # that it was more than MATTERS
    mean: Array  # of the lost share of thrust, given the hypothesis
    sd: Array


@dataclass(frozen=True)
class Comparison:
    """Posterior probabilities of faults; lists have an entry for each flight in which one may have set in."""

    onsets: tuple[tuple[Onset, ...], ...]  # R of each flight
    chances: tuple[Array, ...]  # (R, N, kinds)
    matters: tuple[Array, ...]  # (R, N, kinds) that more than MATTERS is lost, given the hypothesis
    mean: tuple[Array, ...]  # (R, N, kinds) of the lost share of thrust
    square: tuple[Array, ...]
    gain: tuple[Array, ...]  # (R,) log of the evidence gained by a fault or a payload alone, set in like this
    mended: tuple[Mended, ...]  # faults that are not there any more
    payload: float  # probability that in one flight something was not as drawn
    slid: float  # of it, that it moved within the flight
    last: Array  # (N, 3, 3) information on a fault that was there in all of the last flight


def compared(flights: Sequence[Flight], *, slides: bool = True) -> Comparison:
    """All hypotheses over flights, oldest first; without `slides` nothing aboard moves within a flight.

    The grid of onsets is made finer where something sets in; noise is what the likeliest hypothesis leaves.
    """
    sums = [FlightSums(f) for f in flights]
    found, best = _compared(sums, slides)
    for _ in range(ROUNDS):
        split = [_worth(o, g) for o, g in zip(found.onsets, found.gain, strict=True)]
        if not any(split):
            break
        for k, parts in enumerate(split):
            known = sums[k].onsets
            for at in parts:
                known = variants(known, at)
            if parts:
                sums[k] = sums[k].variants(known)
        found, best = _compared(sums, slides)
    for _ in range(LOOKS):
        rests = _left(sums, best)
        changed = [louder(s.flight, rest) for s, rest in zip(sums, rests, strict=True)]
        if all(c is None for c in changed):
            break
        sums = [s if c is None else FlightSums(c, s.onsets) for s, c in zip(sums, changed, strict=True)]
        found, best = _compared(sums, slides)
    return found


@dataclass(frozen=True)
class _Hypothesis:
    """One of all: a payload's flight and way, and a fault's; None for none."""

    payload: tuple[int, Onset] | None
    fault: _Fault | None


@dataclass(frozen=True)
class _Fault:
    """It set in in flight `since` and was mended before flight `until`, if there is one."""

    since: int
    until: int
    onset: int
    rotor: int
    kind: int


def _left(sums: Sequence[FlightSums], best: _Hypothesis) -> list[Array]:
    """(n,) of each flight, what the likeliest hypothesis leaves."""
    parts: slice = slice(0, 0)
    prior = np.zeros((0, 0))
    if best.fault:
        parts, prior = PRIORS[best.fault.kind]
    designs = []
    for k, s in enumerate(sums):
        columns = np.zeros((len(s.y), len(prior)))
        if best.fault and best.fault.since <= k < best.fault.until:
            f, rotor = s.flight, best.fault.rotor
            time_profile = s.time_profiles[best.fault.onset if k == best.fault.since else 0]
            loads = np.stack([-f.thrust[:, rotor], -f.torque[:, rotor], f.slower[:, rotor]], axis=1)
            columns = loads[:, parts] * time_profile[:, None]
        onset_of_payload = best.payload[1] if best.payload and best.payload[0] == k else None
        designs.append(s.columns(*_way(onset_of_payload), columns))
    return left(sums, lasting_precision(sums[0].flight), designs, np.asarray(np.linalg.inv(prior), float))


def _worth(known: Sequence[Onset], gain: Array) -> list[Onset]:
    """The sudden and the gradual onset that explain most, by a fault or a payload, if anything."""
    found = []
    for sudden in (True, False):
        fits = np.where([o.start_s is not None and o.sudden == sudden for o in known], gain, -np.inf)
        best = int(np.argmax(fits))
        if fits[best] > 0.0:
            found.append(known[best])
    return found


def _compared(sums: Sequence[FlightSums], slides: bool) -> tuple[Comparison, _Hypothesis]:
    count, rotors = len(sums), sums[0].flight.thrust.shape[1]
    precision = lasting_precision(sums[0].flight)
    drawn = [s.eliminated() for s in sums]
    (nuisance,) = seen(drawn, precision, count - 1)
    # the ways in which a payload may have hung, and their log weights without a fault; the first is as drawn
    payloads: list[tuple[int, Onset | None]] = [(-1, None)]
    without = [nuisance.log + float(np.log(1 - PAYLOAD_ODDS))]
    for k, s in enumerate(sums):
        for onset in s.onsets:
            slid, strapped = _way(onset)
            payloads.append((k, onset))
            if slid and not slides:
                without.append(-np.inf)
                continue
            have = [*drawn[:k], s.eliminated(slid, payload=strapped, faults=False), *drawn[k + 1 :]]
            without.append(evidence(have, precision) + float(np.log(PAYLOAD_ODDS / count * onset.prior)))
    sound = [w + float(np.log(1 - FAULT_ODDS)) for w in without]
    faulty: list[tuple[int, int, int, _Weighed]] = []  # since and until which flight, way
    for way in _beside(payloads, without):
        where, hung = payloads[way]
        have = list(drawn)
        if hung is not None:
            slid, strapped = _way(hung)
            have[where] = sums[where].eliminated(slid, payload=strapped)
        for since, s in enumerate(sums):
            each = np.log(FAULT_ODDS / (count * rotors * len(KINDS)))
            prior = np.log([o.prior for o in s.onsets])[:, None, None] + each
            for until, so_far in enumerate(seen(have, precision, since), start=since + 1):
                weighed = _weighed(so_far)
                log = weighed.log + without[way] + prior + _lasts(since, until, count)
                faulty.append((since, until, way, replace(weighed, log=log)))
    alone = [
        np.max([w.log.max(axis=(1, 2)) for start, _, way, w in faulty if (start, way) == (k, 0)], axis=0)
        for k in range(count)
    ]
    ways_to_slide = np.split(np.array(sound[1:]), np.cumsum([len(s.onsets) for s in sums])[:-1])
    gain = tuple(np.maximum(a, b) - sound[0] for a, b in zip(alone, ways_to_slide, strict=True))

    top = max(*sound, *(float(w.log.max()) for *_, w in faulty))
    ways = np.exp(np.array(sound) - top)
    shapes = [(len(s.onsets), rotors, len(KINDS)) for s in sums]
    mass, matters, mean, square = ([np.zeros(shape) for shape in shapes] for _ in range(4))
    gone: dict[tuple[int, int], list[Array]] = {}
    for since, until, way, w in faulty:
        part = np.exp(w.log - top)
        ways[way] += part.sum()
        if until < count:
            here = gone.setdefault((since, until), [np.zeros(rotors) for _ in range(4)])
            for moment, power in zip(here, (w.matters, 1.0, w.mean, w.mean**2 + w.sd**2), strict=True):
                moment += (part * power).sum(axis=(0, 2))
            continue
        mass[since] += part
        matters[since] += part * w.matters
        mean[since] += part * w.mean
        square[since] += part * (w.mean**2 + w.sd**2)
    total = float(ways.sum())

    def given(values: list[Array]) -> tuple[Array, ...]:
        return tuple(v / np.maximum(m, 1e-300) for v, m in zip(values, mass, strict=True))

    mended = []
    for (since, until), (much, weight, first, second) in gone.items():
        each = first / np.maximum(weight, 1e-300)
        sd = np.sqrt(np.maximum(second / np.maximum(weight, 1e-300) - each**2, 0.0))
        mended.append(Mended(since, until, much / total, each, sd))
    moved = [bool(onset and onset.start_s is not None) for _, onset in payloads]
    on_the_way = float(ways[moved].sum()) / total
    found = Comparison(
        tuple(s.onsets for s in sums), tuple(m / total for m in mass), given(matters), given(mean),
        given(square), gain, tuple(mended), 1.0 - float(ways[0]) / total, on_the_way, nuisance.information[0],
    )  # fmt: skip
    way, fault = int(np.argmax(sound)), None
    most = sound[way]
    for since, until, at, w in faulty:
        if float(w.log.max()) > most:
            place = [int(i) for i in np.unravel_index(int(np.argmax(w.log)), w.log.shape)]
            most, way, fault = float(w.log.max()), at, _Fault(since, until, *place)
    where, hung = payloads[way]
    return found, _Hypothesis((where, hung) if hung else None, fault)


def _lasts(since: int, until: int, count: int) -> float:
    """Log of the prior of when a fault that set in in one flight was mended, if it was."""
    gaps = count - 1 - since
    if not gaps:
        return 0.0
    return float(np.log(1.0 - MENDED if until == count else MENDED / gaps))


def _way(onset: Onset | None) -> tuple[Onset | None, bool]:
    """What slid when, and whether something was strapped on otherwise from the start."""
    if onset is None or onset.start_s is None:
        return None, onset is not None
    return onset, False


def _beside(payloads: Sequence[tuple[int, Onset | None]], without: Sequence[float]) -> list[int]:
    """Ways that are weighed beside faults: as drawn, strapped on otherwise, and the likeliest to slide."""
    fixed = [way for way, (_, onset) in enumerate(payloads) if onset is None or onset.start_s is None]
    slid = [way for way in range(len(payloads)) if way not in fixed]
    slid.sort(key=lambda way: -without[way])
    likely = [way for way in slid[:SLID] if without[way] > without[0] + np.log(NEGLIGIBLE)]
    return [*fixed, *likely]


def chipped_prior() -> Array:
    """(2, 2) covariance of the thrust and the torque that a blade loses with a part of it."""
    a, both = LOSS_SD**2, TORQUE_WITH_THRUST * LOSS_SD**2
    return np.array([[a, both], [both, TORQUE_WITH_THRUST**2 * a + TORQUE_APART**2]])


# of KINDS: which of lost thrust, lost torque and lost speed, and their covariance
PRIORS = (
    (slice(0, 2), chipped_prior()),
    (slice(0, 2), np.diag([LOSS_SD**2, ROUGH_TORQUE**2])),
    (slice(2, 3), np.array([[LOSS_SD**2]])),
)
ROUGH = 1


@dataclass(frozen=True)
class _Weighed:
    """(R, N, kinds) each: log of the evidence, and the lost thrust."""

    log: Array
    mean: Array
    sd: Array
    matters: Array


def _weighed(s: Seen) -> _Weighed:
    """What each fault gains over none: its size integrated over its prior, thrust lost and not gained."""
    from scipy.special import ndtr

    logs, means, sds, matters = [], [], [], []
    for k, (part, prior) in enumerate(PRIORS):
        gain, mean, covariance = _posterior(s.information[..., part, part], s.score[..., part], prior)
        sd = np.sqrt(covariance[..., 0, 0])
        if k == ROUGH:  # a quarter of the prior's plane: thrust lost, torque gained
            torque_sd = np.sqrt(covariance[..., 1, 1])
            rho = -covariance[..., 0, 1] / (sd * torque_sd)
            spoken = -mean[..., 1] / torque_sd
            allowed, much = (_quadrant((mean[..., 0] - x) / sd, spoken, rho) for x in (0.0, MATTERS))
        else:  # a half
            allowed, much = (ndtr((mean[..., 0] - x) / sd) for x in (0.0, MATTERS))
        share = 4.0 if k == ROUGH else 2.0
        logs.append(gain + np.log(share * allowed + 1e-300))
        matters.append(np.clip(much / np.maximum(allowed, 1e-300), 0.0, 1.0))
        means.append(mean[..., 0])
        sds.append(sd)
    return _Weighed(*(np.stack(x, axis=-1) for x in (logs, means, sds, matters)))


def _posterior(information: Array, score: Array, prior: Array) -> tuple[Array, Array, Array]:
    """Log of the evidence gained, mean and covariance of a fault's numbers under a normal prior."""
    size = np.eye(len(prior))
    covariance = np.linalg.inv(information + np.linalg.inv(prior))
    mean = (covariance @ score[..., None])[..., 0]
    price = np.linalg.slogdet(size + prior @ information)[1]
    return 0.5 * (np.sum(score * mean, axis=-1) - price), mean, covariance


def _quadrant(h: Array, k: Array, rho: Array) -> Array:
    """P(x < h, y < k) of two standard normal variables (Plackett 1954).

    >>> round(float(_quadrant(np.zeros(1), np.zeros(1), np.array([0.5]))[0]), 6)
    0.333333
    """
    from scipy.special import ndtr

    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    top = np.arcsin(np.clip(rho, -0.9999, 0.9999))[..., None]
    angle = 0.5 * top * (nodes + 1.0)
    h, k = np.asarray(h)[..., None], np.asarray(k)[..., None]
    exponent = (h * h + k * k - 2.0 * h * k * np.sin(angle)) / (2.0 * np.cos(angle) ** 2)
    more = np.sum(weights * np.exp(-exponent), axis=-1) * 0.5 * top[..., 0] / (2.0 * np.pi)
    return np.clip(ndtr(h[..., 0]) * ndtr(k[..., 0]) + more, 0.0, 1.0)
