"""A world that flies a raw stand map, or a rotor file with its drive, against physics of the test's own."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from sim_pilot import Pilot

from sim.errors import SimulationError
from sim.physics.drive import open_circuit
from sim.physics.escs import reported_escs
from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.truth import HiddenEffect, Truth
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = EXAMPLES / "x8_demo.toml"
COAX = Path(__file__).parents[3] / "shared" / "data" / "coax"
LEVELS = np.linspace(0.08, 0.95, 10)
VOLTS = 22.0  # of the supply at rest
RAD = math.pi / 30.0


def speeds_of(c, d):
    """(upper, lower) rpm at commands c, d of VOLTS: a bent drive, and a lower rotor that the wake unloads."""
    c, d = np.asarray(c, float), np.asarray(d, float)
    return 7000.0 * c**0.85 - 60.0 * d, 6900.0 * d**0.85 + 500.0 * c * (1.0 - d)


def loads_of(n, m):
    """(upper thrust N, upper torque N m, lower thrust, lower torque) at rpm; the wake pushes a slow rotor."""
    n, m = np.asarray(n, float), np.asarray(m, float)
    wake = 2.2e-7 * n * n
    return (
        6.0e-7 * n * n - 2e-8 * n * m, 1.1e-8 * n * n,
        6.0e-7 * m * m - wake * (0.4 + 0.6 * m / 7000.0), 1.1e-8 * m * m - 1.5e-9 * n * n,
    )  # fmt: skip


def watts_of(n, torque):
    """From the battery; a rotor that the wake turns gives nothing back."""
    return np.maximum(4.0 + torque * n * RAD / 0.92 + 150.0 * torque**2, 1.0)


def measured():
    """Rows of the stand: throttle, rpm, thrust, torque, volts, amps of either side; the supply sags."""
    c, d = (x.ravel() for x in np.meshgrid(LEVELS, LEVELS, indexing="ij"))
    volts = VOLTS - 0.9 * c * d - 0.5 * c
    n, m = speeds_of(c * volts / VOLTS, d * volts / VOLTS)
    thrust, torque, low, low_torque = loads_of(n, m)
    return {
        "c": c, "d": d, "n": n, "m": m,
        "thrust": thrust, "torque": torque, "low": low, "low_torque": low_torque,
        "volts": volts, "amps": watts_of(n, torque) / volts, "low_amps": watts_of(m, low_torque) / volts,
    }  # fmt: skip


def written(path, rows):
    """As the platform writes it: g, us, torques of opposite sign, a column of its own, a row at rest."""
    columns = {
        "Time [s]": np.arange(len(rows["c"])), "PWM Left": 1000 + 1000 * rows["c"],
        "PWM Right": 1000 + 1000 * rows["d"], "Thrust Left [g]": rows["thrust"] / 9.80665e-3,
        "Torque Left [Nm]": -rows["torque"], "Thrust Right [g]": rows["low"] / 9.80665e-3,
        "Torque Right [Nm]": rows["low_torque"], "Voltage Left [V]": rows["volts"],
        "Voltage Right [V]": rows["volts"], "Current Left [A]": rows["amps"],
        "Current Right [A]": rows["low_amps"], "Speed Left [rpm]": rows["n"], "Speed Right [rpm]": rows["m"],
    }  # fmt: skip
    rest = [0, 1000, 1000, 0, 0, 0, 0, 22, 22, 0, 0, 0, 0]
    table = np.vstack([rest, np.column_stack(list(columns.values()))])
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return path


def own_columns(path, rows):
    """As coaxlink's own stand logs, without amps."""
    names = (
        "upper_throttle",
        "lower_throttle",
        "upper_rpm",
        "lower_rpm",
        "upper_thrust_N",
        "upper_torque_Nm",
    )
    names += ("lower_thrust_N", "lower_torque_Nm", "voltage_V")
    keys = ("c", "d", "n", "m", "thrust", "torque", "low", "low_torque", "volts")
    table = np.column_stack([rows[key] for key in keys])
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    return path


