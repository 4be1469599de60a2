"""Stand data to a rotor model: every form's held-out errors, the chosen form's terms and their intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from coaxlink import files
from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.data import Samples
from coaxlink.data.aliases import SIDES
from coaxlink.errors import InputError
from coaxlink.load import Load
from coaxlink.notebook import Shown
from coaxlink.rotor.drive import TURNS
from coaxlink.rotor.drive_fit import drive_of
from coaxlink.rotor.fit import (
    FORMS,
    ROWS_A_TERM,
    Array,
    LoadFit,
    Options,
    fit_all_terms,
    fit_shared,
    least_squares,
    load_terms,
    orders,
    row_weights,
)
from coaxlink.rotor.model import LOADS, RotorModel
from coaxlink.rotor.pair_sum import OPEN, is_pair, of_each_rotor
from coaxlink.rotor.physics import held_to_physics, keeps_to_physics, misses_rows, windmilling_ratio
from coaxlink.rotor.polynomial import design_matrix
from coaxlink.rotor.power_only import with_torque_of_power
from coaxlink.rotor.selection import Selection
from coaxlink.rotor.stand_data import COAXIAL, FASTEST, LoadRows, StandData, Values, stand_data, unit_of
from coaxlink.rotor.uncertainty import (
    NORMALISER,
    ONE_STANDARD_ERROR,
    HeldOutError,
    Intervals,
    held_out_error,
    noise_floor,
    standard_errors_above,
    term_intervals,
)

CORRELATED = 0.98  # correlation of the two speeds beyond which a log is one line, not a map
OUTLYING = 6.0  # standard deviations beyond which a row is reported
HELD_ORDERS = (3, 4)  # of terms that help a load to keep to physics
MEASURED_FULL = 0.98  # of full speed: measured there
EXACT = 1e-9  # of the largest load: what rounding of a fit leaves is no error
LASSO = "LASSO on standardised terms, refitted on the support, blocks held out"
Channels = Mapping[str, HeldOutError]  # of the coaxial sums and of each load
Fits = dict[int | None, dict[str, LoadFit]]  # by the fold left out, None: none
Rows = dict[int | None, LoadRows]


@dataclass(frozen=True)
class Outlier:
    """A row that the robust fit does not believe: down-weighted, reported, kept."""

    where: str
    load: str
    measured: float
    expected: float
    deviations: float


@dataclass(frozen=True)
class Identification(Shown):
    """An identified model, and everything reported about it."""

    form: str
    model: RotorModel
    channels: Channels  # held out
    comparison: Mapping[str, Channels]  # every form tried
    noise_floor: Mapping[str, float]  # channel: N or N m
    fits: Mapping[str, LoadFit]
    intervals: Mapping[str, Intervals]  # of the coefficients, whatever terms there may be
    given: Mapping[str, Intervals]  # of the model's values, were its terms the only ones there can be
    outliers: tuple[Outlier, ...]
    data: StandData
    predicted: Values  # held-out predictions of the chosen form
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()  # what the model rests on that no row shows, and what to doubt

    def __repr__(self) -> str:
        source = Path(self.data.samples.source).name
        return f"Identification({self.form} of {source}, {self.data.logged} rows)"

    def __str__(self) -> str:
        """Ten lines: what it is of, the model, and each load's error on blocks that no fit saw."""
        rows = f"{self.data.samples.source}: {self.data.logged} rows"
        errors = [
            f"{name.replace('_', ' ')}: {e.rmse:.3g} {unit_of(name)} held out, {100 * e.nrmse:.2g} % of range"
            for name, e in self.channels.items()
            if name not in COAXIAL
        ]
        return "\n".join([rows, str(self.model), *errors])

    def as_json(self) -> dict[str, Any]:
        """The contract's JSON of `identify`, and more."""
        fits = self.fits
        return {
            "form": self.form,
            "speed_max_rpm": self.model.speed_max_rpm,
            "rows": self.data.logged,
            "conditions": self.data.samples.rows,
            "terms": self.model.terms(),
            "channels": _errors_json(self.channels),
            "nrmse_normaliser": NORMALISER,
            "noise_floor": dict(self.noise_floor),
            "forms": {form: _errors_json(channels) for form, channels in self.comparison.items()},
            "intervals": {load: i.as_json() for load, i in self.intervals.items()},
            "standard_errors": {load: dict(i.standard_error) for load, i in self.intervals.items()},
            "standard_errors_given_the_terms": {
                load: dict(i.standard_error) for load, i in self.given.items()
            },
            "indistinct": {load: [list(g) for g in i.indistinct] for load, i in self.intervals.items()},
            "orders": {load: fit.order for load, fit in fits.items()},
            "selection": {
                load: [vars(step) for step in fit.history] for load, fit in fits.items() if fit.history
            },
            "wild_rows": [vars(row) for row in self.outliers],
            "drive": None if self.model.drive is None else asdict(self.model.drive),
            "battery_power": {side: asdict(power) for side, power in self.model.battery_power.items()},
            "measured": measured(self.data),
            "watts_crosstalk": _crosstalk(self.data),
            "notes": list(self.notes),
        }


