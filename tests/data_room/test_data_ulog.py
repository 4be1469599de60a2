"""ULogs of PX4 1.12 to 1.17, as each writes motors, ESCs, packs and range finders; made byte by byte."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from case_table import case_table

from coaxlink.data import read_flight_log
from coaxlink.data.samples import OUTPUTS_AS_MOTORS

CODES = {"uint64_t": "Q", "float": "f", "uint8_t": "B", "int32_t": "i"}
TOPIC = dict[str, tuple[str, float]]  # field: type, value; a float may be a function of the row
ROWS, PERIOD_US = 100, 20_000


def framed(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog(
    topics: dict[tuple[str, int], TOPIC],
    parameters: dict[str, float],
    start_us: int = 0,
    rows: int = ROWS,
    every: dict[str, int] | None = None,
) -> bytes:
    """A log of a hundred rows of each topic and instance, every 20 ms, or of some topics one in so many."""
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", start_us), framed("B", bytes(40))]
    for name in dict.fromkeys(name for name, _ in topics):
        fields = next(f for (n, _), f in topics.items() if n == name)
        text = f"{name}:uint64_t timestamp;" + "".join(
            f"{kind} {field};" for field, (kind, _) in fields.items()
        )
        out.append(framed("F", text.encode()))
    for name, value in parameters.items():
        kind = "int32_t" if isinstance(value, int) else "float"
        key = f"{kind} {name}".encode()
        out.append(framed("P", bytes([len(key)]) + key + struct.pack("<" + CODES[kind], value)))
    for number, (name, instance) in enumerate(topics):
        out.append(framed("A", struct.pack("<BH", instance, number) + name.encode()))
    for row in range(rows):
        for number, ((name, _), fields) in enumerate(topics.items()):
            if row % (every or {}).get(name, 1):
                continue
            body = struct.pack("<HQ", number, start_us + row * PERIOD_US)
            for kind, value in fields.values():
                body += struct.pack("<" + CODES[kind], value(row) if callable(value) else value)
            out.append(framed("D", body))
    return b"".join(out)


def array(kind: str, name: str, count: int, values: dict[int, float]) -> TOPIC:
    """The fields of an array, spread: one a place, as a reader sees them."""
    return {f"{name}[{i}]": (kind, values.get(i, 0.0)) for i in range(count)}


ATTITUDE = array("float", "q", 4, {0: 1.0})
LOCAL = {n: ("float", v) for n, v in {"vx": 0.0, "vy": 0.0, "vz": 0.5, "z": -3.0}.items()}
FLYING = {"arming_state": ("uint8_t", 2)}
COMBINED = array("float", "gyro_rad", 3, {}) | array("float", "accelerometer_m_s2", 3, {2: -9.75})
MOTION = {
    ("vehicle_attitude", 0): ATTITUDE,
    ("sensor_combined", 0): COMBINED,
    ("vehicle_local_position", 0): LOCAL,
}
FILTERED = {
    ("vehicle_acceleration", 0): array("float", "xyz", 3, {2: -9.75}),
    ("vehicle_angular_velocity", 0): array("float", "xyz", 3, {}),
}
COMMON = MOTION | {("vehicle_status", 0): FLYING, ("vehicle_land_detected", 0): {"landed": ("uint8_t", 0)}}


def outputs(values: dict[int, float]) -> TOPIC:
    return array("float", "output", 16, values)


def escs(rpm: dict[int, int], functions: bool) -> TOPIC:
    out: TOPIC = {"esc_count": ("uint8_t", 4)}
    for i in range(4):
        out[f"esc[{i}].esc_rpm"] = ("int32_t", rpm.get(i, 0))
        out[f"esc[{i}].esc_current"] = ("float", 10.0 * i)
        out[f"esc[{i}].esc_temperature"] = ("float", 40.0 + i)
        if functions:
            out[f"esc[{i}].actuator_function"] = ("uint8_t", 101 + i if i in rpm else 0)
    return out


PULSES = {0: 1500.0, 1: 1250.0}
CONTROLS = array("float", "control", 12, {0: 0.5, 1: 0.25})
TWO = {"CA_ROTOR_COUNT": 2, "THR_MDL_FAC": 0.0}
OUT, MOTORS, ESCS = "actuator_outputs", "actuator_motors", "esc_status"
# what is logged beside the common topics, the parameters, and whether they say which output is which motor
ERAS: dict[str, tuple[dict[tuple[str, int], TOPIC], dict[str, float], bool]] = {
    "1.12, outputs alone": (
        {(OUT, 0): outputs(PULSES), (ESCS, 0): escs({0: 3000, 1: 2000}, False)},
        {"PWM_MIN": 1000, "PWM_MAX": 2000},
        False,
    ),
    "1.12, two drivers": ({(OUT, 0): outputs({}), (OUT, 1): outputs(PULSES)}, {}, False),
    "1.13, functions of outputs": (
        {(OUT, 0): outputs({2: 1500.0, 5: 1250.0})},
        {"PWM_MAIN_FUNC3": 101, "PWM_MAIN_FUNC6": 102},
        True,
    ),
    "1.14, motors": ({(MOTORS, 0): CONTROLS, (OUT, 0): outputs({})}, TWO, True),
    "1.17, ESCs know their motors": (
        {(MOTORS, 0): CONTROLS, (ESCS, 0): escs({0: 3000, 1: 2000}, True)} | FILTERED,
        TWO,
        True,
    ),
}


def test_every_version_says_which_motor_had_which_command(tmp_path: Path) -> None:
    path = tmp_path / "log.ulg"
    with case_table() as case:
        for name, (topics, parameters, known) in ERAS.items():
            with case(name):
                path.write_bytes(ulog(COMMON | topics, parameters))
                log = read_flight_log(path)
                np.testing.assert_allclose(log["motor1"], 0.5)
                np.testing.assert_allclose(log["motor2"], 0.25)
                np.testing.assert_allclose(log["accel_z_m_s2"], -9.75)
                assert (OUTPUTS_AS_MOTORS not in log.premises) == known
                if any(topic == "esc_status" for topic, _ in topics):
                    for column, value in (("rpm2", 2000), ("current2_A", 10), ("temperature2_C", 41)):
                        np.testing.assert_allclose(log[column], value)


def test_of_several_instances_the_one_in_use_counts(tmp_path: Path) -> None:
    topics = COMMON | ERAS["1.14, motors"][0]
    topics[("battery_status", 1)] = {"voltage_v": ("float", 24.5)}  # logged ahead of the first one
    topics[("battery_status", 0)] = {"voltage_v": ("float", 0.0)}  # not connected
    finder = {"current_distance": ("float", 9.0), "orientation": ("uint8_t", 0)}
    topics[("distance_sensor", 0)] = finder  # looks ahead
    topics[("distance_sensor", 1)] = finder | {
        "current_distance": ("float", 2.5),
        "orientation": ("uint8_t", 25),
    }
    path = tmp_path / "log.ulg"
    path.write_bytes(ulog(topics, {"CA_ROTOR_COUNT": 2}))
    log = read_flight_log(path)
    np.testing.assert_allclose(log["voltage_V"], 24.5)
    np.testing.assert_allclose(log["height_m"], 2.5)


def test_a_log_that_begins_in_the_air(tmp_path: Path) -> None:
    path = tmp_path / "log.ulg"
    path.write_bytes(ulog(COMMON | ERAS["1.14, motors"][0], {"CA_ROTOR_COUNT": 2}, start_us=600_000_000))
    log = read_flight_log(path)
    assert log.rows == ROWS and log["armed"].all() and not log["landed"].any()


MIXER = np.array(
    [[-0.6, 0.5, 0.2, -1.0], [0.6, -0.5, 0.3, -1.0], [0.5, 0.6, -0.3, -1.0], [-0.5, -0.6, -0.2, -1.0]]
)
LONG = 600


def stepping(rows: int) -> np.ndarray:
    """(rows, 4) torque and thrust demanded, which jump within a tenth of a second now and then."""
    dice = np.random.default_rng(5)
    jumps = dice.normal(0.0, 0.05, (rows, 4)) * (dice.random((rows, 4)) < 0.06)
    at = np.zeros((rows, 4))
    for k in range(1, rows):
        at[k] = 0.8 * at[k - 1] + jumps[k]
    return at + np.array([0.0, 0.0, 0.0, -0.5])


def slowly_commanded(commands: np.ndarray, demands: np.ndarray) -> bytes:
    """Commands ten times a second, demands fifty times, as in PX4's default set."""

    def column(values: np.ndarray) -> tuple[str, float]:
        return ("float", lambda row: float(values[row]))  # type: ignore[return-value]

    stamps = {"timestamp_sample": ("uint64_t", 0)}
    topics = MOTION | {
        ("vehicle_torque_setpoint", 0): stamps | {f"xyz[{i}]": column(demands[:, i]) for i in range(3)},
        ("vehicle_thrust_setpoint", 0): stamps
        | {f"xyz[{i}]": column(demands[:, 3] * (i == 2)) for i in range(3)},
        ("actuator_motors", 0): {
            f"control[{i}]": column(commands[:, i]) if i < 4 else ("float", float("nan")) for i in range(12)
        },
    }
    return ulog(topics, {"CA_ROTOR_COUNT": 4}, rows=LONG, every={"actuator_motors": 5})


