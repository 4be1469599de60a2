"""What a notebook shows of a result: its printed form, and its picture below it."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING, Any

import numpy as np

from coaxlink.report.html import PagePicture
from coaxlink.report.pictures.figures import drawn, new_figure, plain_axis
from coaxlink.report.pictures.looks import DARK
from coaxlink.residual.result import Refinement
from coaxlink.rotor.identification import Identification

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from coaxlink.rotor import RotorModel

OTHERS = (0.0, 0.5, 1.0)  # speeds of the upper rotor, of full, over which the lower one's loads are drawn


def html_of(thing: RotorModel | Identification | Refinement) -> str:
    """The text of `print(thing)` and its picture as one piece of HTML."""
    text = f"<pre>{html.escape(str(thing))}</pre>"
    figure = _figure(thing)
    if figure is None:
        return text
    return f'{text}<img style="max-width:100%" alt="" src="{PagePicture(drawn(figure), "").source}">'


def _figure(thing: Any) -> Figure | None:
    if isinstance(thing, Identification):
        from coaxlink.report.pictures.identify_plots import surfaces

        return surfaces(thing)
    if isinstance(thing, Refinement):
        from coaxlink.report.pictures.residual_plots import overview_figure

        figure: Figure | None = None if thing.series is None else overview_figure(thing)
        return figure
    return _loads(thing)


def _loads(model: RotorModel) -> Figure:
    """Thrust and torque of both rotors over their own speed, the lower one's at `OTHERS` of the upper one."""
    figure = new_figure(7.0)
    u = np.linspace(0.0, 1.0, 41)
    for axes, column, unit in zip(figure.subplots(2, 1), (0, 1), ("thrust, N", "torque, N m"), strict=True):
        upper = model.predict(np.stack([u, np.zeros_like(u)], axis=1))
        axes.plot(u, upper[:, column], **DARK[0].line, label="upper")
        for other, look in zip(OTHERS, DARK[1:], strict=False):
            lower = model.predict(np.stack([np.full_like(u, other), u], axis=1))
            axes.plot(u, lower[:, column + 2], **look.line, label=f"lower, upper at {other:g}")
        axes.set(xlabel="speed, of full", ylabel=unit)
        axes.legend()
        plain_axis(axes)
    return figure