def _errors_json(channels: Channels) -> dict[str, Any]:
    return {name: error.as_json() for name, error in channels.items()}


def identify(
    samples: Samples,
    form: str = "crm",
    *,
    speed_max_rpm: float | None = None,
    options: Options | None = None,
    compare: bool = True,
) -> Identification:
    """Fit `form` (crm, rcrm, srm, cpcm or auto) to a stand log.

    Errors of all forms are held out in blocks; order, penalty and terms are chosen again without each block.
    auto keeps the simplest form within one standard error of the best; without `compare` the named form is
    the only one tried. Raises InputError.
    """
    if form != "auto":
        try:
            load_terms(form, LOADS[0])
        except ValueError as error:
            raise InputError("`form`", "", str(error)) from error
    read, samples = samples, with_torque_of_power(of_each_rotor(samples))
    if is_pair(samples):
        raise InputError(samples.source, "", f"thrust of both rotors together: {'; '.join(OPEN)}")
    with threadpool_limits(limits=1, user_api="blas"):  # of many small products: see `threads`
        premises = samples.notes[len(read.notes) :]  # what stands for readings that the log has not
        return _identified(stand_data(samples, speed_max_rpm), form, options or Options(), compare, premises)


def _identified(
    data: StandData, form: str, options: Options, compare: bool, premises: Sequence[str] = ()
) -> Identification:
    tried = {name: _fits(name, data, options) for name in FORMS if compare or form in (name, "auto")}
    bent: list[str] = []
    against: list[str] = []
    if "crm" in tried:
        tried["crm"], bent, against = _physical(data, tried["crm"])
    predicted = {name: _predictions(data, fits) for name, fits in tried.items()}
    comparison = {name: _channel_errors(data, values) for name, values in predicted.items()}
    chosen = _simplest(data, predicted) if form == "auto" else form
    fits = tried[chosen][None]
    residuals = _scatter(data, options)
    model = RotorModel.from_terms(
        chosen,
        data.speeds.speed_max_rpm,
        {load: fits[load].polynomial.terms() if load in fits else {} for load in LOADS},
        sources={"upper": "measured", "lower": "measured"},
        drive=drive_of(data.speeds.drives, data.speeds.speed_max_rpm),
        battery_power={side: watts.power for side, watts in data.watts.items()},
    )
    reason = _reason(chosen, comparison) if form == "auto" else None
    notes = _notes(data, reason, bent if chosen == "crm" else [])
    warnings = tuple(dict.fromkeys([*premises, *_warnings(data, against if chosen == "crm" else [])]))
    result = Identification(
        chosen,
        model,
        channels=comparison[chosen],
        comparison=comparison,
        noise_floor=_floors(data, residuals),
        fits=fits,
        intervals={load: fit.intervals for load, fit in fits.items()},
        given={load: _given(data, load, fit) for load, fit in fits.items()},
        outliers=tuple(_outliers(data, residuals)),
        data=data,
        predicted=predicted[chosen],
        notes=(*data.samples.notes, *notes, *warnings),
        warnings=warnings,
    )
    return replace(result, model=replace(model, identified=_provenance(result)))


