"""Flight logs with a fault in them: the column is flagged, nothing is claimed instead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from case_table import case_table
from residual_world import fly

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.channels.flight import flight_frame, reduce_columns
from coaxlink.data import Samples
from coaxlink.instruments.flight import columns
from coaxlink.instruments.flight.columns import _Judged
from coaxlink.instruments.flight.commands import motors_too_many
from coaxlink.instruments.flight.flown_log import FlownLog
from coaxlink.instruments.flight.kinematics import kinematics_of
from coaxlink.instruments.flight.rotors import _early, _late, _swapped, off_centre
from coaxlink.residual import refine
from coaxlink.rotor import load_rotor_model


def column_faults(log):
    return columns.column_faults(FlownLog.of(log))


def answer_faults(frame):
    return _early(frame) or _late(frame)


@pytest.fixture(scope="module")
def clean():
    return dict(fly([{}])[0])


def ask(columns):
    airframe = replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=0.02)
    return refine(Samples(columns, "fault"), airframe, load_rotor_model(files.example("rotor_paper.toml")))


@pytest.mark.slow
def test_a_sound_log_is_not_flagged(clean):
    assert ask(clean).suspect_data == ()


def stands_still(log):
    late = log["time_s"] > 25.0
    return {"height_m": np.where(late, log["height_m"][late][0], log["height_m"])}


def exchanged(log, a, b):
    return {a: log[b], b: log[a]}


def test_another_scale_for_a_while_has_its_rows(clean):
    late = clean["time_s"] > 25.0
    harmed = clean | {"accel_z_m_s2": np.where(late, 0.5, 1.0) * clean["accel_z_m_s2"]}
    ((column, rows, why),) = column_faults(Samples(harmed, "fault"))
    assert column == "accel_z_m_s2" and "times" in why and np.mean(rows == late) > 0.95


@pytest.mark.parametrize(
    ("column", "by"), [("accel_x_m_s2", 0.8), ("accel_y_m_s2", -0.8), ("gyro_z_rad_s", 0.1)]
)
@pytest.mark.parametrize("share", [0.3, 0.75])
def test_a_zero_that_moves_in_flight_is_told_with_its_rows(column, by, share, clean):
    late = clean["time_s"] > share * clean["time_s"][-1]
    ((found, rows, why),) = column_faults(Samples(clean | {column: clean[column] + by * late}, "fault"))
    few = late if share > 0.5 else ~late  # which of the two is the sound one nothing tells
    assert found == column and "zero moves" in why and np.mean(rows == few) > 0.9


def test_a_zero_that_drifts_as_sensors_do_is_sound(clean):
    warm = np.linspace(0.0, 1.0, len(clean["time_s"]))
    harmed = clean | {"accel_x_m_s2": clean["accel_x_m_s2"] + 0.2 * warm}
    assert not column_faults(Samples(harmed | {"gyro_y_rad_s": clean["gyro_y_rad_s"] + 0.01 * warm}, "fault"))


def test_another_scale_from_the_middle_on_is_no_noise(clean):
    """Half of a flight is off: neither half is an outlier of the other."""
    time = clean["time_s"]
    for share in (0.45, 0.5, 0.55):
        late = time > time[0] + share * (time[-1] - time[0])
        harmed = clean | {"accel_z_m_s2": np.where(late, 0.83, 1.0) * clean["accel_z_m_s2"]}
        found = column_faults(Samples(harmed, "fault"))
        assert [column for column, *_ in found] == ["accel_z_m_s2"], share


def test_what_the_yardstick_misses_a_little_adds_up_to_no_fault_however_long_the_flight(clean, monkeypatch):
    kin = kinematics_of(FlownLog.of(Samples(clean, "long")))
    long = replace(kin, first=np.tile(kin.first, 60))
    judged = _Judged.of(long, np.ones(len(long.first), bool))
    monkeypatch.setattr(_Judged, "_states", lambda j: iter([("roll_rad, pitch_rad", "odd", 0.9 * j.misses)]))
    assert list(judged.chained(len(clean["time_s"]))) == []


def test_what_the_rest_of_the_log_contradicts_is_flagged(clean):
    with case_table() as case:
        for column, harm in (
            ("height_m", stands_still),
            ("accel_z_m_s2", lambda log: {"accel_z_m_s2": 0.91 * log["accel_z_m_s2"]}),
            ("accel_z_m_s2", lambda log: {"accel_z_m_s2": log["accel_z_m_s2"] - 0.8}),
            ("voltage_V", lambda log: {"voltage_V": 1000.0 * log["voltage_V"]}),
            ("vel_d_m_s", lambda log: {"vel_d_m_s": -log["vel_d_m_s"]}),
            ("vel_e_m_s", lambda log: {"vel_e_m_s": -log["vel_e_m_s"]}),
            ("height_m", lambda log: {"height_m": 5.0 - log["height_m"]}),
            ("height_m", lambda log: {"height_m": log["height_m"] / 0.3048}),
            (
                "height_m",
                lambda log: {"height_m": np.where(log["time_s"] > 30.0, -1.0, 1.0) * log["height_m"]},
            ),
            ("roll_rad", lambda log: {"roll_rad": -log["roll_rad"]}),
            ("pitch_rad", lambda log: {"pitch_rad": 4.0 * log["pitch_rad"]}),
            ("roll_rad", lambda log: {"roll_rad": np.rad2deg(log["roll_rad"])}),
            (
                "roll_rad",
                lambda log: {"roll_rad": np.where(log["time_s"] > 30.0, 2.0, 1.0) * log["roll_rad"]},
            ),
            ("accel_z_m_s2", lambda log: {"accel_z_m_s2": 1.2 * np.round(log["accel_z_m_s2"] / 1.2)}),
            ("gyro_y_rad_s", lambda log: {"gyro_y_rad_s": 1.3 * log["gyro_y_rad_s"]}),
            ("vel_n_m_s, vel_e_m_s", lambda log: exchanged(log, "vel_n_m_s", "vel_e_m_s")),
            ("pitch_rad, yaw_rad", lambda log: exchanged(log, "pitch_rad", "yaw_rad")),
            ("gyro_y_rad_s, gyro_z_rad_s", lambda log: exchanged(log, "gyro_y_rad_s", "gyro_z_rad_s")),
            ("gyro_x_rad_s, gyro_y_rad_s", lambda log: exchanged(log, "gyro_x_rad_s", "gyro_y_rad_s")),
        ):
            with case(f"{column}, {harm}"):
                assert [f[0] for f in column_faults(Samples(clean | harm(clean), "fault"))] == [column]


@pytest.mark.parametrize("share", [0.97, 1.03])
def test_a_scale_within_a_data_sheet_is_no_fault(share, clean):
    held = np.repeat(clean["height_m"][::50], 50)[
        : len(clean["height_m"])
    ]  # a height of one reading a second
    log = clean | {"accel_z_m_s2": share * clean["accel_z_m_s2"], "height_m": held}
    assert column_faults(Samples(log, "sound")) == []


@pytest.mark.slow
def test_motors_that_the_airframe_does_not_have_are_told_first(clean):
    answer = ask(clean | {"motor9": clean["motor1"], "motor10": clean["motor2"]})
    assert [s.column for s in answer.suspect_data] == ["motor9, motor10"]
    assert "8 rotors" in answer.suspect_data[0].why and answer.effects == ()


@pytest.mark.slow
def test_commands_that_are_none_are_flagged_and_the_rest_is_judged(clean):
    motor = clean["motor3"].copy()
    motor[1200:1500] = np.linspace(1.5, 40.0, 300)  # damaged packets
    answer = ask(clean | {"motor3": motor})
    assert [(s.column, s.rows) for s in answer.suspect_data] == [("motor3", "1201-1500")]
    assert answer.effects == ()


def test_outputs_that_no_motor_hangs_on_are_none(clean):
    rests = {"motor9": np.full(len(clean["time_s"]), 0.05), "motor10": np.full(len(clean["time_s"]), np.nan)}
    assert motors_too_many(FlownLog.of(Samples(clean | rests, "sound"), range(1, 9))) == []


def test_a_servo_in_the_middle_of_its_range_is_no_motor(clean):
    """A tlog has every output that sends pulses, and 1500 us is half of a motor's range."""
    with case_table() as case:
        for what in ("gripper at rest", "gimbal that holds level", "landing gear", "servo"):
            with case(f"{what}"):
                time, random = clean["time_s"], np.random.default_rng(3)
                moves = {
                    "gripper at rest": np.full(len(time), 0.5),
                    "gimbal that holds level": 0.5 + 0.6 * clean["pitch_rad"],
                    "landing gear": np.where(time > 20.0, 0.9, 0.4),
                    "servo": 0.5 + 0.05 * random.standard_normal(len(time)),
                }
                log = Samples(clean | {"motor9": np.clip(moves[what], 0.0, 1.0)}, "sound")
                assert motors_too_many(FlownLog.of(log, range(1, 9))) == []


