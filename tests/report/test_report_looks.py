"""Series of a picture are told apart without their hue: by lightness, dashes, shape or hatching."""

import io
import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from test_report_pages import FOUND

from coaxlink.files import example
from coaxlink.report.pictures.looks import AFTER, BEFORE, LOOKS, THRUST, TORQUE
from coaxlink.report.pictures.mixers import draw_comparison
from coaxlink.report.pictures.residual_plots import errors_figure
from coaxlink.tables.worth import px4_worths
from coaxlink.vehicle import load_vehicle

APART = 20.0  # of 100, in CIE lightness


def lightness(colour) -> float:
    """CIE L* of an sRGB colour."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
    y = np.dot((0.2126, 0.7152, 0.0722), linear)
    return 116.0 * y ** (1 / 3) - 16.0 if y > 0.008856 else 903.3 * y


def clashes(figure) -> list[tuple[str, str]]:
    """Named lines of one panel that only their hue tells apart."""
    found = []
    for axes in figure.axes:
        lines = [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
        for a, b in itertools.combinations(lines, 2):
            shape = [
                (x.get_marker(), "" if x.get_linestyle() == "None" else str(x._dash_pattern)) for x in (a, b)
            ]
            near = abs(lightness(a.get_color()) - lightness(b.get_color())) < APART
            if shape[0] == shape[1] and near:
                found.append((str(a.get_label()), str(b.get_label())))
    return found


def test_looks_differ_in_dashes_shape_and_hatching():
    for what in ("dashes", "marker", "hatch", "colour"):
        assert len({getattr(look, what) for look in LOOKS}) == len(LOOKS)
    for a, b in ((BEFORE, AFTER), (THRUST, TORQUE)):
        assert abs(lightness(a.colour) - lightness(b.colour)) > APART


@pytest.mark.slow
@pytest.mark.parametrize("picture", ["comparison", "errors"])
def test_no_picture_needs_colour(picture):
    vehicle = load_vehicle(example("x8_demo.toml"))
    if picture == "comparison":
        worths = px4_worths(vehicle)
        figure = draw_comparison("x8", worths, worths.serving())
        points = [line.get_marker() for line in figure.axes[0].get_lines() if line.get_markersize() < 20]
        assert len(set(points)) == len(points) == len(worths.rows)
    else:
        figure = errors_figure(FOUND)
    assert any(axes.get_lines() for axes in figure.axes) and clashes(figure) == []
    figure.savefig(io.BytesIO(), format="svg")