def _fits(form: str, data: StandData, options: Options) -> Fits:
    """Every measured load of a form fitted without each fold, and, under None, on all rows."""
    left_out = (None, *map(int, np.unique(data.fold)))
    if form == "crm":
        selections = {load: Selection(data.rows(load), options) for load in data.measured}
        return {k: {load: s.fit(k) for load, s in selections.items()} for k in left_out}
    return {k: _fit_all_terms(form, data, k) for k in left_out}


def _fit_all_terms(form: str, data: StandData, without: int | None) -> dict[str, LoadFit]:
    rows = {load: data.rows(load, data.fold != without) for load in data.measured}
    if form != "srm":
        return {load: fit_all_terms(form, of_load) for load, of_load in rows.items()}
    fits: dict[str, LoadFit] = {}
    for load in rows:
        if load not in fits:
            partner = Load.of(load).partner.key
            fits |= fit_shared([rows[name] for name in (load, partner) if name in rows])
    return fits


def _physical(data: StandData, free: Fits) -> tuple[Fits, list[str], list[str]]:
    """The fits held to physics, loads that this changed, and loads whose held-out rows contradict it.

    Contradicted: missed by more than the free fit misses them, beyond chance, and on blocks left out as well.
    These stay as they were, and so does all where the rows are one line of both speeds: they tell no slopes.
    Each fold's fit is held by its own rows alone, as the one on all rows is.
    """
    if data.speeds.correlation() > CORRELATED:
        return free, [], []
    ratios = {k: windmilling_ratio(data, data.fold != k) for k in free}
    found, bent, against = {k: dict(fits) for k, fits in free.items()}, [], []
    for name in data.measured:
        load, rows = Load.of(name), {k: data.rows(name, data.fold != k) for k in free}

        def kept(order: int, name: str = name, load: Load = load, rows: Rows = rows) -> Fits:
            return {
                k: {name: held_to_physics(load, fits[name], rows[k], ratios[k], order)}
                for k, fits in free.items()
            }

        own, sound = kept(0), keeps_to_physics(load, free[None][name], rows[None], ratios[None])
        if all(own[k][name] is fits[name] for k, fits in free.items()):
            against += [] if sound else [name]
            continue
        tried = [own, *(kept(order) for order in HELD_ORDERS)]
        losses = [_lost(data, name, fits) for fits in tried]
        best = min(range(len(tried)), key=lambda i: float(losses[i].sum()))
        unseen = _above(losses[best], _lost(data, name, free)) > ONE_STANDARD_ERROR
        if unseen and misses_rows(tried[best][None][name], free[None][name], rows[None]):
            against += [] if sound else [name]
            continue
        for k, fits in tried[best].items():
            found[k][name] = fits[name]
        bent += [] if found[None][name] is free[None][name] else [name]
    return found, bent, against


def _lost(data: StandData, load: str, fits: Fits) -> Array:
    """(folds,) squared error of a load on each block that its fit has not seen."""
    squared = np.nan_to_num((data.loads[load] - _predictions(data, fits)[load]) ** 2)
    return np.array([squared[data.fold == k].sum() for k in np.unique(data.fold)])


def _predictions(data: StandData, fits: Fits) -> Values:
    """Predictions of each row by a model that has not seen its block."""
    predicted = {load: np.full(data.samples.rows, np.nan) for load in LOADS}
    for number in np.unique(data.fold):
        out = data.fold == number
        for load, fit in fits[int(number)].items():
            predicted[load][out] = fit.predict(data.speeds.upper[out], data.speeds.lower[out])
    return predicted


def _channel_errors(data: StandData, predicted: Values) -> Channels:
    """Errors of the coaxial channels and of each load."""
    errors = {}
    for name, (a, b) in COAXIAL.items():
        if a in data.measured and b in data.measured:
            errors[name] = held_out_error(data.loads[a] + data.loads[b], predicted[a] + predicted[b])
    for load in data.measured:
        errors[Load.of(load).channel] = held_out_error(data.loads[load], predicted[load])
    return errors


