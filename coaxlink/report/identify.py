"""An identification as tables for the terminal. Numbers come from the result; nothing is computed here."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from coaxlink.load import Load
from coaxlink.report.pictures.label import channel_words
from coaxlink.report.terminal import grouped, table
from coaxlink.rotor.identification import COAXIAL, Identification
from coaxlink.rotor.log_checks import for_the_table

TERM_HEADS = ("load", "term", "value", "95 % interval", "± if the terms are these")
ERROR_HEADS = ("channel", "form", "RMSE", "NRMSE", "R", "rows")
FLOOR = "noise floor"
NAMES = {
    "srm": "SRM",
    "cpcm": "CPCM",
    "rcrm": "R-CRM",
    "crm": "CRM",
}


def tables(result: Identification) -> Iterator[Any]:
    """Rich tables: the terms of the chosen form, then the held-out errors of every form."""
    terms = list(term_rows(result))
    title, sections = f"{NAMES[result.form]}: terms", grouped(terms)
    yield table(title, TERM_HEADS, terms, left=2, boxed=True, sections=sections)
    errors = list(error_rows(result))
    new = [n for n in range(1, len(errors)) if errors[n][0] != errors[n - 1][0]]
    shown = [("" if form == FLOOR else channel, *rest) for channel, *rest in errors for form in rest[:1]]
    yield table("errors on held-out blocks", ERROR_HEADS, shown, left=2, boxed=True, sections=new)


def sentence(result: Identification) -> str:
    """The answer in one sentence: which form, and how well it predicts rows that the fit did not use."""
    name = next((c for c in ("coaxial_thrust", Load.UPPER_THRUST.channel) if c in result.channels), None)
    name = name or next(iter(result.channels))
    e = result.channels[name]
    unit = unit_of(name)
    floor = result.noise_floor.get(name)
    noise = f" (noise alone: {floor:.2g} {unit})" if floor else ""
    others = {f: c[name].rmse for f, c in result.comparison.items() if f != result.form and name in c}
    less = " only" if others.get("srm", np.inf) < e.rmse else ""
    usual = f"; the usual u² law misses{less} {others['srm']:.3g} {unit}" if "srm" in others else ""
    return (
        f"The {NAMES[result.form]} predicts the {channel_words(name)} at speeds it was not fitted to within "
        f"{e.rmse:.3g} {unit} rms{noise}{usual}."
    )


def answer(result: Identification) -> Any:
    """A row a channel: the chosen form's held-out error, and what noise alone makes."""
    rows = []
    for name in ("coaxial_thrust", *(load.channel for load in Load)):
        if name in result.channels:
            e, unit = result.channels[name], unit_of(name)
            floor = f"{result.noise_floor[name]:.2g} {unit}" if name in result.noise_floor else ""
            rows.append((channel_words(name), f"{e.rmse:.3g} {unit}", f"{100 * e.nrmse:.1f} %", floor))
    return table("", ("held out", "rms error", "of its range", "noise alone"), rows, left=1)


def drive_lines(result: Identification) -> Iterator[str]:
    """What commands turn and what the battery gives, where the log tells."""
    drive = result.model.drive
    if drive is not None:
        volts = "" if drive.voltage_V is None else f" at {drive.voltage_V:.1f} V"
        errors = " and ".join(f"{100 * side.error:.1f}" for side in (drive.upper, drive.lower))
        yield (
            f"Full throttle{volts} is {result.model.speed_max_rpm:.0f} rpm; throttles are known to "
            f"{errors} % of full (upper and lower, held out)."
        )
    watts = result.data.watts
    if watts:
        shares = " and ".join(f"{100 * w.efficiency:.0f} %" for w in watts.values())
        errors = " and ".join(f"{w.power.error:.0f}" for w in watts.values())
        sides = ", ".join(watts)
        yield f"Of the battery's watts {shares} reach the shafts ({sides}; to {errors} W, held out)."


def unit_of(channel: str) -> str:
    """Of a channel's errors."""
    return "N" if channel.endswith("thrust") else "N m"


def remarks(result: Identification) -> Iterator[str]:
    """What a reader of the tables must know besides."""
    yield from result.notes
    for load, fit in result.fits.items():
        if fit.alone:
            yield f"{load}: its intervals take its terms for granted"
    for load, intervals in result.intervals.items():
        for group in intervals.indistinct:
            shown = (
                ", ".join(group)
                if len(group) <= 6
                else f"{len(group)} of the dictionary's {len(intervals.bounds)}"
            )
            yield f"{load}: the data cannot separate these terms: {shown}"
        if intervals.indistinct:
            yield f"{load}: {for_the_table(result, load)}"
    for row in result.outliers:
        yield (
            f"outlier: {row.where}, {row.load} = {row.measured:.4g} where {row.expected:.4g} is expected "
            f"({row.deviations:.0f} standard deviations); weighted down"
        )


def term_rows(result: Identification) -> Iterator[tuple[str, str, str, str, str]]:
    """(load, term, value, interval, half width once the terms are granted); the load on its first row."""
    for load, terms in result.model.terms().items():
        bounds = result.intervals[load].bounds if load in result.intervals else {}
        errors = result.given.get(load)
        for i, (term, value) in enumerate(terms.items()):
            shown = " .. ".join(f"{x:.4f}" for x in bounds[term]) if term in bounds else "not determined"
            half = (
                ""
                if errors is None or term not in errors.bounds
                else f"{np.ptp(errors.bounds[term]) / 2:.4f}"
            )
            yield load if i == 0 else "", term, f"{value:.4f}", shown, half


def error_rows(result: Identification) -> Iterator[tuple[str, str, str, str, str, str]]:
    """(channel, form, RMSE with its unit, NRMSE, R, rows), each channel's noise floor after its forms."""
    for channel in (*COAXIAL, *(c for c in result.channels if c not in COAXIAL)):
        if channel not in result.channels:
            continue
        unit = unit_of(channel)
        for form, channels in result.comparison.items():
            e = channels[channel]
            held_out = str(e.held_out_rows)
            yield channel, NAMES[form], f"{e.rmse:.4f} {unit}", f"{e.nrmse:.4f}", f"{e.r:.5f}", held_out
        if channel in result.noise_floor:
            yield channel, FLOOR, f"{result.noise_floor[channel]:.4f} {unit}", "", "", ""
