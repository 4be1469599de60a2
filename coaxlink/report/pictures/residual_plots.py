"""Pictures of a refinement: the residual as given, corrected and with effects, over time and its cause."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from coaxlink.report.pictures.figures import GREY, SIZE, new_figure, plain_axis, stamped
from coaxlink.report.pictures.label import cause_words, channel_words
from coaxlink.report.pictures.label import label as words
from coaxlink.report.pictures.looks import AFTER, STATES
from coaxlink.residual.result import Refinement, Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOG_GAP_S = 2.0  # drawn between logs and pieces of a log, which stand one after another


def overview_figure(result: Refinement, stamp: str = "") -> Any:
    """Each touched channel's residual over time, and below over its effect's cause; `stamp` under all."""
    series = _series(result)
    shown = _rows(result)
    figure = new_figure(1.0 + 4.4 * len(shown))
    axes = figure.subplots(2 * len(shown), 1, squeeze=False)[:, 0]
    for i, (channel, effect) in enumerate(shown):
        _over_time(axes[2 * i], result, series, channel, i == 0)
        _over_cause(axes[2 * i + 1], result, series, channel, effect)
    figure.suptitle(words(_title(result)), x=0.01, ha="left", fontsize=SIZE + 1)
    return stamped(figure, stamp)


def errors_figure(result: Refinement, stamp: str = "") -> Any:
    """Each channel's error as given, corrected, with effects, in noise floors; `stamp` below it."""
    figure = new_figure(1.6 + 0.45 * len(result.channels))
    axis = figure.subplots()
    names = list(result.channels)
    for i, name in enumerate(names):
        c = result.channels[name]
        unit = max(c.noise_floor, 1e-12)
        given = (c.rmse_as_given, (c.rmse_as_given, c.rmse_as_given))
        errors = (given, (c.rmse_before, c.ci_before), (c.rmse_after, c.ci_after))
        for (label, look), (value, interval), shift in zip(STATES, errors, (0.25, 0.0, -0.25), strict=True):
            axis.plot(
                [x / unit for x in interval], [i + shift] * 2, color=look.colour, lw=2, solid_capstyle="butt"
            )
            shown = label if i == 0 else None
            axis.plot(value / unit, i + shift, ls="", **look.points, ms=5, label=shown)
    axis.axvline(1.0, color=GREY, lw=1, ls="--")
    axis.set_xscale("log")
    axis.set_yticks(range(len(names)), [words(channel_words(name)) for name in names])
    axis.set_xlabel("RMS error on rows the fit did not use,\nin noise floors (1: all explained)")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(
        "{x:g}" if max(axis.get_xlim()) < 10 * max(min(axis.get_xlim()), 1e-9) else ""
    )
    axis.legend(frameon=False)
    plain_axis(axis)
    return stamped(figure, stamp)


def _series(result: Refinement) -> Series:
    if result.series is None:
        raise ValueError("this refinement carries no series to draw")
    return result.series


def _rows(result: Refinement) -> list[tuple[str, str | None]]:
    """(channel, effect) pairs worth a row: what each effect improved most, else the worst channels."""
    out: list[tuple[str, str | None]] = []
    for effect in result.effects:
        gain = {c: before / max(after, 1e-12) for c, (before, after) in effect.rmse.items()}
        best = sorted(gain, key=lambda c: -gain[c])[: 2 if len(result.effects) == 1 else 1]
        out += [(c, effect.name) for c in best]
    if out:
        return out[:6]
    ratio = {n: c.rmse_before / max(c.noise_floor, 1e-12) for n, c in result.channels.items()}
    return [(name, None) for name in sorted(ratio, key=lambda n: -ratio[n])[:3]]


def _over_time(axis: Axes, result: Refinement, series: Series, channel: str, first: bool) -> None:
    c = series.channels.index(channel)
    floor = series.noise[channel]
    steps = np.diff(series.time_s)
    broken = (steps < 0) | (steps > 5 * np.median(steps))  # another log starts, or rows are left out
    time = np.concatenate([[0.0], np.cumsum(np.where(broken, LOG_GAP_S, steps))])
    gaps = np.flatnonzero(broken) + 1
    axis.axhspan(-2 * floor, 2 * floor, color=GREY, alpha=0.25, lw=0, label="within 2 x noise floor")
    for (label, look), rows in zip(STATES, (series.given, series.before, series.after), strict=True):
        values = rows[:, c]
        axis.plot(
            np.insert(time, gaps, np.nan),
            np.insert(values, gaps, np.nan),
            **look.line,
            lw=1.1,
            label=label,
        )
    if first:
        axis.legend()
    axis.set_title(_axis_words(result, channel, ", "), loc="left")
    axis.set_xlabel("time in the log, pauses shortened, s")
    plain_axis(axis)


def _axis_words(result: Refinement, channel: str, between: str) -> str:
    unit = result.channels[channel].unit
    return words(channel_words(channel)) + between + words(f"measured - model, {unit}")


def _over_cause(axis: Axes, result: Refinement, series: Series, channel: str, effect: str | None) -> None:
    c = series.channels.index(channel)
    if effect is None or (effect, channel) not in series.causes:
        axis.hist(series.after[:, c], bins=50, color=AFTER.colour, alpha=0.8)
        axis.set_xlabel(_axis_words(result, channel, ", "))
        axis.set_ylabel("number of rows")
        plain_axis(axis)
        return
    label, cause = series.causes[effect, channel]
    for (_, look), rows in zip(STATES, (series.given, series.before, series.after), strict=True):
        values = rows[:, c]
        axis.plot(cause, values, ".", ms=2, alpha=0.35, color=look.colour, rasterized=True)
        edges = np.unique(np.quantile(cause, np.linspace(0, 1, 13)))
        at = np.clip(np.searchsorted(edges, cause, side="right") - 1, 0, max(len(edges) - 2, 0))
        middles = [(np.mean(cause[at == k]), np.mean(values[at == k])) for k in np.unique(at)]
        axis.plot(*zip(*middles, strict=True), ls="-", ms=3, lw=1.4, **look.points)
    axis.axhline(0.0, color=GREY, lw=0.8)
    axis.set_xlabel(words(cause_words(label)))
    title = f"{channel_words(channel)} over the cause: {effect.replace('_', ' ')}"
    axis.set_title(words(title), loc="left")
    plain_axis(axis)


def _title(result: Refinement) -> str:
    if not result.effects:
        return "residual: no effect found"
    names = ", ".join(e.name.replace("_", " ") for e in result.effects)
    return f"residual as given, corrected, and with {names}"
