"""Exact evidences of what may have happened to a rotor or to a payload, flight by flight.

    y_k = L_k a + P_k b_k + w_k(t) F_k c + noise       a lasting, b_k of flight k alone, c a fault's size

All priors are normal, so every evidence is exact (Bishop 2006, section 3.5). What is of one flight alone is
eliminated flight by flight (the Schur complement of its block): what is left are sums over flights of small
matrices, for every hypothesis of what was strapped on, and of when a fault set in.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from coaxlink.frames import Array
from coaxlink.health.columns import (
    CG_PAYLOAD_M,
    INERTIA_PAYLOAD,
    THRUST_SPECIMEN,
    TORQUE_SPECIMEN,
    Flight,
)
from coaxlink.health.onsets import Onset, onsets
from coaxlink.health.priors import DISTURBED, LIFT_TODAY

LOADS = 3  # columns of a rotor's fault: lost thrust, lost torque, lost speed
SLID = (("cg_", CG_PAYLOAD_M), ("lift_today", LIFT_TODAY), ("yaw_push", DISTURBED))


@dataclass(frozen=True)
class Eliminated:
    """A flight's rows with its own unknowns integrated out; L lasting unknowns, R onsets, N rotors."""

    gram: Array  # (L, L)
    moment: Array  # (L,)
    log: float  # of the evidence, less what all hypotheses share
    cross: Array  # (L, R, N, 3)
    own: Array  # (R, N, 3, 3)
    fault_moment: Array  # (R, N, 3)

    def from_start(self) -> Eliminated:
        """With the fault there in every row: a flight behind the one in which it set in."""
        first = slice(0, 1)
        return replace(
            self,
            cross=self.cross[:, first],
            own=self.own[first],
            fault_moment=self.fault_moment[first],
        )


class FlightSums:
    """One flight's sums of products, from which every hypothesis takes its part."""

    def __init__(self, flight: Flight, known: Sequence[Onset] | None = None) -> None:
        root = np.sqrt(flight.share)
        self.flight, self.onsets = flight, tuple(known or onsets(flight.time_s))
        gains = np.concatenate([flight.thrust, flight.torque], axis=1)
        self._lasting = np.concatenate([flight.lasting, gains], axis=1) * root
        self._passing, self._y = flight.passing * root, flight.y * root
        faults = np.stack([-flight.thrust, -flight.torque, flight.slower], axis=-1) * root  # (n, N, 3)
        self._flat = faults.reshape(len(faults), -1)
        self._squares = np.einsum("nia,nib->niab", faults, faults).reshape(len(faults), -1)
        self._both = np.concatenate([self._lasting, self._passing], axis=1)
        self._products: dict[Onset, tuple[Array, ...]] = {}
        self._take()

    def variants(self, known: Sequence[Onset]) -> FlightSums:
        """The same flight with other onsets; what is known of the old ones is kept."""
        other = copy(self)
        other.onsets = tuple(known)
        other._take()
        return other

    def _take(self) -> None:
        """Products of every onset that is new."""
        for o in self.onsets:
            if o not in self._products:
                w = o.time_profile(self.flight.time_s, self.flight.cutoff_hz)
                own = w[:, None] * self._flat
                self._products[o] = (w, self._both.T @ own, self._y @ own, w**2 @ self._squares)
        self.time_profiles, cross, pull, squares = zip(*(self._products[o] for o in self.onsets), strict=True)
        shape = (len(self.onsets), self.flight.thrust.shape[1], LOADS)
        self._cross = np.stack(cross, axis=1).reshape(self._both.shape[1], -1)  # (L + P, R N 3)
        self._pull = np.stack(pull).reshape(shape)
        self._own = np.stack(squares).reshape(*shape, LOADS)

    def eliminated(
        self, slid: Onset | None = None, *, payload: bool = False, faults: bool = True
    ) -> Eliminated:
        """The flight as drawn; with something else strapped on (`payload`); or with what slid on the way.

        Without `faults` nothing is said of these: R is 0.
        """
        L = self._lasting
        P, sd = self._alone(slid, payload)
        A = P.T @ P + np.diag(sd**-2)
        inverse = np.linalg.inv(A)
        PL, Py = P.T @ L, P.T @ self._y
        gram = L.T @ L - PL.T @ inverse @ PL
        moment = L.T @ self._y - PL.T @ inverse @ Py
        log = 0.5 * float(Py @ inverse @ Py - np.linalg.slogdet(A)[1] - 2.0 * np.sum(np.log(sd)))
        shape = (len(self.onsets) if faults else 0, self.flight.thrust.shape[1], LOADS)
        if not faults:
            return Eliminated(
                gram, moment, log, np.zeros((len(gram), *shape)), np.zeros((*shape, LOADS)), np.zeros(shape)
            )
        cross, extra = self._cross, P[:, self._passing.shape[1] :]
        if extra.shape[1]:
            time_profiles = np.stack(self.time_profiles)  # (R, n)
            more = [time_profiles @ (column[:, None] * self._flat) for column in extra.T]  # (R, N 3) each
            cross = np.concatenate([cross, np.stack(more).reshape(len(more), -1)])
        mine = cross[L.shape[1] :]
        solved = inverse @ mine
        by_rotor, solved_by = (m.reshape(len(m), -1, LOADS) for m in (mine, solved))
        taken = np.stack([np.sum(by_rotor * solved_by[..., [b]], axis=0) for b in range(LOADS)], axis=-1)
        return Eliminated(
            gram, moment, log,
            (cross[: L.shape[1]] - PL.T @ solved).reshape(-1, *shape),
            self._own - taken.reshape(*shape, LOADS),
            self._pull - (Py @ solved).reshape(shape),
        )  # fmt: skip

    def _alone(self, slid: Onset | None, payload: bool) -> tuple[Array, Array]:
        """(n, P) columns of what is of this flight alone, and their priors' sds."""
        f = self.flight
        sd = f.passing_sd.copy()
        for i, name in enumerate(f.passing_names):
            if payload and name.startswith(("cg_", "imu_place")):
                sd[i] = CG_PAYLOAD_M
            elif payload and name.startswith("inertia"):
                sd[i] = INERTIA_PAYLOAD
        if slid is None:
            return self._passing, sd
        own, own_sd = self._slid(slid)
        return np.concatenate([self._passing, own], axis=1), np.concatenate([sd, own_sd])

    def columns(self, slid: Onset | None, payload: bool, fault: Array) -> tuple[Array, Array, Array]:
        """(n, L + k) shared and (n, P) own columns of one hypothesis, and (P,) own precisions.

        `fault` (n, k) are its fault's, unscaled; the rest as for `eliminated`.
        """
        P, sd = self._alone(slid, payload)
        shared = np.concatenate([self._lasting, fault * np.sqrt(self.flight.share)], axis=1)
        return shared, P, sd**-2.0

    @property
    def y(self) -> Array:
        """(n,) what is to be explained, tempered as all columns are."""
        return self._y

    def _slid(self, onset: Onset) -> tuple[Array, Array]:
        """Columns of a load that slides, drops or touches something in flight, and their sds."""
        f = self.flight
        time_profile = onset.time_profile(f.time_s, f.cutoff_hz)[:, None]
        columns, sds = [], []
        for start, sd in SLID:
            for i, name in enumerate(f.passing_names):
                if name.startswith(start):
                    columns.append(self._passing[:, [i]] * time_profile)
                    sds.append(sd)
        pushed = f.yaw_push[:, None] * time_profile * np.sqrt(f.share)
        return np.concatenate([*columns, pushed], axis=1), np.array([*sds, DISTURBED])