def _simplest(data: StandData, predicted: Mapping[str, Values]) -> str:
    """The first form of the ladder whose held-out error is within one standard error of the best.

    A form that a simpler one beats is not among them, however wide its standard error.
    """
    loss = _losses(data, predicted)
    total = {name: float(of.sum()) for name, of in loss.items()}
    best = min(total, key=lambda name: total[name])
    least = np.inf
    for name in predicted:
        if name == best or (total[name] <= least and _above(loss[name], loss[best]) <= ONE_STANDARD_ERROR):
            return name
        least = min(least, total[name])
    return best


def _losses(data: StandData, predicted: Mapping[str, Values]) -> dict[str, Array]:
    """{form: (folds,)} squared errors of every fold, each load in units of its best form's."""
    loss = {}
    for name, values in predicted.items():
        squared = np.zeros(data.samples.rows)
        for load in data.measured:
            least = min(float(np.nanmean((data.loads[load] - p[load]) ** 2)) for p in predicted.values())
            exact = (EXACT * float(np.nanmax(np.abs(data.loads[load])))) ** 2
            squared += np.nan_to_num((data.loads[load] - values[load]) ** 2) / max(least, exact, 1e-300)
        loss[name] = np.array([squared[data.fold == k].sum() for k in np.unique(data.fold)])
    return loss


def _above(loss: Array, other: Array) -> float:
    return float(standard_errors_above(loss[:, None], other)[0])


def _clearest(comparison: Mapping[str, Channels], worse: str, better: str) -> str:
    """The channel in which the one form's held-out error is most above the other's."""
    least = {c: max(error.rmse, 1e-300) for c, error in comparison[better].items()}
    return max(least, key=lambda c: comparison[worse][c].rmse / least[c])


def _reason(chosen: str, comparison: Mapping[str, Channels]) -> str:
    """Why auto took a form: its held-out error beside that of the next simpler and the next richer one."""
    why = f"auto: {chosen} is the simplest form within one standard error of the best"
    tried = list(comparison)
    index = tried.index(chosen)
    beside = [tried[i] for i in (index - 1, index, index + 1) if 0 <= i < len(tried)]
    if not comparison[chosen]:
        return why
    channel = _clearest(comparison, *beside[:2])
    errors = ", ".join(f"{form} {comparison[form][channel].rmse:.3g} {unit_of(channel)}" for form in beside)
    return f"{why} ({channel} held out: {errors})"


