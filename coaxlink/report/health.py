"""Health as a table, a picture and a page. Numbers come from the result; nothing is computed here."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import Any

import numpy as np

from coaxlink.health.judge import Health, SuspectRotor
from coaxlink.health.priors import GROUND, MATTERS, WATCH
from coaxlink.health.turning import APART, apart, turning_words
from coaxlink.report.made import Made
from coaxlink.report.pictures.figures import SIZE, drawn, new_figure, plain_axis, stamped
from coaxlink.report.pictures.label import label
from coaxlink.report.pictures.looks import THRUST, TORQUE
from coaxlink.report.terminal import table

SHOWN = 4  # flights in the table, the last ones; all are in the JSON and in the picture
TITLE = "share of the model's load, 95 % interval, whatever the payload"
LIKELY = 0.01  # of a suspect that is worth a line


def verdict_line(health: Health) -> str:
    """The verdict in one line."""
    if health.reasons:
        return health.reasons[0].line()
    share = f"{100 * MATTERS:.0f} % of its thrust"
    first = health.suspects[0]
    chance = _percent(health.probability)
    if health.verdict != "ground it":
        named = "" if health.verdict == "sound" else f"; most likely rotor {first.rotor}, {_since(first)}"
        seen = f"a loss of {100 * health.detects:.0f} % would have been seen"
        lost = f"the probability that a rotor lost more than {share} is {chance}"
        return f"{health.verdict}: {lost}{named}; {seen}"
    loss = f"{100 * first.loss.value:.0f} % ({100 * first.loss.low:.0f} to {100 * first.loss.high:.0f})"
    who = suspects_named(health)
    if " or " in who:
        who += f"; if it is {first.rotor}"
    return (
        f"{health.verdict}: {who}, {loss} of its thrust gone {_since(first)}; "
        f"the probability that a rotor lost more than {share} is {chance}"
    )


def suspects_named(health: Health) -> str:
    """The rotors to look at: two of one pair may explain a flight alike.

    "rotor 3", "rotor 8 or 3".
    """
    first, *others = health.suspects
    numbers = [first.rotor, *(s.rotor for s in others if s.probability >= WATCH)]
    return f"rotor {' or '.join(map(str, numbers))}"


def remarks(health: Health) -> Iterator[str]:
    """What a reader of the verdict must know besides."""
    yield from (reason.line() for reason in health.reasons[1:])
    yield from health.premises
    blind = {r.premise for r in health.cannot_judge}
    yield from (s.line() for s in health.suspect_data if s.column not in blind)
    if health.reasons:
        return
    for suspect in health.suspects[:3]:
        if suspect.probability > LIKELY and health.verdict != "sound":
            yield (
                f"rotor {suspect.rotor}: {_percent(suspect.probability)}, {100 * suspect.loss.value:.0f} % "
                f"+/- {50 * (suspect.loss.high - suspect.loss.low):.0f} {_since(suspect)}, "
                f"most likely {suspect.kind}"
            )
            yield from _by_speed(health, suspect)
    for m in health.mended:
        yield (
            f"rotor {m.rotor}: {100 * m.loss.value:.0f} % +/- {50 * (m.loss.high - m.loss.low):.0f} of its "
            f"thrust gone since {m.since}, and back since {m.until} ({_percent(m.probability)}): changed "
            "between them? If not, look at it before the next flight"
        )
    if health.payload > GROUND:
        yield f"the centre of mass was elsewhere in one flight ({_percent(health.payload)}): payload, pack?"
    if len(health.flights) == 1:
        yield "a sound flight before this one (health OLD NEW) tells far more"
    yield (
        f"by that chance: sound below {100 * WATCH:.0f} %, watch, ground it from {100 * GROUND:.0f} % on; "
        "shares are of the model's load at the commanded speeds, at a flight's end, after what the others "
        "have in common; intervals are what the flights tell, chances count how rare faults are"
    )


def _by_speed(health: Health, suspect: SuspectRotor) -> Iterator[str]:
    """Whether a suspect turned as its command asks, which tells a motor from a blade."""
    ratio = health.speed_ratios.get(suspect.rotor)
    if ratio is None:
        return
    if apart({suspect.rotor: ratio}):
        yield f"{turning_words({suspect.rotor: ratio})}: its motor or its ESC, before its blades"
    elif np.sqrt(max(1.0 - suspect.loss.value, 0.0)) < 1.0 - APART:
        yield f"{turning_words({suspect.rotor: ratio})}: its blades, not its motor"


def _since(suspect: SuspectRotor) -> str:
    """When it set in; times are the log's own."""
    if suspect.onset_s is None:
        return f"since {suspect.since}"
    how = "gradually from" if suspect.gradual else "from"
    began = suspect.onset_s
    apart = (began.high - began.low) / 2
    return f"{how} {began.value:.1f} s (+/- {apart:.1f}) of {suspect.since} on"


