"""A rotor model's coefficients updated by flights: Bayesian linear regression on the wrench that was
measured.

    measured - predicted(prior mean) = sum_k (c_k - prior_k) X_k + nuisances + noise

X_k is what a unit more of a coefficient adds to force and torques, all pairs sharing one model; the
nuisances are `columns`' (centre of mass, instruments, wind, voltage), without what the coefficients
themselves are. Speeds are the ESCs' where the log has rpm; else commands stand for them, and a scale between
both joins the prior. Columns that follow the commands go through two-stage least squares (`instruments`).
Source: Bishop 2006, *Pattern Recognition and Machine Learning*, section 3.3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink import files
from coaxlink.airframe import Airframe
from coaxlink.channels.flight import JUDGED_RATE_HZ, flight_frame
from coaxlink.channels.logged_speeds import FEW_SPEEDS, LEAST_ROWS, SLOW_S, has_speed, has_speeds
from coaxlink.constants import FULL, NORMAL_95, TURNING
from coaxlink.data import Samples
from coaxlink.data.logs.flight import impossible_commands
from coaxlink.errors import InputError
from coaxlink.evidence.blocks import Block, joined
from coaxlink.frames import Array, FlightFrame
from coaxlink.health.accelerometer import vertical_zero
from coaxlink.health.columns import least_noise, rows_of
from coaxlink.health.evidence import Rows, together
from coaxlink.premises import rotation_of
from coaxlink.residual.diagnosis.flight_search import SETTLES
from coaxlink.rotor.model import LOADS, RotorModel
from coaxlink.rotor.polynomial import design_matrix, parse_term
from coaxlink.rotor_update.regressors import regressors
from coaxlink.signals import lagged

DRIVE_SCALE = 0.10  # sd of full-throttle speed over the table's, where no speed was measured: sag and set-up
# sd of a load as a whole, and of each of its coefficients beside that, where the rotor file has neither
# intervals nor a covariance: twice what a data sheet's prior says of its lower rotor (docs/no_stand.md)
NO_PRIOR = 0.15
NEAR_S = 0.2  # a low-passed row has so much of what is around it
STEADY_S = 0.3  # a motor answers its command within a tenth of a second
SLOPE_SD = 0.1  # of what a command more means in speed over what the command does: an ESC's curve
DETERMINED, BARELY = 0.5, 0.8  # of the prior's sd: less is determined, more is not


@dataclass(frozen=True)
class Coefficient:
    """One coefficient: what was believed before, and after."""

    load: str
    term: str
    prior: float
    prior_sd: float
    value: float
    sd: float

    @property
    def verdict(self) -> str:
        """told, partly or not told by these flights."""
        left = self.sd / max(self.prior_sd, 1e-300)
        return "told" if left < DETERMINED else "partly" if left < BARELY else "not told"


@dataclass(frozen=True)
class Known:
    """What a plan for the next flight starts from."""

    names: tuple[tuple[str, str], ...]  # K coefficients: load, term
    covariance: Array  # (L, L) of the coefficients and of what else lasts from flight to flight
    scale: Array  # (4,) one over the noise of an independent row, N, N m
    frame: FlightFrame  # the last flight


@dataclass(frozen=True)
class Update:
    """A rotor model after flights."""

    model: RotorModel
    coefficients: tuple[Coefficient, ...]
    # at hover speeds: prior, its sd, posterior, its sd
    loads: Mapping[str, tuple[float, float, float, float]]
    hover: tuple[float, float]  # normalised speeds of upper and lower rotor
    seconds: float
    rms: tuple[Array, Array]  # (4,) N, N m of the residual's mean-free rows: before, after
    measured_speeds: bool
    notes: tuple[str, ...]
    known: Known

    def as_json(self) -> dict[str, Any]:
        """The contract's keys of `identify`, and what flights told."""
        return {
            "form": self.model.form,
            "speed_max_rpm": self.model.speed_max_rpm,
            "terms": self.model.terms(),
            "channels": {},
            "intervals": self.model.identified["intervals"],
            "told": [{**vars(t), "verdict": t.verdict} for t in self.coefficients],
            "hover": {
                "upper_speed": self.hover[0],
                "lower_speed": self.hover[1],
                "loads": {
                    name: {"prior": a, "prior_sd": b, "value": c, "sd": d}
                    for name, (a, b, c, d) in self.loads.items()
                },
            },
            "seconds": self.seconds,
            "residual_before": list(map(float, self.rms[0])),
            "residual_after": list(map(float, self.rms[1])),
            "measured_speeds": self.measured_speeds,
            "notes": list(self.notes),
        }