@pytest.fixture(scope="module")
def rows():
    return measured()


@pytest.fixture(scope="module")
def pair(rows, tmp_path_factory):
    return read_pair(written(tmp_path_factory.mktemp("map") / "MAP.csv", rows))


def test_sensors_that_read_each_other_s_current_give_no_motor_more_than_it_takes(pair, rows, tmp_path):
    crossed = {
        "amps": rows["amps"] - 0.09 * rows["low_amps"],
        "low_amps": rows["low_amps"] - 0.09 * rows["amps"],
    }
    crossed = {name: np.maximum(amps, 0.1) for name, amps in crossed.items()}
    found = read_pair(written(tmp_path / "MAP.csv", rows | crossed))
    speeds = np.meshgrid(np.linspace(0.4, 0.95, 8), np.linspace(0.5, 0.95, 8))
    true = pair.watts(*speeds)
    assert np.abs(found.watts(*speeds) - true).max() < 0.03 * true.max()


def fed(pair, volts, frame=X8, *effects):
    """A plant far up on a supply that holds its voltage."""
    plant = Plant(read_vehicle(frame), pair)
    Truth(effects).act(plant)
    k, p = plant.index, plant.parameters
    p[k.CELLS], p[k.CAPACITY], p[k.RESISTANCE] = volts / open_circuit(1.0, 0.95), 1e12, 0.0
    plant.state[k.CHARGE], plant.state[k.VOLTAGE] = 0.95, volts
    plant.state[2] = -1e4
    return plant


def turned(plant, c, d, seconds=1.0):
    """The plant with its upper rotors at command c and its lower ones at d, held still."""
    command = np.where(plant.vehicle.level == 1, d, c).astype(float)
    for _ in range(round(50 * seconds)):
        plant.advance(command, 20)
        plant.state[3:6], plant.state[6:13] = 0.0, [1, 0, 0, 0, 0, 0, 0]
    return plant


def sides(values, plant):
    """The first upper and the first lower rotor's."""
    level = plant.vehicle.level
    return values[np.flatnonzero(level == 0)[0]], values[np.flatnonzero(level == 1)[0]]


def close(found, wanted, full, share):
    """Within a share of full scale."""
    assert np.abs(np.asarray(found) - wanted).max() < share * full


@pytest.mark.parametrize("row", [0, 9, 27, 44, 55, 63, 90, 99])
def test_the_plant_turns_pulls_and_draws_what_the_row_says(pair, rows, row):
    at = {key: values[row] for key, values in rows.items()}
    plant = turned(fed(pair, at["volts"]), at["c"], at["d"])
    close(sides(plant.speeds * pair.speed_max_rpm, plant), (at["n"], at["m"]), 7000.0, 2e-3)
    close(sides(plant.thrust, plant), (at["thrust"], at["low"]), 27.0, 3e-3)
    close(sides(plant.torque, plant), (at["torque"], at["low_torque"]), 0.5, 3e-3)
    close(sides(plant.rotor_watts() / plant.voltage, plant), (at["amps"], at["low_amps"]), 20.0, 3e-3)
    total = 4 * (at["amps"] + at["low_amps"]) + 1.0  # and 1 A for what thinks
    close(plant.current, total, 80.0, 3e-3)


def test_between_rows_and_at_another_supply_it_is_the_pair_still(pair):
    for c, d, volts in ((0.42, 0.61, 21.5), (0.73, 0.31, 20.0), (0.22, 0.83, 23.0), (0.5, 0.5, 18.0)):
        n, m = speeds_of(c * volts / VOLTS, d * volts / VOLTS)
        plant = turned(fed(pair, volts), c, d)
        close(sides(plant.speeds * pair.speed_max_rpm, plant), (n, m), 7000.0, 4e-3)
        thrust, torque, low, low_torque = loads_of(n, m)
        close(sides(plant.thrust, plant), (thrust, low), 27.0, 6e-3)
        close(sides(plant.torque, plant), (torque, low_torque), 0.5, 6e-3)


