"""Pictures of mixers: errors of the laws side by side, and what a fitted table trades."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from coaxlink.mixer.comparison import THRUSTS, Row
from coaxlink.mixer.fitted import FittedTable
from coaxlink.report.pictures.figures import new_figure, stamped
from coaxlink.report.pictures.looks import LOOKS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FLOOR = 1e-4  # N, N m: what is drawn for an error that is none


def draw_comparison(
    name: str, weight_N: float, rows: Sequence[Row], table: FittedTable, stamp: str = ""
) -> Figure:
    """Three panels: thrust error over thrust, mean errors, the fitted table's trade; `stamp` below them."""
    figure = new_figure(15, 5.2)
    over, bars, trade = figure.subplots(1, 3)
    for row, look in zip(rows, LOOKS, strict=False):
        over.plot(THRUSTS * weight_N, row.thrust_error_N, **look.line, label=row.label, lw=1.8)
    over.axvline(weight_N, color="#bbbbbb", lw=1, ls=":")
    over.annotate("hover", (weight_N, 0.96), xycoords=("data", "axes fraction"), fontsize=8, color="#777777")
    over.set(xlabel="thrust demanded, N", ylabel="delivered minus demanded, N", title=f"{name}: level flight")
    over.legend(fontsize=8)
    width = 0.8 / len(rows)
    for k, (row, look) in enumerate(zip(rows, LOOKS, strict=False)):
        at = [axis + (k - (len(rows) - 1) / 2) * width for axis in range(4)]
        bars.bar(at, [max(float(e), FLOOR) for e in row.mean_error], width, **look.bar, label=row.label)
    bars.set_yscale("log")
    bars.legend(fontsize=7, ncols=2)
    bars.set_xticks(range(4), ["thrust, N", "roll, N m", "pitch, N m", "yaw, N m"])
    bars.set(ylabel="mean |error|, N or N m", title=f"over the envelope (bars at {FLOOR:g}: none)")
    _draw_trade(trade, table)
    return stamped(figure, stamp)


def _draw_trade(axes: Axes, table: FittedTable) -> None:
    shares = [t.share for t in table.trade]
    curves = (
        ("thrust error, N", [t.error[0] for t in table.trade], LOOKS[4]),
        ("power above least, %", [100 * t.power_excess for t in table.trade], LOOKS[0]),
        ("ceiling, 100 N", [t.ceiling_N / 100 for t in table.trade], LOOKS[2]),
        ("yaw at hover, N m", [t.yaw_Nm for t in table.trade], LOOKS[3]),
    )
    for label, values, look in curves:
        axes.plot(shares, [max(v, 1e-3) for v in values], **look.points, label=label, ms=4)
    axes.axvline(table.chosen.share, color="#222222", lw=1, ls="--", label="chosen")
    axes.set_yscale("log")
    axes.set(xlabel="thrust column, upper / lower", title="the fitted table: error, power, authority")
    axes.legend(fontsize=8)
