"""A table is one thing: its files are written together or not at all, and halves of two are refused."""

import errno
import os

import pytest
from verb import run

from coaxlink import files
from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.uploading.plan import load_plan

X8 = example("x8_paper.toml")


def made(capsys, out, law, *options):
    code, _, err = run(capsys, "table", X8, "--firmware", "ardupilot", "--law", law, "--out", out, *options)
    return code, err


def content(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.slow
def test_a_disk_that_fills_between_the_files_leaves_the_old_table(tmp_path, capsys, monkeypatch):
    assert made(capsys, tmp_path / "d", "standard")[0] == 0
    before = content(tmp_path / "d")
    real = os.fsync
    for whole in range(len(before)):  # so many files of the new table still fit
        left = [whole]

        def fills(handle, left=left):
            left[0] -= 1
            if left[0] < 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            real(handle)

        monkeypatch.setattr(os, "fsync", fills)
        code, err = made(capsys, tmp_path / "d", "reduced")
        assert code == 2 and "No space left" in err.splitlines()[-1]
        assert content(tmp_path / "d") == before
    monkeypatch.setattr(os, "fsync", real)
    load_plan(tmp_path / "d")


@pytest.mark.slow
def test_halves_of_two_tables_are_refused_whoever_mixed_them(tmp_path, capsys):
    for law in ("standard", "reduced"):
        assert made(capsys, tmp_path / law, law)[0] == 0
    script = "scripts/coaxlink_matrix.lua"
    for name, found in ((script, "is not what paper-x8.param"), ("vehicle/rotor.toml", "is not what")):
        folder = tmp_path / name.partition("/")[0]
        files.write_together({folder / n: d for n, d in content(tmp_path / "reduced").items()})
        other = (tmp_path / "standard" / name).read_bytes()
        (folder / name).write_bytes(other if name == script else other + b"# of another\n")
        with pytest.raises(InputError, match=found):
            load_plan(folder)
    lone = tmp_path / "reduced"
    (lone / script).unlink()
    with pytest.raises(InputError, match=r"coaxlink_matrix.lua: is missing"):
        load_plan(lone)
    # a table of a coaxlink that noted nothing: its own SCR_LD_CHECKSUM tells
    old = tmp_path / "old"
    files.write_together({old / n: d for n, d in content(tmp_path / "standard").items()})
    text = (old / "paper-x8.param").read_text()
    (old / "paper-x8.param").write_text("\n".join(x for x in text.splitlines() if "File: " not in x) + "\n")
    load_plan(old)
    (old / script).write_bytes((old / script).read_bytes() + b"-- of another table\n")
    with pytest.raises(InputError, match=r"SCR_LD_CHECKSUM is not that of scripts/ \(coaxlink_matrix.lua\)"):
        load_plan(old)


@pytest.mark.slow
def test_a_table_of_another_kind_leaves_no_script_of_the_first(tmp_path, capsys):
    assert made(capsys, tmp_path / "d", "standard")[0] == 0
    assert made(capsys, tmp_path / "d", "standard", "--frame-class", "17")[0] == 0
    assert [p.name for p in (tmp_path / "d/scripts").iterdir()] == ["coaxlink_loader.lua"]
    load_plan(tmp_path / "d")