def test_full_throttle_goes_on_as_the_map_does(pair):
    reference = pair.reference_V
    top = max(speeds_of(reference / VOLTS, reference / VOLTS))
    assert pair.speed_max_rpm == pytest.approx(top, rel=0.01)
    edge, beyond = (pair.loads(*(np.array([1.0, 1.0]) * s)) for s in (1.0, 1.2))
    assert beyond == pytest.approx(edge * 1.44, rel=0.01)
    assert pair.watts(1.2, 1.2) == pytest.approx(pair.watts(1.0, 1.0) * 1.2**3, rel=0.02)


def test_a_rotor_at_rest_leaves_the_other_its_own(pair):
    """And is nothing itself but what the other one's wake does to it."""
    assert np.abs(pair.loads(0.0, 0.0)).max() < 1e-3 and not pair.watts(0.0, 0.0).any()
    assert not pair.turned(0.0, 0.0).any()
    n = 0.8 * pair.speed_max_rpm
    thrust, torque, *_ = loads_of(n, 0.0)
    alone = pair.loads(0.8, 0.0)
    assert alone[:2] == pytest.approx([thrust, torque], rel=0.03)
    assert alone[2] == pytest.approx(loads_of(n, 0.0)[2], abs=0.8) and alone[2] < -1.0
    assert pair.watts(0.8, 0.0)[0] > 100.0 and pair.watts(0.8, 0.0)[1] == 0.0
    slow = pair.turned([0.0, 0.02, 0.04], 0.0)[0]
    assert slow == pytest.approx([0.0, slow[2] / 2, slow[2]], abs=1e-3) and slow[2] > 0.0


def test_single_rotors_of_a_map_lift(pair):
    plant = turned(fed(pair, VOLTS, EXAMPLES / "mixed_hexa.toml"), 0.6, 0.6)
    single = np.flatnonzero(plant.vehicle.level == 2)
    assert single.size and plant.thrust[single].min() > 0.9 * float(loads_of(speeds_of(0.6, 0.0)[0], 0.0)[0])


def test_the_pack_fits_the_map_and_sags(pair, rows, tmp_path):
    small = dict(rows, volts=rows["volts"] / 2)
    assert pair.cells == 6 and read_pair(written(tmp_path / "3s.csv", small)).cells == 3
    plant = Plant(read_vehicle(X8), pair)
    assert plant.voltage > pair.reference_V
    plant.state[2] = -1e4
    full, speeds = plant.voltage, []
    for charge in (0.95, 0.15):
        plant.swap_battery(charge)
        turned(plant, 0.8, 0.8)
        speeds.append(sides(plant.speeds * pair.speed_max_rpm, plant))
        volts = plant.voltage
        close(speeds[-1], speeds_of(0.8 * volts / VOLTS, 0.8 * volts / VOLTS), 7000.0, 6e-3)
    assert volts < full - 2.0 and speeds[1][0] < speeds[0][0] - 300.0


