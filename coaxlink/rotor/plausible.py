"""What is odd in a stand log before any model is fitted, a line each. Nothing is changed by it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from coaxlink.rotor import forms
from coaxlink.rotor.identification import COAXIAL, CORRELATED, Identification, StandData

OVER = 1.02  # of the speed that u = 1 means: rpm sensors agree within 2 per cent
SHORT = 0.6  # of it: a table is used up to 1, and squares extrapolated from here are off by their square
DRAWS, IDLE = 0.2, 0.02  # of the greatest power, of the greatest thrust
FAST = 0.5  # of a rotor's own fastest: below, a wake may well push it down
ROWS_A_TERM = 3
# of the range that was measured: between the forms that the paper flies (CRM, R-CRM: 0.007 to 0.039) and the
# one that it finds unfit (SRM: 0.052 and 0.078; Berra, Trujillo and Heredia 2024, Table 2, NRMSE)
POOR = 0.05
SHOWN = 4


def oddities(data: StandData, form: str) -> tuple[str, ...]:
    """What a person should look at in the log before they believe a model of it, one line each."""
    return tuple(
        line for look in (_no_speed, _beyond, _stalled, _idle_power, _wrong_way) for line in look(data)
    ) + tuple(_few_rows(data, form))


def poor_errors(result: Identification) -> Iterator[str]:
    """The channels whose held-out error says that the model does not hold on rows it has not seen."""
    for channel, error in result.channels.items():
        if channel in COAXIAL or error.nrmse <= POOR:  # a sum of two loads hides either
            continue
        unit = "N" if channel.endswith("thrust") else "N m"
        floor = result.noise_floor.get(channel)
        scatter = "" if floor is None else f"; rows at neighbouring speeds scatter by {floor:.3g} {unit}"
        yield (
            f"{channel}: {result.form} misses held-out rows by {error.rmse:.3g} {unit}, "
            f"{100 * error.nrmse:.2g} % of the measured range (above {100 * POOR:.0f} % a table of it is off "
            f"by as much){scatter}"
        )


def _sides(data: StandData) -> Iterator[tuple[str, NDArray[np.float64]]]:
    for side, u in (("upper", data.speeds.upper), ("lower", data.speeds.lower)):
        if np.any(u > 0):
            yield side, u


def _beyond(data: StandData) -> Iterator[str]:
    if data.speeds.source != "given":
        return
    for side, u in _sides(data):
        top = float(u.max())
        if top > OVER:
            rows = np.flatnonzero(u > OVER)
            yield (
                f"{side}: {len(rows)} rows run faster than `speed_max_rpm`, up to {top:.2f} of it "
                f"({_row_names(data, rows)}): is it the motor's highest speed under load?"
            )
        elif top < SHORT:
            yield (
                f"{side}: no row beyond {top:.2f} of `speed_max_rpm`: what a table does above is extrapolated"
            )


def _no_speed(data: StandData) -> Iterator[str]:
    if data.speeds.from_throttle:
        yield (
            "no speed was measured: the units in the headings can hardly be held against the readings "
            "(`diameter_m` narrows it), and the model goes with the battery's voltage"
        )


def _stalled(data: StandData) -> Iterator[str]:
    """Thrust that no longer grows in the fastest fifth, the other rotor's share taken off."""
    for side, u in _sides(data):
        load = data.loads[f"{side}.thrust_N"]
        other = data.speeds.lower if side == "upper" else data.speeds.upper
        top = np.isfinite(load) & (u > 0.8 * u.max())
        if top.sum() < 6 or np.ptp(u[top]) < 0.05 * u.max():
            continue
        X = np.stack([np.ones(top.sum()), u[top], other[top]], axis=1)
        apart = np.ptp(other[top]) > 0 and abs(np.corrcoef(u[top], other[top])[0, 1]) < CORRELATED
        X = X if apart else X[:, :2]
        b = np.linalg.lstsq(X, load[top], rcond=None)[0]
        left = load[top] - X @ b
        error = float(np.std(left)) / (float(np.std(u[top])) * np.sqrt(top.sum()))
        if b[1] < 0 and -b[1] > 3 * error:
            yield (
                f"{side}: thrust falls with speed above {0.8 * u.max():.2f}: a blade stalls, a cell is at "
                "its limit, or the battery was changed"
            )


def _idle_power(data: StandData) -> Iterator[str]:
    for side, _ in _sides(data):
        power = _power(data, side)
        load = data.loads[f"{side}.thrust_N"]
        if power is None or not np.isfinite(load).any():
            continue
        rows = np.flatnonzero((power > DRAWS * power.max()) & (np.abs(load) < IDLE * np.nanmax(np.abs(load))))
        if len(rows):
            where = _row_names(data, rows)
            yield f"{side}: {len(rows)} rows draw power without thrust ({where}): cell or propeller?"


def _power(data: StandData, side: str) -> NDArray[np.float64] | None:
    samples = data.samples
    if samples.has(f"{side}_power_W"):
        return samples[f"{side}_power_W"]
    volts = next((n for n in (f"{side}_voltage_V", "voltage_V") if samples.has(n)), None)
    if volts is None or not samples.has(f"{side}_current_A"):
        return None
    return samples[volts] * samples[f"{side}_current_A"]


def _wrong_way(data: StandData) -> Iterator[str]:
    """Rows at speed in which a load has the wrong sign."""
    for load in data.measured:
        side, quantity = load.split(".")
        u = data.speeds.upper if side == "upper" else data.speeds.lower
        other = data.speeds.lower if side == "upper" else data.speeds.upper
        values = data.loads[load]
        rows = np.flatnonzero(
            (u > FAST * u.max()) & (u >= other) & (values < -IDLE * np.nanmax(np.abs(values)))
        )
        if len(rows):
            name = quantity.rpartition("_")[0]
            yield f"{side}: {name} against its rotor in {len(rows)} rows at speed ({_row_names(data, rows)})"


def _few_rows(data: StandData, form: str) -> Iterator[str]:
    for load in data.measured:
        terms = len(forms.load_terms(form, load))
        rows = int(np.isfinite(data.loads[load]).sum())
        if rows < ROWS_A_TERM * terms:
            yield (
                f"{load}: {rows} rows for the {terms} terms of {form}: {ROWS_A_TERM} a term are wanted; "
                "`form` rcrm has at most 2"
            )


def _row_names(data: StandData, rows: NDArray[np.int64]) -> str:
    shown = ", ".join(data.samples.place(int(row)) for row in rows[:SHOWN])
    return shown + (f" and {len(rows) - SHOWN} more" if len(rows) > SHOWN else "")
