"""A pair's rotor model before anybody measured the pair: a table of one rotor, and the wake's physics.

The upper rotor is the table's. The lower one gives alone what the table says, less what the upper one's wake
takes (`contracted_wake`): a share of the wake's work that goes with u_u u_l and u_u^2. What no data sheet
prints is drawn at random from stated priors, given that such blades make the table's thrust and torque; every
coefficient is the mean of the draws, its interval their 95 %. No coaxial measurement enters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink import files
from coaxlink.constants import RAD_S_PER_RPM
from coaxlink.data.single import DENSITY_KG_M3, SingleTable
from coaxlink.errors import InputError
from coaxlink.load import Load
from coaxlink.rotor.contracted_wake import Blades, Calibrated, calibrated, lower_shares, upper_loss
from coaxlink.rotor.fit import huber_weights
from coaxlink.rotor.model import LOADS, RotorModel
from coaxlink.rotor.polynomial import design_matrix
from coaxlink.rotor.stand_data import refuse_full_speed

Array = NDArray[np.float64]

DRAWS = 800  # of the prior: its spread is then known to 2.5 %
LIKELY = 0.02  # mean likelihood of the draws: less, and the table's figures are no propeller's
SEED = 1  # the same table gives the same prior
RATIOS = np.linspace(0.2, 1.6, 15)  # upper over lower speed: what vehicles fly, and a margin
WORKING = 0.7  # of the highest speed: where solidity and drag are identified from the table
TERMS = ("u_u u_l", "u_u^2")  # of what the wake takes

# name: mean, 1 sd, unit, source
PRIORS: Mapping[str, tuple[float, float, str, str]] = {
    "zero_lift_deg": (
        3.5,
        1.5,
        "deg",
        "flat-bottomed to thin cambered sections; 4.9 in Drela 2007's example",
    ),
    "lift_slope": (5.7, 0.4, "1/rad", "Leishman 2006, ch. 2; 5.8 in Drela 2007's example"),
    "tip_loss": (1.15, 0.05, "1", "Leishman 2006, section 2.15: induced power factor"),
    "drag_rise": (0.05, 0.02, "1", "cd2 0.05 in Drela 2007's example"),
    "solidity_a_blade": (0.045, 0.015, "1", "hovering propellers: 0.03 (thin) to 0.065 (slow-fly) a blade"),
    "pitch_ratio": (0.38, 0.08, "1", "makers' catalogues of multirotor propellers: 0.30 to 0.50"),
    "pitch_printed": (1.0, 0.08, "1", "printed against measured pitch, Brandt and Selig 2011"),
    "motor_efficiency": (0.80, 0.06, "1", "electrical to shaft power of motor and ESC at hover loads"),
    "figure_of_merit": (0.62, 0.07, "1", "small propellers in hover, Deters, Ananda and Selig 2014"),
}
REYNOLDS = 0.2  # sd of the share of a load that goes with u instead of u^2: CT rises with Reynolds' number
SPECIMEN = 0.02  # sd between two propellers of one mould
DISCREPANCY = 0.2  # no theory is exact: a fifth of what it says the wake does (design/evidence.md)
LENGTH = 0.7  # of speed ratio over which that fifth stays the same
UPPER_FEELS = 0.25  # sd of the share of the lower rotor's draught that the upper one feels


# metres, and shares of the diameter: the smallest that lifts a vehicle to the largest on a multirotor; a
# figure in inches or mm is outside
DIAMETERS, PITCH_RATIOS, SPACINGS = (0.03, 2.5), (0.15, 1.2), (0.02, 3.0)


@dataclass(frozen=True)
class Propeller:
    """What is printed on it, and where the other one is. Raises InputError for what are no metres."""

    diameter_m: float
    spacing_m: float
    pitch_m: float | None = None
    blades: int = 2

    def __post_init__(self) -> None:
        """Each length is one of a propeller's."""
        ratios = {"spacing_m": (self.spacing_m, SPACINGS), "pitch_m": (self.pitch_m, PITCH_RATIOS)}
        _within("diameter_m", self.diameter_m, *DIAMETERS)
        for name, (value, (low, high)) in ratios.items():
            if value is not None:
                _within(name, value, low * self.diameter_m, high * self.diameter_m)


def _within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        inches = f" ({value:g} in is {value * 0.0254:.3g} m)" if low <= value * 0.0254 <= high else ""
        raise InputError(f"`{name}`", "", f"{low:.3g} to {high:.3g} m are expected, found {value:g}{inches}")