def test_commands_logged_seldom_are_told_by_the_demands_between_them(tmp_path: Path) -> None:
    path, demands = tmp_path / "flight.ulg", stepping(LONG)
    commands = demands @ MIXER.T
    path.write_bytes(slowly_commanded(commands, demands))
    log = read_flight_log(path)
    row = np.round(log["time_s"] / 0.02).astype(int)
    assert np.median(np.diff(row)) == 1
    for n in range(4):
        straight = np.interp(np.arange(LONG), np.arange(0, LONG, 5), commands[::5, n])
        off = np.abs(log[f"motor{n + 1}"] - commands[row, n])
        assert np.abs(straight - commands[:, n])[: row[-1]].max() > 0.03
        assert off.max() < 1e-4
    assert any("10 commands a second" in note for note in log.notes)


def test_a_command_that_stands_still_does_not_follow_its_demand(tmp_path: Path) -> None:
    path, demands = tmp_path / "flight.ulg", stepping(LONG)
    commands = demands @ MIXER.T
    commands[200:301, 1] = commands[200, 1]
    path.write_bytes(slowly_commanded(commands, demands))
    log = read_flight_log(path)
    row = np.round(log["time_s"] / 0.02).astype(int)
    held = log["motor2"][(row > 200) & (row < 300)]
    assert len(held) == 99
    assert np.ptp(held) == 0.0


