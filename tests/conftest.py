"""What all rooms share: no property is judged by how long a busy machine took to try it."""

import os
import signal

from coaxlink.threads import ONE_THREAD

for name in ONE_THREAD:  # as the command does, before numpy loads
    os.environ.setdefault(name, "1")

import pytest  # noqa: E402
from hypothesis import HealthCheck, settings  # noqa: E402

settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")
# where the tests run in a shell's background Ctrl-C is ignored, and children would inherit that
signal.signal(signal.SIGINT, signal.default_int_handler)

KEY = bytes(range(32))
POSIX = {
    "fcntl",
    "pty",
    "resource",
    "termios",
    "tty",
}  # what Windows lacks: `sim` needs it, and some tests do
try:
    import fcntl  # noqa: F401
except ImportError:
    collect_ignore = [
        "cli/test_cli_exit_codes.py",
        "hostile/test_hostile_fuzz.py",
        "live/test_live_real.py",
        "mavlink/test_mavlink_real_lines.py",
        "test_files_private.py",
    ]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Where the simulated world cannot run, its tests skip, saying so."""
    try:
        return (yield)
    except ModuleNotFoundError as error:
        if error.name not in POSIX:
            raise
        pytest.skip(f"needs {error.name}, which this system lacks")


def pytest_collection_modifyitems(items):
    """`-m quick` is all that is not marked slow: what is run at each save."""
    for item in items:
        if "slow" not in item.keywords:
            item.add_marker("quick")


def pytest_xdist_auto_num_workers():
    """One more than processors, for some tests wait."""
    return (os.cpu_count() or 1) + 1


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
