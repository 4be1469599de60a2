"""Pictures of an identification, after the paper's Fig. 2 and 3: surfaces with data, residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from coaxlink.load import Load
from coaxlink.report.pictures.figures import GREY, new_figure, plain_axis, stamped
from coaxlink.report.pictures.label import channel_words, label
from coaxlink.report.pictures.looks import AFTER, BEFORE
from coaxlink.rotor.identification import Identification
from coaxlink.rotor.stand_data import COAXIAL

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DATA, MODEL = BEFORE.colour, AFTER.colour
TITLES = {load.key: load.label for load in Load}


def figures(result: Identification, stamp: str = "") -> dict[str, Figure]:
    """Name: figure, of all that this identification has the data for; `stamp` below each."""
    made = {"surfaces": surfaces(result), "residuals": residuals(result)}
    return {name: stamped(figure, stamp) for name, figure in made.items()}


def surfaces(result: Identification) -> Figure:
    """Fig. 2: each load's data over the speeds, and the model through them."""
    loads = result.data.measured
    figure = new_figure(11.0, 4.4 * ((len(loads) + 1) // 2))
    u, v = result.data.speeds.upper, result.data.speeds.lower
    for i, load in enumerate(loads):
        y = result.data.loads[load]
        polynomial = result.model.surface(Load.of(load))
        if load.startswith("upper") or not np.ptp(v):
            axis = figure.add_subplot((len(loads) + 1) // 2, 2, i + 1)
            line = np.linspace(0, max(u.max(), 1e-9), 100)
            axis.plot(u, y, "o", color=DATA, ms=3, alpha=0.7, label="measured")
            axis.plot(line, polynomial(line, float(np.median(v))), color=MODEL, label="model")
            axis.set_xlabel("speed of the upper rotor, share of full")
            axis.legend(frameon=False, fontsize=8)
            plain_axis(axis)
        else:
            axis = figure.add_subplot((len(loads) + 1) // 2, 2, i + 1, projection="3d")
            a, b = np.meshgrid(np.linspace(0, u.max(), 25), np.linspace(0, v.max(), 25))
            axis.plot_wireframe(a, b, polynomial(a, b), color=MODEL, lw=0.5)
            axis.scatter(u, v, y, color=DATA, s=8, depthshade=False)
            axis.set_xlabel("upper speed, of full", fontsize=8)
            axis.set_ylabel("lower speed, of full", fontsize=8)
            axis.view_init(22, -125)
        axis.set_title(TITLES[load], loc="left", fontsize=10)
    return figure


def residuals(result: Identification) -> Figure:
    """Fig. 3: held-out residuals over the rows of the log, beside the noise floor."""
    channels = [c for c in COAXIAL if c in result.channels] or list(result.channels)[:2]
    figure = new_figure(11.0, 2.7 * len(channels))
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
            axis.legend(frameon=False, fontsize=8, loc="upper right")
        for edge in np.flatnonzero(np.diff(result.data.fold)) + 1.5:
            axis.axvline(edge, color=GREY, lw=0.4)
        unit = "N" if "thrust" in channel else "N m"
        axis.set_ylabel(label(f"{channel_words(channel)}, {unit}"))
        plain_axis(axis)
    axes[-1].set_xlabel("row; lines part the blocks that were left out one at a time")
    figure.suptitle("measured less predicted, held out", x=0.01, ha="left", fontsize=11)
    return figure
