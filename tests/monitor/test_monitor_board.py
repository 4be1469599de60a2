"""The table on board, from parameters as an upload leaves them; numbers from the paper's eq. 15 and 18."""

from __future__ import annotations

import pytest

from coaxlink import files
from coaxlink.airframe import Airframe, load_airframe
from coaxlink.monitor.board.description import describe, intended
from coaxlink.rotor import RotorModel, load_rotor_model
from coaxlink.vehicle import Vehicle


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    return load_airframe(files.example("x8_paper.toml"))


@pytest.fixture(scope="module")
def model() -> RotorModel:
    return load_rotor_model(files.example("rotor_paper.toml"))


def table(
    upper: float, lower: float, fac: float = 1.0, km: float = 0.03, arm: float = 0.1807
) -> dict[str, float]:
    places = [(1, 1), (1, -1), (-1, -1), (-1, 1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    values: dict[str, float] = {"CA_AIRFRAME": 0, "CA_METHOD": 2, "CA_ROTOR_COUNT": 8, "THR_MDL_FAC": fac}
    for n, (x, y) in enumerate(places):
        spin = 1 if n % 2 == 0 else -1  # the paper's odd numbers turn ccw
        row = {"PX": x * arm, "PY": y * arm, "PZ": 0, "AX": 0, "AY": 0, "AZ": -1}
        row |= {"CT": upper if n < 4 else lower, "KM": km * spin}
        values |= {f"CA_ROTOR{n}_{field}": value for field, value in row.items()}
    return values


def test_standard_reduced_and_fitted_are_told_apart(airframe: Airframe, model: RotorModel) -> None:
    assert describe(table(73.06, 73.06), Vehicle(airframe, model)).kind == "standard"
    assert describe(table(46.95, 69.89), Vehicle(airframe, model)).kind == "reduced"
    assert describe(table(43.0, 78.18, fac=0.725), Vehicle(airframe, model)).kind == "fitted"
    odd = table(46.95, 69.89)
    odd["CA_ROTOR2_CT"] = 60.0
    assert describe(odd, Vehicle(airframe, model)).kind == "custom"


def test_says_whether_the_table_is_this_models(airframe: Airframe, model: RotorModel) -> None:
    # least squares on the eq. 17 surface over 0..0.9 gives 85.7 - 34.6 and 80.4, not the printed eq. 15
    assert describe(table(85.7 - 34.6, 80.4), Vehicle(airframe, model)).of_model
    assert not describe(table(46.95, 69.89), Vehicle(airframe, model)).of_model


def test_the_hash_follows_the_values_only(airframe: Airframe, model: RotorModel) -> None:
    one = describe(table(46.95, 69.89), Vehicle(airframe, model))
    again = describe(dict(reversed(table(46.95, 69.89).items())), Vehicle(airframe, model))
    other = describe(table(46.95, 69.9), Vehicle(airframe, model))
    assert one.digest == again.digest != other.digest
    assert len(one.digest) == 8 and one.rotors == 8
    assert (one.upper_ct, one.lower_ct, one.thr_mdl_fac) == pytest.approx((46.95, 69.89, 1.0))


def test_half_read_wrong_and_foreign_tables(airframe: Airframe, model: RotorModel) -> None:
    assert describe({}, Vehicle(airframe, model)).state == "unread"
    half = table(46.95, 69.89)
    del half["CA_ROTOR7_KM"]
    assert describe(half, Vehicle(airframe, model)).state == "partial"
    assert describe({"CA_ROTOR_COUNT": 0.0}, Vehicle(airframe, model)).state == "invalid"
    plane = table(46.95, 69.89) | {"CA_AIRFRAME": 1}
    assert describe(plane, Vehicle(airframe, model)).state == "invalid"
    quad = {n: v for n, v in table(70, 70).items() if not n.startswith(("CA_ROTOR4", "CA_ROTOR5"))}
    quad["CA_ROTOR_COUNT"] = 4
    assert any("4 rotors" in note for note in describe(quad, Vehicle(airframe, model)).notes)


def test_geometry_and_spin_that_differ_are_noted(airframe: Airframe, model: RotorModel) -> None:
    turned = table(46.95, 69.89)
    turned["CA_ROTOR1_KM"] *= -1
    assert any("rotor 2 turns the other way" in n for n in describe(turned, Vehicle(airframe, model)).notes)
    wide = describe(table(46.95, 69.89, arm=0.4), Vehicle(airframe, model))
    assert any("elsewhere" in n for n in wide.notes)


def test_traps_of_the_firmware_are_passed_on(airframe: Airframe, model: RotorModel) -> None:
    weak = table(46.95 * 0.02, 69.89 * 0.02, km=0.02)  # every yaw entry below 0.05
    assert any("yaw" in note for note in describe(weak, Vehicle(airframe, model)).notes)


def test_intended_wrench_is_the_tables_own_arithmetic() -> None:
    parameters = table(40.0, 60.0, fac=0.5)
    wrench = intended(parameters, [0.4] * 4 + [0.6] * 4)
    expected = 4 * 40.0 * (0.5 * 0.16 + 0.5 * 0.4) + 4 * 60.0 * (0.5 * 0.36 + 0.5 * 0.6)
    assert wrench == pytest.approx((expected, 0, 0, 0), abs=1e-4)
    assert intended(parameters, [0.4] * 7) is None
    assert intended({}, [0.4] * 8) is None
    assert intended(parameters, [0.4] * 7 + [None]) is None


@pytest.mark.parametrize("value", [1e38, -1e38, 3e-38, float("nan"), float("inf")])
@pytest.mark.parametrize(
    "name", ["CA_ROTOR0_CT", "CA_ROTOR0_PX", "CA_ROTOR0_AZ", "CA_ROTOR0_KM", "THR_MDL_FAC"]
)
def test_numbers_that_no_table_should_hold(
    airframe: Airframe, model: RotorModel, name: str, value: float
) -> None:
    parameters = table(46.95, 69.89) | {name: value}
    assert describe(parameters, Vehicle(airframe, model)).state in ("read", "invalid")
    wrench = intended(parameters, [0.5] * 8)
    assert wrench is None or all(abs(w) < float("inf") for w in wrench)