@dataclass(frozen=True)
class PairPrior:
    """A rotor model before any measurement of the pair."""

    model: RotorModel
    names: tuple[tuple[str, str], ...]  # (K,) load and term of each coefficient
    mean: Array  # (K,)
    covariance: Array  # (K, K)
    intervals: Mapping[str, Mapping[str, tuple[float, float]]]  # 95 %
    guessed: tuple[str, ...]  # in words
    blades: Mapping[str, tuple[float, float]]  # what the table says of the blades: mean, 1 sd

    def spread(self, load: str, u_upper: Array, u_lower: Array) -> Array:
        """(rows,) 1 sd of a load at normalised speeds (rows,)."""
        X = self._design(load, u_upper, u_lower)
        return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", X, self.covariance, X)))

    def _design(self, load: str, u_upper: Array, u_lower: Array) -> Array:
        terms = [term for _, term in self.names]
        own = np.array([name == load for name, _ in self.names])
        return np.asarray(design_matrix(terms, u_upper, u_lower) * own)

    def as_json(self) -> dict[str, Any]:
        """Plain numbers for the JSON report: the contract's keys of `identify`, and what is behind them."""
        return {
            "form": self.model.form,
            "speed_max_rpm": self.model.speed_max_rpm,
            "terms": self.model.terms(),
            "channels": {},
            "intervals": {load: {t: list(b) for t, b in v.items()} for load, v in self.intervals.items()},
            "prior": dict(self.model.identified["prior"]),
            "notes": list(self.guessed),
        }


def pair_prior(
    table: SingleTable, propeller: Propeller, *, speed_max_rpm: float | None = None, seed: int = SEED
) -> PairPrior:
    """The prior of a pair of such rotors. Raises InputError where no propeller makes such a table."""
    top = float(table.rpm.max()) if speed_max_rpm is None else speed_max_rpm
    refuse_full_speed(top)
    rng = np.random.default_rng(seed)
    u = table.rpm / top
    thrust = _of_speed(u, table.thrust_N, rng) * _scale(rng, table.origin.thrust)
    torque, how = _torque(table, propeller, u, thrust, rng)
    blades = _drawn(propeller, rng)
    density = DENSITY_KG_M3 * rng.normal(1.0, 0.03, DRAWS)
    rotor, weight = _made(table, propeller, blades, density, top, thrust, torque)
    chosen = rng.choice(DRAWS, DRAWS, p=weight / weight.sum())
    rotor, thrust, torque = _picked(rotor, chosen), thrust[chosen], torque[chosen]
    names, values = _coefficients(rotor, propeller, thrust, torque, rng)
    mean, covariance = values.mean(0), np.cov(values.T)
    bounds = np.percentile(values, (2.5, 97.5), axis=0)
    terms: dict[str, dict[str, float]] = {load: {} for load in LOADS}
    intervals: dict[str, dict[str, tuple[float, float]]] = {load: {} for load in LOADS}
    for i, (load, term) in enumerate(names):
        terms[load][term] = float(mean[i])
        intervals[load][term] = (float(bounds[0, i]), float(bounds[1, i]))
    quantities = {
        "solidity": rotor.solidity,
        "least_drag": rotor.cd0,
        "zero_lift_deg": np.degrees(rotor.blades.zero_lift_rad),
        "pitch_ratio": rotor.blades.pitch_ratio,
    }
    about = {k: (float(v.mean()), float(v.std())) for k, v in quantities.items()}
    guessed = (*_guesses(table, propeller), *how)
    sources = {"upper": "estimated", "lower": "estimated"}
    model = RotorModel.from_terms("crm", top, terms, sources=sources)
    prior = PairPrior(model, names, mean, covariance, intervals, guessed, about)
    return replace(prior, model=replace(model, identified=_provenance(prior, table, propeller)))


def _scale(rng: np.random.Generator, sd: float) -> Array:
    """(S, 1) factors by which a table is off."""
    return np.exp(rng.normal(0.0, sd, (DRAWS, 1)))


def _of_speed(u: Array, load: Array, rng: np.random.Generator) -> Array:
    """(S, 2) draws of the coefficients of u^2 and u through a table's column.

    Least squares that outliers cannot bend, with a prior on the part that goes with u.
    """
    X = np.stack([u**2, u], axis=1)
    weights, scale = huber_weights(X, load)
    # cells are rounded and a sheet has few rows: no table is believed to better than half a per cent
    noise = max(scale, 0.005 * float(np.abs(load).max()))
    at_top = float(np.median(load[u > 0.5 * u.max()] / u[u > 0.5 * u.max()] ** 2))
    precision = X.T @ (X * weights[:, None]) / noise**2 + np.diag([0.0, 1 / (REYNOLDS * at_top) ** 2])
    covariance = np.linalg.inv(precision)
    mean = covariance @ X.T @ (weights * load) / noise**2
    return np.asarray(rng.multivariate_normal(mean, covariance, DRAWS))


