"""Which rotor, in whose wake, in which units: identified by the loads, or refused; never a wrong rotor."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table
from stand_files import SIDES, UNITS, Array, Pair, equal, grid, readings, table, write

from coaxlink.data import RotorsUnclear, Samples, read_stand_log
from coaxlink.data.sides import exchanged
from coaxlink.data.unit_check import electrical_turns, other_units
from coaxlink.errors import InputError
from coaxlink.rotor.identification import identify
from coaxlink.rotor.log_checks import poor_errors

DRAWS = 150
PAIR = Pair(0.4, 0.09, 0.65, 6000.0)
TRUE = readings(PAIR, *grid(), 1)
AT_EQUAL = readings(PAIR, *equal(), 1)
OUR_UNITS = {"speed": "rpm", "thrust": "N", "torque": "N m", "current": "A", "voltage": "V"}
ALL = tuple(OUR_UNITS)
LOADS = ("speed", "thrust", "torque")
STYLES = {
    "own": ("{side}_rpm", "{side}_thrust_N", "{side}_torque_Nm", "{side}_current_A", "{side}_voltage_V"),
    "words": tuple(f"{{Side}} {q} [{u}]" for q, u in OUR_UNITS.items()),
    "letters": (
        "Motor Optical Speed {letter} (RPM)",
        "Thrust {letter} (N)",
        "Torque {letter} (N·m)",
        "Current {letter} (A)",
        "Voltage {letter} (V)",
    ),
    "numbers": (
        "Powertrain {number} - rotation speed (rpm)",
        "Powertrain {number} - force Fz (thrust) (N)",
        "Powertrain {number} - torque MZ (torque) (N⋅m)",
        "Powertrain {number} - current (A)",
        "Powertrain {number} - voltage (V)",
    ),
}


def columns_of(
    given: dict[str, Array],
    style: str = "letters",
    quantities: tuple[str, ...] = ALL,
    order: tuple[str, ...] = SIDES,
) -> dict[str, Array]:
    """Columns under a style's headings; the first side of `order` is A and 1."""
    columns = {}
    for side, letter, number in zip(order, "AB", "12", strict=True):
        for quantity, heading in zip(ALL, STYLES[style], strict=True):
            if quantity in quantities:
                text = heading.format(side=side, Side=side.title(), letter=letter, number=number)
                columns[text] = given[f"{side}_{quantity}"]
    return columns


def put(folder: Path, columns: dict[str, Array]) -> Path:
    return write(folder / "log.csv", table(columns))


def wrong(log: Samples, true: dict[str, Array]) -> list[str]:
    """The columns of a log that are not the truth's within 2 per cent of their greatest."""
    names = {"rpm": "speed", "thrust_N": "thrust", "torque_Nm": "torque"}
    off = {
        f"{side}_{ours}": np.abs(log[f"{side}_{ours}"] - true[f"{side}_{q}"]).max()
        / np.abs(true[f"{side}_{q}"]).max()
        for side in SIDES
        for ours, q in names.items()
    }
    return [name for name, error in off.items() if error > 0.02]


def test_letters_are_identified_by_the_data(tmp_path: Path) -> None:
    with case_table() as case:
        for rows in (TRUE, AT_EQUAL):
            for order in (SIDES, SIDES[::-1]):
                for style in ("letters", "numbers"):
                    with case(f"{style} {order} {len(rows['upper_speed'])}"):
                        log = read_stand_log(put(tmp_path, columns_of(rows, style, LOADS, order)))
                        assert wrong(log, rows) == []
                        reported = " ".join(log.notes)
                        assert "by the data" in reported and "% of the thrust of" in reported


def test_what_the_rows_do_not_show_is_not_guessed(tmp_path: Path) -> None:
    without_torque = columns_of(AT_EQUAL, quantities=("speed", "thrust"))
    u, v = grid()
    apart = TRUE | {"lower_thrust": 25.0 * v**2, "lower_torque": 0.4 * v**2}
    apart |= {"upper_thrust": 25.0 * u**2, "upper_torque": 0.4 * u**2}
    for columns in (without_torque, columns_of(apart, quantities=LOADS)):
        with pytest.raises(RotorsUnclear, match="`upper` A or `upper` B") as caught:
            read_stand_log(put(tmp_path, columns))
        assert caught.value.labels == ("A", "B")
        assert read_stand_log(tmp_path / "log.csv", upper="a").has("lower_thrust_N")


