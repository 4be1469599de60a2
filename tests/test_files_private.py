"""Code that was compiled before is run only where nobody but its user can have put it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from coaxlink import files
from sim.physics.compile_cache import private

pytestmark = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no owners on this system")
# tmp_path's own parents are pytest's, in /tmp: sticky, or nobody else's
GUARDS: list[Callable[[Path], bool]] = [lambda p: files.keep_private(p) == "", private]


@pytest.fixture(params=GUARDS, ids=["coaxlink", "sim"])
def trusts(request: pytest.FixtureRequest) -> Callable[[Path], bool]:
    return request.param


@pytest.fixture
def trusted(tmp_path: Path) -> Path:
    folder = tmp_path / "cache" / "code"
    folder.mkdir(parents=True)
    folder.chmod(0o755)
    (folder / "loop.o").write_bytes(b"code")
    (folder / "loop.o").chmod(0o644)
    return folder


def test_what_is_ours_alone_is_trusted_and_a_new_folder_is_closed(
    trusts: Callable[[Path], bool], trusted: Path, tmp_path: Path
) -> None:
    assert trusts(trusted)
    before = os.umask(0o002)
    try:
        new = tmp_path / "new" / "code"
        assert trusts(new)
        (new / "inside").mkdir()
        (new / "inside" / "f").write_bytes(b"")  # writable by the group, which cannot get there
        assert trusts(new)
    finally:
        os.umask(before)
    assert new.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("mode", [0o775, 0o757, 0o777])
def test_a_folder_that_others_can_write_is_not(
    trusts: Callable[[Path], bool], trusted: Path, mode: int
) -> None:
    trusted.chmod(mode)
    assert not trusts(trusted)


@pytest.mark.parametrize("mode", [0o664, 0o646])
def test_a_file_that_others_can_write_is_not(
    trusts: Callable[[Path], bool], trusted: Path, mode: int
) -> None:
    (trusted / "loop.o").chmod(mode)
    assert not trusts(trusted)


def test_a_link_is_not_followed(trusts: Callable[[Path], bool], trusted: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(trusted)
    assert not trusts(tmp_path / "link")
    (trusted / "other.o").symlink_to("/etc/hostname")
    assert not trusts(trusted)


def test_a_folder_above_that_everybody_can_rename_is_not(
    trusts: Callable[[Path], bool], trusted: Path
) -> None:
    trusted.parent.chmod(0o777)
    assert not trusts(trusted)
    trusted.parent.chmod(0o1777)  # as /tmp: only the owner renames
    assert trusts(trusted)


def test_another_users_file_is_not(
    trusts: Callable[[Path], bool], trusted: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    us = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: us + 1)
    assert not trusts(trusted)


def test_a_place_that_cannot_be_looked_into_is_not(trusts: Callable[[Path], bool], tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    assert not trusts(tmp_path / "file" / "code")