def test_motors_of_a_vehicle_of_ten_are_found_by_how_they_go_along(clean):
    random = np.random.default_rng(4)
    mixed = 0.5 * (clean["motor1"] + clean["motor6"]) + 0.002 * random.standard_normal(len(clean["time_s"]))
    log = Samples(clean | {"motor9": np.clip(mixed, 0.0, 1.0), "motor10": np.full(len(mixed), 0.5)}, "ten")
    assert [f[0] for f in motors_too_many(FlownLog.of(log, range(1, 9)))] == ["motor9"]


@pytest.mark.parametrize("volts", [np.nan, np.inf])
def test_a_voltage_that_was_never_measured_is_none(volts, clean):
    assert column_faults(Samples(clean | {"voltage_V": np.full(len(clean["time_s"]), volts)}, "sound")) == []


@pytest.mark.slow
def test_what_is_not_finite_flags_nobody_and_warns_of_nothing(clean):
    with case_table() as case:
        for name in ("roll_rad", "accel_y_m_s2", "vel_d_m_s", "height_m"):
            with case(f"{name}"):
                endless = np.where(np.arange(len(clean[name])) % 700 < 3, np.inf, clean[name])
                log = Samples(clean | {name: endless}, "damaged")
                assert column_faults(log) == []


def test_an_angle_that_stands_still_while_the_gyros_turn_is_flagged(clean):
    with case_table() as case:
        for name in ("roll", "pitch", "yaw"):
            with case(f"{name}"):
                time, column = clean["time_s"], f"{name}_rad"
                stands = (time > 25.0) & (time < 48.0)
                log = Samples(
                    clean | {column: np.where(stands, clean[column][stands][0], clean[column])}, "fault"
                )
                (found,) = column_faults(log)
                assert found[0] == column and "gyros" in found[2]
                assert np.mean(found[1] == stands) > 0.99


