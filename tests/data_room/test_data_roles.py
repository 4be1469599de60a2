"""Who works in whose wake, and in which units: told by the loads, or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coaxlink.data import RotorsUnclear, read_stand_log
from coaxlink.errors import InputError

TOP_RPM = 6000.0
SPACED, EQUAL = "spaced", "equal"


def law(u: np.ndarray, v: np.ndarray, seed: int = 0) -> dict[str, np.ndarray]:
    """A pair of 15 in propellers, the second in the wake of the first: textbook coefficients, 1 % noise."""
    rho, d, n = 1.225, 0.381, TOP_RPM / 60
    thrust, torque = 0.1 * rho * n**2 * d**4, 0.04 / (2 * np.pi) * rho * n**2 * d**5
    random = np.random.default_rng(seed)

    def noisy(x: np.ndarray) -> np.ndarray:
        return x + 0.01 * np.abs(x).max() * random.standard_normal(len(x))

    return {
        "upper_rpm": TOP_RPM * u,
        "lower_rpm": TOP_RPM * v,
        "upper_thrust": noisy(thrust * u**2),
        "lower_thrust": noisy(thrust * (v**2 - 0.38 * u * v)),
        "upper_torque": noisy(torque * u**2),
        "lower_torque": noisy(torque * (v**2 - 0.12 * u * v)),
    }


def grid(kind: str) -> tuple[np.ndarray, np.ndarray]:
    if kind == EQUAL:
        return np.linspace(0.3, 1, 25), np.linspace(0.3, 1, 25)
    u, v = np.meshgrid(np.linspace(0.3, 1, 7), np.linspace(0.3, 1, 7))
    return u.ravel(), v.ravel()


def write(path: Path, columns: dict[str, np.ndarray]) -> Path:
    rows = zip(*columns.values(), strict=True)
    path.write_text(
        ",".join(columns) + "\n" + "\n".join(",".join(f"{x:.6g}" for x in row) for row in rows) + "\n"
    )
    return path


def lettered(kind: str, upper: str, lower: str, torque: bool = True) -> dict[str, np.ndarray]:
    loads = law(*grid(kind))
    out = {}
    for side, label in sorted((("upper", upper), ("lower", lower)), key=lambda pair: pair[1]):
        out[f"Speed {label} (rpm)"] = loads[f"{side}_rpm"]
        out[f"Thrust {label} (N)"] = loads[f"{side}_thrust"]
        if torque:
            out[f"Torque {label} (N.m)"] = loads[f"{side}_torque"]
    return out


@pytest.mark.parametrize("kind", [SPACED, EQUAL])
@pytest.mark.parametrize("upper, lower", [("A", "B"), ("B", "A"), ("1", "2"), ("right", "left")])
def test_letters_are_told_by_the_data(tmp_path: Path, kind: str, upper: str, lower: str) -> None:
    log = read_stand_log(write(tmp_path / "log.csv", lettered(kind, upper, lower)))
    assert log.upper_label == upper
    np.testing.assert_allclose(log["upper_thrust_N"], law(*grid(kind))["upper_thrust"], rtol=1e-4)
    said = " ".join(log.notes)
    assert "by the data" in said and "% of the thrust of" in said


def test_equal_speeds_without_torque_tell_nothing(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", lettered(EQUAL, "A", "B", torque=False))
    with pytest.raises(RotorsUnclear, match="`upper` A or `upper` B") as caught:
        read_stand_log(path)
    assert caught.value.labels == ("A", "B")
    assert read_stand_log(path, upper="a").has("lower_thrust_N")


def test_a_weaker_upper_propeller_is_not_taken_for_the_lower_one(tmp_path: Path) -> None:
    columns = lettered(EQUAL, "A", "B")
    small = 0.9  # of the diameter: thrust with its fourth power, torque with its fifth
    columns["Thrust A (N)"] = columns["Thrust A (N)"] * small**4
    columns["Torque A (N.m)"] = columns["Torque A (N.m)"] * small**5
    try:
        log = read_stand_log(write(tmp_path / "log.csv", columns))
    except RotorsUnclear:
        return
    assert log.upper_label == "A"


def test_rotors_without_influence_are_not_guessed(tmp_path: Path) -> None:
    columns = lettered(SPACED, "A", "B")
    u, v = grid(SPACED)
    columns["Thrust B (N)"], columns["Torque B (N.m)"] = 25.0 * v**2, 0.4 * v**2
    columns["Thrust A (N)"], columns["Torque A (N.m)"] = 25.0 * u**2, 0.4 * u**2
    with pytest.raises(RotorsUnclear):
        read_stand_log(write(tmp_path / "log.csv", columns))


@pytest.mark.parametrize(
    "column, factor, unit",
    [
        ("Thrust A (N)", 1 / 9.80665, "kgf"),
        ("Thrust A (N)", 1000 / 9.80665, "gf"),
        ("Torque A (N.m)", 100.0, "N cm"),
        ("Torque A (N.m)", 100 / 9.80665, "kgf cm"),
        ("Speed A (rpm)", np.pi / 30, "rad/s"),
        ("Speed A (rpm)", 1 / 60, "rev/s"),
    ],
)
@pytest.mark.parametrize("both", [True, False])
def test_a_unit_that_no_propeller_has_is_refused(
    tmp_path: Path, column: str, factor: float, unit: str, both: bool
) -> None:
    columns = lettered(SPACED, "A", "B")
    columns[column] = columns[column] * factor
    if both:
        other = column.replace(" A", " B")
        columns[other] = columns[other] * factor
    with pytest.raises(InputError) as caught:
        read_stand_log(write(tmp_path / "log.csv", columns), upper="A", trust_units=False, diameter_m=0.381)
    assert (
        "no propeller" in str(caught.value) and unit in str(caught.value) and "`columns`" in str(caught.value)
    )


@pytest.mark.parametrize("unit, factor", [("gf", 1000 / 9.80665), ("N", 1.0)])
def test_a_unit_that_is_not_written_is_told_where_only_one_fits(
    tmp_path: Path, unit: str, factor: float
) -> None:
    columns = {
        name.replace(" (N)", ""): value * (factor if "Thrust" in name else 1)
        for name, value in lettered(SPACED, "A", "B").items()
    }
    log = read_stand_log(write(tmp_path / "log.csv", columns), diameter_m=0.381)
    np.testing.assert_allclose(log["upper_thrust_N"], law(*grid(SPACED))["upper_thrust"], rtol=1e-3)
    assert f"taken in {unit}" in " ".join(log.notes)


def test_a_unit_that_may_be_several_is_refused_with_the_line_to_write(tmp_path: Path) -> None:
    columns = {
        name.replace(" (N)", ""): value / (9.80665 if "Thrust" in name else 1)
        for name, value in lettered(SPACED, "A", "B").items()
    }
    with pytest.raises(InputError) as caught:
        read_stand_log(write(tmp_path / "log.csv", columns))
    assert "Thrust A" in str(caught.value) and "kgf" in str(caught.value) and "unit =" in str(caught.value)


def test_electrical_turns_want_poles(tmp_path: Path) -> None:
    columns = {
        name.replace("rpm", "eRPM"): value * (7 if "Speed" in name else 1)
        for name, value in lettered(SPACED, "A", "B").items()
    }
    path = write(tmp_path / "log.csv", columns)
    with pytest.raises(InputError, match="`poles`"):
        read_stand_log(path)
    np.testing.assert_allclose(read_stand_log(path, poles=14)["upper_rpm"].max(), TOP_RPM, rtol=1e-4)


def test_two_rotors_of_one_quantity_never_become_one(tmp_path: Path) -> None:
    columns = lettered(SPACED, "A", "B")
    twins = {
        "Speed (rpm)": columns["Speed A (rpm)"],
        "Thrust motor (N)": columns["Thrust A (N)"],
        "Thrust engine (N)": columns["Thrust B (N)"],
        "Torque (N.m)": columns["Torque A (N.m)"],
    }
    with pytest.raises(InputError, match="both read thrust and differ: two rotors"):
        read_stand_log(write(tmp_path / "log.csv", twins))
    three = columns | {"Thrust C (N)": columns["Thrust A (N)"], "Speed C (rpm)": columns["Speed A (rpm)"]}
    with pytest.raises(InputError, match=r"3 rotors \(a, b, c\)"):
        read_stand_log(write(tmp_path / "log.csv", three))


def test_a_map_states_units_and_leaves_the_rest(tmp_path: Path) -> None:
    columns = lettered(SPACED, "A", "B")
    columns["Thrust A (kgf)"] = columns.pop("Thrust A (N)") / 9.80665
    columns["Thrust B (N)"] = columns["Thrust B (N)"] / 4.4482216
    mapping = tmp_path / "map.toml"
    mapping.write_text(
        'upper_rpm = "Speed A (rpm)"\nlower_rpm = "Speed B (rpm)"\nupper_thrust_N = "Thrust A (kgf)"\n'
        'lower_thrust_N = { column = "Thrust B (N)", unit = "lbf" }\nupper_torque_Nm = "Torque A (N.m)"\n'
    )
    log = read_stand_log(write(tmp_path / "log.csv", columns), mapping)
    true = law(*grid(SPACED))
    np.testing.assert_allclose(log["upper_thrust_N"], true["upper_thrust"], rtol=1e-4)
    np.testing.assert_allclose(log["lower_thrust_N"], true["lower_thrust"], rtol=1e-4)
    assert not log.has("lower_torque_Nm") and "left out (not in the map): Torque B (N.m)" in log.notes
    mapping.write_text('uper_rpm = "Speed A (rpm)"\n')
    with pytest.raises(InputError, match=r"uper_rpm: unknown; upper_rpm\?"):
        read_stand_log(tmp_path / "log.csv", mapping)
    mapping.write_text('upper_rpm = { column = "Speed A (rpm)", unit = "knots" }\n')
    with pytest.raises(InputError, match=r"upper_rpm: unit: rpm, rad/s.* expected, found 'knots'"):
        read_stand_log(tmp_path / "log.csv", mapping)


def test_power_stands_in_for_a_speed_that_was_not_measured(tmp_path: Path) -> None:
    """Torque and electrical power bound the speed: grams under N show without a tachometer."""
    u, v = grid(SPACED)
    loads = law(u, v)
    columns = {}
    for side, share in (("upper", u), ("lower", v)):
        shaft = np.abs(loads[f"{side}_torque"]) * TOP_RPM * share * np.pi / 30
        columns |= {
            f"{side}_throttle": share,
            f"{side}_thrust_N": loads[f"{side}_thrust"],
            f"{side}_torque_Nm": loads[f"{side}_torque"],
            f"{side}_current_A": shaft / 0.75 / 24.0,
            f"{side}_voltage_V": 24.0 + 0 * u,
        }
    path = tmp_path / "log.csv"
    assert read_stand_log(write(path, columns), trust_units=False).rows == 49
    for side in ("upper", "lower"):
        columns[f"{side}_thrust_N"] = columns[f"{side}_thrust_N"] * 1000 / 9.80665
    with pytest.raises(InputError, match="no propeller"):
        read_stand_log(write(path, columns), trust_units=False)
