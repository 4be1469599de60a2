"""Stand data to a rotor model: every form's held-out errors, the chosen form's terms and their intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from coaxlink import files
from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.data import Samples
from coaxlink.data.averaging import shortened
from coaxlink.errors import InputError
from coaxlink.load import Load, of_rotor
from coaxlink.rotor import choice, forms
from coaxlink.rotor.fit import OUTLYING, LoadFit, Options, huber_weights, least_squares, orders, row_weights
from coaxlink.rotor.folds import blocks, folds
from coaxlink.rotor.intervals import Intervals, term_intervals
from coaxlink.rotor.metrics import NORMALISER, ChannelError, channel_error
from coaxlink.rotor.model import LOADS, RotorModel
from coaxlink.rotor.noise import noise_floor
from coaxlink.rotor.polynomial import design_matrix
from coaxlink.rotor.selection import fit_load
from coaxlink.rotor.speeds import Speeds, normalised_speeds

CHANNELS = {load.key: load.channel for load in Load}
COAXIAL = {
    "coaxial_thrust": (Load.UPPER_THRUST.key, Load.LOWER_THRUST.key),
    "coaxial_torque": (Load.UPPER_TORQUE.key, Load.LOWER_TORQUE.key),
}
CORRELATED = 0.98  # correlation of the two speeds beyond which a log is one line, not a map
LAWS = {"surface": "the R-CRM's squares and a smooth discrepancy, marginal likelihood, blocks held out"}
Values = dict[str, NDArray[np.float64]]  # load: (rows,), NaN where not measured


@dataclass(frozen=True)
class Outlier:
    """A row that the robust fit does not believe: down-weighted, reported, kept."""

    where: str
    load: str
    measured: float
    expected: float
    deviations: float


@dataclass(frozen=True)
class StandData:
    """What identification sees of a log: speeds, measured loads, folds."""

    samples: Samples
    speeds: Speeds
    loads: Values
    fold: NDArray[np.int64]  # (rows,)

    @property
    def measured(self) -> tuple[str, ...]:
        """The loads with enough rows to fit."""
        return tuple(load for load in LOADS if np.isfinite(self.loads[load]).sum() >= 6)


@dataclass(frozen=True)
class Identification:
    """An identified model, and everything said about it."""

    form: str
    model: RotorModel
    channels: Mapping[str, ChannelError]  # held out
    comparison: Mapping[str, Mapping[str, ChannelError]]  # every form tried: its channels
    noise_floor: Mapping[str, float]  # channel: N or N m
    fits: Mapping[str, LoadFit]
    intervals: Mapping[str, Intervals]  # of the coefficients, whatever terms there may be
    given: Mapping[str, Intervals]  # of the model's values, were its terms the only ones there can be
    outliers: tuple[Outlier, ...]
    data: StandData
    predicted: Values  # held-out predictions of the chosen form
    notes: tuple[str, ...] = field(default=())
    without: Mapping[str, ChannelError] = field(
        default_factory=dict
    )  # held out, physical sense not asked for

    def as_json(self) -> dict[str, Any]:
        """The contract's JSON of `identify`, and more."""
        smooth = {load: vars(fit.smooth) for load, fit in self.fits.items() if fit.smooth}
        return {
            "form": self.form,
            "speed_max_rpm": self.model.speed_max_rpm,
            "rows": self.data.samples.rows,
            "terms": self.model.terms(),
            "channels": {name: error.as_json() for name, error in self.channels.items()},
            "nrmse_normaliser": NORMALISER,
            "noise_floor": dict(self.noise_floor),
            "forms": {f: {n: e.as_json() for n, e in c.items()} for f, c in self.comparison.items()},
            "intervals": {
                load: {t: list(b) for t, b in i.bounds.items()} for load, i in self.intervals.items()
            },
            "standard_errors": {load: dict(i.standard_error) for load, i in self.intervals.items()},
            "standard_errors_given_the_terms": {
                load: dict(i.standard_error) for load, i in self.given.items()
            },
            "indistinct": {load: [list(g) for g in i.indistinct] for load, i in self.intervals.items()},
            "orders": {load: fit.order for load, fit in self.fits.items()},
            "selection": {
                load: [vars(candidate) for candidate in fit.history]
                for load, fit in self.fits.items()
                if fit.history
            },
            "wild_rows": [vars(row) for row in self.outliers],
            "notes": list(self.notes),
            **({"surface": smooth} if smooth else {}),
            **({"physical": self._physical()} if self.without else {}),
        }

    def _physical(self) -> dict[str, Any]:
        """What asking for physical sense changed, and what that cost on held-out blocks."""
        return {
            "loads": {
                load: {
                    "broken": [vars(rule) for rule in fit.broken],
                    "unmet": fit.unmet,
                    "terms_without": fit.freely.terms(),
                    "moved_out_of_their_intervals": list(fit.moved),
                }
                for load, fit in self.fits.items()
                if fit.broken
            },
            "channels_without": {name: error.as_json() for name, error in self.without.items()},
        }


