"""Stand logs as their makers write them: small files written by hand, and the real ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from case_table import case_table

from coaxlink.data import RotorsUnclear, Samples, read_stand_log
from coaxlink.data.headings import recognise
from coaxlink.data.join import join
from coaxlink.data.tare import without_tares
from coaxlink.errors import InputError
from coaxlink.rotor.stand_data import stand_data

SHARED = Path(__file__).parents[2] / ".." / "shared" / "data"
needs_shared = pytest.mark.skipif(
    not SHARED.is_dir(), reason="the shared real data is not beside this checkout"
)
OWN = "upper_rpm,lower_rpm,upper_thrust_N,upper_torque_Nm,lower_thrust_N,lower_torque_Nm\n"
PLATFORM = (
    "PWM Left,PWM Right,Thrust Left [g],Torque Left [Nm],Thrust Right [g],"
    "Speed Left [rpm],Speed Right [rpm],Total Thrust [g],Time [s]\n"
)
G = 9.80665


def write(folder: Path, text: str, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode())
    return path


def test_our_own_columns_and_context_are_taken_as_they_are(tmp_path: Path) -> None:
    log = read_stand_log(write(tmp_path, OWN + "0,0,0.1,0.0,-0.1,0\n3000,2500,20.5,0.4,10.25,0.3\n"))
    assert log.rows == 2 and log.place(1) == "line 3"
    assert log["upper_thrust_N"].tolist() == [0.1, 20.5] and log["lower_rpm"].tolist() == [0.0, 2500.0]
    log = read_stand_log(write(tmp_path, "upper_rpm,upper_thrust_N,humidity\n100,1,40\n200,4,41\n"))
    assert log["humidity"].tolist() == [40.0, 41.0]


def test_platform_headings_grams_pwm_and_signs(tmp_path: Path) -> None:
    rows = "1000,1000,5,0.1,5,0,0,10,1\r\n1500,1250,1000,-0.2,500,4000,3000,1500,2\r\n"
    rows += "1600,1250,1200,-0.3,-50,4400,3000,1150,3\r\n"
    log = read_stand_log(write(tmp_path, PLATFORM + rows), upper="left")
    for name, expected in {
        "upper_thrust_N": [G, 1.2 * G],
        "lower_thrust_N": [0.5 * G, -0.05 * G],
        "upper_torque_Nm": [0.2, 0.3],
        "upper_throttle": [0.5, 0.6],
        "lower_throttle": [0.25, 0.25],
    }.items():
        np.testing.assert_allclose(log[name], expected)
    reported = "\n".join(log.notes)
    assert "1 of 3 rows dropped" in reported and "line 2" in reported
    assert "sign of upper_torque_Nm turned" in reported
    assert "Total Thrust [g]" in reported and not any("Total" in name for name in log.columns)


def test_a_foreign_file_with_a_column_of_ours_is_a_foreign_file(tmp_path: Path) -> None:
    text = PLATFORM.strip() + ",rotor_spacing_m\n1500,1250,1000,-0.2,500,4000,3000,1500,2,0.226\n"
    log = read_stand_log(write(tmp_path, text), upper="Left")
    assert log["rotor_spacing_m"].tolist() == [0.226] and log["upper_rpm"].tolist() == [4000.0]


def test_tyto_bom_trailing_comma_and_both_micros(tmp_path: Path) -> None:
    heading = "\ufeffTime (s),ESC signal (\u00b5s),Servo 1 (\u03bcs),Torque (N\u00b7m),"
    heading += "Thrust (kgf),Voltage (V),Motor Optical Speed (RPM),App message,\n"
    rows = "0,1000,,0,0.01,24,0,,\n1,1300,,0.05,3,24,5000,,\n2,1400,,0.07,4,23.9,5600,hello,\n"
    log = read_stand_log(write(tmp_path, heading + rows))
    np.testing.assert_allclose(log["upper_thrust_N"], [3 * G, 4 * G])
    assert log["upper_torque_Nm"].tolist() == [0.05, 0.07] and log["voltage_V"].tolist() == [24.0, 23.9]
    assert log["upper_throttle"].tolist() == pytest.approx([0.3, 0.4]) and not log.has("lower_rpm")


def test_pulses_in_microseconds_are_throttles_and_nothing_else_is() -> None:
    with case_table() as case:
        for text, label in {
            "ESC signal (µs)": "",
            "ESC signal (\u03bcs)": "",
            "Signal A (us)": "a",
            "Motor 1 (µs)": "1",
            "Upper pulse width [us]": "upper",
            "lower_us": "lower",
            "upper command (us)": "upper",
        }.items():
            with case(text):
                found = recognise(0, text)
                assert found and found.unit and found.unit.name == "us"
                assert (found.quantity, found.label) == ("throttle", label)
        for text in ("us", "A (us)", "Servo 1 (µs)", "loop duration (us)", "Motor 1 (%)"):
            with case(text):
                found = recognise(0, text)
                assert found is None or found.quantity != "throttle"


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


def test_the_si_column_of_two_and_a_speed_sensor_that_never_read(tmp_path: Path) -> None:
    text = "\ufeffRPM;omega;T(gf);T(N);Q(Nm);P(W);\n1006.0;105.3;539.999;5.296;0.187;19.7;\n"
    log = read_stand_log(write(tmp_path, text))
    assert log["upper_thrust_N"].tolist() == [5.296]
    assert set(log.columns) == {"upper_rpm", "upper_thrust_N", "upper_torque_Nm", "upper_power_W"}
    log = read_stand_log(write(tmp_path, "ESC signal (us),Thrust (N),Electrical Speed (RPM)\n1300,3,0\n"))
    assert not log.has("upper_rpm") and log.rows == 1


def test_columns_mapped_by_hand(tmp_path: Path) -> None:
    log = write(tmp_path, "n1,n2,F top [g],percent,F2 [kgf],F3 (N)\n1000,900,100,50,2,3\n")
    mapping = """upper_rpm = "n1"