def coefficients_from_flights(logs: Sequence[Samples], airframe: Airframe, prior: RotorModel) -> Update:
    """The prior's coefficients after flights of a weighed vehicle. Raises InputError."""
    names = [(load, term) for load, terms in prior.terms().items() for term in terms]
    mean = np.array([prior.terms()[load][term] for load, term in names])
    covariance, notes = prior_covariance(prior, names, mean)
    measured = all(has_speeds(log, airframe) for log in logs)
    if measured:
        logs = [by_speed(log, airframe, prior) for log in logs]
        notes += ("what a command means in speed is known by the ESCs' rpm",)
        numbers = [r.number for r in airframe.rotors]
        silent = [n for n in numbers if not all(has_speed(log, n) for log in logs)]
        notes += tuple(
            f"rotor {n} has no logged speed: it turns by its command as the others do" for n in silent
        )
    else:
        order = np.array([sum(parse_term(term)) for _, term in names])
        covariance = covariance + np.outer(order * mean, order * mean) * DRIVE_SCALE**2
        notes += ("no rotor speeds in the logs: commands stand for them, full throttle within 10 %",)
    root = np.asarray(np.linalg.cholesky(covariance + 1e-12 * np.diag(np.diag(covariance))), float)
    bare = prior.by_speed() if measured else prior
    rows, frames = zip(*(_rows(log, airframe, bare, names, measured, root) for log in logs), strict=True)
    whole = together(rows, {})
    count, lasts = len(names), whole.lasting
    units = np.eye(lasts)
    units[:count, :count] = root
    lasting = units @ whole.fit.covariance[-lasts:, -lasts:] @ units.T
    found, spread = mean + root @ whole.fit.values[-lasts:][:count], lasting[:count, :count]
    terms: dict[str, dict[str, float]] = {load: {} for load in LOADS}
    for (load, term), value in zip(names, found, strict=True):
        terms[load][term] = float(value)
    sources = {**prior.sources, "upper": "measured", "lower": "measured"}  # here, in flight
    model = replace(prior.having(terms), sources=sources, rotation=rotation_of(airframe, prior))
    coefficients = tuple(
        Coefficient(load, term, float(a), float(np.sqrt(b)), float(c), float(np.sqrt(d)))
        for (load, term), a, b, c, d in zip(
            names, mean, np.diag(covariance), found, np.diag(spread), strict=True
        )
    )
    hover = _hover(frames)
    loads = _at(names, hover, mean, covariance, found, spread)
    before, after = _rms(frames, model)
    seconds = sum(len(f.keep) for f in frames) / JUDGED_RATE_HZ
    model = replace(model, identified=_provenance(prior, logs, names, found, spread, seconds))
    known = Known(tuple(names), lasting, np.median([r.scale for r in rows], axis=0), frames[-1])
    return Update(model, coefficients, loads, hover, seconds, (before, after), measured, tuple(notes), known)


def prior_covariance(
    prior: RotorModel, names: Sequence[tuple[str, str]], mean: Array
) -> tuple[Array, tuple[str, ...]]:
    """(K, K) covariance of a rotor file's coefficients, and in words where it comes from. Raises
    InputError."""
    about = prior.identified.get("prior", {})
    labels = [f"{load} {term}" for load, term in names]
    if isinstance(about, Mapping) and list(about.get("coefficients", ())) == labels:
        try:
            covariance = np.array(about["covariance"], float)
        except (KeyError, TypeError, ValueError):  # a list of lists of unequal length, words
            covariance = np.zeros(0)
        sound = covariance.shape == (len(names), len(names)) and bool(np.isfinite(covariance).all())
        if not sound or np.linalg.eigvalsh(covariance).min() < -1e-6 * np.trace(covariance):
            raise InputError("rotor", "identified.prior.covariance", "a covariance of its terms is expected")
        return covariance, ("prior: the rotor file's own covariance",)
    bounds = prior.identified.get("intervals", {})
    sds, guessed = [], []
    for (load, term), value in zip(names, mean, strict=True):
        interval = bounds.get(load, {}).get(term) if isinstance(bounds, Mapping) else None
        interval = interval if isinstance(interval, list) and len(interval) == 2 else None
        guessed.append(0.0 if interval else NO_PRIOR * float(value))
        sds.append(max((interval[1] - interval[0]) / 2 / NORMAL_95, 1e-9) if interval else abs(guessed[-1]))
    missing = np.count_nonzero(guessed)
    guess = f"{100 * NO_PRIOR:.0f} % of each load as a whole and of each coefficient"
    where = (
        "its intervals"
        if not missing
        else f"{guess} (the file has no intervals)"
        if missing == len(names)
        else f"its intervals; where it has none ({missing} of {len(names)}), {guess}"
    )
    # a load that is off as a whole is likelier than coefficients that are off each its own way
    same = np.array([[a[0] == b[0] for b in names] for a in names])
    return np.diag(np.array(sds) ** 2) + same * np.outer(guessed, guessed), (f"prior: {where}",)


