"""What the page of parameters asks of the vehicle, done on the link's thread: difference, backup, upload.

The work is that of `coaxlink upload` (`upload.worker`): difference, backup, question, write, read back,
compare, back again on failure; refused while the vehicle is armed.
"""

from __future__ import annotations

import queue
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from coaxlink.errors import CoaxlinkError
from coaxlink.mavlink.session import Session
from coaxlink.uploading.outcome import VERIFIED, Change, Talk
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.worker import Uploader

Ask = Callable[[tuple[Change, ...]], bool]
Done = Callable[["Report"], None]


@dataclass(frozen=True)
class Report:
    """How it went."""

    title: str
    changes: tuple[Change, ...] = ()
    lines: tuple[str, ...] = ()
    error: str = ""


class Desk:
    """Takes one task at a time; `work` is called by the link's thread with its session, or None without one.

    `busy` says what is being done, "" while nothing is: the screen must not be left in an upload.
    """

    def __init__(self, backups: Path) -> None:
        self.backups = backups
        self.busy = ""
        self._tasks: queue.SimpleQueue[tuple[str, Callable[[Session], Report], Done]] = queue.SimpleQueue()

    def difference(self, table: Path, done: Done) -> None:
        """What an upload of `table` would change."""
        self._add("difference", lambda session: self._upload(session, table, None), done)

    def upload(self, table: Path, ask: Ask, done: Done) -> None:
        """Put `table` on board if `ask(changes)`, called on the link's thread, agrees."""
        self._add("upload", lambda session: self._upload(session, table, ask), done)

    def backup(self, done: Done) -> None:
        """Save all parameters of the board."""
        self._add("backup", self._backup, done)

    def work(self, session: Session | None) -> None:
        """Do what waits."""
        while not self._tasks.empty():
            name, task, done = self._tasks.get()
            try:
                report = task(session) if session else Report(name, error="no link to the vehicle")
            except CoaxlinkError as error:
                report = Report(name, error=str(error))
            finally:
                self.busy = ""
            done(report)

    def _add(self, name: str, task: Callable[[Session], Report], done: Done) -> None:
        if self.busy:
            done(Report(name, error=f"wait: {self.busy} is under way"))
            return
        self.busy = name
        self._tasks.put((name, task, done))

    def _upload(self, session: Session, table: Path, ask: Ask | None) -> Report:
        plan = load_plan(table)
        session.refuse_unheard()
        changes: list[Change] = []
        lines: list[str] = []
        talk = Talk(
            say=lines.append,
            difference=changes.extend,
            confirm=lambda: ask is not None and ask(tuple(changes)),
        )
        worker = Uploader(session, backup_folder=self.backups, talk=talk)
        outcome = worker.upload(plan, dry_run=ask is None)
        if outcome.result == VERIFIED:
            lines.append(outcome.reason or "verified: written and read back")
        title = f"{'upload of' if ask else 'difference to'} {table}"
        return Report(title, outcome.changed, tuple(lines), str(outcome.error) if outcome.error else "")

    def _backup(self, session: Session) -> Report:
        lines: list[str] = []
        path = Uploader(session, backup_folder=self.backups, talk=Talk(say=lines.append)).backup()
        return Report("backup", lines=(*lines, f"all parameters of the board: {path}"))
