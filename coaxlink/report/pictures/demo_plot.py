"""The demo in one picture, legible at 400 px: what was hidden, before and after; what each mixer needed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from coaxlink.report.pictures.figures import SIZE, new_figure, plain_axis, stamped
from coaxlink.report.pictures.label import channel_words
from coaxlink.report.pictures.looks import AFTER, BEFORE, LOOKS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from coaxlink.studies.demo import DemoResult


def demo_figure(result: DemoResult, stamp: str = "") -> Figure:
    """Errors of every channel before and after above, battery power of every flight below."""
    figure = new_figure(7.0)
    above, below = figure.subplots(2, 1)
    channels = result.refinement.channels
    at = range(len(channels))
    for k, (look, label, errors) in enumerate(
        (
            (BEFORE, "before", [c.rmse_before / c.noise_floor for c in channels.values()]),
            (AFTER, "after", [c.rmse_after / c.noise_floor for c in channels.values()]),
        )
    ):
        bars = above.barh([i + 0.4 * (k - 0.5) for i in at], errors, 0.38, color=look.colour, label=label)
        above.bar_label(bars, [f"{e:.1f}" for e in errors], padding=3, fontsize=SIZE - 1)
    above.axvline(1.0, color="#222222", lw=1, ls=":")
    above.set_yticks(list(at), [channel_words(c) for c in channels])
    above.invert_yaxis()
    above.margins(x=0.12)
    names = " and ".join(e.name.replace("_", " ") for e in result.refinement.effects) or "nothing"
    above.set_title(f"error of the model, found: {names}")
    above.set_xlabel("times the sensors' noise (dotted: 1)")
    above.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, frameon=False)
    powers = {name: f.power_W for name, f in result.flights.items() if f.power_W is not None}
    rows = range(len(powers))
    bars = below.barh(list(rows), list(powers.values()), 0.6, color=LOOKS[0].colour)
    below.bar_label(bars, [f"{p:.0f} W" for p in powers.values()], padding=-52, fontsize=SIZE, color="white")
    below.set_yticks(list(rows), list(powers))
    below.invert_yaxis()
    below.set_title("battery power on the same path")
    below.set_xlabel("W")
    for axes in (above, below):
        plain_axis(axes)
    return stamped(figure, stamp)
