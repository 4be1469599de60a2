"""A refinement for the terminal: tables and one-line remarks. Numbers come from the result."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from coaxlink.residual.result import Refinement

DIGITS = 3


def tables(result: Refinement) -> Iterator[Any]:
    """Rich tables: the errors before and after by channel, then every effect with its numbers."""
    yield _errors(result)
    if result.effects:
        yield _effects(result)


def verdict(result: Refinement) -> str:
    """The answer in one line."""
    if result.effects:
        names = " and ".join(e.name for e in result.effects)
        return f"found: {names}"
    if result.suspect_data:
        return "no effect can be claimed: the data contradict themselves"
    if result.ambiguous:
        return "something is there, but these data do not say which: " + "; ".join(
            " or ".join(a.names) for a in result.ambiguous
        )
    if result.unexplained:
        return "no known effect explains what is left"
    return "nothing to explain: the residual is at the noise floor or below what would matter"


def remarks(result: Refinement) -> Iterator[str]:
    """What a reader must know besides the tables."""
    for a in result.ambiguous:
        yield f"ambiguous: {' or '.join(a.names)}" + (
            f"; to separate: {a.separate_by}" if a.separate_by else ""
        )
    for u in result.unexplained:
        yield f"unexplained: {u.channel} still follows {', '.join(u.depends_on)} ({u.where})"
    for s in result.suspect_data:
        yield f"suspect: {s.column}, rows {s.rows}: {s.why}"
    for r in result.rejected:
        if r.why.startswith("cannot be judged"):
            yield f"{r.name}: {r.why}"
    yield from result.notes


def number(value: float) -> str:
    """A number with three significant digits."""
    return f"{value:.{DIGITS}g}" if abs(value) < 1e4 else f"{value:.0f}"


def _errors(result: Refinement) -> Any:
    from rich.table import Table

    table = Table(
        title="residual on held-out blocks (RMS)", title_justify="left", box=None, header_style="bold"
    )
    table.add_column("channel", no_wrap=True)
    for heading in ("before", "95 %", "after", "95 %", "noise floor", "rows"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, c in result.channels.items():
        table.add_row(
            f"{name} [{c.unit}]".replace("[", r"\["),
            number(c.rmse_before),
            " .. ".join(number(x) for x in c.ci_before),
            number(c.rmse_after),
            " .. ".join(number(x) for x in c.ci_after),
            number(c.noise_floor),
            str(c.held_out_rows),
        )
    return table


def _effects(result: Refinement) -> Any:
    from rich.table import Table

    table = Table(title="effects added", title_justify="left", box=None, header_style="bold")
    for heading in ("effect", "parameter"):
        table.add_column(heading, no_wrap=True)
    for heading in ("value", "95 %"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("channels")
    for effect in result.effects:
        for i, p in enumerate(effect.parameters):
            table.add_row(
                effect.name if i == 0 else "",
                p.name,
                number(p.value),
                " .. ".join(number(x) for x in p.ci),
                p.unit,
                ", ".join(effect.channels) if i == 0 else "",
            )
    return table
