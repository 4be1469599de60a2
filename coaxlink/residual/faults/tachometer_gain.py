"""A tachometer that reads too high or too low by one share throughout, seen in the loads of a given model.

Thrust and torque of the rotor, and for the upper one what its wake does to the lower, are then those of one
other speed: a single number stands for the misses of two to four loads. It is believed only if it leaves
little but noise, takes most of what is missed (something in one load alone leaves that load's most), does
clearly better than any one effect and than what the nuisance may be off by, and if the other rotor asks for
no such number (both alike is the air, or another pair).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from coaxlink.frames import Array, StandFrame
from coaxlink.residual.regression.blocks import Blocks, Index, least_of, solve, squares
from coaxlink.residual.regression.problem import Option, Problem
from coaxlink.residual.result import Suspect

MOST, LEAST = 0.2, 0.012  # of the speed
NEAR_NOISE = 1.3  # times the noise, over all loads
MOST_OF_IT = 0.7  # of what the nuisance model leaves beyond noise
CLEAR = 30.0  # noise variances that one number must win, and be ahead of any rival
AHEAD = 0.1  # of what the nuisance model leaves beyond noise: as much at least it must be ahead of any rival
ALIKE = 0.35  # of this side's number: as much on the other is the air's, or the model's
GOLDEN = 0.381966


@dataclass(frozen=True)
class _Bench:
    """The loads of a problem and the nuisance model columns that touch them, whitened."""

    problem: Problem
    frame: StandFrame
    loads: list[int]  # channels of the frame, the first ones of the problem
    nuisance: Index  # (B,) columns of the design

    def residual(self, gains: Array) -> Array:
        """(rows, C) whitened, had the tachometers read high by these shares (2,)."""
        p, frame, keep = self.problem, self.frame, self.frame.keep
        read = frame.speeds[keep]
        change = (frame.loads_at(read) - frame.loads_at(read / (1.0 + gains)))[:, self.loads]
        return np.asarray(p.residual[:, : len(self.loads)] + change / p.sigma[: len(self.loads)])

    @cached_property
    def blocks(self) -> Blocks:
        """The normal equations of the loads alone."""
        b, k = self.problem.blocks, len(self.loads)
        return replace(
            b, gram=b.gram[:k], touched=b.touched[:k], moment=b.moment[:, :k], power=b.power[:, :k]
        )

    def left(self, *options: Option) -> float:
        """Least squares that the nuisance model and options leave of the loads at the speeds as read."""
        use = np.concatenate([self.nuisance, *(o.columns for o in options)])
        fit = solve(self.blocks, use, np.ones(self.blocks.count))
        return float(squares(self.blocks, fit).sum())

    def best(self, side: int, other: float = 0.0) -> tuple[float, float]:
        """The share by which this side's tachometer reads high, and what it leaves."""
        design = self.problem.design[:, : len(self.loads), self.nuisance]
        gram = self.blocks.only(self.nuisance).total[0]
        bounds = self.problem.blocks.bounds[self.nuisance]

        def cost(gain: float) -> float:
            gains = np.array([gain, other] if side == 0 else [other, gain])
            return least_of(gram, bounds, design, self.residual(gains))

        coarse = np.linspace(-MOST, MOST, 21)
        at = int(np.argmin([cost(g) for g in coarse]))
        low, high = coarse[max(at - 1, 0)], coarse[min(at + 1, 20)]
        for _ in range(14):
            a, b = low + GOLDEN * (high - low), high - GOLDEN * (high - low)
            low, high = (low, b) if cost(a) < cost(b) else (a, high)
        gain = 0.5 * (low + high)
        return float(gain), cost(gain)


def wrong_gain(problem: Problem) -> Suspect | None:
    """The tachometer that reads another speed throughout than the loads of the given model are of."""
    frame = problem.frame
    if problem.fitted_nuisance or frame.driven or min(np.ptp(frame.speeds, axis=0)) < 0.1:
        return None
    loads = [c for c in frame.present if c < 4]
    touched = np.any(problem.design[:, : len(loads), problem.nuisance] != 0.0, axis=(0, 1))
    bench = _Bench(problem, frame, loads, problem.nuisance[touched])
    nothing = bench.left()
    noise = float(problem.residual.shape[0] * len(loads))
    if nothing < 1.1 * noise:
        return None
    found = []
    for side in (0, 1):
        if {2 * side, 2 * side + 1} <= set(loads):
            gain, left = bench.best(side)
            if abs(gain) > LEAST and nothing - left > CLEAR:
                found.append((left, side, gain))
    if not found:
        return None
    left, side, gain = min(found)
    if left > NEAR_NOISE**2 * noise or nothing - left < MOST_OF_IT * (nothing - noise):
        return None
    beyond = max(CLEAR, AHEAD * (nothing - noise))
    for option in problem.options:
        if not option.effect.flagged and bench.left(option) < left + beyond:
            return None
    other = bench.best(1 - side, gain)
    if abs(other[0]) > ALIKE * abs(gain) and left - other[1] > CLEAR:
        return None
    name = f"{('upper', 'lower')[side]}_rpm"
    why = (
        f"reads {100 * gain:+.1f} % throughout: all loads are those of another speed than it shows, or the"
        " model is of another rotor"
    )
    return Suspect(name, "all", why)
