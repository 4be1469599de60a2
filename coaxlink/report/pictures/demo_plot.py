"""The demo in one picture, legible at 400 px: what was hidden, before and after; what each mixer needed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from coaxlink.report.pictures.figures import SIZE, new_figure, plain_axis, stamped
from coaxlink.report.pictures.label import channel_words
from coaxlink.report.pictures.looks import LOOKS, STATES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from coaxlink.studies.demo import DemoResult


def demo_figure(result: DemoResult, stamp: str = "") -> Figure:
    """Errors of every channel above: as given, corrected, with effects; each flight's battery power below."""
    figure = new_figure(8.0)
    above, below = figure.subplots(2, 1)
    channels = result.refinement.channels
    at = range(len(channels))
    errors = [(c.rmse_as_given, c.rmse_before, c.rmse_after) for c in channels.values()]
    for k, (label, look) in enumerate(STATES):
        times = [e[k] / c.noise_floor for e, c in zip(errors, channels.values(), strict=True)]
        bars = above.barh([i + 0.28 * (k - 1) for i in at], times, 0.26, color=look.colour, label=label)
        above.bar_label(bars, [f"{t:.1f}" for t in times], padding=3, fontsize=SIZE - 2)
    above.axvline(1.0, color="#222222", lw=1, ls=":")
    above.set_yticks(list(at), [channel_words(c) for c in channels])
    above.invert_yaxis()
    above.margins(x=0.12)
    names = " and ".join(e.name.replace("_", " ") for e in result.refinement.effects) or "nothing"
    above.set_title(f"error of the model, found: {names}")
    above.set_xlabel("times the sensors' noise (dotted: 1)")
    above.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3, frameon=False)
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
