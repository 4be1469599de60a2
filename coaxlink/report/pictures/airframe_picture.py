"""A vehicle seen from above as a picture: places, spin, pairs, outputs."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

from coaxlink.airframe import Airframe
from coaxlink.report.pictures.figures import SIZE, new_figure, plain_axis, write_figure
from coaxlink.report.pictures.label import label
from coaxlink.setup import Layout

TURNS = {1: "ccw", -1: "cw"}
UPPER, LOWER = "#4477aa", "#ee6677"


def draw_airframe(path: Path, airframe: Airframe, layout: Layout | None = None) -> None:
    """Write a PNG, SVG or PDF by the file's ending. Raises InputError."""
    from matplotlib.patches import Circle, FancyArrowPatch

    reach = max(math.hypot(*r.position_m[:2]) for r in airframe.rotors)
    places = {r.position_m[:2] for r in airframe.rotors}
    radius = 0.3 * min((math.dist(*two) for two in itertools.combinations(places, 2)), default=reach)
    figure = new_figure(6.4)
    axes = figure.subplots()
    for n, rotor in enumerate(airframe.rotors):
        forward, right, _ = rotor.position_m
        lower = rotor.level == "lower"
        size, colour = (0.72 * radius, LOWER) if lower else (radius, UPPER)
        if not lower:
            axes.plot([0, right], [0, forward], color="#cccccc", lw=3, zorder=0)
        dashes = "--" if lower else "-"
        axes.add_patch(Circle((right, forward), size, fill=False, ec=colour, lw=1.6, ls=dashes))
        turn = rotor.yaw_sign  # seen from above with the nose up, ccw is towards the left
        start, end = (math.radians(a) for a in ((30, 75) if turn > 0 else (75, 30)))
        axes.add_patch(
            FancyArrowPatch(
                (right + size * math.cos(start), forward + size * math.sin(start)),
                (right + size * math.cos(end), forward + size * math.sin(end)),
                arrowstyle="-|>",
                mutation_scale=16,
                color=colour,
                connectionstyle=f"arc3,rad={0.2 * turn}",
            )
        )
        output = layout.mounts[n].output if layout else ""
        words = "\n".join(map(label, filter(None, (f"{rotor.number} {rotor.level} {TURNS[turn]}", output))))
        at = (right, forward + (-0.28 if lower else 0.28) * radius)
        axes.annotate(words, at, fontsize=SIZE - 1, ha="center", va="center", color=colour)
    axes.annotate("nose", (0, 1.42 * reach), ha="center", fontsize=SIZE - 1, color="#777777")
    axes.annotate(
        "", (0, 1.38 * reach), (0, 1.1 * reach), arrowprops={"arrowstyle": "-|>", "color": "#777777"}
    )
    limit = 1.5 * reach
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
    axes.set(xlabel="right, m", ylabel="forward, m")
    axes.set_title(label(f"{airframe.name}, {airframe.mass_kg:g} kg, seen from above"))
    plain_axis(axes)
    write_figure(path, figure)
