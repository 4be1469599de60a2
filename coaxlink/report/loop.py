"""The loop's result: two flights, what lies between them, and their errors side by side."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from coaxlink.report.html import PageTable, render
from coaxlink.report.made import Made
from coaxlink.report.page import refinement_parts
from coaxlink.report.refine import either, number
from coaxlink.report.terminal import table
from coaxlink.studies.loop import OUTCOMES, LoopResult

HEADINGS = ("mean |meant - delivered|", "before (95 %)", "after (95 %)", "ratio", "noise")
CHANNELS = ("thrust, N", "roll, N m", "pitch, N m", "yaw, N m")

AGAIN = "the second flight is by the same table, with other noise: what differs between them is chance"
OWN_FLIGHT = (
    "before and after are flights of their own, with noise of their own; the model saw the first log only"
)


def rows(result: LoopResult) -> list[list[str]]:
    """A row a channel, then the height that was held."""
    out = []
    before, after = result.before.allocation, result.after.allocation
    pairs = zip(
        CHANNELS,
        (before.thrust_error_N, *before.torque_error_Nm),
        before.intervals,
        (after.thrust_error_N, *after.torque_error_Nm),
        after.intervals,
        after.floor,
        strict=True,
    )
    for name, old, old_ci, new, new_ci, floor in pairs:
        was, now = f"{number(old)} ({_span(old_ci)})", f"{number(new)} ({_span(new_ci)})"
        out.append([name, was, now, f"{new / old:.2f}", number(floor)])
    high, then = (f.position_error_m[2] for f in (result.before, result.after))
    out.append(["height held, m", number(high), number(then), f"{then / high:.2f}", ""])
    return out


def _span(interval: tuple[float, float]) -> str:
    return f"{number(interval[0])}–{number(interval[1])}"


def lines(result: LoopResult) -> Iterator[str]:
    """What was done about each effect and what was left alone, in words."""
    yield OUTCOMES[result.outcome].format(done=", ".join(result.compensated))
    if result.way == "live":
        yield "both flights mixed live by the exact law"
    for name, what in result.compensated.items():
        yield f"compensated: {name}: {what}"
    for name, why in result.not_compensated.items():
        yield f"not compensated: {name}: {why}"
    yield from _doubts(result)
    yield OWN_FLIGHT if result.outcome in ("compensated", "not_compensable") else AGAIN


def _doubts(result: LoopResult) -> Iterator[str]:
    found = result.refinement
    for a in found.ambiguous:
        sentences = f"ambiguous: {either(a)}"
        tell_apart = f"; to separate: {a.separate_by}" if a.separate_by else ""
        yield f"{sentences}{tell_apart}"
    for u in found.unexplained:
        yield f"unexplained: {u.channel} still follows {', '.join(u.depends_on)} ({u.where})"
    for s in found.suspect_data:
        yield s.line()


def table_of(result: LoopResult) -> Any:
    """The flights' errors as a rich table, 80 columns wide at most."""
    title = "both flights: mean |meant - delivered| over the whole plan"
    return table(title, ("", *HEADINGS[1:]), rows(result))


def sentence(result: LoopResult) -> str:
    """The answer in one sentence: what was done, and what became of the flight's error."""
    before, after = result.before.allocation, result.after.allocation
    done = OUTCOMES[result.outcome].format(done=", ".join(result.compensated))
    was, now, noise = (number(x) for x in (before.thrust_error_N, after.thrust_error_N, after.floor[0]))
    return (
        f"{done[:1].upper()}{done[1:]}; the thrust error of the flight was {was} N and is {now} N in the "
        f"second one (the sensors' noise alone: {noise} N)."
    )


def page(result: LoopResult, made: Made) -> str:
    """The page (self-contained)."""
    return render(
        "loop.html",
        title=f"coaxlink loop, seed {result.seed}",
        lead=sentence(result),
        made=made,
        r=refinement_parts(result.refinement, made),
        flights=PageTable(HEADINGS, rows(result)),
        lines=list(lines(result)),
    )
