"""Stand files as people have them (`people_stands`): the right loads under the right rotor, or an answer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from case_table import case_table
from people_stands import (
    ALONE,
    PAIR,
    PROSE,
    SEEN,
    Columns,
    both,
    file,
    home,
    one_cell,
    one_cell_alone_too,
    only_sum_and_a,
    power_only,
    rcbenchmark_1520,
    rcbenchmark_1580,
    sheet,
    signal,
    total,
    tyto_1780,
    words,
)
from stand_files import G, grid

from coaxlink.data import read_stand_log
from coaxlink.data.join import join
from coaxlink.data.single import read_single_table
from coaxlink.errors import InputError
from coaxlink.rotor.identification import identify
from coaxlink.rotor.pair_sum import OPEN, is_pair, of_each_rotor, pair_sum

TORQUES = [
    ("N m", "N m"), ("N m", "N·m"), ("N cm", "N cm"), ("N cm", "Ncm"), ("N cm", "cNm"), ("N mm", "mN·m"),
    ("N mm", "N.mm"), ("kgf cm", "kg cm"), ("kgf cm", "kgf·cm"), ("kgf cm", "kg*cm"), ("gf cm", "g cm"),
    ("gf cm", "g*cm"), ("gf cm", "gf.cm"), ("ozf in", "oz in"), ("ozf in", "in-oz"), ("lbf in", "in·lbf"),
    ("lbf ft", "lb-ft"),
]  # fmt: skip
PAIRS: dict[str, tuple[Columns, dict]] = {
    "Tyto 1780 with its sums": (tyto_1780(), {}),
    "Tyto 1780 in gf and ozf in": (tyto_1780("gf", "ozf in"), {}),
    "Tyto 1780 in pounds": (tyto_1780("lbf", "lbf in"), {}),
    "Tyto 1780, sum and one rotor": (only_sum_and_a(), {}),
    **{f"torque in {written}": (home(unit, written), {}) for unit, written in TORQUES},
    "ESC signal in us": (signal(False), {}),
    "ESC signal in percent": (signal(True), {}),
    "columns of words": (words(), {}),
    "words between tabs": (words(), {"mark": "\t"}),
    "a header of prose": (signal(False), {"before": PROSE}),
    "semicolons and decimal commas under prose": (
        signal(True),
        {"mark": ";", "comma": True, "before": PROSE},
    ),
}
ALONES: dict[str, Columns] = {
    "RCbenchmark 1520": rcbenchmark_1520(),
    "RCbenchmark 1580": rcbenchmark_1580("N m", "N·m"),
    "RCbenchmark 1580 in g cm": rcbenchmark_1580("gf cm", "g·cm"),
    "RCbenchmark 1580 in kgf cm": rcbenchmark_1580("kgf cm", "kgf·cm"),
    "RCbenchmark 1580 in oz in": rcbenchmark_1580("ozf in", "oz-in"),
}


def same(log, of: dict, names: tuple[str, ...]) -> None:
    for name in names:
        unit = {"thrust": "_N", "torque": "_Nm"}.get(name.split("_")[1], "")
        column = name.replace("speed", "rpm") + unit
        if log.has(column):
            np.testing.assert_allclose(log[column], of[name], rtol=1e-4, atol=1e-4, err_msg=column)


@pytest.mark.slow
def test_pairs(tmp_path: Path) -> None:
    assert len(PAIRS) + len(ALONES) > 25
    names = tuple(f"{s}_{q}" for s in ("upper", "lower") for q in ("thrust", "torque", "speed", "throttle"))
    with case_table() as case:
        for name, (columns, how) in PAIRS.items():
            with case(name):
                log = read_stand_log(file(tmp_path, columns, **how), trust_units=False)
                assert log.rows == len(SEEN["upper_thrust"])
                assert log.has("upper_thrust_N", "lower_thrust_N", "upper_torque_Nm", "lower_torque_Nm")
                same(log, SEEN, names)


def test_rotors_alone(tmp_path: Path) -> None:
    with case_table() as case:
        for name, columns in ALONES.items():
            with case(name):
                log = read_stand_log(file(tmp_path, columns), trust_units=False)
                assert log.has("upper_thrust_N") and not log.has("lower_thrust_N")
                same(log, ALONE, ("upper_thrust", "upper_torque", "upper_speed"))


def test_makers_sheets_typed_as_csv(tmp_path: Path) -> None:
    with case_table() as case:
        for kind in ("T-Motor", "T-Motor with torque", "KDE", "MAD", "other makers"):
            for how in ({}, {"mark": ";", "comma": True}, {"before": PROSE}):
                with case(f"{kind} {how}"):
                    found = read_single_table(file(tmp_path, sheet(kind), **how), PAIR.diameter)
                    share = found.rpm / PAIR.top_rpm
                    true = PAIR.loads(share, 0 * share)
                    np.testing.assert_allclose(found.thrust_N, true["upper_thrust"], rtol=0.03)
                    assert found.power_W is not None or found.torque_Nm is not None


def test_sums_are_told_by_name_and_by_arithmetic(tmp_path: Path) -> None:
    sums = {"Thrust A + B (kgf)": 1.0, "Total thrust (kgf)": 1.0, "Combined Thrust [kgf]": 1.0}
    own = {k: v for k, v in tyto_1780(sums=False).items() if k != "App message"}
    with case_table() as case:
        for heading, factor in sums.items():
            with case(heading):
                columns = own | {heading: factor * total("thrust") / G}
                notes = read_stand_log(file(tmp_path, columns), trust_units=False).notes
                assert f"'{heading}' left out: the rotors' own columns added" in notes
    wrong = own | {"Thrust A + B (kgf)": 2 * total("thrust") / G}
    notes = read_stand_log(file(tmp_path, wrong), trust_units=False).notes
    assert "'Thrust A + B (kgf)' left out: not what the rotors' own columns add up to" in notes


@pytest.mark.slow
def test_one_cell_under_the_pair_is_a_model_of_the_sum(tmp_path: Path) -> None:
    signals = {f"{s} ESC (us)": 1000 + 1000 * x for s, x in zip(("upper", "lower"), grid(), strict=True)}
    by_signals = signals | {"Thrust (N)": total("thrust"), "Torque (N m)": total("torque")}
    with case_table() as case:
        for name, columns in {
            "unlabelled": one_cell(),
            "total, kgf": one_cell("Total thrust (kgf)", factor=1 / G),
            "a torque in N": one_cell(torque="Torque (N)"),
            "ESC signals, no rpm": by_signals,
        }.items():
            with case(name):
                log = read_stand_log(file(tmp_path, columns), trust_units=False)
                assert is_pair(of_each_rotor(log))
                found = pair_sum(log)
                u, v = grid()
                reported = found.fits["pair_thrust_N"].predict(u, v)
                loads = PAIR.loads(u, v)
                np.testing.assert_allclose(
                    reported, loads["upper_thrust"] + loads["lower_thrust"], atol=0.02 * reported.max()
                )
                assert ("pair_torque_Nm" in found.fits) == (name != "a torque in N")
                with pytest.raises(InputError, match="both rotors together"):
                    identify(log, "rcrm")
    assert "the upper rotor alone" in OPEN[1]


def test_a_pair_of_which_no_sum_can_be_told_is_one_line(tmp_path: Path) -> None:
    still = one_cell() | {"Top Motor Speed (rpm)": np.full(len(SEEN["upper_speed"]), 3000.0)}
    hole = [""] + [f"{x:.6g}" for x in total("thrust")[1:]]
    with case_table() as case:
        for words_, columns in {
            "6 rows in which both speeds vary are expected": still,
            "line 2, column 'Thrust (N)': a number is expected": one_cell() | {"Thrust (N)": hole},
            'pair_thrust_N = { column = "Thrust (stone)"': one_cell("Thrust (stone)"),
        }.items():
            with case(words_):
                with pytest.raises(InputError) as caught:
                    pair_sum(read_stand_log(file(tmp_path, columns), trust_units=False))
                assert words_ in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.slow
def test_the_run_of_the_upper_rotor_alone_tells_the_split(tmp_path: Path) -> None:
    first = read_stand_log(file(tmp_path, one_cell()), trust_units=False)
    alone = {k: np.asarray(v)[len(SEEN["upper_thrust"]) :] for k, v in one_cell_alone_too().items()}
    second = read_stand_log(file(tmp_path, alone, name="alone.csv"), trust_units=False)
    u, v = grid()
    true = PAIR.loads(u, v)
    whole = read_stand_log(file(tmp_path, one_cell_alone_too()), trust_units=False)
    with case_table() as case:
        for name, log in {"one file": whole, "joined": join([first, second])}.items():
            with case(name):
                model = identify(log, "crm", speed_max_rpm=PAIR.top_rpm, compare=False).model
                loads = model.loads(u, v)
                for load, values in true.items():
                    found = getattr(loads, load)
                    assert np.abs(found - values).max() < 0.04 * np.abs(values).max(), load


@pytest.mark.slow
def test_power_stands_for_a_torque_that_no_cell_reads(tmp_path: Path) -> None:
    log = read_stand_log(file(tmp_path, power_only()), trust_units=False)
    found = identify(log, "crm", speed_max_rpm=PAIR.top_rpm, compare=False)
    u, v = grid()
    loads, true = found.model.loads(u, v), PAIR.loads(u, v)
    assert np.abs(loads.lower_torque - true["lower_torque"]).max() < 0.1 * true["lower_torque"].max()
    assert any("a torque cell measures it" in note for note in found.data.samples.notes)
    bare = {k: x for k, x in power_only().items() if "Current" not in k}
    with pytest.raises(InputError, match="upper_current_A with a voltage"):
        identify(read_stand_log(file(tmp_path, bare)), "crm")


def test_a_sum_mapped_as_the_upper_rotors_thrust_is_refused(tmp_path: Path) -> None:
    map_file = tmp_path / "map.toml"
    map_file.write_text(
        'upper_rpm = "Top Motor Speed (rpm)"\nlower_rpm = "Bottom Motor Speed (rpm)"\n'
        'upper_thrust_N = "Thrust (N)"\n'
    )
    with pytest.raises(InputError, match="both rotors together"):
        read_stand_log(file(tmp_path, one_cell()), map_file)
    alone = both("{name} {what}", {"rpm": ("speed", 1.0), "thrust (N)": ("thrust", 1.0)})
    del alone["lower thrust (N)"]
    read_stand_log(file(tmp_path, alone), trust_units=False)  # an upper rotor's own is none