def test_a_weaker_upper_propeller_is_not_taken_for_the_lower_one(tmp_path: Path) -> None:
    small = 0.9  # of the diameter: thrust with its fourth power, torque with its fifth
    weak = AT_EQUAL | {"upper_thrust": AT_EQUAL["upper_thrust"] * small**4}
    weak |= {"upper_torque": AT_EQUAL["upper_torque"] * small**5}
    with contextlib.suppress(RotorsUnclear):
        assert read_stand_log(put(tmp_path, columns_of(weak, quantities=LOADS))).upper_label == "A"


def test_what_no_propeller_reads_is_refused_and_no_unit_is_put_against_a_heading(tmp_path: Path) -> None:
    """What would fit is a factor: a unit against the heading was followed in silence, whatever was wrong."""
    with case_table() as case:
        for quantity, unit in (
            ("thrust", "kgf"),
            ("thrust", "gf"),
            ("torque", "N cm"),
            ("torque", "kgf cm"),
            ("speed", "rad/s"),
            ("speed", "rev/s"),
        ):
            for sides in (SIDES, SIDES[:1]):
                factor = UNITS[quantity][unit]
                given = TRUE | {f"{side}_{quantity}": TRUE[f"{side}_{quantity}"] * factor for side in sides}
                path = put(tmp_path, columns_of(given, quantities=LOADS))
                refused = pytest.raises(InputError, match="no propeller")
                with case(f"{quantity} of {sides} in {unit}"), refused as caught:
                    read_stand_log(path, upper="A", trust_units=False, diameter_m=0.4)
                reported, whose = str(caught.value), "" if sides == SIDES else " of the upper rotor"
                assert "unit =" not in reported and "as they stand" in reported
                fits = re.search(rf"the {quantity}{whose} times ([-+.e0-9]+) to ([-+.e0-9]+)", reported)
                assert fits is not None, reported
                assert 0.9 * float(fits[1]) <= 1 / factor <= 1.1 * float(fits[2])


def test_a_stand_is_asked_about_before_its_units(tmp_path: Path) -> None:
    powers = ("speed", "thrust", "torque", "current", "voltage")
    noise = 1e-4 * np.random.default_rng(1).standard_normal(len(TRUE["upper_speed"]))
    for changed, asked in (
        ({f"{s}_speed": 0.002 * TRUE[f"{s}_speed"] for s in SIDES}, "did the upper rotor turn?"),
        ({"upper_thrust": 0.02 + noise}, "is the cell dead"),
        ({f"{s}_speed": 2.0 * TRUE[f"{s}_speed"] for s in SIDES}, "is the speed counted twice"),
        ({"lower_speed": 2.0 * TRUE["lower_speed"]}, "is the lower rotor's speed counted twice"),
    ):
        path = put(tmp_path, columns_of(TRUE | changed, "words", powers))
        with pytest.raises(InputError, match=re.escape(asked)) as caught:
            read_stand_log(path, trust_units=False)
        assert "unit" not in str(caught.value).replace("trust_units", "")
        if "twice" in asked:  # the map that it carries mends it
            (tmp_path / "map.toml").write_text(caught.value.map)
            log = read_stand_log(path, tmp_path / "map.toml", trust_units=False)
            assert wrong(log, TRUE) == []


