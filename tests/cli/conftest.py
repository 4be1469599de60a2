"""A board on a line, and a folder with a table for it."""

from pathlib import Path

import pytest
from cli_board import KEY
from memory_net import Net, plugged
from px4_board import params_text, x8
from scripted_autopilot import ScriptedAutopilot


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)
    Path("t").mkdir()
    Path("t/x8.params").write_text(params_text())
    Path("key").write_bytes(KEY)
    Path("key").chmod(0o600)


@pytest.fixture
def board():
    """In memory, on a clock of its own: the verbs find it at its address."""
    with plugged(Net()) as net, ScriptedAutopilot(x8(), net=net) as vehicle:
        yield vehicle