lower_rpm = { column = "n2" }
upper_thrust_N = { column = "F top [g]", scale = 0.00980665 }
upper_throttle = { column = "percent", scale = 0.01 }
lower_thrust_N = "F2 [kgf]"
third_thrust = { column = "F3 (N)", offset = 1 }
"""
    samples = read_stand_log(log, write(tmp_path, mapping, "map.toml"))
    assert {name: float(column[0]) for name, column in samples.columns.items()} == pytest.approx(
        {
            "upper_rpm": 1000,
            "lower_rpm": 900,
            "upper_thrust_N": 0.980665,
            "upper_throttle": 0.5,
            "lower_thrust_N": 2 * G,
            "third_thrust": 4,
        }
    )


def test_maps_that_say_nothing_of_use(tmp_path: Path) -> None:
    log = write(tmp_path, "n1,n2,Thrust (stone)\n1,2,3\n")
    with case_table() as case:
        for mapping, expected in {
            'upper_rpm = "nope"': "column 'nope': missing",
            "upper_rpm = { columm = 'n1' }": "upper_rpm.columm: unknown; column?",
            "upper_rpm = 3": "upper_rpm: ",
            "= 3": "not TOML",
            'uper_rpm = "n1"': "uper_rpm: unknown; upper_rpm?",
            'upper_rpm = { column = "n1", unit = "knots" }': "upper_rpm: unit: rpm, rad/s",
            'upper_rpm = { column = "n1", unit = "rpm", scale = 2 }': "a unit or a scale, not both",
            'upper_rpm = { column = "n1", unit = "erpm" }': "magnet poles with `poles`",
            'upper_thrust_N = "Thrust (stone)"': "state it in the map",
        }.items():
            with case(mapping):
                with pytest.raises(InputError) as caught:
                    read_stand_log(log, write(tmp_path, mapping, "map.toml"))
                assert expected in str(caught.value) and "\n" not in str(caught.value)


BAD = {
    "": "log.csv: empty",
    "\n\n": "log.csv: empty",
    OWN: "log.csv: line 2: no rows",
    OWN + "1,2,3,x,5,6\n": "log.csv: line 2, column 'upper_torque_Nm': a number is expected, found 'x'",
    OWN + "1,2,3,4,5,6\n1,2,,4,5,6\n": "line 3, column 'upper_thrust_N': a number is expected, found an",
    OWN + "1,2,3,nan,5,6\n": "line 2, column 'upper_torque_Nm': a finite number is expected, found nan",
    OWN + "1,2,3,4,inf,6\n": "line 2, column 'lower_thrust_N': a finite number is expected, found inf",
    OWN + "1,2,1e300,4,5,6\n": "line 2, column 'upper_thrust_N': no sensor reads 1e300",
    OWN + "1,2,3,4,5\n": "line 2: 6 columns are expected, found 5",
    OWN + "1,2,3,4,5,6,7\n": "line 2: 6 columns are expected, found 7",
    "1,2,3\n4,5,6\n": "line 1: column headings are expected, found numbers",
    "upper_rpm,upper_rpm\n1,2\n": "line 1, column 'upper_rpm': the heading stands there twice",
    "a,b\n1,2\n": "line 1: no speed column",
    "upper_throttle,upper_thrust_N\n50,2\n": "line 2, column upper_throttle: 0..1 is expected, found 50",
    "PWM Left,Thrust Left\n1500,2\n": "line 1, column 'Thrust Left': unit of a thrust expected",
    "PWM Left,Thrust Left [stone]\n1500,2\n": "found 'stone'",
    "PWM Left,Thrust Left [g]\n1500,two\n": "line 2, column 'Thrust Left [g]': a number is expected",
    "Throttle A,Thrust A [g]\n500,2\n": "a throttle in us (1000..2000), % or 0..1 is expected, found 500",
}


def test_bad_input_is_one_clear_line(tmp_path: Path) -> None:
    with case_table() as case:
        for text, expected in BAD.items():
            with case(expected):
                with pytest.raises(InputError) as caught:
                    read_stand_log(write(tmp_path, text))
                assert expected in str(caught.value) and "\n" not in str(caught.value)
        for path in (tmp_path / "absent.csv", tmp_path):
            with case(path), pytest.raises(InputError, match="cannot be read"):
                read_stand_log(path)


def test_samples_name_what_is_missing() -> None:
    samples = Samples({"a": np.arange(3.0)}, "x.csv")
    with pytest.raises(InputError, match=r"x.csv: column b: missing \(columns found: a\)"):
        samples["b"]
    assert samples.take(np.array([False, True, True]))["a"].tolist() == [1, 2]
    assert samples.with_columns(b=[1, 2, 3]).has("a", "b")
    with pytest.raises(ValueError, match="unequal"):
        samples.with_columns(b=[1, 2])


def log_of(name: str, **columns: list[float]) -> Samples:
    return Samples({k: np.array(v) for k, v in columns.items()}, name, (f"read {name}",))


def test_logs_of_one_propeller_joined() -> None:
    """A rotor alone stands beside a still one of unknown load; no load is made up."""
    pair = {"upper_rpm": [1, 2], "lower_rpm": [3, 4], "upper_thrust_N": [5, 6], "lower_thrust_N": [7, 8]}
    only = log_of("pair", **pair, voltage_V=[1, 1])
    assert join([only]) is only
    both = join([only, log_of("alone", upper_rpm=[9.0], upper_thrust_N=[10.0])])
    assert both["upper_rpm"].tolist() == [1, 2, 9] and both["lower_rpm"].tolist() == [3, 4, 0]
    np.testing.assert_array_equal(both["lower_thrust_N"], [7, 8, np.nan])
    reported = "\n".join(both.notes)
    assert not both.has("voltage_V") and "left out, not in every log: voltage_V" in reported
    assert "read pair" in reported and "alone (1 rows)" in reported
    part = join([only, log_of("part", **{k: v for k, v in pair.items() if k != "lower_thrust_N"})])
    assert np.isnan(part["lower_thrust_N"][2:]).all() and part["lower_rpm"].tolist() == [3, 4, 3, 4]
    with pytest.raises(InputError, match="throttled: column upper_rpm: missing"):
        join([only, log_of("throttled", upper_throttle=[0.5], upper_thrust_N=[1.0])])


@needs_shared
@pytest.mark.shared_data
def test_every_real_stand_log_reads() -> None:
    """README of the data: Left is the upper rotor; of tmotor28 B is."""
    with case_table() as case:
        for path in sorted([*SHARED.glob("coax/*.csv"), *SHARED.glob("single/*.csv")]):
            short = path.stem.endswith("run2")  # keeps near equal loads: nothing in it shows the rotors
            best = path.stem.endswith("_optimal")  # one split a thrust: may show them
            with case(path.stem):
                if short:
                    with pytest.raises(RotorsUnclear, match="`upper` left or `upper` right"):
                        read_stand_log(path)
                log = read_stand_log(path, upper="left" if short or best else None)
                effort = "upper_rpm" if log.has("upper_rpm") else "upper_throttle"
                assert log.rows >= 14 and log["upper_thrust_N"] @ log[effort] ** 2 > 0
                upper = "B" if "tmotor28" in path.stem else "left"
                reported = " ".join(log.notes)
                assert f"'{upper}' is the upper rotor" in reported or best or not log.has("lower_thrust_N")
    log = read_stand_log(SHARED / "coax" / "mn4014_16in_zD1.csv")
    assert log.rows == 100 and "line 2, line 3, line 104" in "\n".join(log.notes)
    assert log["upper_thrust_N"].max() == pytest.approx(2590.41840348e-3 * G)
    assert (log["upper_torque_Nm"][log["upper_rpm"] > 2000] > 0).all()
    assert log["lower_thrust_N"].min() < -2.5  # the upper rotor's wake pushes the slow lower one down


def test_what_no_unit_stands_behind_is_left_out_and_a_broken_reading_is_said(tmp_path: Path) -> None:
    rows = "".join(f"Anna,{1000 + 100 * k},{k},fine,T-{k},{k},4{k}\n" for k in range(5))
    head = "operator,upper_rpm,upper_thrust_N,comment,test_id,sample,humidity\n"
    log = read_stand_log(write(tmp_path, head + rows))
    assert set(log.columns) == {"upper_rpm", "upper_thrust_N", "humidity"}
    assert any("operator, comment, test_id, sample" in note for note in log.notes)
    broken = head.replace("humidity", "blade_temperature_C") + rows.replace(",42\n", ",oops\n")
    with pytest.raises(InputError, match="line 4, column 'blade_temperature_C': a number is expected"):
        read_stand_log(write(tmp_path, broken))


def test_loads_at_rest_are_a_tare_and_a_noisy_zero_is_none(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    rpm = np.concatenate([np.zeros(6), np.repeat(np.linspace(800.0, 4000.0, 30), 2)])
    u = rpm / 4000.0
    columns = {
        "upper_rpm": rpm,
        "upper_thrust_N": 60 * u**2 + 2.5 + 0.1 * random.standard_normal(len(u)),
        "upper_torque_Nm": 1.2 * u**2 + 0.01 * random.standard_normal(len(u)),
    }
    log = Samples(columns, "rig")
    less = without_tares(log)
    assert np.median(less["upper_thrust_N"][:6]) == pytest.approx(0.0, abs=1e-9)
    assert less["upper_torque_Nm"] is log["upper_torque_Nm"]
    assert "upper_thrust_N 2.5" in less.notes[0] and "6 rows at rest" in less.notes[0]
    assert without_tares(log.take(rpm > 0)).notes == ()


def test_too_few_rows_name_the_filter_that_took_them() -> None:
    log = Samples({n: np.arange(3.0) for n in ("upper_rpm", "upper_thrust_N", "upper_torque_Nm")}, "rig")
    with pytest.raises(InputError, match=r"3, 6 at least; 40 of 43 rows dropped, motors off"):
        stand_data(log.with_notes("40 of 43 rows dropped, motors off"))