def test_a_refusal_for_headings_carries_a_map_that_can_be_pasted(tmp_path: Path) -> None:
    columns = {"t [s]": np.arange(float(len(TRUE["upper_speed"])))}
    for letter, side, sign in (("A", "upper", 1), ("B", "lower", -1)):
        columns[f"n_{letter}"] = TRUE[f"{side}_speed"]
        columns[f"LC_{letter} [gf]"] = TRUE[f"{side}_thrust"] / 9.80665e-3
        columns[f"Mz_{letter} [N\u00b7cm]"] = sign * 100 * TRUE[f"{side}_torque"]
    path = put(tmp_path, columns)
    with pytest.raises(InputError, match="unit of a speed expected") as caught:
        read_stand_log(path, trust_units=False)
    reported = caught.value.map
    assert "\n" not in str(caught.value)
    assert 'upper_thrust_N = { column = "LC_A [gf]", unit = "gf" }' in reported.splitlines()
    assert "# A is taken for the upper rotor" in reported and "make sure of upper_rpm" in reported
    (tmp_path / "map.toml").write_text(reported)
    log = read_stand_log(path, tmp_path / "map.toml", trust_units=False)
    assert wrong(log, TRUE) == [] and "sign of lower_torque_Nm turned" in log.notes
    cells = {heading: values for heading, values in columns.items() if heading.startswith("LC")}
    path = put(tmp_path, columns_of(TRUE, quantities=("speed", "torque")) | cells)
    with pytest.raises(InputError, match="column upper_thrust_N: missing") as caught:
        read_stand_log(path, upper="B", trust_units=False).require("upper_thrust_N")
    assert 'upper_thrust_N = { column = "LC_B [gf]", unit = "gf" }' in caught.value.map


def test_a_torque_in_no_unit_of_a_torque_is_named_with_the_line_that_mends_it(tmp_path: Path) -> None:
    columns = columns_of(TRUE, "words", ("speed", "thrust"))
    columns |= {f"{s} torque (kgf)": TRUE[f"{s}_torque"] for s in SIDES}
    with pytest.raises(InputError, match=r"upper_torque_Nm = .* unit = \"N m\""):
        read_stand_log(put(tmp_path, columns))


def test_a_unit_that_is_not_written_is_taken_where_only_one_fits(tmp_path: Path) -> None:
    def without_unit(factor: float) -> Path:
        columns = columns_of(TRUE, quantities=LOADS)
        return put(
            tmp_path, {n.replace(" (N)", ""): x * (factor if "Thr" in n else 1) for n, x in columns.items()}
        )

    for unit in ("gf", "N"):
        log = read_stand_log(without_unit(UNITS["thrust"][unit]), diameter_m=0.4)
        assert wrong(log, TRUE) == [] and f"taken in {unit}" in " ".join(log.notes)
    with pytest.raises(InputError, match=r"Thrust A.*kgf.*unit ="):
        read_stand_log(without_unit(UNITS["thrust"]["kgf"]))


def test_every_unit_is_read_from_its_heading(tmp_path: Path) -> None:
    with case_table() as case:
        for quantity, units in UNITS.items():
            for unit in units:
                names = {**OUR_UNITS, quantity: unit}
                columns = {
                    f"{q} {side} ({names[q]})": TRUE[f"{side}_{q}"] * UNITS[q][names[q]]
                    for side in SIDES
                    for q in LOADS
                }
                with case(f"{quantity} in {unit}"):
                    assert (
                        wrong(read_stand_log(put(tmp_path, columns), poles=14, trust_units=False), TRUE) == []
                    )
    with pytest.raises(InputError, match="`poles`"):
        read_stand_log(put(tmp_path, {n.replace("(rpm)", "(erpm)"): x for n, x in columns.items()}))


def test_electrical_turns_under_rpm_are_refused_or_said(tmp_path: Path) -> None:
    turns = TRUE | {f"{s}_speed": 7.0 * TRUE[f"{s}_speed"] for s in SIDES}
    with pytest.raises(InputError, match=r"electrical turns \(`poles`\)"):
        read_stand_log(put(tmp_path, columns_of(turns, "words")), trust_units=False)
    silent = put(tmp_path, columns_of(turns, "words", LOADS))
    assert "electrical turns" in electrical_turns(read_stand_log(silent, trust_units=False))
    with pytest.raises(InputError):  # its size tells
        read_stand_log(silent, trust_units=False, diameter_m=0.4)
    right = read_stand_log(put(tmp_path, columns_of(TRUE, "words", LOADS)), trust_units=False)
    assert electrical_turns(right) == "" and other_units(right) == ""