def lasting_precision(flight: Flight) -> Array:
    """(L,) of the prior of all lasting unknowns: the vehicle's, each rotor's thrust and torque."""
    rotors = flight.thrust.shape[1]
    specimen = np.repeat([THRUST_SPECIMEN, TORQUE_SPECIMEN], rotors)
    return np.asarray(np.concatenate([flight.lasting_sd, specimen]) ** -2.0)


@dataclass(frozen=True)
class Seen:
    """What the data say of faults that set in in one flight, all else integrated out."""

    log: float  # evidence without a fault
    information: Array  # (R, N, 3, 3)
    score: Array  # (R, N, 3)


def seen(flights: Sequence[Eliminated], precision: Array, since: int) -> Iterator[Seen]:
    """Of a fault that set in in flight `since`, mended before each later one in turn, then never."""
    gram, moment, log = _shared(flights, precision)
    inverse = np.linalg.inv(gram)
    cross, own, pull = (np.array(a) for a in _of(flights[since]))
    for until in range(since + 1, len(flights) + 1):
        flat = cross.reshape(len(cross), -1, LOADS)
        solved = (inverse @ flat.reshape(len(cross), -1)).reshape(flat.shape)
        taken = np.stack([np.sum(flat * solved[..., [b]], axis=0) for b in range(LOADS)], axis=-1)
        score = pull - (moment @ solved.reshape(len(cross), -1)).reshape(pull.shape)
        yield Seen(log, own - taken.reshape(own.shape), score)
        if until < len(flights):
            for total, part in zip((cross, own, pull), _of(flights[until].from_start()), strict=True):
                total += part


def evidence(flights: Sequence[Eliminated], precision: Array) -> float:
    """Log of the evidence without a fault, less what all hypotheses share."""
    return _shared(flights, precision)[2]


def _shared(flights: Sequence[Eliminated], precision: Array) -> tuple[Array, Array, float]:
    gram = np.sum([f.gram for f in flights], axis=0) + np.diag(precision)
    moment = np.sum([f.moment for f in flights], axis=0)
    log = sum(f.log for f in flights) + 0.5 * float(
        moment @ np.linalg.solve(gram, moment) - np.linalg.slogdet(gram)[1] + np.sum(np.log(precision))
    )
    return gram, moment, log


def _of(f: Eliminated) -> tuple[Array, Array, Array]:
    return f.cross, f.own, f.fault_moment


def left(
    sums: Sequence[FlightSums], precision: Array, designs: Sequence[tuple[Array, Array, Array]], fault: Array
) -> list[Array]:
    """(n,) of each flight: what the likeliest numbers of one hypothesis leave, in its flight's noise.

    `designs` are `FlightSums.columns`; `fault` (k, k) is the precision of its fault's numbers.
    """
    total = np.zeros((len(precision) + len(fault),) * 2)
    total[: len(precision), : len(precision)] = np.diag(precision)
    total[len(precision) :, len(precision) :] = fault
    pull = np.zeros(len(total))
    kept = []
    for s, (X, P, own) in zip(sums, designs, strict=True):
        inverse = np.linalg.inv(P.T @ P + np.diag(own))
        PX, Py = P.T @ X, P.T @ s.y
        total += X.T @ X - PX.T @ inverse @ PX
        pull += X.T @ s.y - PX.T @ inverse @ Py
        kept.append((inverse, PX, Py))
    shared = np.linalg.solve(total, pull)
    rests = []
    for s, (X, P, _), (inverse, PX, Py) in zip(sums, designs, kept, strict=True):
        rest = s.y - X @ shared - P @ (inverse @ (Py - PX @ shared))
        rests.append(rest / np.sqrt(s.flight.share))
    return rests
