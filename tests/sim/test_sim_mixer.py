"""The stand-in's own mixer against the outputs of PX4's real allocation code."""

import json
from pathlib import Path

import numpy as np
import pytest

from sim.px4.mixer import Px4Mixer
from sim.px4.store import Px4Store
from sim.vehicle import read_vehicle

HERE = Path(__file__).parents[1]
CASES = json.loads((HERE / "data" / "px4_vectors.json").read_text())["cases"]
VEHICLE = read_vehicle(HERE.parent / "examples" / "x8_paper.toml")


def wired(store: Px4Store, name: str, value: float) -> None:
    import struct

    if store.type(name) == 6:
        value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
    assert store.write(name, store.type(name), value) is not None


def test_uploaded_tables_mix_as_px4_mixes_them() -> None:
    for case in CASES:
        mixes_as_px4(case)


def mixes_as_px4(case: dict) -> None:
    store = Px4Store((1, 16, 1), VEHICLE)
    rotors = int(case["parameters"]["CA_ROTOR_COUNT"])
    mixer = Px4Mixer(store, rotors)
    for name, value in case["parameters"].items():
        wired(store, name, value)
    for vector in case["vectors"]:
        roll, pitch, yaw, x, y, z = vector["setpoint"]
        if x or y:
            continue
        command = mixer.command(roll, pitch, yaw, -z)
        # the thrust curve's root magnifies what float32 leaves of a zero
        assert command == pytest.approx(vector["throttle"], abs=1e-5), (case["name"], vector["setpoint"])


def test_the_old_mixer_of_1_13_ignores_the_table() -> None:
    store = Px4Store((1, 13, 3), VEHICLE)
    mixer = Px4Mixer(store, 8)
    before = mixer.command(0.05, -0.02, 0.03, 0.4)
    wired(store, "CA_ROTOR0_CT", 40.0)
    assert np.array_equal(mixer.command(0.05, -0.02, 0.03, 0.4), before)
    wired(store, "SYS_CTRL_ALLOC", 1)
    assert not np.allclose(mixer.command(0.05, -0.02, 0.03, 0.4), before, atol=1e-3)


def test_a_table_that_cannot_be_mixed_stops_the_motors() -> None:
    store = Px4Store((1, 16, 1), VEHICLE)
    mixer = Px4Mixer(store, 8)
    assert mixer.command(0, 0, 0, 0.5).min() > 0.3
    wired(store, "CA_ROTOR_COUNT", 0)
    assert mixer.mix is None and not mixer.command(0, 0, 0, 0.5).any()