def test_a_log_without_speeds_says_which_units_fit_as_well(tmp_path: Path) -> None:
    given = TRUE | {f"{s}_thrust": TRUE[f"{s}_thrust"] / 9.80665 for s in SIDES}
    columns = columns_of(given, "words", ("thrust", "torque"))
    columns |= {f"{s} throttle": TRUE[f"{s}_speed"] / TRUE[f"{s}_speed"].max() for s in SIDES}
    path = put(tmp_path, columns)
    assert "thrust in kgf" in other_units(read_stand_log(path, trust_units=False))
    with pytest.raises(InputError, match="the thrust times"):
        read_stand_log(path, trust_units=False, diameter_m=0.4)


def test_electrical_power_bounds_a_speed_that_was_not_measured(tmp_path: Path) -> None:
    columns = columns_of(TRUE, "own", ("thrust", "torque", "current", "voltage"))
    columns |= {f"{s}_throttle": TRUE[f"{s}_throttle"] for s in SIDES}
    assert read_stand_log(put(tmp_path, columns), trust_units=False).rows == len(TRUE["upper_speed"])
    columns |= {f"{s}_thrust_N": TRUE[f"{s}_thrust"] * 1000 / 9.80665 for s in SIDES}
    with pytest.raises(InputError, match="no propeller"):
        read_stand_log(put(tmp_path, columns), trust_units=False)


def test_two_rotors_of_one_quantity_never_become_one(tmp_path: Path) -> None:
    columns = {
        "Speed (rpm)": TRUE["upper_speed"],
        "Thrust motor (N)": TRUE["upper_thrust"],
        "Thrust engine (N)": TRUE["lower_thrust"],
        "Torque (N.m)": TRUE["upper_torque"],
    }
    with pytest.raises(InputError, match="both read thrust and differ: two rotors"):
        read_stand_log(put(tmp_path, columns))
    three = columns_of(TRUE) | {"Thrust C (N)": TRUE["upper_thrust"], "Speed C (rpm)": TRUE["upper_speed"]}
    with pytest.raises(InputError, match=r"3 rotors \(a, b, c\)"):
        read_stand_log(put(tmp_path, three))


def test_a_map_states_units_and_leaves_the_rest(tmp_path: Path) -> None:
    columns = columns_of(TRUE, quantities=LOADS)
    columns["Thrust B (N)"] = columns["Thrust B (N)"] / 4.4482216
    mapping = write(
        tmp_path / "map.toml",
        'upper_rpm = "Motor Optical Speed A (RPM)"\nlower_rpm = "Motor Optical Speed B (RPM)"\n'
        'upper_thrust_N = "Thrust A (N)"\nlower_thrust_N = { column = "Thrust B (N)", unit = "lbf" }\n',
    )
    log = read_stand_log(put(tmp_path, columns), mapping)
    np.testing.assert_allclose(log["lower_thrust_N"], TRUE["lower_thrust"], rtol=1e-4, atol=1e-3)
    assert not log.has("lower_torque_Nm")
    assert "left out (not in the map): Torque A (N·m), Torque B (N·m)" in log.notes


def spoiled(random: np.random.Generator, true: dict[str, Array]) -> tuple[dict[str, Array], str]:
    """Readings with rotors, units and signs exchanged at random, and what was done."""
    logged, done = dict(true), []
    if random.random() < 0.5:  # whole rotors under each other's name
        turned = {"upper": "lower", "lower": "upper"}
        logged = {turned[k[:5]] + k[5:]: x for k, x in true.items()}
        done.append("rotors")
    if random.random() < 0.5:
        quantity = str(random.choice(list(UNITS)))
        unit = str(random.choice([u for u in UNITS[quantity] if u not in ("N", "N m", "rpm")]))
        for side in SIDES if random.random() < 0.6 else (str(random.choice(SIDES)),):
            logged[f"{side}_{quantity}"] = logged[f"{side}_{quantity}"] * UNITS[quantity][unit]
            done.append(f"{side} {quantity} in {unit}")
    for name in [f"{s}_{q}" for s in SIDES for q in ("thrust", "torque")]:
        if random.random() < 0.25:
            logged[name] = -logged[name]
            done.append(f"-{name}")
    return logged, ", ".join(done)


