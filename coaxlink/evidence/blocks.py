"""What a hypothesis is made of: blocks of columns with the prior deviation of each coefficient."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coaxlink.frames import Array

FUNCTIONS_PER_LENGTH = 1.6  # cosine functions that a Gaussian process of this length over a range asks for
LEAST_FUNCTIONS, MOST_FUNCTIONS = 3, 32
FORM_LENGTHS = (0.15, 0.5)  # prior of a free form's correlation length, in ranges of its variable
NEGLIGIBLE = 0.03  # of the largest deviation: a thousandth of the variance


@dataclass(frozen=True)
class Block:
    """Columns of one explanation: `columns` (rows, C, K) in the channels' units, `deviation` (K,) prior."""

    name: str
    columns: Array
    deviation: Array

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.deviation)


def joined(blocks: Sequence[Block]) -> tuple[Array, Array]:
    """(rows, C, P) columns and (P,) deviations of blocks side by side."""
    columns = np.concatenate([b.columns for b in blocks], axis=-1)
    return columns, np.concatenate([b.deviation for b in blocks])


def waves(values: Array, length: float) -> tuple[Array, Array]:
    """(rows, K) cosine functions over a variable, and (K,) deviations that make a Gaussian process of them.

    It has unit variance and this correlation length (in ranges of the variable; squared exponential).

    Source: Solin and Saerkkae 2020, Hilbert space methods for reduced-rank Gaussian process regression.
    The constant is among them; near the ends of the range a process is its own mirror image.
    """
    low, high = float(np.min(values)), float(np.max(values))
    x = (values - low) / max(high - low, 1e-300)
    count = int(np.clip(np.ceil(FUNCTIONS_PER_LENGTH / length), LEAST_FUNCTIONS, MOST_FUNCTIONS))
    number = np.arange(count + 1)
    functions = np.cos(np.pi * x[:, None] * number)
    spectrum = np.sqrt(2.0 * np.pi) * length * np.exp(-0.5 * (np.pi * number * length) ** 2)
    return _felt(functions, np.sqrt(spectrum * np.where(number > 0, 2.0, 1.0)))


def products(first: tuple[Array, Array], second: tuple[Array, Array]) -> tuple[Array, Array]:
    """The functions and deviations of a Gaussian process over two variables, one along each."""
    a, b = first[0], second[0]
    functions = (a[:, :, None] * b[:, None, :]).reshape(len(a), -1)
    return _felt(functions, np.outer(first[1], second[1]).ravel())


def beside(*processes: tuple[Array, Array]) -> tuple[Array, Array]:
    """The sum of processes, together of one's variance: a lower rotor's load goes with both speeds."""
    share = 1.0 / np.sqrt(len(processes))
    functions, deviations = (np.concatenate(part, axis=-1) for part in zip(*processes, strict=True))
    return functions, deviations * share


def _felt(functions: Array, deviations: Array) -> tuple[Array, Array]:
    """Without those of next to no deviation."""
    use = deviations > NEGLIGIBLE * deviations.max()
    return functions[:, use], deviations[use]


def in_channel(name: str, functions: tuple[Array, Array], weight: Array, channel: int, count: int) -> Block:
    """A process, its functions weighted by (rows,) in the channel's unit, in one of `count` channels."""
    columns = np.zeros((len(weight), count, functions[0].shape[1]))
    columns[:, channel] = functions[0] * weight[:, None]
    return Block(name, columns, functions[1])
