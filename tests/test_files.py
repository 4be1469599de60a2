"""Files are whole or not there, and unreadable ones end in one clear line."""

import json
import os
import socket
from pathlib import Path

import pytest
from case_table import case_table

from coaxlink import files
from coaxlink.errors import InputError


def test_a_failed_write_leaves_the_old_file(tmp_path):
    target = tmp_path / "out.json"
    files.write_json(target, {"a": 1})
    with pytest.raises(InputError, match="no finite number"):
        files.write_json(target, {"a": float("nan")})
    assert json.loads(target.read_text()) == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["out.json"]


def test_a_place_that_is_no_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        files.write_atomic(tmp_path / "file" / "x", "y")


def test_an_unwritable_place_is_known_before_the_work(tmp_path):
    files.refuse_unwritable(None)
    files.refuse_unwritable(tmp_path / "new" / "x.json")
    assert list((tmp_path / "new").iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"x\.json: cannot be written"):
        files.refuse_unwritable(tmp_path / "file" / "x.json")


def test_only_a_regular_file_is_written(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "to_pipe").symlink_to("pipe")
    with socket.socket(socket.AF_UNIX) as listener, case_table() as case:
        listener.bind(str(tmp_path / "socket"))
        before = {path: path.lstat() for path in (*tmp_path.iterdir(), Path("/dev/null"), Path("/dev/full"))}
        for path in before:
            with case(path):
                for write in (files.refuse_unwritable, lambda path: files.write_atomic(path, "x")):
                    with pytest.raises(InputError, match=r"is there; only|cannot be written"):
                        write(path)
                assert os.path.samestat(path.lstat(), before[path])


def test_a_link_stays_and_its_file_is_replaced(tmp_path):
    (tmp_path / "there").mkdir()
    for name in ("old", "new"):
        (tmp_path / name).symlink_to(f"there/{name}")
    (tmp_path / "there" / "old").write_text("old")
    for name in ("old", "new"):
        files.write_atomic(tmp_path / name, "x")
        assert (tmp_path / name).is_symlink() and (tmp_path / "there" / name).read_text() == "x"


def test_what_a_verb_reads_it_does_not_write_over(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "_read", None)
    (tmp_path / "a.toml").write_text("x = 1")
    os.link(tmp_path / "a.toml", tmp_path / "hard")
    (tmp_path / "soft").symlink_to("a.toml")
    for name in ("a.toml", "hard", "soft"):
        with pytest.raises(InputError, match="is read here"):
            files.refuse_unwritable(tmp_path / name, [tmp_path / "a.toml"])
    files.note_reads()
    files.read_toml(tmp_path / "a.toml")
    for name in ("a.toml", "hard", "soft"):
        with pytest.raises(InputError, match="is read here"):
            files.write_atomic(tmp_path / name, "y = 2")
    files.note_reads()
    files.write_atomic(tmp_path / "a.toml", "y = 2")  # another verb may


@pytest.mark.parametrize(
    ("content", "message"), [(b"\xff\xfe\x00", "not text"), (b"a = [1,\nb = ", "not TOML")]
)
def test_unreadable_toml_names_the_file(tmp_path, content, message):
    path = tmp_path / "rotor.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        files.read_toml(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.toml: cannot be read \(No such file"):
        files.read_toml(tmp_path / "nothing.toml")


def test_the_byte_order_mark_is_dropped(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xef\xbb\xbfx = 1\n")
    assert files.read_toml(path) == {"x": 1}


def test_shipped_examples_are_found():
    assert files.example("x8_paper.toml").is_file()
    with pytest.raises(InputError):
        files.example("nothing.toml")
