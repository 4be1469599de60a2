"""Results are whole or as they were; the simulator is a process of its own that says why it did not start."""

import pytest

from coaxlink.errors import InputError, LinkError
from coaxlink.mavlink import connect
from coaxlink.studies.result_folder import complete_or_unchanged
from coaxlink.studies.simulator import simulator

NAMES = ("report.html", "tables", "log.tlog")


def fill(out, text):
    (out / "report.html").write_text(text)
    (out / "tables").mkdir()
    (out / "tables" / "a.params").write_text(text)


@pytest.mark.parametrize("failure", [KeyboardInterrupt, InputError("a", "b", "c")])
def test_what_stood_there_comes_back(tmp_path, failure):
    fill(tmp_path, "old")
    (tmp_path / "mine.txt").write_text("not yours")
    with pytest.raises((KeyboardInterrupt, InputError)), complete_or_unchanged(tmp_path, NAMES):
        fill(tmp_path, "half")
        (tmp_path / "log.tlog").write_text("half")
        raise failure
    assert (tmp_path / "report.html").read_text() == (tmp_path / "tables" / "a.params").read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.txt", "report.html", "tables"]
    with pytest.raises(KeyboardInterrupt), complete_or_unchanged(tmp_path / "new", NAMES):
        fill(tmp_path / "new", "half")
        raise KeyboardInterrupt
    assert not (tmp_path / "new").exists()  # a folder that was not there goes again


def test_what_ends_well_stays_and_replaces(tmp_path):
    fill(tmp_path, "old")
    with complete_or_unchanged(tmp_path, NAMES):
        fill(tmp_path, "new")
    assert (tmp_path / "tables" / "a.params").read_text() == "new"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["report.html", "tables"]


@pytest.mark.slow
def test_the_simulator_answers_goes_with_the_block_and_says_why_it_does_not_start(tmp_path):
    with simulator(["--speed", "5"]) as address, connect(address) as session:
        assert session.identity.is_px4
    with pytest.raises(LinkError, match="no autopilot heard"):
        connect(address, timeout_s=0.5)
    with (
        pytest.raises(LinkError, match=r"did not start: coaxlink: .*nothing\.toml"),
        simulator(["--airframe", str(tmp_path / "nothing.toml")]),
    ):
        pass
