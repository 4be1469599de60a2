"""Results are whole or as they were: after an error and after Ctrl-C."""

import pytest

from coaxlink.errors import InputError
from coaxlink.studies.result_folder import complete_or_unchanged

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
    assert (tmp_path / "report.html").read_text() == "old"
    assert (tmp_path / "tables" / "a.params").read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.txt", "report.html", "tables"]


def test_a_folder_that_was_not_there_goes_again(tmp_path):
    with pytest.raises(KeyboardInterrupt), complete_or_unchanged(tmp_path / "new", NAMES):
        fill(tmp_path / "new", "half")
        raise KeyboardInterrupt
    assert not (tmp_path / "new").exists()


def test_what_ends_well_stays_and_replaces(tmp_path):
    fill(tmp_path, "old")
    with complete_or_unchanged(tmp_path, NAMES):
        fill(tmp_path, "new")
    assert (tmp_path / "tables" / "a.params").read_text() == "new"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["report.html", "tables"]