def _normal(rng: np.random.Generator, name: str) -> Array:
    mean, sd, _, _ = PRIORS[name]
    return np.asarray(rng.normal(mean, sd, DRAWS))


def _torque(
    table: SingleTable, propeller: Propeller, u: Array, thrust: Array, rng: np.random.Generator
) -> tuple[Array, tuple[str, ...]]:
    """(S, 2) coefficients of the torque, and in words what had to be guessed for them."""
    if table.torque_Nm is not None:
        return _of_speed(u, table.torque_Nm, rng) * _scale(rng, table.origin.torque), ()
    if table.power_W is not None:
        omega = table.rpm * RAD_S_PER_RPM
        torque = _of_speed(u, table.power_W / omega, rng)
        words = "no torque in the table: electrical power times a motor's efficiency"
        return torque * _normal(rng, "motor_efficiency")[:, None], (_guess("motor_efficiency", words),)
    # P = T sqrt(T / 2 rho A) / FM: momentum theory's power over the figure of merit
    area = np.pi * propeller.diameter_m**2 / 4
    at = WORKING
    lift = thrust @ [at**2, at]
    power = (
        lift * np.sqrt(np.maximum(lift, 0.0) / (2 * DENSITY_KG_M3 * area)) / _normal(rng, "figure_of_merit")
    )
    share = power / (at * _top_omega(table, u)) / lift
    words = "neither torque nor power in the table: the torque of a figure of merit"
    return thrust * share[:, None], (_guess("figure_of_merit", words),)


def _top_omega(table: SingleTable, u: Array) -> float:
    return float(np.median(table.rpm / u)) * RAD_S_PER_RPM


def _drawn(propeller: Propeller, rng: np.random.Generator) -> Blades:
    if propeller.pitch_m is None:
        pitch = _normal(rng, "pitch_ratio")
    else:
        pitch = propeller.pitch_m / propeller.diameter_m * _normal(rng, "pitch_printed")
    return Blades(
        np.maximum(pitch, 0.05),
        np.radians(_normal(rng, "zero_lift_deg")),
        _normal(rng, "lift_slope"),
        np.maximum(_normal(rng, "tip_loss"), 1.0),
        np.maximum(_normal(rng, "drag_rise"), 0.0),
        rng.uniform(0.0, 1.0, DRAWS),
    )


def _made(
    table: SingleTable,
    propeller: Propeller,
    blades: Blades,
    density: Array,
    top: float,
    thrust: Array,
    torque: Array,
) -> tuple[Calibrated, Array]:
    """The blades that make the table, and how likely each draw is (S,). Raises InputError."""
    at = np.array([WORKING**2, WORKING])
    radius = propeller.diameter_m / 2
    tip = WORKING * top * RAD_S_PER_RPM * radius
    unit = density * np.pi * radius**2 * tip**2
    ct, cq = thrust @ at / unit, torque @ at / (unit * radius)
    # over the disc's area pi R^2 the annuli's sums are T / (rho pi R^2 tip^2): the same unit
    rotor = calibrated(blades, ct, cq)
    mean, sd, _, _ = PRIORS["solidity_a_blade"]
    count = propeller.blades
    weight = np.exp(-0.5 * ((rotor.solidity - count * mean) / (count * sd)) ** 2) * (rotor.cd0 > 0)
    if weight.mean() < LIKELY:
        merit = float(np.median(ct)) ** 1.5 / np.sqrt(2) / float(np.median(cq))
        raise InputError(
            table.source,
            "",
            f"no propeller of {propeller.diameter_m:g} m with {count} blades makes this thrust and torque "
            f"(thrust coefficient {float(np.median(ct)):.3g}, 0.004 to 0.02 is usual; figure of merit "
            f"{merit:.2f}, 0.5 to 0.75 is): check `diameter_m`, `pitch_m`, `blades` and the units",
        )
    return rotor, weight


def _picked(rotor: Calibrated, index: NDArray[np.int64]) -> Calibrated:
    b = rotor.blades
    picked = Blades(*(getattr(b, name)[index] for name in Blades.__dataclass_fields__))
    return Calibrated(picked, rotor.solidity[index], rotor.cd0[index])