def test_an_angle_that_stands_still_with_the_vehicle_is_sound(clean):
    """A heading that is held on the ground, or told in whole degrees, repeats itself for that."""
    whole = np.radians(np.round(np.degrees(clean["yaw_rad"])))
    assert column_faults(Samples(clean | {"yaw_rad": whole}, "sound")) == []


@pytest.mark.slow
def test_a_height_that_stands_still_takes_nothing_else_from_the_answer(clean):
    answer = ask(clean | stands_still(clean))
    assert [s.column for s in answer.suspect_data] == ["height_m"]
    assert answer.effects == () and "ground_effect" in {r.name for r in answer.rejected}


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [0.08, 0.12])
def test_motors_that_are_stamped_late_leave_nothing_to_claim(late_s, clean):
    time = clean["time_s"]
    shifted = {f"motor{n}": np.interp(time - late_s, time, clean[f"motor{n}"]) for n in range(1, 9)}
    answer = ask(clean | shifted)
    assert [s.column for s in answer.suspect_data] == ["time_s"] and answer.effects == ()
    assert "before their commands" in answer.suspect_data[0].why


@pytest.mark.parametrize(
    ("columns", "late_s", "named"),
    [
        *(((column,), 0.06, column) for column in ("gyro_x_rad_s", "gyro_y_rad_s")),
        (("accel_z_m_s2",), 0.2, "accel_z_m_s2"),
        (("gyro_x_rad_s", "gyro_y_rad_s"), 0.02, ""),  # as motors that are slower are
        (("accel_z_m_s2",), 0.005, ""),  # as another filter is
        ((), 0.0, ""),
    ],
)
def test_an_axis_later_than_what_the_same_rotors_make_beside_it_is_named(columns, late_s, named, clean):
    time = clean["time_s"]
    log = Samples(clean | {n: np.interp(time - late_s, time, clean[n]) for n in columns}, "late")
    airframe = replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=0.02)
    frame = flight_frame([log], airframe, load_rotor_model(files.example("rotor_paper.toml")))
    assert [s.column for s in answer_faults(frame)] == ([named] if named else [])