def stand_data(samples: Samples, speed_max_rpm: float | None = None) -> StandData:
    """Speeds, loads and folds of a stand log. Raises InputError when nothing can be identified from it."""
    samples = shortened(samples)
    speeds = normalised_speeds(samples, speed_max_rpm)
    # a rotor without its thrust makes no model; the lower one is only asked for where it turned
    samples.require(*(load.column for load in of_rotor(0)))
    if np.ptp(speeds.lower) > 0:
        samples.require(*(load.column for load in of_rotor(1)))
    loads: Values = {}
    for load in LOADS:
        name = load.replace(".", "_")
        loads[load] = samples[name] if samples.has(name) else np.full(samples.rows, np.nan)
    found = StandData(samples, speeds, loads, folds(blocks(samples, speeds)))
    if not found.measured:
        raise InputError(samples.source, "", f"too few rows to identify anything: {samples.rows}, 6 at least")
    return found


def identify(
    samples: Samples,
    form: str = "crm",
    *,
    speed_max_rpm: float | None = None,
    options: Options | None = None,
    compare: bool = True,
) -> Identification:
    """Fit `form` (crm, rcrm, srm, cpcm, surface, mutual or auto) to a stand log.

    Errors of all forms are held out in blocks; order, penalty and terms are chosen again without each block.
    auto keeps the simplest form within one standard error of the best; without `compare` the form asked for
    is the only one tried. Raises InputError.
    """
    options = options or Options()
    if form != "auto":
        try:
            forms.load_terms(form, LOADS[0])
        except ValueError as error:
            raise InputError("`form`", "", str(error)) from error
    with threadpool_limits(limits=1, user_api="blas"):  # of many small products: see `threads`
        return _identified(stand_data(samples, speed_max_rpm), form, options, compare)


def _identified(data: StandData, form: str, options: Options, compare: bool) -> Identification:
    tried = [f for f in forms.FORMS if compare or form in (f, "auto")]
    tried += [form] if form not in (*forms.FORMS, "auto") else []
    predicted = {name: held_out(name, data, options) for name in tried}
    comparison = {name: channel_errors(data, values) for name, values in predicted.items()}
    chosen = choice.simplest(data, predicted) if form == "auto" else form
    without: Mapping[str, ChannelError] = {}
    if options.physical:
        without = channel_errors(data, held_out(chosen, data, replace(options, physical=False)))
    fits = fit_form(chosen, data, np.ones(data.samples.rows, bool), options)
    intervals = {load: fit.intervals for load, fit in fits.items()}
    rich = _scatter(data, options)
    outliers = _outliers(data, rich)
    terms = {load: fits[load].polynomial.terms() if load in fits else {} for load in LOADS}
    model = RotorModel.from_terms(chosen, data.speeds.speed_max_rpm, terms)
    notes = (
        *choice.beyond(chosen, predicted, comparison, data),
        *data.samples.notes,
        *_notes(data, form, chosen, choice.reason(chosen, comparison)),
    )
    result = Identification(
        chosen, model, comparison[chosen], comparison, _floors(data, rich), fits, intervals,
        _given(data, fits, options), outliers, data,
        predicted[chosen], notes, without,
    )  # fmt: skip
    return replace(result, model=replace(model, identified=_provenance(result)))


