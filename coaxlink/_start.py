"""What the `coaxlink` command loads first."""

from __future__ import annotations

import os

from coaxlink import _interrupts

_interrupts.end_at_once()


def main() -> None:
    """The command; ends with SystemExit."""
    from coaxlink.threads import ONE_THREAD

    for name in ONE_THREAD:
        os.environ[name] = "1"  # whatever the machine has set: answers are the same bit for bit
    from coaxlink.cli import main as command

    try:
        command()
    except KeyboardInterrupt:  # between the verbs' own nets
        _interrupts.leave(2, None)
    except SystemExit as ended:
        if ended.code == _interrupts.INTERRUPTED:  # all is put back: what is left is memory
            _interrupts.drop()
        raise
    finally:
        _interrupts.end()