@pytest.mark.slow
def test_two_motors_exchanged_are_named(clean):
    answer = ask(clean | {"motor2": clean["motor7"], "motor7": clean["motor2"]})
    assert [s.column for s in answer.suspect_data] == ["motor2, motor7"]
    assert answer.effects == ()


def test_what_fits_as_labelled_for_a_while_is_no_exchange(clean):
    airframe = replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=0.02)
    model = load_rotor_model(files.example("rotor_paper.toml"))
    frame = flight_frame([Samples(clean, "fault")], airframe, model)
    calm = frame.time_s < np.median(frame.time_s)
    speeds, pair = frame.speeds.copy(), [1, 6]
    middle = speeds[:, pair].mean(axis=1, keepdims=True)
    speeds[:, pair] = np.where(calm[:, None], middle + 0.1 * (speeds[:, pair] - middle), speeds[:, pair])
    other = speeds.copy()
    other[:, pair] = speeds[:, pair[::-1]]
    labelled, exchanged = (airframe.body_loads(*airframe.loads(model, u)) for u in (speeds, other))

    def reported(measured):
        return [s.column for s in _swapped(replace(frame, speeds=speeds, measured=measured))]

    assert reported(exchanged) == ["motor2, motor7"]
    assert reported(np.where(calm[:, None], labelled, exchanged)) == []


def test_a_centre_of_mass_is_the_rival_of_an_exchange(clean):
    """A steady torque that goes with the force is as well explained by where it acts; an exchange is not."""
    airframe = replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=0.02)
    model = load_rotor_model(files.example("rotor_paper.toml"))

    def left(columns, arm):
        frame = flight_frame([Samples(columns, "fault")], airframe, model)
        measured = frame.measured.copy()
        measured[:, 3:] += np.cross(arm, frame.measured[:, :3])
        torques = reduce_columns(frame, measured)[:, 3:]
        scale = np.std(torques, axis=0)
        return off_centre(frame, torques / scale, scale) / np.mean((torques / scale) ** 2)

    assert left(clean, (0.02, -0.03, 0.0)) < 0.02
    assert left(clean | {"motor2": clean["motor7"], "motor7": clean["motor2"]}, (0.0, 0.0, 0.0)) > 0.3


@pytest.mark.slow
def test_a_reversed_gyro_is_named(clean):
    answer = ask(clean | {"gyro_y_rad_s": -clean["gyro_y_rad_s"]})
    assert [s.column for s in answer.suspect_data] == ["gyro_y_rad_s"]
    assert answer.effects == ()


def test_a_stuck_axis_is_named_with_its_rows(clean):
    values = clean["accel_z_m_s2"].copy()
    values[1200:1300] = values[1200]
    answer = ask(clean | {"accel_z_m_s2": values})
    assert [(s.column, s.rows) for s in answer.suspect_data] == [("accel_z_m_s2", "1201-1300")]
    assert answer.effects == ()


def test_an_accelerometer_at_its_limit_is_named_with_its_rows_and_the_rest_is_judged(clean):
    read = clean["accel_x_m_s2"]
    limit = np.quantile(read, 0.8)
    harmed = clean | {"accel_x_m_s2": np.minimum(read, limit)}
    ((column, rows, why),) = column_faults(Samples(harmed, "fault"))
    assert column == "accel_x_m_s2" and "at its limit" in why
    assert np.array_equal(rows, read >= limit)
    coarse = clean | {"accel_x_m_s2": np.round(np.minimum(read, limit), 1)}
    assert all("limit" not in why for _, _, why in column_faults(Samples(coarse, "fault")))


def test_a_repeated_stretch_is_named(clean):
    log = {k: v.copy() for k, v in clean.items()}
    for name in log:
        if name.startswith(("accel", "gyro")):
            log[name][1500:1700] = log[name][900:1100]
    answer = ask(log)
    assert [(s.column, s.rows) for s in answer.suspect_data] == [("accel_*, gyro_*", "1501-1700")]


def test_a_force_that_comes_and_goes_with_nothing_is_unexplained(clean):
    time = clean["time_s"]
    answer = ask(clean | {"accel_x_m_s2": clean["accel_x_m_s2"] + 0.3 * np.sin(2 * np.pi * time / 6.3)})
    assert answer.effects == ()
    assert "force_x" in [u.channel for u in answer.unexplained]
