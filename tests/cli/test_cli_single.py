"""`coaxlink identify --single` as a user without a stand runs it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from cli_runs import coaxlink

from coaxlink.rotor import load_rotor_model

SIZES = ("--diameter", 0.4115, "--pitch", 0.1346, "--spacing", 0.16)  # 16.2 x 5.3 in
SHEET = """Item,Prop,Throttle,Volts (V),Amps (A),Watts (W),Thrust (G),RPM,Torque (N*m)
MN4014,16*5.4,50%,22.2,4.2,93,800,3690,0.16
,,65%,,7.5,166,1190,4480,0.23
,,75%,,10.5,233,1500,5020,0.30
,,100%,,19.5,433,2250,6110,0.44
"""


def test_a_sheet_of_two_supplies_asks_which(tmp_path):
    path = tmp_path / "two.csv"
    twice = [(3690, 800), (4480, 1190), (5020, 1500), (6110, 2250)]
    rows = [f"{volts},{rpm},{grams}" for volts in (22.2, 44.4) for rpm, grams in twice]
    path.write_text("\n".join(["Volts (V),RPM,Thrust (g)", *rows]) + "\n")
    run = coaxlink("identify", "--single", path, *SIZES)
    assert run.code == 2 and "rows at 22.2 V and 44.4 V: which are yours? --voltage" in run.err
    run = coaxlink("identify", "--single", path, *SIZES, "--voltage", 30)
    assert run.code == 2 and "--voltage: no rows at 30 V" in run.err


@pytest.mark.slow
def test_rubbish_gets_one_line(tmp_path):
    tables = {
        "RPM,Power (W)\n3000,10\n4000,20\n5000,30\n6000,40\n": "no column of thrust",
        "RPM,Thrust (stone)\n3000,10\n4000,20\n": "unit of a thrust",
        "RPM,Thrust (g)\n3000,x\n4000,20\n": "line 2",
        "RPM,Thrust (g)\n3000,500\n4000,900\n5000,1400\n": "4 speeds",
        "RPM,Thrust (g)\n3000,500\n4000,900\n5000,1400\n3000,900\n4000,1700\n5000,2600\n": (
            "several propellers"
        ),
        "RPM CT CP\n3000 0.1\n": "line 2",
        "J CT CP eta\n0.1 0.1 0.04 0.3\n": "static data",
    }
    path = tmp_path / "t.csv"
    wrong = []
    for text, expected in tables.items():
        path.write_text(text)
        run = coaxlink("identify", "--single", path, *SIZES)
        if run.code != 2 or run.err.count("\n") != 1 or expected not in run.err:
            wrong.append((expected, run))
    assert not wrong


def test_options_that_cannot_be_are_refused_in_one_line(tmp_path):
    sheet = tmp_path / "maker.csv"
    sheet.write_text(SHEET)
    wrong = {
        ("--diameter", 16, "--spacing", 0.1): "--diameter: 0.03 to 2.5 m are expected, found 16 (16 in is",
        ("--diameter", 0.4): "needed with it, in metres",
        ("--diameter", 0.4, "--spacing", 0.1, "--pitch", 5): "--pitch",
        ("--diameter", 0.4, "--spacing", 0.1, "--speed-max-rpm", 0): "--speed-max-rpm: more than 0",
        ("--diameter", 0.4, "--spacing", 0.1, sheet): "in place of stand logs",
    }
    for options, expected in wrong.items():
        run = coaxlink("identify", "--single", sheet, *options)
        assert run.code == 2 and run.err.count("\n") == 1 and expected in run.err, (options, run.err)


@pytest.mark.slow
def test_the_verb_writes_a_rotor_file_that_says_what_it_is(tmp_path):
    sheet, rotor_file, report = (tmp_path / n for n in ("maker.csv", "r.toml", "r.json"))
    sheet.write_text(SHEET)
    outputs = ("--out", rotor_file, "--json", report, "--plot", tmp_path)
    run = coaxlink("identify", "--single", sheet, *SIZES, *outputs)
    assert run.code == 0
    assert "the lower rotor lifts" in run.out and "guessed:" in run.err
    model, found = load_rotor_model(rotor_file), json.loads(report.read_text())
    assert model.terms() == found["terms"]
    about = model.identified
    assert "no coaxial measurement" in about["law"] and len(about["prior"]["guessed"]) >= 5
    assert np.shape(about["prior"]["covariance"]) == (12, 12)
    for load, terms in model.terms().items():
        for term, value in terms.items():
            low, high = about["intervals"][load][term]
            assert low < value < high
    assert (tmp_path / "prior.png").read_bytes().startswith(b"\x89PNG")