def test_effects_of_pack_winding_air_and_damage_act_on_a_map(pair):
    plain = turned(fed(pair, 19.0), 0.7, 0.7)
    governed = turned(fed(pair, 19.0, X8, HiddenEffect("battery_voltage", 0.0)), 0.7, 0.7)
    close(sides(governed.speeds, governed), pair.turned(0.7, 0.7), 1.0, 2e-3)
    assert plain.speeds.max() < governed.speeds.max() - 0.05
    warm = fed(pair, 19.0, X8, HiddenEffect("motor_heating", 0.1))
    warm.windings[:] = 100.0
    turned(warm, 0.7, 0.7)
    assert 0.85 * plain.speeds.max() < warm.speeds.max() < 0.95 * plain.speeds.max()
    high = HiddenEffect("air_density", 1.0, extra={"altitude_m": 3000.0})
    thin = turned(fed(pair, 19.0, X8, high), 0.7, 0.7)
    ratio = thin.thrust[0] / plain.thrust[0]
    assert ratio == pytest.approx(70109.0 / 101325.0, rel=1e-3)  # the standard atmosphere's pressures
    assert thin.rotor_watts() == pytest.approx(ratio * plain.rotor_watts(), rel=1e-6)
    assert thin.current - 1.0 == pytest.approx(ratio * (plain.current - 1.0), rel=1e-3)
    worn = turned(fed(pair, 19.0, X8, HiddenEffect("degraded_rotor", 0.2, extra={"rotor": 1})), 0.7, 0.7)
    assert worn.rotor_watts()[0] == pytest.approx(0.88 * plain.rotor_watts()[0], rel=1e-6)


def test_own_columns_without_amps_pay_for_the_shaft(pair, rows, tmp_path):
    """A first column without a name, rows twice, an empty cell and words of remarks do no harm."""
    path = own_columns(tmp_path / "own.csv", rows)
    plain = read_pair(path)
    head, *lines = path.read_text().splitlines()
    broken = lines[50].split(",")
    broken[4] = ""
    table = ["," + head + ",remark", *(f"{i},{x},calm" for i, x in enumerate([*lines, *lines]))]
    table.append("," + ",".join(broken) + ",")
    path.write_text("\n".join(table))
    own = read_pair(path)
    u, v = rows["n"] / own.speed_max_rpm, rows["m"] / own.speed_max_rpm
    assert own.loads(u, v) == pytest.approx(plain.loads(u, v), abs=1e-6)
    close(own.loads(u, v)[2], rows["low"], 27.0, 3e-3)
    close(own.watts(u, v)[0], rows["torque"] * rows["n"] * RAD / 0.8, 450.0, 3e-3)


def test_a_map_that_is_none_is_one_line(rows, tmp_path):
    path = written(tmp_path / "MAP.csv", rows)
    head, rest, *lines = path.read_text().splitlines()
    line = np.linspace(0.1, 0.9, 40)
    diagonal = dict(zip("cd", (line, line), strict=True))
    n, m = speeds_of(line, line)
    loads = dict(zip(("thrust", "torque", "low", "low_torque"), loads_of(n, m), strict=True))
    amps = {"volts": np.full(40, 22.0), "amps": n / 400, "low_amps": m / 400}
    written(tmp_path / "line.csv", {**diagonal, "n": n, "m": m, **loads, **amps})
    bad = {
        "lie on a line": (tmp_path / "line.csv").read_text(),
        "at least make a map": "\n".join([head, rest, *lines[:12]]),
        "upper_throttle": "",
        "lower_rpm": "\n".join([head.replace("Speed Right", "Pace"), *lines]),
        "row 3: 13 cells are expected, found 14": "\n".join([head, rest, lines[0] + ",1", *lines]),
        "13 cells are expected, found 6": "\n".join([head, *(",".join(x.split(",")[:6]) for x in lines)]),
        "a number is expected, found 'fast'": "\n".join([head, rest, lines[0].rpartition(",")[0] + ",fast"]),
    }
    for named, text in bad.items():
        path.write_text(text)
        with pytest.raises(SimulationError) as caught:
            read_pair(path)
        assert named in str(caught.value) and "\n" not in str(caught.value)


# rotor files


DRIVE = """
[drive]
voltage_V = 22.0
[drive.upper]
command = [0.02, 0.55, 0.25]
torque_per_Nm = 0.05
range = [0.1, 0.95]
[battery_power.upper]
constant = 3.0
per_Nm2 = 20.0
shaft = 1.05
"""


def driven(tmp_path, more):
    path = tmp_path / "rotor.toml"
    path.write_text((EXAMPLES / "rotor_paper.toml").read_text() + more)
    return read_pair(path)


