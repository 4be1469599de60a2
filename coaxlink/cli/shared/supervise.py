"""A plain parent process that starts a verb again when it dies; nothing else lives in it."""

from __future__ import annotations

import os
import signal
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable

import typer

from coaxlink.absent import absent
from coaxlink.cli.shared.shell import say
from coaxlink.errors import CoaxlinkError, InputError

MOST, WITHIN_S = 5, 60.0  # starts: a sixth within a minute waits for its turn
CRASHED = 70  # EX_SOFTWARE of sysexits.h: an error that nobody meant


def supervise(work: Callable[[int], None]) -> None:
    """Do `work(n)`, its n-th life from 0 on, in a child process; again when it was killed or lost its link.

    Ends as the child ends when it is done (0), says no (1), cannot work (2) or refuses (4), and when it is
    told to stop: SIGINT reaches the child, SIGTERM becomes one. A child outlives a supervisor that is killed.
    Raises InputError where processes cannot be forked.
    """
    if not hasattr(os, "fork"):
        raise InputError("--supervise", "", "not on this system: let a service manager do it")
    starts: deque[float] = deque(maxlen=MOST)
    received: list[int] = []
    child = [0]

    def stop(number: int, _: object) -> None:
        received.append(number)
        if number == signal.SIGTERM and child[0]:
            os.kill(child[0], signal.SIGINT)

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    life = 0
    while True:
        for number in before:
            signal.signal(number, stop)
        if len(starts) == MOST:
            _rest(starts[0] + WITHIN_S, received)
        if received:
            raise KeyboardInterrupt
        starts.append(time.monotonic())
        sys.stdout.flush()
        sys.stderr.flush()
        # a signal waits until the child has handlers of its own and its number is known here
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, before)
        child[0] = os.fork()
        if child[0] == 0:
            for number, handler in before.items():
                signal.signal(number, handler)
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            _live(work, life)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        code = _code(child[0])
        child[0] = 0
        if received or code in (0, 1, 2, 4, 130):
            raise typer.Exit(code)
        why = f"was killed by signal {-code}" if code < 0 else f"ended with code {code}"
        life += 1
        say(f"supervisor: it {why}: start {life + 1}")


def _rest(until: float, received: list[int]) -> None:
    if (wait := until - time.monotonic()) > 0:
        say(f"supervisor: {MOST} starts within {WITHIN_S:.0f} s: the next in {wait:.0f} s")
    while not received and time.monotonic() < until:
        time.sleep(0.1)


def _code(child: int) -> int:
    """Of a child that ended: its exit code, or minus the signal that killed it."""
    while True:
        try:
            return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        except InterruptedError:
            continue


def _live(work: Callable[[int], None], life: int) -> None:
    """In the child: the work, its error in one line, and out; never returns."""
    code = 0
    try:
        work(life)
    except CoaxlinkError as error:
        say(f"coaxlink: {error}")
        code = error.exit_code
    except typer.Exit as left:
        code = left.exit_code
    except KeyboardInterrupt:
        code = 130
    except ImportError as error:
        missing = absent(error, "mix")
        say(f"coaxlink: {missing or error}")
        code = missing.exit_code if missing else CRASHED
    except BaseException:
        traceback.print_exc()
        code = CRASHED
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
