"""One effect tried beside others: how much held-out error it removes, and the tests that it must pass."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_test

from coaxlink.residual.regression.autocorrelation import autocorrelation_time
from coaxlink.residual.regression.blocks import held_out, solve, squares
from coaxlink.residual.regression.joint_model import columns_of
from coaxlink.residual.regression.problem import Option, Problem
from coaxlink.residual.regression.schur_complement import SchurComplement

Array = NDArray[np.float64]
Index = NDArray[np.intp]

ALPHA = 1e-3  # over all looks of one step
SIZE = 0.005  # of the reference load, 95th percentile of what the nuisance model cannot absorb
CLEAR = 0.6  # of the squared error of a channel: what explains that much of what is left may be smaller
GAIN = 0.15  # of the squared error of the channel that gains most
ENOUGH = 150_000  # rows times channels that a trial looks at one by one
# of what a member adds to a load: its form may err by that much, so less beside it is no effect
FORM = 0.05
BEYOND_FORM = 0.9  # of a channel's squared error: no misfit of another's form is mended so by chance


@dataclass(frozen=True)
class Trial:
    """One option judged against a set of members."""

    option: Option
    gain: float  # drop of the held-out square sum, in variances of the remaining error
    share: float  # largest relative drop of any channel's held-out square sum
    p_value: float  # corrected for all looks
    size: float
    refused: str | None
    total: float  # held-out square sum left
    least: float = SIZE  # size that counts
    channel: int = 0  # where it is that large

    @property
    def real(self) -> bool:
        """Whether the data demand it and physics allows it, however small it is."""
        return self.gain > 0 and self.p_value <= ALPHA and self.refused is None

    @property
    def only_small(self) -> bool:
        """Whether its size alone keeps it out."""
        return self.real and self.size < self.least and self.share >= GAIN

    @property
    def why_not(self) -> str | None:
        """The first gate it fails, or None."""
        if self.gain <= 0:
            return "no better on held-out blocks"
        if self.p_value > ALPHA:
            return f"within noise (p = {self.p_value:.2g} over all looks)"
        if self.size < self.least:
            return (
                f"adds {100 * self.size:.2f} % of the reference load beyond what the base corrections absorb"
            )
        if self.share < GAIN:
            return f"lowers no channel's held-out squared error by more than {100 * self.share:.1f} %"
        return self.refused


class Judge:
    """Tries options against sets of members; remembers the held-out errors of sets."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.looks = len(problem.options)
        self._known: dict[tuple[int, ...], Array] = {}
        self._sums: dict[tuple[int, ...], Array] = {}
        # how large and how coloured things are, a part of a long log tells as well: whole blocks of it
        every = max(1, problem.residual.size // ENOUGH)
        self._rows: Any = slice(None) if every == 1 else np.flatnonzero(problem.block % every == 0)
        self._design, self._residual = problem.design[self._rows], problem.residual[self._rows]
        self._block = problem.block[self._rows]
        self._nuisance = np.ascontiguousarray(self._design[:, :, problem.nuisance], dtype=float)

    def held_out(self, use: Index) -> Array:
        """(B, C) held-out square sums of a fit of these columns."""
        key = tuple(use)
        if key not in self._known:
            self._known[key] = held_out(self.problem.blocks, use)[0]
        return self._known[key]

    def left(self, members: list[Option]) -> float:
        """Held-out square sum of a set."""
        return float(self.sums(members).sum())

    def sums(self, members: list[Option]) -> Array:
        """(B,) held-out square sums of a set over all channels."""
        beside = columns_of(self.problem, members)[len(self.problem.nuisance) :]
        key = tuple(beside)
        if key not in self._sums:
            self._sums[key] = self._sets.held_out_sum(beside)
        return self._sums[key]

    @cached_property
    def _sets(self) -> SchurComplement:
        return SchurComplement(self.problem.blocks, self.problem.nuisance)

    def trial(self, members: list[Option], option: Option) -> Trial:
        """`option` on top of `members`."""
        p = self.problem
        without = columns_of(p, members)
        whole = columns_of(p, [*members, option])
        before, after = self.held_out(without), self.held_out(whole)
        ones = np.ones(p.blocks.count)
        null, full = solve(p.blocks, without, ones), solve(p.blocks, whole, ones)
        rows = p.blocks.rows.sum()
        beyond = whole[len(p.nuisance) :]
        added = self._design[:, :, beyond].astype(float)
        left = self._residual - self._nuisance @ full[p.nuisance] - added @ full[beyond]
        variance = np.maximum(np.mean(left**2, axis=0), 1e-12)
        inflation = autocorrelation_time(left, self._block)
        drop = (squares(p.blocks, null) - squares(p.blocks, full)).sum(axis=0) / (variance * inflation)
        p_value = min(1.0, self.looks * self._chance(drop, len(whole) - len(without), whole))
        change = self._nuisance @ (full - null)[p.nuisance] + added @ (full - null)[beyond]
        sizes = np.quantile(np.abs(change) * p.sigma / p.reference, 0.95, axis=0)
        size = float(sizes.max())
        mine = self.worth_of(option.columns, full)
        held_before, held_after = before.sum(axis=0), after.sum(axis=0)
        shares = (held_before - held_after) / np.maximum(held_before, 1e-12)
        share = float(np.max(shares))
        gain = float(np.sum((held_before - held_after) / np.maximum(held_after / rows, 1e-12)))
        total = float(after.sum())
        named = option.numbers(p.frame, full[option.columns])
        refused = option.effect.refuse(named)
        if refused is None and share < BEYOND_FORM:
            refused = self._within_form(members, full, mine)
        return Trial(
            option,
            gain if total < before.sum() else -1.0,
            share,
            p_value,
            size,
            refused,
            total,
            p.clear_size if share > CLEAR else SIZE,
            int(np.argmax(sizes)),
        )

    def _chance(self, drop: Array, numbers: int, use: Index) -> float:
        """Of a fall of the square sums (C,), in variances, by so many numbers where nothing is there.

        F test: the variances were had from the same rows, of which the columns `use` took their share.
        """
        p = self.problem
        rows = float(p.blocks.rows.sum())
        touched = np.any(self._design[:, :, use] != 0.0, axis=0).sum(axis=1)
        weight = np.maximum(drop, 0.0) / max(float(np.maximum(drop, 0.0).sum()), 1e-300)
        free = np.maximum(rows - touched, 1.0)
        statistic = max(float(np.sum(drop * free / rows)), 0.0)
        return float(f_test.sf(statistic / numbers, numbers, float(weight @ free)))

    def worth_of(self, columns: Index, fit: Array) -> Array:
        """(C,) what columns add under a fit (P,), 95th percentile over the reference load."""
        added = self._design[:, :, columns].astype(float) @ fit[columns]
        scale = self.problem.sigma / self.problem.reference
        return np.asarray(np.quantile(np.abs(added), 0.95, axis=0) * scale)

    def _within_form(self, members: list[Option], fit: Array, mine: Array) -> str | None:
        """Whether what is added, `mine` (C,), is no more anywhere than the form of a member may err by."""
        c = int(np.argmax(mine))
        for m in members:
            if mine[c] < FORM * float(self.worth_of(m.columns, fit)[c]):
                return f"no more than the form of {m.name} may err by"
        return None

    def _refused(self, members: list[Option], option: Option) -> str | None:
        """Why physics does not allow the option's coefficients beside the others'."""
        p = self.problem
        full = solve(p.blocks, columns_of(p, members), np.ones(p.blocks.count))
        return option.effect.refuse(option.numbers(p.frame, full[option.columns]))

    def best_of_each(self, members: list[Option], allowed: set[str] | None = None) -> list[Trial]:
        """The best shape of every effect that is not a member, best first."""
        taken = {m.name for m in members}
        shapes: dict[str, list[Option]] = {}
        for option in self.problem.options:
            if option.name not in taken and (allowed is None or option.name in allowed):
                shapes.setdefault(option.name, []).append(option)
        best = []
        for mine in shapes.values():
            ranked = sorted(mine, key=lambda option: float(self.sums([*members, option]).sum()))
            sound = (o for o in ranked if self._refused([*members, o], o) is None)
            best.append(next(sound, ranked[0]))
        trials = [self.trial(members, option) for option in best]
        return sorted(trials, key=lambda t: t.total)
