"""A board on a line, and a folder with a table for it."""

import pytest
from cli_board import furnish, on_a_line


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)
    furnish()


@pytest.fixture
def board():
    with on_a_line() as vehicle:
        yield vehicle
