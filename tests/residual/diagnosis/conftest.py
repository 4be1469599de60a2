"""Every test here asks the engine of evidence; the paper's rotor pair."""

import pytest

from coaxlink import files
from coaxlink.rotor import load_rotor_model


@pytest.fixture(autouse=True)
def switched(monkeypatch):
    monkeypatch.setenv("COAXLINK_ENGINE", "evidence")


@pytest.fixture(scope="module")
def paper():
    return load_rotor_model(files.example("rotor_paper.toml"))
