"""A board on a line, and a folder with a table for it."""

from pathlib import Path

import pytest
from cli_board import KEY
from px4_board import params_text, x8
from scripted_autopilot import ScriptedAutopilot

from coaxlink.mavlink.parameters import Parameters
from coaxlink.uploading.worker import Uploader


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))
    monkeypatch.setattr("coaxlink.mavlink.parameters.LOST_S", 0.6)  # the board here beats every 50 ms
    monkeypatch.setattr("coaxlink.mavlink.parameters._BEAT_S", 0.1)
    monkeypatch.setitem(Parameters.__init__.__kwdefaults__, "timeout_s", 0.15)
    monkeypatch.setitem(Uploader.__init__.__kwdefaults__, "patience_s", 1.0)
    monkeypatch.chdir(tmp_path)
    Path("t").mkdir()
    Path("t/x8.params").write_text(params_text())
    Path("key").write_bytes(KEY)
    Path("key").chmod(0o600)


@pytest.fixture
def board():
    with ScriptedAutopilot(x8()) as vehicle:
        yield vehicle