def by_speed(log: Samples, airframe: Airframe, model: RotorModel) -> Samples:
    """A log whose motor columns are speeds: slowly as the ESCs' rpm say, quickly as the commands go.

        speed = mean(rpm) + slope (command - mean(command)),   means over SLOW_S, centred

    What a command means drifts with the pack and the windings: rpm tell it, late and coarsely as they come.
    What happens within seconds they tell too late. The slope is that of both over STEADY_S, commands through
    the declared lag, with proportion as its prior: a hover alone says nothing of it. A rotor without a
    speed turns by its command as the others do.
    """
    given = np.stack([log[f"motor{rotor.number}"] for rotor in airframe.rotors], axis=1)
    volts = log["voltage_V"] if log.has("voltage_V") else None
    asked = airframe.turned(model, np.where(impossible_commands(given), np.nan, given), volts)
    turned, ratios = {}, {}
    for rotor, command in zip(airframe.rotors, asked.T, strict=True):
        speed = log[f"rpm{rotor.number}"] / model.speed_max_rpm if has_speed(log, rotor.number) else None
        if speed is not None:
            turned[rotor.number], ratios[rotor.number] = _turned(command, speed, log, airframe.motor_lag_s)
    usual = float(np.median(list(ratios.values())))
    for rotor, command in zip(airframe.rotors, asked.T, strict=True):
        speeds = turned.get(rotor.number, usual * command)
        turned[rotor.number] = np.where(command <= 0, 0.0, np.clip(speeds, 0.0, None))
    return log.with_columns(**{f"motor{n}": speeds for n, speeds in turned.items()})


def _turned(command: Array, speed: Array, log: Samples, lag_s: float) -> tuple[Array, float]:
    """(rows,) what a rotor turned at, and how many times its command that usually is."""
    rows = np.isfinite(command) & np.isfinite(speed) & (command > TURNING) & (speed > TURNING)
    period = float(np.median(np.diff(log["time_s"])))
    behind = _turning(command, period, lag_s)
    every = period * len(rows) / max(rows.sum(), 1)  # ESCs may report more seldom than the log has rows
    slow, short = (max(round(span / period), 1) for span in (max(SLOW_S, FEW_SPEEDS * every), STEADY_S))
    u, v = (_mean(values, rows, slow) for values in (command, speed))
    x, y = ((_mean(values, rows, short) - _mean(values, rows, slow))[rows] for values in (behind, speed))
    ratio = float(np.median(speed[rows] / command[rows]))
    noise = float(np.var(y - ratio * x)) * STEADY_S / period  # neighbours share their mean
    own = noise / (SLOPE_SD * ratio) ** 2
    slope = (float(x @ y) + own * ratio) / max(float(x @ x) + own, 1e-300)
    near = np.isfinite(v)
    return np.where(near, v + slope * (command - np.where(near, u, 0.0)), ratio * command), ratio


def _turning(command: Array, period_s: float, lag_s: float) -> Array:
    """Commands behind a motor's lag; NaN where they are damaged. White ones lose a tenth of a mean to it."""
    known = np.isfinite(command)
    row = np.arange(len(command))
    filled = np.interp(row, row[known], command[known])
    return np.where(known, lagged(filled[:, None], period_s, lag_s)[:, 0], np.nan)


def _mean(values: Array, rows: NDArray[np.bool_], width: int) -> Array:
    """Centred running mean of those rows; NaN where there is none within `width` rows."""
    from scipy.ndimage import uniform_filter1d

    weight = uniform_filter1d(rows.astype(float), width, mode="constant")
    total = uniform_filter1d(np.where(rows, values, 0.0), width, mode="constant")
    return np.where(weight > 0.5 / width, total / np.maximum(weight, 1e-12), np.nan)


