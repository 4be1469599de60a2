"""How far a long verb is, on stderr: one bar on a terminal, lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from coaxlink.cli.shared.shell import say, talk

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

EVERY_S = 10.0  # between lines where stderr is no terminal


class Bar:
    """One bar; see `progress`."""

    def __init__(self, shown: Progress, bar: TaskID, done: int, total: int | None, what: str) -> None:
        self._shown, self._bar, self._first, self._total, self._what = shown, bar, done, total, what
        self._began = time.monotonic()
        self._reported = self._began + 2.0 - EVERY_S  # a first line soon
        self._step = what

    def step(self, text: str) -> None:
        """A step begins; where steps are what is counted, the one before it is done."""
        self._step = text
        self._shown.update(self._bar, description=text, advance=1)
        if not self._shown.console.is_terminal:
            say(text)

    def watch(self, segment: str, seconds: float) -> None:
        """Where the step under way is; on a terminal only."""
        self._shown.update(self._bar, description=f"{self._step}: {segment}, {seconds:.0f} s")

    def at(self, done: int) -> None:
        """So many of all are done; a line every `EVERY_S` where stderr is no terminal, and at the end."""
        rate = (done - self._first) / max(time.monotonic() - self._began, 1e-9)
        text = f"{done} of {self._total} {self._what}"
        self._shown.update(self._bar, completed=done, description=f"{text}, {rate:.3g} a second")
        if self._shown.console.is_terminal:
            return
        last = done == self._total
        if last or time.monotonic() - self._reported > EVERY_S:
            self._reported = time.monotonic()
            say(f"{text} ({100 * done // (self._total or 1)} %), {rate:.3g} a second")


@contextmanager
def progress(what: str, total: int | None = None, done: int = 0) -> Iterator[Bar]:
    """A bar of `total` steps or things named `what`, `done` of which are; one without an end if None."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    text = TextColumn("{task.description}", markup=False)
    with Progress(text, BarColumn(), TimeElapsedColumn(), TimeRemainingColumn(), console=talk()) as shown:
        yield Bar(shown, shown.add_task(what, total=total, completed=done), done, total, what)
