"""Locks on open files that go with the process, however it ends. POSIX; elsewhere nothing is locked away.

`open_transport` refuses systems without them before anything could need one.
"""

from __future__ import annotations

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

from coaxlink.errors import SafetyRefusal


def lock(handle: int, *, shared: bool = False, wait: bool = True) -> None:
    """Take the lock of an open file. Raises BlockingIOError if it is held and nobody shall wait.

    Raises SafetyRefusal on a system that has none: two uploads at a time could not be detected there.
    """
    if fcntl is None:
        raise SafetyRefusal("this system has no file locks that end with their process (fcntl)")
    kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
    fcntl.flock(handle, kind if wait else kind | fcntl.LOCK_NB)
