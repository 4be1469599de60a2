"""Locks on open files that go with the process, however it ends: flock, on Windows LockFile (portalocker)."""

from __future__ import annotations

import time

_AGAIN_S = 0.01


def lock(handle: int, *, shared: bool = False, wait: bool = True) -> None:
    """Take the lock of an open file. Raises BlockingIOError if it is held and nobody shall wait.

    A shared one is let go of (`unlock`) before it is taken for oneself: Windows turns none into the other.
    """
    import portalocker

    kind = portalocker.LockFlags.SHARED if shared else portalocker.LockFlags.EXCLUSIVE
    while True:
        try:
            # without waiting: on Windows a wait gives up after ten seconds
            portalocker.lock(handle, kind | portalocker.LockFlags.NON_BLOCKING)
            return
        except portalocker.AlreadyLocked as error:
            if not wait:
                raise BlockingIOError from error
        except portalocker.LockException as error:
            raise OSError(f"cannot be locked ({error})") from error
        time.sleep(_AGAIN_S)


def unlock(handle: int) -> None:
    """Let go of the lock of an open file."""
    import portalocker

    portalocker.unlock(handle)
