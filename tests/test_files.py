"""Files are whole or not there, and unreadable ones end in one clear line."""

import json

import pytest

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