def fit_form(form: str, data: StandData, rows: NDArray[np.bool_], options: Options) -> dict[str, LoadFit]:
    """Every measured load of a form fitted on the masked rows (rows,)."""
    fits: dict[str, LoadFit] = {}
    for load in data.measured:
        partner = forms.shared_load(form, load)
        if partner in fits:
            continue
        y = data.loads[load]
        mask = rows & np.isfinite(y)
        u, v = data.speeds.upper[mask], data.speeds.lower[mask]
        if form == "srm":
            fits.update(_shared(load, data, rows))
        else:
            fits[load] = fit_load(form, load, u, v, y[mask], data.fold[mask], options)
    return fits


def _shared(load: str, data: StandData, rows: NDArray[np.bool_]) -> dict[str, LoadFit]:
    """One k for both rotors (srm)."""
    partner = Load.of(load).partner.key
    pairs = [(load, data.speeds.upper if load.startswith("upper") else data.speeds.lower)]
    if partner in data.measured:
        pairs.append((partner, data.speeds.upper if partner.startswith("upper") else data.speeds.lower))
    squares, values = [], []
    for name, u in pairs:
        mask = rows & np.isfinite(data.loads[name])
        squares.append(u[mask] ** 2)
        values.append(data.loads[name][mask])
    x, y = np.concatenate(squares)[:, None], np.concatenate(values)
    weights = huber_weights(x, y)[0]
    k = least_squares(x, y, weights)
    shared = {}
    for name, _ in pairs:
        term = f"u_{name[0]}^2"
        shared[name] = LoadFit((term,), k, 2, 0.0, k, term_intervals((term,), x, y, weights))
    return shared


def held_out(form: str, data: StandData, options: Options) -> Values:
    """Predictions of each row by a model that has not seen its block."""
    predicted = {load: np.full(data.samples.rows, np.nan) for load in LOADS}
    for number in np.unique(data.fold):
        out = data.fold == number
        for load, fit in fit_form(form, data, ~out, options).items():
            predicted[load][out] = fit.predict(data.speeds.upper[out], data.speeds.lower[out])
    return predicted


def channel_errors(data: StandData, predicted: Values) -> dict[str, ChannelError]:
    """Errors of the coaxial channels and of each load."""
    errors = {}
    for name, pair in COAXIAL.items():
        if all(load in data.measured for load in pair):
            measured, model = (np.sum([v[p] for p in pair], axis=0) for v in (data.loads, predicted))
            errors[name] = channel_error(measured, model)
    for load in data.measured:
        errors[CHANNELS[load]] = channel_error(data.loads[load], predicted[load])
    return errors


