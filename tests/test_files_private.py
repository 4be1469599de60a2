"""Code that was compiled before is run only where nobody but its user can have put it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from case_table import case_table

from coaxlink import files
from sim.physics.compile_cache import private

pytestmark = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no owners on this system")
# tmp_path's own parents are pytest's, in /tmp: sticky, or nobody else's
GUARDS: list[Callable[[Path], bool]] = [lambda p: files.keep_private(p) == "", private]


@pytest.fixture
def trusted(tmp_path: Path) -> Path:
    folder = tmp_path / "cache" / "code"
    folder.mkdir(parents=True)
    folder.chmod(0o755)
    (folder / "loop.o").write_bytes(b"code")
    (folder / "loop.o").chmod(0o644)
    return folder


def test_what_is_ours_alone_is_trusted_and_a_new_folder_is_closed(trusted: Path, tmp_path: Path) -> None:
    before = os.umask(0o002)
    try:
        for number, trusts in enumerate(GUARDS):
            assert trusts(trusted)
            new = tmp_path / f"new{number}" / "code"
            assert trusts(new)
            (new / "inside").mkdir()
            (new / "inside" / "f").write_bytes(b"")  # writable by the group, which cannot get there
            assert trusts(new) and new.stat().st_mode & 0o777 == 0o700
    finally:
        os.umask(before)


def test_what_others_can_write_or_put_there_is_not(
    trusted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = trusted / "loop.o"
    (tmp_path / "link").symlink_to(trusted)
    (tmp_path / "file").write_bytes(b"")
    with case_table() as case:
        for number, trusts in enumerate(GUARDS):
            for path, mode, usual in (
                *((trusted, mode, 0o755) for mode in (0o775, 0o757, 0o777)),
                *((code, mode, 0o644) for mode in (0o664, 0o646)),
                (trusted.parent, 0o777, 0o1777),  # as /tmp: only the owner renames
            ):
                with case(f"{number}: {path.name} {mode:o}"):
                    path.chmod(mode)
                    refused = not trusts(trusted)
                    path.chmod(usual)
                    assert refused and trusts(trusted)
            with case(f"{number}: a link, and a place that cannot be looked into"):
                assert not trusts(tmp_path / "link") and not trusts(tmp_path / "file" / "code")
            with case(f"{number}: another user's"), monkeypatch.context() as patch:
                us = os.geteuid()
                patch.setattr(os, "geteuid", lambda us=us: us + 1)
                assert not trusts(trusted)
            with case(f"{number}: a link inside"):
                (trusted / "other.o").symlink_to("/etc/hostname")
                refused = not trusts(trusted)
                (trusted / "other.o").unlink()
                assert refused
