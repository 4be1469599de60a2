"""Every hypothesis of a rotor's fault weighed: which rotor, of which kind, since when, until which flight if
it was mended before that, beside which payload.

Kinds are what a fault does to loads at the commanded speed: a blade that lost a part gives less thrust and
torque, a rough one (ice, erosion, a nicked edge) less thrust and takes more torque, a motor that turns slower
does to both rotors of its pair what the model's derivatives say.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from coaxlink.evidence.blocks import Block, joined
from coaxlink.frames import Array
from coaxlink.health.columns import Flight
from coaxlink.health.evidence import Further, Statistics, Together, gained, together
from coaxlink.health.onsets import ONSET_ROUNDS, Onset, onsets, variants
from coaxlink.health.priors import (
    CG_MOVED_M,
    INERTIA_TODAY,
    LIFT_TODAY,
    LOSS_SD,
    MATTERS,
    MENDED,
    ROUGH_TORQUE,
    TORQUE_APART,
    TORQUE_WITH_THRUST,
)
from coaxlink.residual.diagnosis.hypotheses import ODDS

FAULT_ODDS = float(np.exp(ODDS))  # that a rotor lost something: as of any other effect
PAYLOAD_ODDS = 1 / 5  # that its payload is not where it was
CG_PAYLOAD_M, INERTIA_PAYLOAD = 0.03, 0.1  # something else hangs there today
# beside faults so many payloads are weighed at most, and none below this share of the odds of no payload
PAYLOADS, NEGLIGIBLE = 8, 1e-4
LOOKS = 3  # at most, at what the likeliest hypothesis leaves
SETTLED = 0.05  # of noise: less of a change is not worth another look
KINDS = ("a blade that lost a part", "a rough blade", "a motor that turns slower")
# of KINDS, (kinds, 3, 2): lost thrust, torque, and speed as thrust for a deviation of each of two numbers,
# the loss and the torque beside it
LOADS = np.zeros((3, 3, 2))
LOADS[0] = [[LOSS_SD, 0.0], [TORQUE_WITH_THRUST * LOSS_SD, TORQUE_APART], [0.0, 0.0]]
LOADS[1] = [[LOSS_SD, 0.0], [-ROUGH_TORQUE, ROUGH_TORQUE], [0.0, 0.0]]
LOADS[2, 2, 0] = LOSS_SD


@dataclass(frozen=True)
class Payload:
    """Something otherwise aboard: strapped on so from before a flight on, or moved within it."""

    flight: int
    onset: Onset

    @property
    def slid(self) -> bool:
        """Whether it moved within the flight."""
        return self.onset.start_s is not None

    def blocks(self, f: Flight) -> list[Block]:
        """What it may add to its flight."""
        time_profile = self.onset.time_profile(f.time_s, f.cutoff_hz)[:, None, None]
        return [
            replace(b, columns=b.columns * time_profile) for b in (slides(f) if self.slid else strapped(f))
        ]


def strapped(f: Flight) -> list[Block]:
    """What is further off where something else hangs."""
    cg, inertia = np.sqrt(CG_PAYLOAD_M**2 - CG_MOVED_M**2), np.sqrt(INERTIA_PAYLOAD**2 - INERTIA_TODAY**2)
    return _wider(f, {"cg_": cg, "imu_place": cg, "inertia": inertia})


def slides(f: Flight) -> list[Block]:
    """What changes where a load slides, drops or touches something in flight."""
    return [*_wider(f, {"cg_": CG_PAYLOAD_M, "lift_today": LIFT_TODAY}), f.yaw_push]


def _wider(f: Flight, sds: Mapping[str, float]) -> list[Block]:
    """What may be otherwise today, by how its name begins, with these deviations."""
    wide = [(b, sd) for b in f.passing for start, sd in sds.items() if b.name.startswith(start)]
    return [replace(b, deviation=np.array([sd])) for b, sd in wide]


@dataclass(frozen=True)
class Fault:
    """It set in in flight `since` and was mended before flight `until`, if there is one."""

    since: int
    until: int
    onset: Onset
    rotor: int
    loads: Array  # (3, 2) of LOADS

    def blocks(self, number: int, f: Flight) -> list[Block]:
        """What it adds to a flight; all flights have its size in common."""
        w = np.full(len(f.time_s), float(self.since <= number < self.until))
        if number == self.since:
            w = self.onset.time_profile(f.time_s, f.cutoff_hz)
        return [lost(f, self.rotor, self.loads, w)]


def lost(f: Flight, rotor: int, loads: Array, share: Array) -> Block:
    """What a rotor's loss adds, a unit for each of LOADS' two numbers; `share` (rows,) of it is there."""
    return Block("loss", f.loads[:, :, rotor] @ loads * share[:, None, None], np.ones(2))


@dataclass(frozen=True)
class Comparison:
    """Posterior probabilities, with R onsets of each flight, N rotors, K kinds."""

    onsets: tuple[tuple[Onset, ...], ...]
    # by the flight that a fault set in in and the one before which it was mended (or how many there are):
    # (4, R, N, K) its probability, and this times that of more than MATTERS lost, the lost share, its square
    faults: Mapping[tuple[int, int], Array]
    gain: tuple[Array, ...]  # (R,) log of the evidence gained by a fault or a payload alone, set in like this
    best: Payload | Fault | None  # the likeliest one, if any
    payload: float  # probability that in one flight something was not as drawn
    slid: float  # of it, that it moved within the flight
    last: Array  # (N, 3, 3) information on a fault that was there in all of the last flight
    flights: tuple[Flight, ...]  # with the noise that the likeliest hypothesis leaves


def compared(flights: Sequence[Flight], *, slides: bool = True) -> Comparison:
    """All hypotheses over flights, oldest first; without `slides` nothing aboard moves within a flight.

    The grid of onsets is made finer where something sets in; noise is what the likeliest hypothesis leaves.
    """
    grid = [onsets(f.time_s) for f in flights]
    found = _compared(flights, grid, slides)
    for look in range(ONSET_ROUNDS + LOOKS):
        if look < ONSET_ROUNDS:
            now, finer = list(flights), [_finer(o, g) for o, g in zip(grid, found.gain, strict=True)]
        else:
            now, finer = _as_left(flights, found.best), grid
        if finer != grid or any(a is not b for a, b in zip(now, flights, strict=True)):
            flights, grid = now, finer
            found = _compared(flights, grid, slides)
    return found


def _as_left(flights: Sequence[Flight], best: Payload | Fault | None) -> list[Flight]:
    """Flights with the noise that a payload or a fault leaves at its likeliest, where that is more.

    Less is none: a hypothesis fits some of the noise, and its form of what comes gradually is rough.
    """
    own = {best.flight: best.blocks(flights[best.flight])} if isinstance(best, Payload) else {}
    shared = [best.blocks(k, f) for k, f in enumerate(flights)] if isinstance(best, Fault) else ()
    out = []
    for f, left in zip(flights, together(flights, own, shared).left, strict=True):
        rest = left / f.scale
        noise = np.maximum(f.noise, np.sqrt(np.mean(rest**2, axis=0)))
        hang = max(f.together, f.hangs(rest))
        change = np.log(noise / f.noise * np.sqrt(hang / f.together))
        out.append(replace(f, noise=noise, together=hang) if change.max() > SETTLED else f)
    return out


def _finer(known: tuple[Onset, ...], gain: Array) -> tuple[Onset, ...]:
    """With the sudden and the gradual onset split that explain most, by a fault or a payload, if anything."""
    found = known
    for sudden in (True, False):
        fits = np.where([o.start_s is not None and o.sudden == sudden for o in known], gain, -np.inf)
        if fits.max() > 0.0:
            found = variants(found, known[int(np.argmax(fits))])
    return found


def _compared(flights: Sequence[Flight], grid: Sequence[tuple[Onset, ...]], may_slide: bool) -> Comparison:
    profiles = [
        np.stack([o.time_profile(f.time_s, f.cutoff_hz) for o in known])
        for f, known in zip(flights, grid, strict=True)
    ]
    drawn = together(flights, {})
    payloads, without = _payloads(flights, grid, profiles, drawn, may_slide)
    sound = without + float(np.log(1 - FAULT_ODDS))
    weighed = list(_faults(flights, grid, profiles, drawn, payloads, without))
    most = max(float(w.log.max()) for w in weighed)
    top = max(float(sound.max()), most)
    masses, faults = np.exp(sound - top), dict[tuple[int, int], Array]()
    alone = [np.full(len(known), -np.inf) for known in grid]
    for w in weighed:
        part = np.exp(w.log - top)
        masses[w.beside] += part.sum()
        moments = part * np.stack([np.ones_like(part), w.matters, w.mean, w.mean**2 + w.sd**2])
        faults[w.since, w.until] = faults.get((w.since, w.until), 0.0) + moments
        if w.beside == 0:
            alone[w.since] = np.maximum(alone[w.since], w.log.max(axis=(1, 2)))
    ways = np.split(sound[1:], np.cumsum([len(known) for known in grid])[:-1])
    gain = tuple(np.maximum(a, b) - sound[0] for a, b in zip(alone, ways, strict=True))
    best = max((w for w in weighed if w.beside == 0), key=lambda w: float(w.log.max()))
    likeliest = payloads[int(np.argmax(sound))]
    total = float(masses.sum())
    slid = np.array([bool(p and p.slid) for p in payloads])
    last = next(w for w in weighed if w.beside == 0 and w.since == len(flights) - 1).information[0]
    return Comparison(
        tuple(grid), {k: m / total for k, m in faults.items()}, gain,
        best.likeliest(grid) if float(best.log.max()) > float(sound.max()) else likeliest,
        1.0 - float(masses[0]) / total, float(masses[slid].sum()) / total, last, tuple(flights),
    )  # fmt: skip


def _payloads(
    flights: Sequence[Flight],
    grid: Sequence[tuple[Onset, ...]],
    profiles: Sequence[Array],
    drawn: Together,
    may_slide: bool,
) -> tuple[list[Payload | None], Array]:
    """All payloads, None as drawn, and their log weights without a fault."""
    payloads: list[Payload | None] = [None]
    without = [float(np.log(1 - PAYLOAD_ODDS))]
    for k, (f, w, known) in enumerate(zip(flights, profiles, grid, strict=True)):
        gains = [_alone(drawn, k, f, strapped(f), w[:1]), _alone(drawn, k, f, slides(f), w[1:])]
        prior = np.log([PAYLOAD_ODDS / len(flights) * o.prior for o in known])
        prior[1 if not may_slide else len(known) :] = -np.inf
        payloads += [Payload(k, o) for o in known]
        without += list(prior + np.concatenate(gains))
    return payloads, np.array(without)


def _alone(drawn: Together, k: int, f: Flight, blocks: Sequence[Block], profiles: Array) -> Array:
    """(R,) log evidence that blocks add in these time profiles."""
    columns, deviation = joined(blocks)
    return gained(Further(f, columns[:, :, None], profiles).beside(drawn, k), deviation)[:, 0]


def _faults(
    flights: Sequence[Flight],
    grid: Sequence[tuple[Onset, ...]],
    profiles: Sequence[Array],
    drawn: Together,
    payloads: Sequence[Payload | None],
    without: Array,
) -> Iterator[_Weighed]:
    """Every fault beside the payload as drawn, and beside the likeliest others."""
    further = [Further(f, f.loads, w) for f, w in zip(flights, profiles, strict=True)]
    count, rotors = len(flights), flights[0].loads.shape[2]
    others = 1 + np.argsort(-without[1:], kind="stable")[:PAYLOADS]
    likely = [int(k) for k in others if without[k] > without[0] + np.log(NEGLIGIBLE)]
    for beside in (0, *likely):
        p = payloads[beside]
        now = together(flights, {p.flight: p.blocks(flights[p.flight])}) if p else drawn
        for since, until, reported in _spans([x.beside(now, k) for k, x in enumerate(further)]):
            odds = np.log(FAULT_ODDS / (count * rotors * len(KINDS))) + _lasts(since, until, count)
            prior = odds + np.log([o.prior for o in grid[since]])[:, None, None]
            yield _weighed(reported, since, until, beside, prior + without[beside])


def _spans(reported: Sequence[Statistics]) -> Iterator[tuple[int, int, Statistics]]:
    """Of a fault that set in in each flight, mended before each later one in turn, then never."""
    for since, total in enumerate(reported):
        for until in range(since + 1, len(reported) + 1):
            yield since, until, total
            if until < len(reported):
                total = total + reported[until].always()


def _lasts(since: int, until: int, count: int) -> float:
    """Log of the prior of when a fault that set in in one flight was mended, if it was."""
    gaps = count - 1 - since
    if not gaps:
        return 0.0
    return float(np.log(1.0 - MENDED if until == count else MENDED / gaps))


@dataclass(frozen=True)
class _Weighed:
    """Faults set in in flight `since`, mended before `until`, beside one of the payloads.

    (R, N, K) each: log of their weight, the lost thrust, and the chance of more than MATTERS.
    """

    since: int
    until: int
    beside: int
    log: Array
    mean: Array
    sd: Array
    matters: Array
    information: Array  # (R, N, 3, 3)

    def likeliest(self, grid: Sequence[tuple[Onset, ...]]) -> Fault:
        """Of all of them."""
        r, rotor, kind = np.unravel_index(int(np.argmax(self.log)), self.log.shape)
        return Fault(self.since, self.until, grid[self.since][r], int(rotor), LOADS[kind])


def _weighed(reported: Statistics, since: int, until: int, beside: int, prior: Array) -> _Weighed:
    """What each fault gains over none: its size integrated over its prior, thrust lost and not gained."""
    from scipy.special import log_ndtr

    all_of_it = reported.information
    information = np.einsum("kai,rnab,kbj->rnkij", LOADS, all_of_it, LOADS, optimize=True)
    score = np.einsum("kai,rna->rnki", LOADS, reported.score)
    covariance = np.linalg.inv(information + np.eye(2))
    sizes = np.einsum("rnkij,rnkj->rnki", covariance, score)
    gain = 0.5 * (np.sum(score * sizes, axis=-1) + np.linalg.slogdet(covariance)[1])
    mean, sd = LOSS_SD * sizes[..., 0], LOSS_SD * np.sqrt(covariance[..., 0, 0])
    allowed = log_ndtr(mean / sd)
    matters = np.minimum(np.exp(log_ndtr((mean - MATTERS) / sd) - allowed), 1.0)
    log = prior + gain + np.log(2.0) + allowed
    return _Weighed(since, until, beside, log, mean, sd, matters, all_of_it)
