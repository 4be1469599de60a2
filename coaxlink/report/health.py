"""Health as a table and a picture. Numbers come from the result; nothing is computed here."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

from coaxlink.health.judge import GROUND, WATCH, Health
from coaxlink.health.priors import MATTERS
from coaxlink.report.pictures.looks import THRUST, TORQUE

SHOWN = 4  # flights in the table, the last ones; all are in the JSON and in the picture
LIKELY = 0.01  # of a suspect that is worth a line


def verdict_line(health: Health) -> str:
    """The verdict in one line."""
    share = f"{100 * MATTERS:.0f} % of its thrust"
    first = health.suspects[0]
    chance = _percent(health.probability)
    if health.verdict == "sound":
        return f"sound: the probability that a rotor lost more than {share} is {chance}"
    loss = f"{100 * first.loss.value:.0f} % ({100 * first.loss.low:.0f} to {100 * first.loss.high:.0f})"
    return (
        f"{health.verdict}: rotor {first.number}, {loss} of its thrust gone since {first.since}; "
        f"the probability that a rotor lost more than {share} is {chance}"
    )


def remarks(health: Health) -> Iterator[str]:
    """What a reader of the verdict must know besides."""
    for suspect in health.suspects[:3]:
        if suspect.probability > LIKELY and health.verdict != "sound":
            yield (
                f"rotor {suspect.number}: {_percent(suspect.probability)}, {100 * suspect.loss.value:.0f} % "
                f"+/- {50 * (suspect.loss.high - suspect.loss.low):.0f} since {suspect.since}"
            )
    if health.payload > GROUND:
        yield f"the centre of mass was elsewhere in one flight ({_percent(health.payload)}): payload, pack?"
    yield (
        f"a rotor that loses {100 * health.detects:.0f} % would be told by these flights"
        + ("" if len(health.flights) > 1 else "; a sound flight before it (health OLD NEW) tells far more")
    )
    yield (
        f"sound below {100 * WATCH:.0f} %, watch, ground it from {100 * GROUND:.0f} % on; thrust and torque "
        "are against the model at the commanded speeds, what all rotors have in common taken off"
    )


def _percent(probability: float) -> str:
    if probability < 0.001:
        return "below 0.1 %"
    if probability > 0.999:
        return "above 99.9 %"
    return f"{100 * probability:.1f} %"


def health_table(health: Health) -> Any:
    """Rich table: thrust and torque of every rotor in the last flights, pairs below."""
    from rich.table import Table

    last = health.flights[-SHOWN:]
    table = Table(title="share of the model's load, 95 % interval", title_justify="left")
    table.add_column("rotor")
    for flight in last:
        table.add_column(f"{flight.name}\nthrust", justify="right")
    table.add_column("torque, last", justify="right")
    table.add_column("probability", justify="right")
    chance = {s.number: s.probability for s in health.suspects}
    for i, rotor in enumerate(last[-1].rotors):
        cells = [_cell(flight.rotors[i].thrust) for flight in last]
        table.add_row(str(rotor.number), *cells, _cell(rotor.torque), _percent(chance[rotor.number]))
    if last[-1].pairs:
        table.add_section()
    for i, pair in enumerate(last[-1].pairs):
        name = f"{pair.rotors[0]} over {pair.rotors[1]}"
        table.add_row(name, *(_cell(flight.pairs[i].thrust) for flight in last), "", "")
    return table


def _cell(value: Any) -> str:
    return f"{value.value:.3f} ± {(value.high - value.low) / 2:.3f}"


def picture(health: Health) -> bytes:
    """PNG: every rotor's thrust and torque over the flights, the band of what does not matter."""
    from matplotlib.figure import Figure

    from coaxlink.report.pictures.label import label

    rotors = health.flights[0].rotors
    columns = min(4, len(rotors))
    rows = -(-len(rotors) // columns)
    figure = Figure(figsize=(2.6 * columns, 2.2 * rows + 0.6), layout="constrained")
    figure.suptitle(label(verdict_line(health).split(";")[0]), fontsize=9)
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    places = list(range(1, len(health.flights) + 1))
    for i, rotor in enumerate(rotors):
        axis = axes[i // columns][i % columns]
        axis.axhspan(1 - MATTERS, 1 + MATTERS, color="#d9dde2", lw=0)
        for load, look, shift in (("thrust", THRUST, -0.08), ("torque", TORQUE, 0.08)):
            found = [getattr(flight.rotors[i], load) for flight in health.flights]
            middle = [v.value for v in found]
            spread = [[v.value - v.low for v in found], [v.high - v.value for v in found]]
            axis.errorbar([p + shift for p in places], middle, spread, ls="", ms=3, **look.points, label=load)
        pair = f" (with {rotor.pair})" if rotor.pair is not None else ""
        axis.set_title(f"rotor {rotor.number}{pair}", fontsize=8)
        axis.set_xticks(places)
        axis.tick_params(labelsize=7)
    for axis in list(axes.ravel())[len(rotors) :]:
        axis.set_visible(False)
    axes[0][0].legend(frameon=False, fontsize=7)
    figure.supxlabel("flight", fontsize=8)
    figure.supylabel("share of the model's load", fontsize=8)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return stream.getvalue()
