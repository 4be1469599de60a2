"""Pictures of an identification, after the paper's Fig. 2 to 5: surfaces with data, residuals, tolerances,
efficiency. Nothing is fitted here but what a picture itself sweeps.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from coaxlink.errors import InputError
from coaxlink.load import Load
from coaxlink.report.pictures.figures import GREY, new_figure, plain_axis, stamped
from coaxlink.report.pictures.label import channel_words, label
from coaxlink.report.pictures.looks import AFTER, BEFORE, LOOKS
from coaxlink.rotor.efficiency import measured_efficiency, split_curves
from coaxlink.rotor.fit import least_squares, load_terms
from coaxlink.rotor.identification import Identification
from coaxlink.rotor.lasso import tolerance_form
from coaxlink.rotor.polynomial import design_matrix
from coaxlink.rotor.stand_data import COAXIAL

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DATA, MODEL = BEFORE.colour, AFTER.colour
TITLES = {load.key: load.label for load in Load}


def figures(result: Identification, stamp: str = "") -> dict[str, Figure]:
    """Name: figure, of all that this identification has the data for; `stamp` below each."""
    made = {"surfaces": surfaces(result), "residuals": residuals(result)}
    if {Load.LOWER_THRUST.key, Load.UPPER_THRUST.key} <= set(result.data.measured):
        made["tolerance"] = tolerance_sweep(result)
    if all(load in result.data.measured for pair in COAXIAL.values() for load in pair):
        with contextlib.suppress(InputError):  # no rpm: speeds came from the throttle
            made["efficiency"] = efficiency(result)
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


def tolerance_sweep(result: Identification, points: int = 14) -> Figure:
    """Fig. 4: terms of the lower thrust that the paper's tolerance form keeps, and the error they leave."""
    figure = new_figure(11.0, 4.2)
    left, right = figure.subplots(1, 2)
    for kind, standardised, look in (("standardised terms", True, AFTER), ("raw terms", False, BEFORE)):
        eps, sizes, errors = _sweep(result, standardised, points)
        left.step(eps, sizes, where="mid", color=look.colour, label=kind)
        right.plot(eps, errors, **look.points, ms=3, label=f"{kind}, refitted")
    right.plot(eps, eps, color=GREY, lw=0.8, ls="--", label="the l1 problem's own")
    left.set_ylabel("terms kept of 9")
    left.yaxis.get_major_locator().set_params(integer=True)
    right.set_ylabel("RMSE of the lower thrust, N")
    right.set_yscale("log")
    for axis in (left, right):
        axis.set_xscale("log")
        axis.set_xlabel("tolerance, N")
        axis.legend(frameon=False, fontsize=8)
        plain_axis(axis)
    return figure


def _sweep(
    result: Identification, standardised: bool, points: int
) -> tuple[NDArray[np.float64], list[int], list[float]]:
    load = Load.LOWER_THRUST.key
    y = result.data.loads[load]
    rows = np.isfinite(y)
    y = y[rows]
    X = design_matrix(
        load_terms("crm", load, 2), result.data.speeds.upper[rows], result.data.speeds.lower[rows]
    )
    scale = np.sqrt(np.mean(X**2, axis=0)) if standardised else np.ones(X.shape[1])
    floor = float(np.sqrt(np.mean((y - X @ least_squares(X, y, np.ones(len(y)))) ** 2)))
    eps = np.geomspace(1.01 * floor, max(0.5 * float(np.std(y)), 2 * floor), points)
    sizes, errors = [], []
    for tolerance in eps:
        chosen = tolerance_form(X / scale, y, float(tolerance)) != 0
        b = least_squares(X[:, chosen], y, np.ones(len(y)))
        sizes.append(int(chosen.sum()))
        errors.append(float(np.sqrt(np.mean((y - X[:, chosen] @ b) ** 2))))
    return eps, sizes, errors


def efficiency(result: Identification) -> Figure:
    """Fig. 5: efficiencies of eq. 5 over the coaxial thrust. Raises InputError without measured speeds."""
    found = measured_efficiency(result.data.samples)
    columns = [("propeller, N/W", found.propeller)]
    columns += [("motor", found.motor)] if found.motor is not None else []
    columns += [("overall, N/W", found.overall)] if found.overall is not None else []
    figure = new_figure(4.0 * len(columns) + 1.5, 3.9)
    axes = np.atleast_1d(figure.subplots(1, len(columns)))
    for axis, (title, values) in zip(axes, columns, strict=True):
        axis.plot(found.thrust_N, values, "o", color=DATA, ms=3, alpha=0.6, label="measured")
        axis.set_title(title, loc="left", fontsize=10)
        axis.set_xlabel("coaxial thrust, N")
        axis.set_ylim(bottom=0, top=float(np.nanquantile(values, 0.99)) * 1.25)
        plain_axis(axis)
    thrust = np.linspace(0.1, 1.0, 24) * float(found.thrust_N.max())
    for split, look in zip(split_curves(result.model, thrust), LOOKS[:3], strict=True):
        axes[0].plot(thrust, split.propeller, **look.line, label=f"model, {split.name}")
    axes[0].legend(frameon=False, fontsize=8, loc="lower left")
    return figure
