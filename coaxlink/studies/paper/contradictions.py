"""Where the paper disagrees with itself, each recomputed from its own numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.load import Load
from coaxlink.mixer import allocate, make_law, reduced_coefficients
from coaxlink.rotor import RotorModel
from coaxlink.rotor.lasso import tolerance_form
from coaxlink.rotor.polynomial import design_matrix, dictionary
from coaxlink.studies.paper.equations import hover_error
from coaxlink.studies.paper.laws import printed_laws
from coaxlink.studies.paper.ledger import CONTRADICTED, GRAVITY, IN_PART, NOT_CHECKED, Claim, Line, printed
from coaxlink.vehicle import Vehicle

GRID = tuple(g.ravel() for g in np.meshgrid(np.linspace(0, 0.9, 11), np.linspace(0, 0.9, 11), indexing="ij"))
BENCH_NOISE_N = 0.5  # of the noise that the standard errors are given for
TRUE_TERMS = ("u_u^2 u_l^2", "u_l^2", "u_u u_l", "u_l", "u_u^2", "1")


def contradictions(
    airframe: Airframe, crm: RotorModel, rcrm: RotorModel, srm: RotorModel, close_pair: Path | None
) -> list[Claim]:
    """All eleven. `close_pair` is a real stand log of a pair at small spacing, for the last."""
    made: Sequence[Callable[[], Claim]] = (
        lambda: _hover(airframe, crm, rcrm, srm),
        lambda: _no_yaw(airframe, crm),
        lambda: _relaxation(crm),
        _yaw_row,
        _arm,
        _normalisers,
        _swapped_text,
        lambda: _squares(airframe, rcrm),
        lambda: _least_squares(airframe, crm),
        _small_terms,
        lambda: _upper_feels_lower(close_pair),
    )
    return [make() for make in made]


def _hover(airframe: Airframe, crm: RotorModel, rcrm: RotorModel, srm: RotorModel) -> Claim:
    t4 = printed()["table_4"]
    reduced, fast = hover_error("reduced", airframe, rcrm, crm)
    standard, even = hover_error("standard", airframe, srm, crm)
    return Claim(
        "contradiction-1",
        "The printed R-CRM and the printed CRM are not the same rotor",
        CONTRADICTED,
        "Table 4 puts the reduced mixer ahead of the standard one; on the eq. 17 rotors, in hover, the printed "
        "eq. 15 is far worse than the printed eq. 18",
        (
            Line("thrust error of the reduced mixer", t4["reduced"]["thrust_N"], reduced, "N"),
            Line("thrust error of the standard mixer", t4["standard"]["thrust_N"], standard, "N"),
            Line("its speeds: reduced, upper", None, float(fast[0]), ""),
            Line("its speeds: reduced, lower", None, float(fast[4]), ""),
            Line("its speeds: standard", None, float(even[0]), ""),
        ),
    )


def _no_yaw(airframe: Airframe, crm: RotorModel) -> Claim:
    vehicle = Vehicle(airframe, crm)
    law = printed_laws(vehicle)["coaxial-printed"]
    demands = np.linspace(-1.0, 1.0, 9)
    errors = [abs(allocate(law, vehicle, [196.2, 0.0, 0.0, yaw]).error[3] + yaw) for yaw in demands]
    mean = float(np.mean([abs(allocate(law, vehicle, [196.2, 0.0, 0.0, y]).error[3]) for y in demands]))
    return Claim(
        "contradiction-2",
        "Algorithm 1 is not a full mixer: it never uses the torques it allocates",
        CONTRADICTED,
        "the yaw error equals the whole yaw demand, whatever the demand",
        (
            Line("largest departure of the yaw error from the demand", None, float(max(errors)), "N m"),
            Line("mean yaw error over demands of +-1 N m (Table 4: in its flight)",
                 printed()["table_4"]["coaxial"]["torque_Nm"][2], mean, "N m"),
        ),
    )  # fmt: skip


def _relaxation(crm: RotorModel) -> Claim:
    terms = dictionary(2, 2)
    u, v = GRID
    b = tolerance_form(design_matrix(terms, u, v), crm.lower_thrust(u, v), 10.0)
    nonzero = {t: float(c) for t, c in zip(terms, b, strict=True) if abs(c) > 1e-3}
    linear = sum(1 for t in nonzero if "^" not in t)
    return Claim(
        "contradiction-3",
        "Relaxing the LASSO tolerance to 10 N does not leave a quadratic model",
        CONTRADICTED,
        f"on the nine raw terms of the eq. 17 lower thrust the l1 norm keeps {', '.join(nonzero)}: it prefers linear "
        "terms, which are larger on speeds below 1, and it shrinks what it keeps",
        (
            *(Line(f"kept: {t}", None, c, "N") for t, c in nonzero.items()),
            Line("linear terms kept", 0.0, float(linear), ""),
        ),
    )


def _yaw_row() -> Claim:
    eq = printed()["eq_18"]
    return Claim(
        "contradiction-4",
        "The yaw row of eq. 18 is a ratio, not a torque",
        CONTRADICTED,
        "0.026 is 1.9 / 73.06; the row should read 1.9",
        (Line("torque over thrust", eq["yaw_row"], eq["torque_Nm"] / eq["thrust_N"], "m"),),
    )


def _arm() -> Claim:
    e15, e18 = printed()["eq_15"], printed()["eq_18"]
    return Claim(
        "contradiction-5",
        "The arm printed is not the arm in the matrices",
        CONTRADICTED,
        "both matrices hold the same arm, a little longer than the text's",
        (
            Line("arm from eq. 15, times sqrt 2", printed()["geometry"]["arm_m"],
                 math.sqrt(2) * e15["upper_roll_Nm"] / e15["upper_thrust_N"], "m"),
            Line("arm from eq. 18, times sqrt 2", printed()["geometry"]["arm_m"],
                 math.sqrt(2) * e18["roll_Nm"] / e18["thrust_N"], "m"),
        ),
    )  # fmt: skip


def _normalisers() -> Claim:
    rows = printed()["table_2"]["coaxial_thrust"]
    return Claim(
        "contradiction-6",
        "Table 2 normalises its errors in two ways",
        CONTRADICTED,
        "RMSE over NRMSE must be one number for one data set; it is one for CRM and R-CRM and another for SRM "
        "and CPCM",
        tuple(Line(f"{form}: RMSE / NRMSE", None, row[0] / row[1], "N") for form, row in rows.items()),
    )


def _swapped_text() -> Claim:
    t5, text = printed()["table_5"], printed()["section_5_4"]
    return Claim(
        "contradiction-7",
        "Section 5.4 and Table 5 swap the two mixers",
        CONTRADICTED,
        "the text gives the standard mixer the error that the table gives the coaxial one, and the other way round",
        (
            Line("standard: text beside table", text["standard_thrust_N"], t5["standard"]["thrust_N"], "N"),
            Line("coaxial: text beside table", text["coaxial_thrust_N"], t5["coaxial"]["thrust_N"], "N"),
        ),
    )


def _squares(airframe: Airframe, rcrm: RotorModel) -> Claim:
    weight = printed()["geometry"]["mass_kg"] * GRAVITY
    vehicle = Vehicle(airframe, rcrm)
    right = allocate(make_law("reduced", vehicle), vehicle, [weight, 0, 0, 0])
    thrust, _ = airframe.loads(rcrm, right.speeds**2)
    return Claim(
        "contradiction-8",
        "u = A+ mu gives squared speeds",
        CONTRADICTED,
        "eq. 7's matrix is of u^2: taken as speeds, A+ mu does not carry the weight on the model it comes from",
        (
            Line("thrust with u = sqrt(A+ mu)", weight, float(right.delivered[0]), "N"),
            Line("thrust with u = A+ mu", weight, float(thrust.sum()), "N"),
        ),
    )


def _least_squares(airframe: Airframe, crm: RotorModel) -> Claim:
    c, found = printed()["rcrm"], reduced_coefficients(crm)
    error, _ = hover_error("reduced", airframe, crm, crm)
    return Claim(
        "contradiction-9",
        "The printed R-CRM is not the least-squares reduction of the printed CRM",
        CONTRADICTED,
        "and no pure-square model can follow the linear terms of eq. 17: even the least-squares one misses the "
        "weight in hover",
        (
            *(Line(name, c[name], getattr(found, name), "N" if name[0] == "p" else "N m") for name in c),
            Line("its hover error on eq. 17", None, error, "N"),
        ),
    )


def _small_terms() -> Claim:
    u, v = GRID
    full, true = dictionary(2, 2), TRUE_TERMS
    nine, six = (
        dict(zip(terms, BENCH_NOISE_N * np.sqrt(np.diag(np.linalg.inv(X.T @ X))), strict=True))
        for terms in (full, true)
        for X in (design_matrix(terms, u, v),)
    )
    small = ("u_u^2 u_l^2", "u_u u_l", "1")
    table = printed()["table_1"][Load.LOWER_THRUST.key]
    return Claim(
        "contradiction-10",
        "121 points cannot determine Table 1's small terms",
        CONTRADICTED,
        f"standard errors at {BENCH_NOISE_N} N of noise beside the printed values: with all nine terms the first "
        "two are a few times their own size; even with the true six they stay at two or three standard errors",
        (
            *(
                Line(f"{t}: value, and standard error with nine terms", table[t], float(nine[t]), "N")
                for t in small
            ),
            *(
                Line(f"{t}: value, and standard error with the true six", table[t], float(six[t]), "N")
                for t in small
            ),
        ),
    )


def _upper_feels_lower(log: Path | None) -> Claim:
    title = "Whether the upper rotor feels the lower one: eq. 1 and 2 say it does not"
    if log is None or not log.is_file():
        return Claim(
            "contradiction-11",
            title,
            NOT_CHECKED,
            "the paper's model has no such term and its data are not public; give a real stand log of a close "
            "pair with `pair`",
        )
    from coaxlink.data import read_stand_log

    samples = read_stand_log(log)
    upper, lower = samples["upper_rpm"] / 1e3, samples["lower_rpm"] / 1e3
    X = np.stack([upper**2, upper * lower, lower**2, upper, np.ones_like(upper)], axis=1)
    with_lower, *_ = np.linalg.lstsq(X, samples[Load.UPPER_THRUST.column], rcond=None)
    at = float(np.quantile(upper, 0.7))
    loss = float(with_lower[1] * at * at + with_lower[2] * at * at)
    alone = float(with_lower[0] * at * at + with_lower[3] * at + with_lower[4])
    return Claim(
        "contradiction-11",
        title,
        IN_PART,
        f"measured on one real pair, {log.name}: the upper thrust at {1e3 * at:.0f} rpm changes by {100 * loss / alone:.1f} % when the lower "
        "rotor turns as fast (least squares on both speeds)",
        (
            Line("upper thrust, lower rotor at rest", None, alone, "N"),
            Line("change with the lower rotor as fast", 0.0, loss, "N"),
        ),
    )
