"""What every test of a link has: a state folder and a signing key of its own."""

import pytest

KEY = bytes(range(32))


@pytest.fixture(autouse=True)
def state(tmp_path, monkeypatch):
    """Journals of a test stay with it."""
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))


@pytest.fixture
def key_file(tmp_path):
    """A file with `KEY` that only its owner can read."""
    path = tmp_path / "key"
    path.write_bytes(KEY)
    path.chmod(0o600)
    return path
