"""One spelling of a load: `Load` has it, files and logs keep theirs through it."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest

import coaxlink
from coaxlink.files import example
from coaxlink.frames import STAND_CHANNELS, STAND_UNITS
from coaxlink.load import Load, of_rotor
from coaxlink.rotor import RotorModel, load_rotor_model

ROOT = Path(coaxlink.__file__).parent
SPELLING = re.compile(r"(upper|lower)[._](thrust|torque)(_N|_Nm)?")
# readers speak the contract's column names; the paper's own table has keys of its own
ELSEWHERE = {
    "load.py": "where the spellings are",
    "studies/paper/contradictions.py": "printed.toml",
    "studies/paper/equations.py": "printed.toml",
}


def test_files_logs_and_results_keep_their_spellings():
    assert [load.key for load in Load] == [
        "upper.thrust_N",
        "upper.torque_Nm",
        "lower.thrust_N",
        "lower.torque_Nm",
    ]
    assert [load.column for load in Load] == [load.key.replace(".", "_") for load in Load]
    assert STAND_CHANNELS == (
        "upper_thrust", "upper_torque", "lower_thrust", "lower_torque", "upper_speed", "lower_speed",
    )  # fmt: skip
    assert STAND_UNITS == ("N", "N m", "N", "N m", "1", "1")
    assert [load.label for load in of_rotor(1)] == ["lower thrust, N", "lower torque, N m"]
    assert all(Load.of(name) is load for load in Load for name in (load.key, load.column, load.channel))
    assert all(load.partner.partner is load and load.partner.quantity == load.quantity for load in Load)


def test_a_load_is_the_place_in_arrays_and_the_surface_of_a_model():
    model = load_rotor_model(example("rotor_paper.toml"))
    pair = model.loads(0.5, 0.6)
    assert (
        float(pair[Load.LOWER_TORQUE])
        == float(pair.lower_torque)
        == float(model.surface(Load.LOWER_TORQUE)(0.5, 0.6))
    )
    assert np.arange(4)[Load.LOWER_THRUST] == 2
    again = RotorModel.from_terms(model.form, model.speed_max_rpm, model.terms())
    assert again.terms() == model.terms() and list(model.terms()) == [load.key for load in Load]


@pytest.mark.slow
def test_no_other_place_spells_a_load():
    found = []
    for path in ROOT.rglob("*.py"):
        name = path.relative_to(ROOT).as_posix()
        if name.startswith("data/") or name in ELSEWHERE:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if (
                isinstance(node, ast.Constant)
                and isinstance(node.value, str)
                and SPELLING.fullmatch(node.value)
            ):
                found.append(f"{name}:{node.lineno}: {node.value}")
    assert not found, found
