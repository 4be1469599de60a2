"""Stand logs as their makers write them: small files written by hand, and the real ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coaxlink.data import RotorsUnclear, Samples, read_stand_log
from coaxlink.errors import InputError

SHARED = Path(__file__).parents[2] / ".." / "shared" / "data"
needs_shared = pytest.mark.skipif(
    not SHARED.is_dir(), reason="the shared real data is not beside this checkout"
)

OWN = "upper_rpm,lower_rpm,upper_thrust_N,upper_torque_Nm,lower_thrust_N,lower_torque_Nm\n"
PLATFORM = (
    "PWM Left,PWM Right,Thrust Left [g],Torque Left [Nm],Thrust Right [g],"
    "Speed Left [rpm],Speed Right [rpm],Total Thrust [g],Time [s]\n"
)


def write(folder: Path, text: str, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode())
    return path


def test_our_own_columns_are_taken_as_they_are(tmp_path: Path) -> None:
    log = read_stand_log(write(tmp_path, OWN + "0,0,0.1,0.0,-0.1,0\n3000,2500,20.5,0.4,10.25,0.3\n"))
    assert log.rows == 2
    assert log["upper_thrust_N"].tolist() == [0.1, 20.5]
    assert log["lower_rpm"].tolist() == [0.0, 2500.0]
    assert log.place(1) == "line 3"


def test_context_columns_are_kept_under_their_names(tmp_path: Path) -> None:
    log = read_stand_log(write(tmp_path, "upper_rpm,upper_thrust_N,humidity\n100,1,40\n200,4,41\n"))
    assert log["humidity"].tolist() == [40.0, 41.0]


def test_platform_headings_grams_pwm_and_signs(tmp_path: Path) -> None:
    rows = "1000,1000,5,0.1,5,0,0,10,1\r\n1500,1250,1000,-0.2,500,4000,3000,1500,2\r\n"
    rows += "1600,1250,1200,-0.3,-50,4400,3000,1150,3\r\n"
    log = read_stand_log(write(tmp_path, PLATFORM + rows), upper="left")
    assert log.rows == 2
    np.testing.assert_allclose(log["upper_thrust_N"], [9.80665, 1.2 * 9.80665])
    np.testing.assert_allclose(log["lower_thrust_N"], [0.5 * 9.80665, -0.05 * 9.80665])
    np.testing.assert_allclose(log["upper_torque_Nm"], [0.2, 0.3])
    np.testing.assert_allclose(log["upper_throttle"], [0.5, 0.6])
    np.testing.assert_allclose(log["lower_throttle"], [0.25, 0.25])
    said = "\n".join(log.notes)
    assert "1 of 3 rows dropped" in said and "line 2" in said
    assert "sign of upper_torque_Nm turned" in said
    assert "Total Thrust [g]" in said and not any("Total" in name for name in log.columns)


def test_a_foreign_file_with_a_column_of_ours_is_a_foreign_file(tmp_path: Path) -> None:
    text = PLATFORM.strip() + ",rotor_spacing_m\n1500,1250,1000,-0.2,500,4000,3000,1500,2,0.226\n"
    log = read_stand_log(write(tmp_path, text), upper="Left")
    assert log["rotor_spacing_m"].tolist() == [0.226] and log["upper_rpm"].tolist() == [4000.0]


@pytest.mark.parametrize("unit, factor", [("N", 1.0), ("gf", 0.00980665), ("kgf", 9.80665)])
def test_tyto_thrust_units_bom_trailing_comma_and_both_micros(
    tmp_path: Path, unit: str, factor: float
) -> None:
    heading = "\ufeffTime (s),ESC signal (\u00b5s),Servo 1 (\u03bcs),Torque (N\u00b7m),"
    heading += f"Thrust ({unit}),Voltage (V),Motor Optical Speed (RPM),App message,\n"
    rows = "0,1000,,0,0.01,24,0,,\n1,1300,,0.05,3,24,5000,,\n2,1400,,0.07,4,23.9,5600,hello,\n"
    log = read_stand_log(write(tmp_path, heading + rows))
    np.testing.assert_allclose(log["upper_thrust_N"], np.array([3, 4]) * factor)
    assert log["upper_torque_Nm"].tolist() == [0.05, 0.07]
    assert log["voltage_V"].tolist() == [24.0, 23.9]
    assert log["upper_throttle"].tolist() == pytest.approx([0.3, 0.4])
    assert not log.has("lower_rpm")


def test_micro_of_either_kind_is_a_microsecond(tmp_path: Path) -> None:
    for micro in "\u00b5\u03bc":
        text = f"ESC signal ({micro}s),Thrust (N)\n1250,3\n"
        assert read_stand_log(write(tmp_path, text))["upper_throttle"].tolist() == [0.25]


def test_pybemt_letters(tmp_path: Path) -> None:
    text = "RPM,T_A(N),Q_A(Nm),P_A(W),T_B(N),Q_B(Nm),P_B(W),RPM_B\n1000,3,0.1,20,5,0.2,25,1010\n"
    path = write(tmp_path, text)
    with pytest.raises(RotorsUnclear, match="which is the upper one\\? Say `upper` A or `upper` B"):
        read_stand_log(path)
    log = read_stand_log(path, upper="B")
    assert (log["lower_rpm"][0], log["upper_rpm"][0]) == (1000, 1010)
    assert (log["lower_thrust_N"][0], log["upper_thrust_N"][0]) == (3, 5)
    assert any("as `upper` says" in note for note in log.notes)
    assert read_stand_log(path, upper="a")["lower_thrust_N"][0] == 5


def test_semicolons_and_the_si_column_of_two(tmp_path: Path) -> None:
    text = "\ufeffRPM;omega;T(gf);T(N);Q(Nm);P(W);\n1006.0;105.3;539.999;5.296;0.187;19.7;\n"
    log = read_stand_log(write(tmp_path, text))
    assert log["upper_thrust_N"].tolist() == [5.296]
    assert set(log.columns) == {"upper_rpm", "upper_thrust_N", "upper_torque_Nm", "upper_power_W"}


def test_a_speed_sensor_that_never_read_is_left_out(tmp_path: Path) -> None:
    text = "ESC signal (us),Thrust (N),Motor Electrical Speed (RPM)\n1300,3,0\n1400,4,0\n"
    log = read_stand_log(write(tmp_path, text))
    assert not log.has("upper_rpm") and log.rows == 2


def test_columns_mapped_by_hand(tmp_path: Path) -> None:
    log = write(tmp_path, "n1,n2,F top [g],percent\n1000,900,100,50\n")
    mapping = write(
        tmp_path,
        'upper_rpm = "n1"\nlower_rpm = { column = "n2" }\n'
        'upper_thrust_N = { column = "F top [g]", scale = 0.00980665 }\n'
        'upper_throttle = { column = "percent", scale = 0.01 }\n',
        "map.toml",
    )
    samples = read_stand_log(log, mapping)
    assert samples["upper_thrust_N"][0] == pytest.approx(0.980665)
    assert samples["upper_throttle"][0] == pytest.approx(0.5)
    assert set(samples.columns) == {"upper_rpm", "lower_rpm", "upper_thrust_N", "upper_throttle"}


@pytest.mark.parametrize(
    "text, expected",
    [
        ("", "log.csv: empty"),
        ("\n\n", "log.csv: empty"),
        (OWN, "log.csv: line 2: no rows"),
        (OWN + "1,2,3,x,5,6\n", "log.csv: line 2, column 'upper_torque_Nm': a number is expected, found 'x'"),
        (
            OWN + "1,2,3,4,5,6\n1,2,,4,5,6\n",
            "line 3, column 'upper_thrust_N': a number is expected, found an empty cell",
        ),
        (OWN + "1,2,3,nan,5,6\n", "line 2, column 'upper_torque_Nm': a finite number is expected, found nan"),
        (OWN + "1,2,3,4,inf,6\n", "line 2, column 'lower_thrust_N': a finite number is expected, found inf"),
        (OWN + "1,2,3,4,5\n", "line 2: 6 columns are expected, found 5"),
        (OWN + "1,2,3,4,5,6,7\n", "line 2: 6 columns are expected, found 7"),
        ("1,2,3\n4,5,6\n", "line 1: column headings are expected, found numbers"),
        ("upper_rpm,upper_rpm\n1,2\n", "line 1, column 'upper_rpm': the heading stands there twice"),
        ("a,b\n1,2\n", "line 1: no speed column"),
        (
            "upper_throttle,upper_thrust_N\n50,2\n",
            "line 2, column upper_throttle: 0..1 is expected, found 50",
        ),
        ("PWM Left,Thrust Left\n1500,2\n", "line 1, column 'Thrust Left': unit of a thrust expected"),
        ("PWM Left,Thrust Left [stone]\n1500,2\n", "found 'stone'"),
        (
            "PWM Left,Thrust Left [g]\n1500,two\n",
            "line 2, column 'Thrust Left [g]': a number is expected, found 'two'",
        ),
    ],
)
def test_bad_input_is_one_clear_line(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        read_stand_log(write(tmp_path, text))
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_stand_log(tmp_path / "absent.csv")
    with pytest.raises(InputError, match="cannot be read"):
        read_stand_log(tmp_path)
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x9f")
    with pytest.raises(InputError, match="not text"):
        read_stand_log(tmp_path / "binary.csv")


@pytest.mark.parametrize(
    "mapping, expected",
    [
        ('upper_rpm = "nope"', "column 'nope': missing"),
        ("upper_rpm = { columm = 'n1' }", "upper_rpm.columm: unknown; column?"),
        ("upper_rpm = 3", "upper_rpm: "),
        ("= 3", "not TOML"),
    ],
)
def test_bad_maps(tmp_path: Path, mapping: str, expected: str) -> None:
    log = write(tmp_path, "n1,n2\n1,2\n")
    with pytest.raises(InputError) as caught:
        read_stand_log(log, write(tmp_path, mapping, "map.toml"))
    assert expected in str(caught.value) and "\n" not in str(caught.value)


def test_samples_name_what_is_missing() -> None:
    samples = Samples({"a": np.arange(3.0)}, "x.csv")
    with pytest.raises(InputError, match=r"x.csv: column b: missing \(columns found: a\)"):
        samples["b"]
    assert samples.take(np.array([False, True, True]))["a"].tolist() == [1, 2]
    assert samples.with_columns(b=[1, 2, 3]).has("a", "b")
    with pytest.raises(ValueError, match="unequal"):
        samples.with_columns(b=[1, 2])


@needs_shared
@pytest.mark.shared_data
def test_real_coaxial_map() -> None:
    log = read_stand_log(SHARED / "coax" / "mn4014_16in_zD1.csv")
    assert log.rows == 100
    assert "line 2, line 3, line 104" in "\n".join(log.notes)
    assert log["upper_thrust_N"].max() == pytest.approx(2590.41840348 * 9.80665e-3)
    assert (log["upper_torque_Nm"][log["upper_rpm"] > 2000] > 0).all()
    assert log["lower_thrust_N"].min() < -2.5  # the upper rotor's wake pushes the slow lower one down


@needs_shared
@pytest.mark.shared_data
@pytest.mark.parametrize(
    "path", sorted(SHARED.glob("coax/*.csv")) + sorted(SHARED.glob("single/*.csv")), ids=lambda p: p.stem
)
def test_every_real_stand_log_reads(path: Path) -> None:
    # the short runs keep near equal loads: nothing in them tells the rotors apart
    log = read_stand_log(path, upper="left" if path.stem.endswith("run2") else None)
    assert log.rows >= 14
    assert log.has("upper_thrust_N")
    effort = "upper_rpm" if log.has("upper_rpm") else "upper_throttle"
    assert log["upper_thrust_N"] @ log[effort] ** 2 > 0
