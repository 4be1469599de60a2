"""Pictures of an identification, after the paper's Fig. 2 and 3: loads over the speeds, residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from coaxlink.data.aliases import SIDES
from coaxlink.load import Load
from coaxlink.report.pictures.figures import GREY, SIZE, new_figure, plain_axis, stamped
from coaxlink.report.pictures.label import channel_words, label
from coaxlink.report.pictures.looks import AFTER, DARK
from coaxlink.rotor.identification import Identification
from coaxlink.rotor.stand_data import COAXIAL, Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODEL = AFTER.colour
NEAR = 0.02  # of full speed: points that a line for one speed is drawn through


def figures(result: Identification, stamp: str = "") -> dict[str, Figure]:
    """Name: figure, of all that this identification has the data for; `stamp` below each."""
    made = {"surfaces": surfaces(result), "residuals": residuals(result)}
    return {name: stamped(figure, stamp) for name, figure in made.items()}


def surfaces(result: Identification) -> Figure:
    """Fig. 2: each load over its own rotor's speed, points and model, at some speeds of the other rotor.

    One panel below the other, legible at 400 px.
    """
    loads = [Load.of(key) for key in result.data.measured]
    figure = new_figure(0.4 + 3.0 * len(loads))
    speeds = result.data.speeds.upper, result.data.speeds.lower
    for axis, load in zip(np.atleast_1d(figure.subplots(len(loads), 1)), loads, strict=True):
        along = load.rotor if np.ptp(speeds[load.rotor]) else 1 - load.rotor
        x, other = speeds[along], speeds[1 - along]
        line = np.linspace(0.0, max(x.max(), 1e-9), 100)

        def model(at: float, load: Load = load, along: int = along, line: Array = line) -> Array:
            pair = (line, np.full(100, at))
            return np.asarray(result.model.surface(load)(pair[along], pair[1 - along]))

        alone = np.array_equal(model(other.min()), model(other.max()))
        for at, look in zip(other[:1] if alone else _levels(other), DARK, strict=False):
            near = np.abs(other - at) <= (np.inf if alone else NEAR)
            axis.plot(x[near], result.data.loads[load.key][near], **look.points, ls="", ms=5, alpha=0.7)
            axis.plot(line, model(at), **look.line, lw=2, label="" if alone else f"{at:.2f}")
        axis.set_title(load.label, loc="left")
        axis.set_xlabel(f"speed of the {SIDES[along]} rotor, share of full")
        if not alone:
            axis.legend(title=f"{SIDES[1 - along]} rotor's speed", frameon=False)
        plain_axis(axis)
    figure.suptitle("points: measured, lines: model", x=0.01, ha="left", fontsize=SIZE + 1)
    return figure


def _levels(speeds: Array) -> Array:
    """Some measured speeds, spread from the least to the largest."""
    measured = np.unique(speeds)
    wanted = np.linspace(measured[0], measured[-1], len(DARK))
    return np.unique(measured[np.abs(measured[:, None] - wanted).argmin(axis=0)])


def residuals(result: Identification) -> Figure:
    """Fig. 3: held-out residuals over the rows of the log, beside the noise floor."""
    channels = [c for c in COAXIAL if c in result.channels] or list(result.channels)[:2]
    figure = new_figure(0.8 + 2.6 * len(channels))
    axes = np.atleast_1d(figure.subplots(len(channels), 1, sharex=True))
    for axis, channel in zip(axes, channels, strict=True):
        pair = COAXIAL.get(channel) or tuple(
            load for load in result.data.measured if load.replace(".", "_").startswith(channel)
        )
        error = np.sum([result.data.loads[p] - result.predicted[p] for p in pair], axis=0)
        axis.plot(np.arange(1, len(error) + 1), error, ".", color=MODEL, ms=4)
        floor = result.noise_floor.get(channel)
        if floor:
            axis.axhspan(-2 * floor, 2 * floor, color=GREY, alpha=0.18, lw=0, label="2 x noise floor")
            axis.legend(frameon=False, loc="upper right")
        for edge in np.flatnonzero(np.diff(result.data.fold)) + 1.5:
            axis.axvline(edge, color=GREY, lw=0.4)
        unit = "N" if "thrust" in channel else "N m"
        axis.set_title(label(f"{channel_words(channel)}, {unit}"), loc="left")
        plain_axis(axis)
    axes[-1].set_xlabel("row; lines part the blocks left out one at a time", fontsize=SIZE)
    figure.suptitle("measured less predicted, held out", x=0.01, ha="left", fontsize=SIZE + 1)
    return figure