def _percent(probability: float) -> str:
    if probability < 0.001:
        return "below 0.1 %"
    if probability > 0.999:
        return "above 99.9 %"
    return f"{100 * probability:.1f} %"


def health_table(health: Health) -> Any:
    """Rich table: thrust and torque of every rotor in the last flights, pairs below."""
    heads, rotors, pairs = _rows(health)
    return table(TITLE, heads, [*rotors, *pairs], boxed=True, sections=(len(rotors),))


def _rows(health: Health) -> tuple[list[str], list[list[str]], list[list[str]]]:
    """Headings, a row a rotor and a row a pair, in the last flights."""
    last = health.flights[-SHOWN:]
    thrusts = [f"{flight.name}\nthrust" for flight in last]
    lost = f"chance of\n> {100 * MATTERS:.0f} % lost"
    heads = ["rotor", *thrusts, "torque, last", "% lost,\nif this", lost]
    suspects = {s.rotor: s for s in health.suspects}
    rotors = [
        [str(rotor.rotor), *(_cell(f.rotors[i].thrust) for f in last), _cell(rotor.torque),
         *_weighed(suspects.get(rotor.rotor))]
        for i, rotor in enumerate(last[-1].rotors)
    ]  # fmt: skip
    pairs = [
        [f"pair {pair.rotors[0]}/{pair.rotors[1]}", *(_cell(f.pairs[i].thrust) for f in last), "", "", ""]
        for i, pair in enumerate(last[-1].pairs)
    ]
    return heads, rotors, pairs


def _weighed(suspect: SuspectRotor | None) -> tuple[str, str]:
    """What the verdict rests on: how much a rotor lost if it is the one that did, and how likely it is."""
    if suspect is None:
        return "-", "-"
    half = 50 * (suspect.loss.high - suspect.loss.low)
    return f"{100 * suspect.loss.value:+z.0f} ± {half:.0f}", _percent(suspect.probability)


def _cell(value: Any) -> str:
    half = (value.high - value.low) / 2
    digits = 3 if half < 0.01 else 2
    return f"{value.value:.{digits}f} ± {half:.{digits}f}"


def health_page(health: Health, made: Made) -> str:
    """One self-contained HTML page: the verdict, the picture, the table, the remarks, how it was made."""
    from coaxlink.report.html import PagePicture, PageTable, render

    sentences = verdict_line(health)
    heads, rotors, pairs = _rows(health)
    caption = (
        f"Thrust and torque over those of the model, flight by flight, with 95 % intervals; within the band "
        f"of {100 * MATTERS:.0f} % nothing is flagged"
    )
    return render(
        "health.html",
        title="Is every rotor sound?",
        lead=f"{sentences[:1].upper()}{sentences[1:]}.",
        picture=PagePicture(drawn(figure(health, made.line())), caption),
        loads=PageTable([head.replace("\n", " ") for head in heads], [*rotors, *pairs]),
        remarks=list(remarks(health)),
        made=made,
    )


def figure(health: Health, stamp: str = "") -> Any:
    """Every rotor's thrust and torque over the flights, the band of what does not matter (matplotlib)."""
    rotors = health.flights[0].rotors
    columns = min(2, len(rotors))
    rows = -(-len(rotors) // columns)
    drawing = new_figure(1.9 * rows + 1.2)
    lines = textwrap.wrap(verdict_line(health).split(";")[0], 70)
    drawing.suptitle("\n".join(map(label, lines)), fontsize=SIZE)
    axes = drawing.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    numbers = list(range(1, len(health.flights) + 1))
    for i, rotor in enumerate(rotors):
        axis = axes[i // columns][i % columns]
        axis.axhspan(1 - MATTERS, 1 + MATTERS, color="#d9dde2", lw=0)
        for load, look, shift in (("thrust", THRUST, -0.08), ("torque", TORQUE, 0.08)):
            found = [getattr(flight.rotors[i], load) for flight in health.flights]
            spread = [[v.value - v.low for v in found], [v.high - v.value for v in found]]
            at, middle = [p + shift for p in numbers], [v.value for v in found]
            axis.errorbar(at, middle, spread, ls="", ms=3, **look.points, label=load)
        pair = f" (with {rotor.pair})" if rotor.pair is not None else ""
        axis.set_title(f"rotor {rotor.rotor}{pair}")
        axis.set_xticks(numbers)
        axis.set_xlim(0.5, len(numbers) + 0.5)
        if i < columns:  # both of the first row, so that their titles stand level
            axis.legend()
        plain_axis(axis)
    for axis in list(axes.ravel())[len(rotors) :]:
        axis.set_visible(False)
    for axis in axes[(len(rotors) - 1) // columns]:
        axis.set_xlabel("flight", fontsize=SIZE)
    drawing.supylabel("share of the model's load", fontsize=SIZE)
    return stamped(drawing, stamp)