def _scatter(data: StandData, options: Options) -> Values:
    """Residuals of the richest fit of each load (rows,): what is left is noise, or an outlier."""
    residuals = {}
    for load in data.measured:
        mask = np.isfinite(data.loads[load])
        y, u, v = data.loads[load][mask], data.speeds.upper[mask], data.speeds.lower[mask]
        richest = forms.load_terms("mutual", load, orders("mutual", load, len(y), options)[-1])
        if not np.any(v) or not np.any(u):
            side = [u, v][not np.any(u)]
            richest = forms.load_terms("crm", "upper", min(options.max_order, len(y) // 3))
            Z = design_matrix(richest, side, side)
        else:
            Z = design_matrix(richest, u, v)
        b = least_squares(Z, y, huber_weights(Z, y)[0])
        residuals[load] = np.full(len(mask), np.nan)
        residuals[load][mask] = (y - Z @ b) * np.sqrt(len(y) / max(len(y) - Z.shape[1], 1))
    return residuals


def _given(data: StandData, fits: Mapping[str, LoadFit], options: Options) -> dict[str, Intervals]:
    """Intervals on the chosen terms alone: how well the rows fix the numbers once the terms are granted."""
    found = {}
    for load, fit in fits.items():
        if fit.smooth:  # its prior is part of it: least squares on its terms alone says nothing
            found[load] = fit.intervals
            continue
        nonzero = [t for t, b in zip(fit.terms, fit.coefficients, strict=True) if b != 0.0]
        mask = np.isfinite(data.loads[load])
        X = design_matrix(nonzero, data.speeds.upper[mask], data.speeds.lower[mask])
        y = data.loads[load][mask]
        found[load] = term_intervals(nonzero, X, y, row_weights(X, y, options))
    return found


def _floors(data: StandData, residuals: Values) -> dict[str, float]:
    floors = {}
    u, v = data.speeds.upper, data.speeds.lower
    for name, pair in COAXIAL.items():
        if all(load in residuals for load in pair):
            floors[name] = noise_floor(u, v, np.sum([residuals[p] for p in pair], axis=0), 0)
    for load, residual in residuals.items():
        floors[CHANNELS[load]] = noise_floor(u, v, residual, 0)
    return floors


def _outliers(data: StandData, residuals: Values) -> tuple[Outlier, ...]:
    found = []
    for load, residual in residuals.items():
        scale = SIGMA_PER_MAD * float(np.nanmedian(np.abs(residual)))
        for row in np.flatnonzero(np.abs(np.nan_to_num(residual)) > OUTLYING * max(scale, 1e-12)):
            value = float(data.loads[load][row])
            off = float(residual[row])
            found.append(Outlier(data.samples.place(int(row)), load, value, value - off, abs(off) / scale))
    return tuple(found)


def speed_correlation(speeds: Speeds) -> float:
    """Correlation of the two speeds where both turn; 0 when a rotor also turns without the other."""
    upper, lower = speeds.upper > 0, speeds.lower > 0
    both = upper & lower
    if both.sum() < 3 or both.sum() < 0.9 * (upper | lower).sum():
        return 0.0
    u, v = speeds.upper[both], speeds.lower[both]
    return float(np.corrcoef(u, v)[0, 1]) if np.ptp(u) > 0 and np.ptp(v) > 0 else 0.0


def _notes(data: StandData, requested: str, chosen: str, reason: str) -> Sequence[str]:
    count = len(np.unique(data.fold))
    said = [
        f"u = 1 is {data.speeds.speed_max_rpm:.0f} rpm ({data.speeds.source})"
        if not data.speeds.from_throttle
        else data.speeds.source,
        f"errors on held-out blocks: {count} sweeps or stretches, each left out once",
        f"NRMSE = RMSE / ({NORMALISER})",
    ]
    if requested == "auto":
        said.append(reason)
    alike = speed_correlation(data.speeds)
    if alike > CORRELATED:
        said.append(
            f"both speeds move together (correlation {alike:.5f}): the model holds along them only, "
            "what each rotor does to the other cannot be separated"
        )
    missing = [load for load in LOADS if load not in data.measured]
    if missing:
        said.append(f"not measured, left without terms: {', '.join(missing)}")
    return said


def _provenance(result: Identification) -> dict[str, Any]:
    path = Path(result.data.samples.source)
    return {
        "file": path.name,
        "sha256": files.sha256(path) if path.is_file() else "",
        "rows": result.data.samples.rows,
        "law": LAWS.get(result.form, "LASSO on standardised terms, refitted on the support, blocks held out"),
        "errors": {name: error.as_json() for name, error in result.channels.items()},
        "noise_floor": dict(result.noise_floor),
        "intervals": {
            load: {t: list(b) for t, b in i.bounds.items()} for load, i in result.intervals.items()
        },
    }
