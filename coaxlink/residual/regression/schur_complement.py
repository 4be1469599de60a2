"""Held-out square sums of a nuisance and a few columns beside it, by the Schur complement of the nuisance.

A choice asks for hundreds of such sets, and most of each is the nuisance. Its normal equations are solved
once a fold, which leaves their Schur complement in the other columns: a set then costs its own columns.
A nuisance that would go beyond its bounds is solved as a whole.
"""

from __future__ import annotations

import numpy as np

from coaxlink.residual.regression.blocks import BEYOND, Array, Blocks, Index, held_out_sum, scaled, solved


class SchurComplement:
    """What `held_out_sum` says of `nuisance` and other columns, at a fraction of the cost later."""

    def __init__(self, blocks: Blocks, nuisance: Index) -> None:
        """F folds, B blocks, b columns in the nuisance model and o others."""
        self.blocks, self.nuisance = blocks, nuisance
        others = np.setdiff1d(np.arange(len(blocks.bounds)), nuisance)
        self._place = np.full(len(blocks.bounds), -1, np.intp)  # of a column among the others
        self._place[others] = np.arange(len(others))

        # of what a fold is fitted to: the nuisance model is stands - moves @ values of the others
        scale, gram, moment, self._limit = scaled(*blocks.trains, blocks.bounds)
        inner, mixed = gram[:, nuisance[:, None], nuisance], gram[:, nuisance[:, None], others]
        both = solved(inner, np.concatenate([mixed, moment[:, nuisance, None]], axis=-1))
        self._moves, self._stands = np.asarray(both[..., :-1]), np.asarray(both[..., -1])  # (F, b, o), (F, b)
        self._gram = gram[:, others[:, None], others] - mixed.swapaxes(1, 2) @ self._moves
        self._moment = moment[:, others] - (mixed.swapaxes(1, 2) @ self._stands[..., None])[..., 0]
        self._limit = self._limit[:, nuisance]

        # of what it is held against: power, moments and Gram matrices once the nuisance follows the others
        self._fold = np.unique(blocks.fold, return_inverse=True)[1]
        scale = scale[self._fold]
        grams, moments = blocks.summed
        grams, moments = grams / scale[:, :, None], moments / scale
        grams /= scale[:, None, :]
        inner, mixed = grams[:, nuisance[:, None], nuisance], grams[:, nuisance[:, None], others]
        follows, stands = self._moves[self._fold], self._stands[self._fold]
        met = (inner @ stands[..., None])[..., 0]
        missed = moments[:, nuisance] - met
        self._power = blocks.power.sum(axis=1) - np.sum(stands * (moments[:, nuisance] + missed), axis=1)
        taken = mixed.swapaxes(1, 2) @ stands[..., None] + follows.swapaxes(1, 2) @ missed[..., None]
        self._held_moment = moments[:, others] - taken[..., 0]
        self._held_gram = grams[:, others[:, None], others]
        self._mixed = mixed - 0.5 * (inner @ follows)  # (B, b, o)

    def held_out_sum(self, beside: Index) -> Array:
        """(B,) held-out square sums of a fit of the nuisance model and the columns `beside` it."""
        use = self._place[beside]
        fit = solved(self._gram[:, use[:, None], use], self._moment[:, use, None])
        moved = (self._moves[:, :, use] @ fit)[..., 0]  # (F, b)
        if np.any(np.abs(self._stands - moved) > self._limit * BEYOND):
            return held_out_sum(self.blocks, np.concatenate([self.nuisance, beside]))
        values = fit[self._fold]  # (B, k, 1)
        square = ((self._held_gram[:, use[:, None], use] @ values) * values)[..., 0].sum(axis=1)
        square -= 2.0 * np.sum(moved[self._fold] * (self._mixed[:, :, use] @ values)[..., 0], axis=1)
        linear = np.sum(self._held_moment[:, use] * values[..., 0], axis=1)
        return np.asarray(np.maximum(self._power - 2.0 * linear + square, 0.0))