def _coefficients(
    rotor: Calibrated, propeller: Propeller, thrust: Array, torque: Array, rng: np.random.Generator
) -> tuple[tuple[tuple[str, str], ...], Array]:
    """Names (K,) and draws (S, K) of all the model's coefficients."""
    at = np.array([WORKING**2, WORKING]) / WORKING**2
    spacing = propeller.spacing_m / propeller.diameter_m
    share_thrust, share_torque = lower_shares(rotor, spacing, RATIOS)
    lost, spent = 1 - share_thrust, 1 - share_torque  # (S, X)
    # the torque's loss is the difference of two effects, each of the size of the thrust's: a fifth of that
    lost = lost + DISCREPANCY * lost * _smooth(rng)
    spent = spent + DISCREPANCY * (1 - share_thrust) * _smooth(rng)
    X = np.stack([RATIOS, RATIOS**2], axis=1)
    wake_thrust = -(lost @ np.linalg.pinv(X).T) * (thrust @ at)[:, None]
    wake_torque = -(spent @ np.linalg.pinv(X).T) * (torque @ at)[:, None]
    felt = 1 - (rng.normal(0.0, UPPER_FEELS, DRAWS) * upper_loss(rotor, spacing))[:, None]
    specimen = _scale(rng, SPECIMEN), _scale(rng, SPECIMEN)
    columns = {
        Load.UPPER_THRUST.key: (("u_u^2", "u_u"), thrust * felt),
        Load.UPPER_TORQUE.key: (("u_u^2", "u_u"), torque * (1 + felt) / 2),
        Load.LOWER_THRUST.key: (("u_l^2", "u_l", *TERMS), np.hstack([thrust * specimen[0], wake_thrust])),
        Load.LOWER_TORQUE.key: (("u_l^2", "u_l", *TERMS), np.hstack([torque * specimen[1], wake_torque])),
    }
    names = tuple((load, term) for load, (terms, _) in columns.items() for term in terms)
    return names, np.hstack([values for _, values in columns.values()])


def _smooth(rng: np.random.Generator) -> Array:
    """(S, X) smooth random functions of the speed ratio, of unit sd."""
    apart = (RATIOS[:, None] - RATIOS) / LENGTH
    factor = np.linalg.cholesky(np.exp(-0.5 * apart**2) + 1e-8 * np.eye(len(RATIOS)))
    return np.asarray(rng.standard_normal((DRAWS, len(RATIOS))) @ factor.T)


def _guess(name: str, words: str) -> str:
    mean, sd, unit, source = PRIORS[name]
    unit = "" if unit == "1" else f" {unit}"
    return f"guessed: {words}, {mean:g} +/- {sd:g}{unit} ({source})"


def _guesses(table: SingleTable, propeller: Propeller) -> tuple[str, ...]:
    origin = table.origin
    guesses = [
        f"guessed: the table's level, {origin.words}: +/- {100 * origin.thrust:.0f} % of thrust, "
        f"{100 * origin.torque:.0f} % of torque (1 sd)",
        f"guessed: air of {DENSITY_KG_M3} kg/m3 +/- 3 %: the table does not say",
        _guess("zero_lift_deg", "the blades' zero-lift line above the printed pitch"),
        _guess(
            "solidity_a_blade",
            f"the chord, as solidity a blade ({propeller.blades} blades; `blades` says it)",
        ),
        "guessed: what the theory gets wrong, a fifth of what the wake does; two propellers of one kind "
        f"differ by {100 * SPECIMEN:.0f} %",
    ]
    if propeller.pitch_m is None:
        guesses.insert(2, _guess("pitch_ratio", "the pitch over the diameter (`pitch_m` says it)"))
    return tuple(guesses)


def _provenance(prior: PairPrior, table: SingleTable, propeller: Propeller) -> dict[str, Any]:
    path = Path(table.source)
    pitch = {"pitch_m": propeller.pitch_m} if propeller.pitch_m is not None else {}
    return {
        "file": path.name,
        "sha256": files.sha256(path) if path.is_file() else "",
        "rows": len(table.rpm),
        "law": "prior: table of one rotor, lower rotor by blade elements in the contracted wake; "
        "no coaxial measurement",
        "errors": {},
        "intervals": {load: {t: list(b) for t, b in v.items()} for load, v in prior.intervals.items()},
        "prior": {
            "table": table.origin.name,
            "diameter_m": propeller.diameter_m,
            "spacing_m": propeller.spacing_m,
            **pitch,
            "blades": propeller.blades,
            "said_by_the_table": {k: [float(m), float(s)] for k, (m, s) in prior.blades.items()},
            "guessed": list(prior.guessed),
            "coefficients": [f"{load} {term}" for load, term in prior.names],
            "mean": [float(v) for v in prior.mean],
            "covariance": [[float(v) for v in row] for row in prior.covariance],
        },
    }
