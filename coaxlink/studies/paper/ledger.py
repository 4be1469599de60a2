"""The ledger: a claim a table, figure, equation or contradiction, each with printed and computed values."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

GRAVITY = 9.81  # m/s^2, as the paper rounds it
REPRODUCED = "reproduced"  # the paper's own numbers give what it prints
CONTRADICTED = "contradicted"  # they give something else
IN_PART = "in part"  # some of it can be had and agrees, some cannot be had
NOT_HAD = "cannot be reproduced"  # the paper does not print what it would take
NOT_CHECKED = "not checked"  # it could be, but not in this run


@cache
def printed() -> dict[str, Any]:
    """The paper's printed numbers, from printed.toml."""
    return tomllib.loads(files("coaxlink.studies.paper").joinpath("printed.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Line:
    """One number: what it is, as printed (None: the paper has none), as computed here."""

    what: str
    printed: float | None
    computed: float | None
    unit: str = ""


@dataclass(frozen=True)
class Claim:
    """One thing the paper says, and the verdict on it."""

    id: str  # table-1, eq-15, figure-5, contradiction-4
    title: str
    verdict: str
    why: str
    lines: tuple[Line, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As `reproduce --json` writes it."""
        return {
            "id": self.id,
            "title": self.title,
            "verdict": self.verdict,
            "why": self.why,
            "lines": [vars(line) for line in self.lines],
        }


@dataclass(frozen=True)
class Ledger:
    """All claims of one run."""

    claims: tuple[Claim, ...]

    def to_json(self) -> dict[str, Any]:
        """One entry per table and contradiction, by id."""
        return {"entries": [c.to_json() for c in self.claims]}


def close(value: float, reference: float, relative: float) -> bool:
    """Whether a computed value stands for a printed one."""
    return abs(value - reference) <= relative * abs(reference)
