"""Which flight a cell is: everything about it follows from the campaign and the cell's number alone."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from coaxlink.studies.campaign.spec import Spec


@dataclass(frozen=True)
class Cell:
    """One flight: cell = draw x laws + place of its law."""

    number: int
    draw: int
    law: str
    seed: int  # of gusts, noise and plan: one for all laws of a draw
    values: Mapping[str, float | str]  # of every quantity; an effect that is not true has size 0


def cell(spec: Spec, number: int) -> Cell:
    """The cell of that number, from 0; the same whoever asks, in whatever order."""
    draw, law_index = divmod(number, len(spec.laws))
    values = _on_grid(spec, draw) if spec.grid else _at_random(spec, draw)
    for name in spec.effects:
        if f"effects.{name}.chance" in spec.quantities:
            chance = float(values.pop(f"effects.{name}.chance"))
            if not _share(spec.seed, draw, f"effects.{name}") < chance:
                values[f"effects.{name}.size"] = 0.0
    seed = zlib.crc32(f"{spec.seed}/{draw}".encode()) >> 1
    return Cell(number, draw, spec.laws[law_index], seed, values)


def _share(seed: int, draw: int, name: str) -> float:
    """Evenly between 0 and 1, a stream of its own for every quantity: another one more moves none of them."""
    return float(np.random.default_rng([seed & 0xFFFFFFFF, draw, zlib.crc32(name.encode())]).random())


def _at_random(spec: Spec, draw: int) -> dict[str, float | str]:
    return {
        name: q.at(_share(spec.seed, draw, name) if q.varies or q.at(0.0) != q.at(0.5) else 0.0)
        for name, q in spec.quantities.items()
    }


def _on_grid(spec: Spec, draw: int) -> dict[str, float | str]:
    rest, values = draw // spec.repeats, {}
    for name, q in spec.quantities.items():
        grid = q.grid()
        rest, at = divmod(rest, len(grid))
        chosen = grid[at]
        values[name] = _share(spec.seed, draw, name) if chosen == "any" else chosen
    return values
