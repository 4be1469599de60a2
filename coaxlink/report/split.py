"""The best split as a picture: watts over the share of the upper rotors. Nothing is computed here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from coaxlink.report.pictures.figures import new_figure, plain_axis, stamped

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from coaxlink.fly.split_answer import SplitAnswer

HEIGHT_IN = 3.6


def split_figure(answer: SplitAnswer, stamp: str = "") -> Figure:
    """Dwells less what time, wind and climb explain, their fit, the least and the split on board."""
    figure = new_figure(HEIGHT_IN)
    axis = figure.subplots()
    axis.plot(answer.flown_share, answer.flown_watts, ".", color="0.6", label="dwells, drift taken off")
    axis.plot(answer.curve_share, answer.curve_watts, "-", color="C0", label="fit")
    axis.axvspan(*answer.share_ci, color="C0", alpha=0.15, lw=0.0, label="least power, 95 %")
    axis.axvline(answer.on_board, color="0.3", ls="--", lw=1.0, label="on board")
    axis.set_xlabel("share of the thrust by the upper rotors")
    axis.set_ylabel("battery power, W")
    low, high = (100 * v for v in answer.saving_ci)
    axis.set_title(f"at {answer.share:.3f}: {100 * answer.saving:.1f} % less ({low:.1f} to {high:.1f})")
    axis.legend(frameon=False)
    plain_axis(axis)
    return stamped(figure, stamp)
