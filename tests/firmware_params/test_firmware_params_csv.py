"""The research fork's mixer.csv: the same mix through another door."""

import json
from pathlib import Path

import numpy as np
import pytest

from firmware_params import px4
from firmware_params.errors import ParamsFileError, TableError

CASES = json.loads((Path(__file__).parents[1] / "data" / "px4_vectors.json").read_text())["cases"]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_px4_s_own_mix_through_the_file_flies_the_same(case, tmp_path):
    path = tmp_path / "mixer.csv"
    path.write_text(px4.mixer_csv(case["mix"]))
    assert max(map(len, path.read_bytes().splitlines())) < 99
    mix = px4.realise_csv(px4.read_mixer_csv(path), px4.realise(case["parameters"]))
    for vector in case["vectors"]:
        sp = mix.setpoints(vector["setpoint"])
        np.testing.assert_allclose(sp, vector["sp"], atol=1e-5)


def test_the_fork_s_parser(tmp_path):
    path = tmp_path / "m.csv"
    path.write_bytes(b"\xef\xbb\xbf -0.7, 0.7,1,,0,-1,9\r\n\r\n0.7,-0.7,1,0,0,-1\r\n")
    np.testing.assert_array_equal(
        px4.read_mixer_csv(path), [[-0.7, 0.7, 1, 0, 0, -1], [0.7, -0.7, 1, 0, 0, -1]]
    )


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("roll,pitch,yaw,x,y,z\n", "line 1: numbers are expected"),
        ("1,2,3,4,5\n", "line 1: 6 values are expected, found 5"),
        ("\n1,2,3,4,5,nan\n", "line 2: finite values"),
        ("1,2,3,4,5,0." + "0" * 40 + "\n", "line 1: finite values of at most 31"),
        ("0,0,0,0,0,0\n", "not all zero"),
        ("", "1..16 rows"),
    ],
)
def test_what_the_fork_refuses_is_named(tmp_path, text, why):
    path = tmp_path / "m.csv"
    path.write_text(text)
    with pytest.raises(ParamsFileError, match=why):
        px4.read_mixer_csv(path)


@pytest.mark.parametrize("mix", [np.zeros((8, 6)), np.ones((17, 6)), np.ones((8, 5)), [[np.nan] * 6]])
def test_what_cannot_be_written(mix):
    with pytest.raises(TableError):
        px4.mixer_csv(mix)


def test_rows_must_be_the_vehicle_s():
    geometry = px4.realise(CASES[0]["parameters"])
    with pytest.raises(TableError, match="6 rows, CA_ROTOR_COUNT is 8"):
        px4.realise_csv(np.ones((6, 6)), geometry)
