"""A board in memory, tables for it, and tables as the verb writes them for the stand-ins."""

import pytest
from memory_net import X8, Net
from px4_board import params_text, x8
from scripted_autopilot import ScriptedAutopilot

from coaxlink.cli import main
from coaxlink.uploading.plan import load_plan

ARDUPILOT = ("--firmware", "ardupilot")
LOADER = (*ARDUPILOT, "--frame-class", "17", "--spin-min", "0")
TABLES = {
    "px4": ("--firmware", "px4", "--law", "reduced", "--rotor", str(X8.with_name("rotor_eq15.toml"))),
    "matrix": (*ARDUPILOT, "--law", "reduced"),
    "loader": (*LOADER, "--law", "reduced"),
    "loader-standard": (*LOADER, "--law", "standard"),
}


@pytest.fixture
def board():
    with ScriptedAutopilot(x8(), net=Net()) as vehicle:
        yield vehicle


@pytest.fixture
def plan_of(tmp_path):
    """`plan_of(**options)`: a small PX4 table of `px4_board.params_text`."""

    def make(**options):
        path = tmp_path / "x8.params"
        path.write_text(params_text(**options))
        return load_plan(path)

    return make


@pytest.fixture(scope="session")
def tables(tmp_path_factory):
    """Folders by name, each written by the verb."""
    folder = tmp_path_factory.mktemp("tables")
    for name, options in TABLES.items():
        with pytest.raises(SystemExit) as ended:
            main(["table", str(X8), *options, "--out", str(folder / name)])
        assert ended.value.code == 0
    return {name: folder / name for name in TABLES}