def test_a_rotor_file_flies_with_its_drive_and_its_watts(tmp_path):
    pair = driven(tmp_path, DRIVE)
    for c, d, volts in ((0.3, 0.5, 22.0), (0.7, 0.7, 22.0), (0.8, 0.4, 19.8)):
        plant = turned(fed(pair, volts), c, d)
        speeds, torques = sides(plant.speeds, plant), sides(plant.torque, plant)
        for command, u, torque, watts in zip(
            (c, d), speeds, torques, sides(plant.rotor_watts(), plant), strict=True
        ):
            determined = 0.02 + 0.55 * u + 0.25 * u * u + 0.05 * torque
            assert determined == pytest.approx(command * volts / 22.0, abs=4e-3)
            rate = u * pair.speed_max_rpm * RAD
            assert watts == pytest.approx(3.0 + 20.0 * torque**2 + 1.05 * torque * rate, rel=5e-3)
    first = pair.turned(0.1, 0.5)[0]
    assert pair.turned(0.05, 0.5)[0] == pytest.approx(0.5 * first, abs=2e-3) and first > 0.05


def test_an_older_files_curve_is_flown(tmp_path):
    pair = driven(tmp_path, "[identified.rpm_over_throttle]\nupper = [300.0, 7000.0, -2000.0]\n")
    for side in pair.turned([0.4, 0.9], [0.4, 0.9]) * pair.speed_max_rpm:
        assert side == pytest.approx([2780.0, 4980.0], rel=2e-3)


def test_a_drive_that_is_none_is_one_line(tmp_path):
    side = "[drive.upper]\ncommand = "
    for text, named in (
        ("[drive]\n", "drive: upper or lower"),
        ("[drive]\nvoltage_V = 0\nupper = {command = [0, 1]}\n", "drive.voltage_V"),
        (side + "[0.5, 0]\n", "drive.upper.command: commands are expected to rise"),
        (side + "[0, 1]\nrange = [0.9, 0.1]\n", "drive.upper.range"),
        (side + "[0, 1]\nrange = 3\n", "drive.upper.range"),
        (side + "[0, nan]\n", "drive.upper.command"),
        (side + "[0, 1]\nbend = 2\n", "drive.upper.bend"),
        ("[drive]\nupper = 3\n", "drive.upper"),
        ("[battery_power]\nupper = 3\n", "battery_power.upper"),
        ("[battery_power.upper]\nshaft = 'all'\n", "battery_power.upper.shaft"),
        ("[identified]\nrpm_over_throttle = 4\n", "identified.rpm_over_throttle"),
        ("[identified.rpm_over_throttle]\nupper = 4\n", "identified.rpm_over_throttle.upper"),
    ):
        with pytest.raises(SimulationError) as caught:
            driven(tmp_path, text)
        assert named in str(caught.value) and "\n" not in str(caught.value), text


# the stand-ins


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_it_hovers_and_its_escs_tell_each_rotors_own_amps(pair, rows, tmp_path, firmware):
    light = tmp_path / "x8.toml"
    light.write_text(X8.read_text().replace("mass_kg = 20.0", "mass_kg = 8.0"))
    hovering(light, written(tmp_path / "MAP.csv", rows), firmware)


def hovering(frame, rotor, firmware):
    """Take off, hover, and hold what ESCs tell against the plant."""
    pilot = Pilot(firmware, frame=frame, rotor=rotor)
    pilot.climb()
    pilot.run(8.0)
    plant = pilot.autopilot.plant
    assert plant.height == pytest.approx(3.2, abs=0.4) and np.abs(plant.rates).max() < 0.1
    assert plant.thrust.sum() == pytest.approx(9.80665 * plant.vehicle.mass_kg, rel=0.02)
    determined = reported_escs(pilot.autopilot)
    assert determined is not None and sum(determined.amps) == pytest.approx(plant.current - 1.0, rel=0.05)
    assert determined.rpm == pytest.approx(list(plant.speeds * plant.pair.speed_max_rpm), rel=0.02)
    upper, lower = sides(np.array(determined.amps), plant)
    assert abs(upper - lower) > 0.02 * (upper + lower)


