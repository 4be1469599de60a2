"""The Textual screen. It asks for a view five times a second and formats it; it computes nothing."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Grid, Horizontal
from textual.content import Content
from textual.screen import ModalScreen
from textual.widgets import Footer, Static

from coaxlink import files
from coaxlink.errors import CoaxlinkError
from coaxlink.monitor import format as words
from coaxlink.monitor.history import History
from coaxlink.monitor.state import ArmView, View

REFRESH_S = 0.2

HELP = """\
[b]coaxlink monitor[/b] watches; it commands nothing.

Thrust and torque are the rotor model's at the speeds the vehicle reports:
measured ones (ESC rpm) before commanded ones (SERVO_OUTPUT_RAW,
ACTUATOR_OUTPUT_STATUS). The vehicle panel names the source. ESCs that
contradict weight and command by 10 % in a steady hover are passed over.

[#5cc8ff]▲ upper[/]  [#ffb454]▼ lower[/]  thrust, speed, commanded throttle. A full bar is the
rotor's most thrust; below it the arm's thrust, split upper : lower.

[b]model[/b]   what the rotors make, by the rotor model
[b]table[/b]   what the mixer table on board means by the same commands
[b]demand[/b]  instead, on PX4 up to 1.13: what its controllers ask for
[b]error[/b]   model less table (or demand): the allocation error

Grey and "stale" is old. The plot runs on the vehicle's own clock.

q quit   p pause the picture   s save it as SVG   ? this help
"""


class Help(ModalScreen[None]):
    """The keys and what the numbers are."""

    BINDINGS: ClassVar[list[BindingType]] = [("escape,question_mark,q,enter,space", "dismiss", "Close")]

    def compose(self) -> ComposeResult:
        yield Static(HELP, id="help")


class ArmPanel(Static):
    """One arm; its border carries name and split."""

    def show(self, arm: ArmView, stale: bool) -> None:
        """Draw `arm`."""
        self.border_title = Content(arm.name)
        self.border_subtitle = Content.from_rich_text(words.arm_split(arm, stale))
        self.update(words.arm_body(arm, max(self.content_size.width, 24), stale))


class Monitor(App[None]):
    """`look(now_s)` gives the view; once `trouble()` is not None the feed is dead and the screen ends.

    `folder` is where snapshots go (default: the current one).
    """

    TITLE = "coaxlink monitor"
    ENABLE_COMMAND_PALETTE = False
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (150, "-wide")]  # noqa: RUF012 - as Textual types it
    VERTICAL_BREAKPOINTS = [(0, "-short"), (30, "-tall")]  # noqa: RUF012
    BINDINGS: ClassVar[list[BindingType]] = [
        ("q", "quit", "Quit"),
        Binding("ctrl+c", "quit", "Quit", show=False, priority=True),
        ("p", "pause", "Pause"),
        ("s", "save", "Save SVG"),
        ("question_mark", "help", "Help"),
    ]
    CSS = """
    Screen { layout: vertical; overflow-y: auto; }
    #head { height: 1; padding: 0 1; background: $panel; }
    #waiting { height: 1fr; content-align: center middle; text-align: center; }
    #arms { grid-size: 2; grid-rows: auto; height: auto; }
    .-wide #arms { grid-size: 4; }
    ArmPanel { height: auto; min-height: 4; border: round $primary-darken-2; padding: 0 1; }
    ArmPanel, #info Static, #plot { border-title-color: $text; border-subtitle-color: $text; }
    ArmPanel { border-title-style: bold; text-wrap: nowrap; }
    #info { height: 8; }
    #info Static { border: round $primary-darken-2; padding: 0 1; height: 8; }
    #info Static { text-wrap: nowrap; text-overflow: ellipsis; }
    #balance { width: 34; }
    #vehicle { width: 1fr; }
    #board { width: 23; }
    .-wide #info Static { width: 1fr; }
    #plot { height: 1fr; min-height: 4; border: round $primary-darken-2; padding: 0 1; }
    #notes { height: auto; max-height: 8; padding: 0 1; }
    .-short #notes { max-height: 2; }
    Help { align: center middle; }
    #help { width: auto; max-width: 100%; height: auto; padding: 0 1; }
    #help { border: round $accent; background: $surface; }
    """

    def __init__(
        self,
        look: Callable[[float], View],
        *,
        trouble: Callable[[], BaseException | None] = lambda: None,
        folder: Path | None = None,
        plot_span_s: float = 60.0,
    ) -> None:
        super().__init__()
        self.look, self.trouble = look, trouble
        self.folder = folder or Path.cwd()
        self.paused = False
        self.view: View | None = None
        self._history = History(plot_span_s)
        self._shown = self._history  # what a paused plot keeps

    def compose(self) -> ComposeResult:
        view = self.look(time.monotonic())
        yield Static(id="head")
        yield Static(id="waiting")
        yield Grid(*(ArmPanel(id=f"arm{k}") for k in range(len(view.arms))), id="arms")
        with Horizontal(id="info"):
            yield Static(id="balance")
            yield Static(id="vehicle")
            yield Static(id="board")
        yield Static(id="plot")
        yield Static(id="notes")
        yield Footer()

    def on_mount(self) -> None:
        for name in ("balance", "vehicle", "board"):
            self.query_one(f"#{name}").border_title = name if name != "board" else "table on board"
        self.tick()
        self.set_interval(REFRESH_S, self.tick)

    def on_resize(self) -> None:
        # sizes are known only after the layout has run
        self.call_after_refresh(self.draw)

    def tick(self) -> None:
        """Take a new view; a paused picture stands still while the history goes on."""
        if self.trouble() is not None:
            self.exit()
            return
        now = time.monotonic()
        view = self.look(now)
        self._history = self._history.extended(view, now)
        if not self.paused:
            self.view, self._shown = view, self._history
        self.draw()

    def draw(self) -> None:
        """Format the view that is shown."""
        view = self.view
        if view is None or len(self.screen_stack) == 0:
            return
        root = self.screen_stack[0]
        waiting = view.link.state == "waiting"
        for name in ("arms", "info", "plot", "notes"):
            root.query_one(f"#{name}").display = not waiting
        root.query_one("#waiting").display = waiting
        self._put("head", words.head(view, self.size.width - 2, self.paused))
        if waiting:
            self._put("waiting", _waiting(view))
            return
        stale = view.speeds_stale or view.link.state == "lost"
        for k, arm in enumerate(view.arms):
            root.query_one(f"#arm{k}", ArmPanel).show(arm, stale)
        self._put("balance", words.balance(view))
        split = Content.from_rich_text(words.weight_and_split(view))
        root.query_one("#balance").border_subtitle = split
        self._put("vehicle", words.vehicle(view))
        self._put("board", words.board(view))
        plot = root.query_one("#plot", Static)
        plot.border_title = Content.from_rich_text(words.plot_legend(view.arms))
        plot.border_subtitle = f"the last {self._shown.span_s:.0f} s of the vehicle's clock"
        size = plot.content_size
        plot.update(words.split_plot(self._shown, size.width, size.height))
        notes = words.notes(view)
        root.query_one("#notes").display = bool(notes.plain)
        self._put("notes", notes)

    def action_pause(self) -> None:
        """Hold the picture, or let it run again."""
        self.paused = not self.paused
        self.tick()

    def action_help(self) -> None:
        """Show the help."""
        self.push_screen(Help())

    def action_save(self) -> None:
        """Write the screen as an SVG file beside the user's other files."""
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        path = self.folder / f"coaxlink-monitor-{stamp}.svg"
        try:
            files.write_atomic(path, self.export_screenshot(title=self.TITLE))
        except CoaxlinkError as error:
            self.notify(str(error), severity="error", markup=False)
        else:
            self.notify(f"saved {path}", markup=False)

    def _put(self, name: str, text: Text) -> None:
        self.screen_stack[0].query_one(f"#{name}", Static).update(text)


def _waiting(view: View) -> Text:
    return Text.assemble(
        (f"waiting for {view.link.detail}\n\n", f"bold {words.WARN}"),
        ("no autopilot has been heard yet; the screen fills as soon as one is.\n", ""),
        ("A simulated one:  coaxlink sim --firmware px4", words.DIM),
    )
