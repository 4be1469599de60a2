"""The page of parameters: the difference to a table's file, a backup, an upload that is confirmed."""

from __future__ import annotations

import queue
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Button, Input, Static

from coaxlink.monitor.board.desk import Desk, Report
from coaxlink.monitor.screen.marks import BAD, DIM, GOOD, WARN
from coaxlink.monitor.screen.pages import Picture, put
from coaxlink.monitor.screen.themes import Palette, dress
from coaxlink.uploading.outcome import Change

_HINT = "what coaxlink table wrote: a folder, or a .params or .param file"


class Confirm(ModalScreen[bool]):
    """Asks before anything is written."""

    BINDINGS: ClassVar[list[BindingType]] = [
        ("y", "dismiss(True)", "Write it"),
        ("n,escape", "dismiss(False)", "Leave it"),
    ]

    def __init__(self, changes: tuple[Change, ...], palette: Palette) -> None:
        super().__init__()
        self._changes, self._palette = changes, palette

    def compose(self) -> ComposeResult:
        text = Text.assemble(
            (f"write {len(self._changes)} parameters to the vehicle?  y: write   n: leave\n\n", "bold"),
            difference_words(self._changes),
        )
        with VerticalScroll(id="confirm"):
            yield Static(dress(text, self._palette))


class ParametersPage(Vertical):
    """Without a desk (a replay, a browser) it only says why."""

    # not in the footer: the page itself shows them, and 80 columns hold help and quit then too
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f", "file", "File", show=False),
        Binding("d", "ask('difference')", "Difference", show=False),
        Binding("b", "ask('backup')", "Backup", show=False),
        Binding("u", "ask('upload')", "Upload", show=False),
    ]

    def __init__(self, desk: Desk | None, table: Path | None, why_not: str) -> None:
        super().__init__(id="parameters")
        self._desk, self._table, self._why_not = desk, table, why_not
        self._report: Report | None = None
        self._armed = False
        self._palette: Palette = {}

    def compose(self) -> ComposeResult:
        yield Input(str(self._table or ""), placeholder=_HINT, id="table", compact=True)
        with Horizontal(id="tasks"):
            for name in ("difference", "backup", "upload"):
                yield Button(f"{name} ({name[0]})", id=f"do-{name}", compact=True)
        with VerticalScroll(id="report"):
            yield Static(id="told")

    def draw(self, picture: Picture) -> None:
        """Show a picture."""
        self._palette = picture.palette
        vehicle = picture.view.vehicle
        self._armed = vehicle is None or vehicle.armed
        self.border_title = "parameters: compare with a file (f), back up, upload"
        for button in self.query(Button):
            button.disabled = self._desk is None or self._armed or bool(self._desk.busy)
        put(self.query_one("#told", Static), self._words(), picture.palette)

    def _words(self) -> Text:
        if self._desk is None:
            return Text(self._why_not, WARN)
        if self._desk.busy:
            return Text(f"{self._desk.busy} ...", WARN)
        if self._armed:
            return Text("the vehicle is armed: nothing is read or written here until it is not", WARN)
        return Text("nothing compared yet", DIM) if self._report is None else report_words(self._report)

    def action_file(self) -> None:
        """Type the name of the table."""
        self.query_one("#table", Input).focus()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        event.stop()
        self.query_one("#report").focus()
        self.action_ask("difference")

    def on_button_pressed(self, event: Button.Pressed) -> None:
        event.stop()
        self.action_ask(str(event.button.id).removeprefix("do-"))

    def action_ask(self, what: str) -> None:
        """Have it done; the report comes when it is."""
        desk = self._desk
        if desk is None or self._armed:
            return
        name = self.query_one("#table", Input).value.strip()
        if what == "backup":
            desk.backup(self._done)
        elif not name:
            self._show(Report(what, error="name the table first (f)"))
        elif what == "difference":
            desk.difference(Path(name).expanduser(), self._done)
        else:
            desk.upload(Path(name).expanduser(), self._confirmed, self._done)

    def _done(self, report: Report) -> None:
        """On any thread."""
        self._report = report

    def _show(self, report: Report) -> None:
        self._report = report

    def _confirmed(self, changes: tuple[Change, ...]) -> bool:
        """On the link's thread: ask the user and wait; a screen that ends has not agreed."""
        answer: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self.app.call_from_thread(self._question, changes, answer)
        while self.app.is_running:
            try:
                return bool(answer.get(timeout=0.2))
            except queue.Empty:
                continue
        return False

    def _question(self, changes: tuple[Change, ...], answer: queue.SimpleQueue[bool]) -> None:
        self.app.push_screen(Confirm(changes, self._palette), lambda yes: answer.put(bool(yes)))


def difference_words(changes: tuple[Change, ...]) -> Text:
    """A row a parameter: name, on board, new."""
    rows = [(c.name, f"{c.old.value:.7g}" if c.old.bits else "--", f"{c.new.value:.7g}") for c in changes]
    lines = [Text(f"{'parameter':<18}{'on board':>14}{'new':>14}", DIM)]
    lines += [Text(f"{name:<18}{old:>14}{new:>14}") for name, old, new in rows]
    return Text("\n").join(lines)


def report_words(report: Report) -> Text:
    """A report in lines, the worst first."""
    lines = [Text(report.title, "bold")]
    if report.error:
        lines.append(Text(report.error, f"bold {BAD}"))
    lines += [Text(line) for line in report.lines]
    if report.changes:
        lines += [Text(), difference_words(report.changes)]
    elif not report.error and report.title.startswith("difference"):
        lines.append(Text("the board holds it already", GOOD))
    return Text("\n").join(lines)