# real pairs


REAL = ("mn4014_16in_zD055.csv", "propdrive_11in_zD055.csv", "u5_16in_zD05.csv")


def platform(path):
    """The rows of a real map in which both rotors turn."""
    table = np.genfromtxt(
        path, delimiter=",", names=True, deletechars="", replace_space=" ", encoding="utf-8-sig"
    )
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    names = ("c", "d", "n", "m", "thrust", "low", "volts", "low_volts", "amps", "low_amps")
    heads = ("PWM Left", "PWM Right", "Speed Left [rpm]", "Speed Right [rpm]", "Thrust Left [g]")
    heads += ("Thrust Right [g]", "Voltage Left [V]", "Voltage Right [V]", "Current Left [A]")
    heads += ("Current Right [A]",)
    rows = {name: table[head] for name, head in zip(names, heads, strict=True)}
    for name in ("c", "d"):
        rows[name] = rows[name] / 1000.0 - 1.0
    for name in ("thrust", "low"):
        rows[name] = rows[name] * 9.80665e-3
    keep = (rows["c"] > 0.02) & (rows["d"] > 0.02) & (rows["n"] > 1.0) & (rows["m"] > 1.0)
    return {name: values[keep] for name, values in rows.items()}, lines[0], np.array(lines[1:])[keep]


def held(pair, rows, share):
    """Speeds, thrusts and watts of rows within a share of full scale, by root mean square."""
    reference, top = pair.reference_V, pair.speed_max_rpm
    turns = pair.turned(rows["c"] * rows["volts"] / reference, rows["d"] * rows["low_volts"] / reference)
    loads = pair.loads(rows["n"] / top, rows["m"] / top)
    watts = pair.watts(rows["n"] / top, rows["m"] / top)
    drawn = (rows["volts"] * rows["amps"], rows["low_volts"] * rows["low_amps"])
    alone = [
        other < 0.1 * other.max() for other in drawn[::-1]
    ]  # this stand's sensors read each other's current
    for found, wanted, full in (
        (turns[0] * top, rows["n"], top), (turns[1] * top, rows["m"], top),
        (loads[0], rows["thrust"], 30.0 if top < 7000 else 16.0),
        (loads[2], rows["low"], 30.0 if top < 7000 else 16.0),
        *((watts[k][alone[k]], drawn[k][alone[k]], 1.5 * drawn[k].max()) for k in (0, 1)),
    ):  # fmt: skip  # currents repeat less well than speeds and thrusts
        assert math.sqrt(float(np.mean((found - wanted) ** 2))) < share * full


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
@pytest.mark.shared_data
@pytest.mark.skipif(not COAX.is_dir(), reason="needs the real stand data beside the repository")
def test_a_real_map_is_its_rows_and_those_that_were_left_out(name, tmp_path):
    rows, head, lines = platform(COAX / name)
    held(read_pair(COAX / name), rows, 0.01)  # the rows themselves repeat to half a per cent
    out = np.arange(len(lines)) % 7 == 3
    part = tmp_path / "MAP.csv"
    part.write_text("\n".join([head, *lines[~out]]))
    held(read_pair(part), {key: values[out] for key, values in rows.items()}, 0.025)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
@pytest.mark.shared_data
@pytest.mark.skipif(not COAX.is_dir(), reason="needs the real stand data beside the repository")
def test_a_real_pair_hovers(firmware, tmp_path):
    frame = tmp_path / "x8.toml"
    frame.write_text(X8.read_text().replace("mass_kg = 20.0", "mass_kg = 8.2"))
    hovering(frame, COAX / "mn4014_16in_zD055.csv", firmware)