def _rows(
    log: Samples,
    airframe: Airframe,
    prior: RotorModel,
    names: Sequence[tuple[str, str]],
    measured: bool,
    root: Array,
) -> tuple[Rows, FlightFrame]:
    """One flight's rows and its frame. `root` (K, K) of the prior's covariance: its columns are the unknowns.

    Noise is what the columns as they are leave at the numbers that fit what instruments explain of them.
    """
    frame = _within(flight_frame([log], airframe, prior), log)
    zero, zero_sd = vertical_zero(frame)
    moved = frame.measured.copy()
    moved[:, 2] -= zero * frame.airframe.mass_kg
    frame = replace(frame, measured=moved)
    raw, seen, parts = regressors(frame, names, measured, zero_sd)
    (own, lasts, passes), deviations = seen, [joined(part)[1] for part in parts]
    coefficients = Block("coefficients", own @ root, np.ones(len(names)))
    rows = Rows(
        target=rows_of(frame, (frame.measured - frame.predicted)[..., None])[:, :, 0],
        lasting=(coefficients, Block("lasting", lasts, deviations[0])),
        passing=(Block("passing", passes, deviations[1]),),
        time_s=frame.time_s[frame.keep],
        least=least_noise(frame),
    )
    values = together([rows], {}, rounds=SETTLES).fit.values
    rest = rows.target - np.concatenate([raw[2], raw[0] @ root, raw[1]], axis=-1) @ values
    noise = np.maximum(np.sqrt(np.mean(rest**2, axis=0)), rows.least)
    return replace(rows, noise=noise, together=rows.hangs(rest)), frame


def _within(frame: FlightFrame, log: Samples) -> FlightFrame:
    """Without the rows near those at which a motor is at its end. Raises InputError where none is left."""
    from scipy.ndimage import maximum_filter1d

    out = ((frame.speeds < TURNING) | (frame.speeds > FULL)).any(axis=1)
    near = maximum_filter1d(out, 2 * round(NEAR_S * frame.rate_hz) + 1)
    keep = frame.keep[~near[frame.keep]]
    if len(keep) < LEAST_ROWS:
        raise InputError(log.source, "motors", f"between {TURNING:g} and {FULL:g} of full speed nearly never")
    return replace(frame, keep=keep)


def _hover(frames: Sequence[FlightFrame]) -> tuple[float, float]:
    body = frames[0].airframe
    speeds = np.concatenate([f.speeds[f.keep] for f in frames])
    middle = np.median(speeds, axis=0)
    uppers = [u for u, _ in body.pairs] or list(body.singles)
    lowers = [low for _, low in body.pairs] or list(body.singles)
    return float(np.mean(middle[uppers])), float(np.mean(middle[lowers]))


def _at(
    names: Sequence[tuple[str, str]],
    hover: tuple[float, float],
    mean: Array,
    covariance: Array,
    found: Array,
    spread: Array,
) -> dict[str, tuple[float, float, float, float]]:
    u, v = np.array([hover[0]]), np.array([hover[1]])
    out = {}
    for load in LOADS:
        own = np.array([name == load for name, _ in names])
        x = design_matrix([term for _, term in names], u, v)[0] * own
        out[load] = (
            float(x @ mean),
            float(np.sqrt(x @ covariance @ x)),
            float(x @ found),
            float(np.sqrt(x @ spread @ x)),
        )
    return out


def _rms(frames: Sequence[FlightFrame], model: RotorModel) -> tuple[Array, Array]:
    pairs = []
    for frame in frames:
        after = frame.pulling(*frame.airframe.loads(model, frame.speeds))
        pairs.append([rows_of(f, (f.measured - f.predicted)[..., None])[:, :, 0] for f in (frame, after)])
    before, after_rows = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return np.sqrt(np.mean(before**2, axis=0)), np.sqrt(np.mean(after_rows**2, axis=0))


def _provenance(
    prior: RotorModel,
    logs: Sequence[Samples],
    names: Sequence[tuple[str, str]],
    mean: Array,
    covariance: Array,
    seconds: float,
) -> dict[str, Any]:
    """The prior's own provenance, with the flights behind it: the posterior is the next flights' prior."""
    half = NORMAL_95 * np.sqrt(np.diag(covariance))
    intervals: dict[str, dict[str, list[float]]] = {}
    for (load, term), m, h in zip(names, mean, half, strict=True):
        intervals.setdefault(load, {})[term] = [float(m - h), float(m + h)]
    before = prior.identified.get("prior", {})
    flights = [
        {"file": Path(log.source).name, "sha256": files.sha256(Path(log.source))}
        for log in logs
        if Path(log.source).is_file()
    ]
    return {
        **{k: v for k, v in prior.identified.items() if k != "prior"},
        "law": "prior updated by flights: Bayesian linear regression on the measured wrench",
        "errors": {},
        "intervals": intervals,
        "flights": [*prior.identified.get("flights", []), *flights],
        "flight_seconds": float(prior.identified.get("flight_seconds", 0.0)) + seconds,
        "prior": {
            **(dict(before) if isinstance(before, Mapping) else {}),
            "coefficients": [f"{load} {term}" for load, term in names],
            "mean": [float(v) for v in mean],
            "covariance": [[float(v) for v in row] for row in covariance],
        },
    }
