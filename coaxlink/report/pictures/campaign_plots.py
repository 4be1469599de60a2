"""Pictures of a campaign: spreads a law, differences on equal seeds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from coaxlink.report.pictures.figures import drawn, new_figure, plain_axis
from coaxlink.report.pictures.looks import LOOKS
from coaxlink.studies.campaign.summary import FIGURES, Summary

SHOWN = ("height_rms_m", "level_rms_m", "tilt_rms_deg", "yaw_rms_deg", "thrust_error_N", "yaw_error_Nm",
         "saturated", "energy_Wh")  # fmt: skip
WORDS = {
    "height_rms_m": "height error, rms",
    "height_max_m": "height error, largest",
    "level_rms_m": "error over ground, rms",
    "tilt_rms_deg": "tilt error, rms",
    "yaw_rms_deg": "yaw error, rms",
    "roll_rate_rms_deg_s": "roll rate, rms",
    "pitch_rate_rms_deg_s": "pitch rate, rms",
    "yaw_rate_rms_deg_s": "yaw rate, rms",
    "thrust_error_N": "thrust missed, rms",
    "roll_error_Nm": "roll moment missed, rms",
    "pitch_error_Nm": "pitch moment missed, rms",
    "yaw_error_Nm": "yaw moment missed, rms",
    "saturated": "time with a rotor at its bound",
    "energy_Wh": "energy",
}


def words(figure: str) -> str:
    """A figure of `FIGURES` in words, with its unit."""
    unit = FIGURES[figure]
    return f"{WORDS[figure]}, {'share' if unit == '1' else unit}"


def spreads(summary: Summary, columns: Mapping[str, Any]) -> bytes:
    """Boxes a law of the main figures: median, quartiles, 5 and 95 %."""
    figure = new_figure(11.0)
    law = np.asarray(columns["law"])
    good = (np.asarray(columns["failsafe"]) == "") & (np.asarray(columns["problem"]) == "")
    for axes, name in zip(figure.subplots(4, 2).flat, SHOWN, strict=True):
        values = np.asarray(columns[name], float)
        rows = [values[(law == n) & good] for n in summary.laws]
        axes.boxplot([r if len(r) else [np.nan] for r in rows], whis=(5, 95), showfliers=False)
        axes.set_xticks(range(1, 1 + len(rows)), summary.laws, rotation=30)
        axes.set_title(words(name))
        plain_axis(axes)
    return drawn(figure)


def differences(summary: Summary) -> bytes:
    """Mean difference to the first law, in per cent of its mean, with intervals."""
    figure = new_figure(7.0)
    axes = figure.subplots()
    names = list(FIGURES)
    for k, ((law, found), look) in enumerate(zip(summary.paired.items(), LOOKS, strict=False)):
        height = np.arange(len(names)) + 0.2 * (k - 0.5 * (len(summary.paired) - 1))
        base = np.array([p.difference / p.share if p.share else np.nan for p in (found[n] for n in names)])
        middle = np.array([found[n].difference for n in names]) / base
        ends = np.array([found[n].ci for n in names]) / base[:, None]
        spread = np.abs(ends.T - middle)
        axes.errorbar(100 * middle, height, xerr=100 * spread, ls="", ms=4, label=law, **look.points)
    axes.axvline(0.0, color="0.6", lw=1)
    axes.set_yticks(range(len(names)), [WORDS[n] for n in names])
    axes.invert_yaxis()
    axes.set_xlabel(f"% of {summary.laws[0]}'s mean, left is better")
    axes.legend()
    plain_axis(axes)
    return drawn(figure)