def taken(path: Path) -> Samples | None:
    """The log as `identify` takes it, None where it refuses."""
    try:
        log = read_stand_log(path, trust_units=False)
    except InputError as error:
        assert "\n" not in str(error)
        return None
    return log if exchanged(log) is None else None


@pytest.mark.slow
def test_no_draw_gives_a_wrong_rotor(tmp_path: Path) -> None:
    """Propellers, styles and mistakes at random: the right rotor or a refusal, and sound logs are read."""
    read = 0
    with case_table() as case:
        for seed in range(DRAWS):
            random = np.random.default_rng(seed)
            diameter = random.uniform(0.2, 0.75)
            rpm = 60 * random.uniform(60, 170) / (np.pi * diameter)
            coefficients = random.uniform(0.05, 0.14), random.uniform(0.5, 0.75)
            pair = Pair(diameter, *coefficients, rpm, random.uniform(0.25, 0.45))
            rows = grid(int(random.integers(5, 9))) if random.random() < 0.75 else equal()
            true = readings(pair, *rows, seed)
            logged, done = spoiled(random, true)
            columns = columns_of(logged, str(random.choice(list(STYLES))))
            if random.random() < 0.5:
                columns = dict(reversed(columns.items()))
            log = taken(put(tmp_path, columns))
            read += log is not None
            with case(f"{seed} {done}"):
                assert wrong(log, true) == [] if log else done
    assert read > 0.25 * DRAWS


@pytest.mark.slow
def test_letters_on_poor_logs_are_right_or_refused(tmp_path: Path) -> None:
    """Sparse or one-sided logs of unequal propellers that feel each other both ways."""
    decided = 0
    for seed in range(100):
        random = np.random.default_rng(10_000 + seed)
        diameter = random.uniform(0.1, 0.8)
        rpm = 60 * random.uniform(50, 180) / (np.pi * diameter)
        coefficients = random.uniform(0.045, 0.16), random.uniform(0.4, 0.78)
        pair = Pair(diameter, *coefficients, rpm, random.uniform(0.15, 0.5))
        ramp = np.linspace(0.3, 1, 25)
        beside = np.clip(ramp * random.uniform(0.8, 1.25) + 0.02 * random.standard_normal(25), 0.05, 1)
        scattered = random.uniform(0.2, 1, (2, int(random.integers(15, 120))))
        u, v = (grid(4), equal(int(random.integers(8, 40))), (ramp, beside), tuple(scattered))[seed % 4]
        true = readings(pair, u, v, seed, float(random.choice([0.003, 0.01, 0.03])))
        true["upper_thrust"] = true["upper_thrust"] * (1 - random.uniform(0, 0.08) * v / np.maximum(u, 0.2))
        size = random.uniform(0.8, 1.25)  # of the lower propeller
        for name, power in (("lower_thrust", 4), ("lower_torque", 5), ("lower_current", 5)):
            true[name] = true[name] * size**power
        order = SIDES if random.random() < 0.5 else SIDES[::-1]
        log = taken(put(tmp_path, columns_of(true, order=order)))
        decided += log is not None
        assert log is None or not wrong(log, true), seed
    assert decided > 50


@pytest.mark.slow
def test_a_rotor_alone_whose_model_misses_what_it_has_not_seen(tmp_path: Path) -> None:
    u = np.linspace(0.2, 1.0, 60)
    for scatter, poor in ((0.005, False), (0.15, True)):
        noise = 1 + scatter * np.random.default_rng(3).standard_normal((2, 60))
        columns = {
            "Speed (rpm)": 6000 * u,
            "Thrust (N)": 25 * u**2 * noise[0],
            "Torque (N m)": 0.4 * u**2 * noise[1],
        }
        found = identify(read_stand_log(put(tmp_path, columns)), "srm")
        assert any("upper_thrust" in line for line in poor_errors(found)) == poor