def _scatter(data: StandData, options: Options) -> Values:
    """Residuals of the richest fit of each load (rows,): what is left is noise, or an outlier."""
    residuals = {}
    for load in data.measured:
        rows = data.rows(load)
        count = len(rows.y)
        if np.any(rows.upper) and np.any(rows.lower):
            order = orders(Load.LOWER_THRUST.key, count, options.max_order)[-1]
            X = rows.design(load_terms("crm", Load.LOWER_THRUST.key, order))
        else:
            alone = rows.upper if np.any(rows.upper) else rows.lower
            order = min(options.max_order, count // ROWS_A_TERM)
            X = design_matrix(load_terms("crm", Load.UPPER_THRUST.key, order), alone, alone)
        b = least_squares(X, rows.y, row_weights(X, rows.y))
        residuals[load] = np.full(data.samples.rows, np.nan)
        degrees = max(count - X.shape[1], 1)
        residuals[load][np.isfinite(data.loads[load])] = (rows.y - X @ b) * np.sqrt(count / degrees)
    return residuals


def _given(data: StandData, load: str, fit: LoadFit) -> Intervals:
    """Intervals on the chosen terms alone: how well the rows fix the numbers once the terms are granted."""
    terms, rows = list(fit.polynomial.terms()), data.rows(load)
    X = rows.design(terms)
    return term_intervals(terms, X, rows.y, row_weights(X, rows.y))


def _floors(data: StandData, residuals: Values) -> dict[str, float]:
    sums = {
        name: residuals[a] + residuals[b]
        for name, (a, b) in COAXIAL.items()
        if a in residuals and b in residuals
    }
    each = {Load.of(load).channel: residual for load, residual in residuals.items()}
    u, v = data.speeds.upper, data.speeds.lower
    return {name: noise_floor(u, v, residual) for name, residual in {**sums, **each}.items()}


def _outliers(data: StandData, residuals: Values) -> Iterator[Outlier]:
    for load, residual in residuals.items():
        scale = SIGMA_PER_MAD * float(np.nanmedian(np.abs(residual)))
        for row in np.flatnonzero(np.abs(np.nan_to_num(residual)) > OUTLYING * max(scale, 1e-12)):
            value, off = float(data.loads[load][row]), float(residual[row])
            yield Outlier(data.samples.place(int(row)), load, value, value - off, abs(off) / scale)


def _notes(data: StandData, reason: str | None, bent: Sequence[str]) -> Iterator[str]:
    speeds = data.speeds
    if not speeds.from_throttle:
        yield f"u = 1 is {speeds.speed_max_rpm:.0f} rpm ({speeds.source})"
    count = len(np.unique(data.fold))
    yield f"errors on held-out blocks: {count} sweeps or stretches, each left out once"
    yield f"NRMSE = RMSE / ({NORMALISER})"
    if reason:
        yield reason
    if bent:
        yield f"kept to physics between and beyond the rows: {', '.join(bent)}"
    top = max(speeds.upper.max(), speeds.lower.max())
    if top < MEASURED_FULL:
        yield f"measured up to u = {top:.2f}: from there to 1 the model is extrapolated"
    missing = [load for load in LOADS if load not in data.measured]
    if missing:
        yield f"not measured, left without terms: {', '.join(missing)}"


def _warnings(data: StandData, against: Sequence[str]) -> Iterator[str]:
    speeds = data.speeds
    if speeds.from_throttle:
        yield speeds.source
    elif speeds.source == FASTEST and not any(data.samples.has(f"{side}_throttle") for side in SIDES):
        yield (
            f"u = 1 is {speeds.speed_max_rpm:.0f} rpm, the fastest of a log without throttle: a table takes "
            "that for full throttle; `speed_max_rpm` states another"
        )
    alike = speeds.correlation()
    if alike > CORRELATED:
        yield (
            f"both speeds move together (correlation {alike:.5f}): the model holds along them only, "
            "what each rotor does to the other cannot be separated"
        )
    if against:
        yield f"held-out rows contradict slopes that physics expects: {', '.join(against)} (left as measured)"


def measured(data: StandData) -> dict[str, Any]:
    """Where the rows were: speeds of rotors that turn, and how slow the lower one was beside the upper."""
    u, v = data.speeds.upper, data.speeds.lower
    both = (u > TURNS) & (v > TURNS)
    sides = {
        side: [float(x[x > TURNS].min()), float(x.max())]
        for side, x in zip(SIDES, (u, v), strict=True)
        if np.any(x > TURNS)
    }
    stood = np.any((u <= TURNS) & (v > TURNS)), np.any((v <= TURNS) & (u > TURNS))
    out = {**sides, "rested": [side for side, at_rest in zip(SIDES, stood, strict=True) if at_rest]}
    if not both.any():
        return out
    ratios = {"ratio_least": float(np.min(v[both] / u[both])), "windmilling": windmilling_ratio(data)}
    return {**out, **ratios}


def _provenance(result: Identification) -> dict[str, Any]:
    path = Path(result.data.samples.source)
    return {
        "file": path.name,
        "sha256": files.sha256(path) if path.is_file() else "",
        "rows": result.data.logged,
        "law": LASSO,
        "errors": _errors_json(result.channels),
        "noise_floor": dict(result.noise_floor),
        "intervals": {load: i.as_json() for load, i in result.intervals.items()},
        "measured": measured(result.data),
        **({"watts_crosstalk": lacks} if (lacks := _crosstalk(result.data)) else {}),
        **_range(result.data),
    }


def _crosstalk(data: StandData) -> dict[str, float]:
    return {side: watts.crosstalk for side, watts in data.watts.items() if watts.crosstalk}


def _range(data: StandData) -> dict[str, Any]:
    """How far throttles went, where that does not tell what full throttle gives."""
    unknown = [
        d.top for d in data.speeds.drives.values() if not d.reaches_full and data.speeds.source != "given"
    ]
    return {"throttle_to": max(unknown)} if unknown else {}