def test_commands_that_no_demand_made_are_read_at_their_own_rate(tmp_path: Path) -> None:
    path, demands = tmp_path / "flight.ulg", stepping(LONG)
    commands = 0.5 + 0.1 * np.random.default_rng(6).standard_normal((LONG, 4))
    path.write_bytes(slowly_commanded(np.clip(commands, 0.1, 0.9), demands))
    assert np.median(np.diff(read_flight_log(path)["time_s"])) > 0.099


def test_demands_that_no_controller_makes_are_left_out(tmp_path: Path) -> None:
    """As of a damaged message: neither a failed fit nor a warning on the terminal."""
    path, demands = tmp_path / "flight.ulg", stepping(LONG)
    commands = demands @ MIXER.T
    damaged = demands.copy()
    damaged[301:304] = [[3e38, -3e38, np.inf, 0.0], [-3e38, 3e38, 0.0, 3e38], [40.0, 0.0, 0.0, 0.0]]
    path.write_bytes(slowly_commanded(commands, damaged))
    log = read_flight_log(path)
    row = np.round(log["time_s"] / 0.02).astype(int)
    sound = (row < 295) | (row > 310)
    for n in range(4):
        assert np.abs(log[f"motor{n + 1}"] - commands[row, n])[sound].max() < 1e-4
