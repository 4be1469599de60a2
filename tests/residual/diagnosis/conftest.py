"""The paper's rotor pair."""

import pytest

from coaxlink import files
from coaxlink.rotor import load_rotor_model


@pytest.fixture(scope="module")
def paper():
    return load_rotor_model(files.example("rotor_paper.toml"))
