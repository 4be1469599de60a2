"""The Textual screen. It asks for a view five times a second and formats it; it computes nothing."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.css.query import NoMatches
from textual.widgets import ContentSwitcher, Footer, Static

from coaxlink import files
from coaxlink.errors import CoaxlinkError
from coaxlink.monitor.incoming.recording import Player
from coaxlink.monitor.screen import words
from coaxlink.monitor.screen.dialogs import GoTo, Help
from coaxlink.monitor.screen.history import History, Window
from coaxlink.monitor.screen.marks import DIM, WARN
from coaxlink.monitor.screen.pages import (
    ErrorPage,
    HealthPage,
    MessagesPage,
    ParametersPage,
    Picture,
    SplitPage,
    put,
)
from coaxlink.monitor.screen.plots import Zoomed
from coaxlink.monitor.state.moment import Moment

REFRESH_S = 0.2
REPLAY_KEYS: list[BindingType] = [
    Binding("space", "play", "Play/stop", show=False),
    Binding("comma", "seek(-10)", "10 s back", show=False),
    Binding("full_stop", "seek(10)", "10 s on", show=False),
    Binding("less_than_sign", "seek(-60)", "1 min back", show=False),
    Binding("greater_than_sign", "seek(60)", "1 min on", show=False),
    Binding("left_square_bracket", "speed(0.5)", "Slower", show=False),
    Binding("right_square_bracket", "speed(2.0)", "Faster", show=False),
    Binding("g", "go_to", "Go to", show=False),
]
REPLAY_ACTIONS = ("play", "seek", "speed", "go_to")


class Monitor(App[None]):
    """`look()` gives the present; once `trouble()` is not None the link is dead and the screen ends.

    `folder` is where pictures go (default: the current one), none are saved without `saves`; `page` is what
    is shown first; with `player` it is a replay.
    """

    TITLE = "coaxlink monitor"
    AUTO_FOCUS = ""  # else keys would go to a page that is not shown
    HORIZONTAL_BREAKPOINTS = [(0, "-phone"), (76, "-narrow"), (150, "-wide")]  # noqa: RUF012 - as Textual types it
    VERTICAL_BREAKPOINTS = [(0, "-short"), (30, "-tall")]  # noqa: RUF012
    BINDINGS: ClassVar[list[BindingType]] = [
        ("1", "page('split')", "Split"),
        ("2", "page('error')", "Error"),
        ("3", "page('parameters')", "Parameters"),
        ("4", "page('messages')", "Messages"),
        ("5", "page('health')", "Health"),
        ("p", "pause", "Pause"),
        Binding("s", "save", "Save", show=False),  # 80 columns hold no more
        ("question_mark", "help", "Help"),
        ("q", "quit", "Quit"),
        Binding("ctrl+c", "quit", "Quit", show=False, priority=True),
        Binding("left", "scroll(0.25)", "Earlier", show=False),
        Binding("right", "scroll(-0.25)", "Later", show=False),
        Binding("end", "scroll(-1000)", "Now", show=False),
        Binding("plus,equals_sign", "zoom(0.5)", "Zoom in", show=False),
        Binding("minus", "zoom(2.0)", "Zoom out", show=False),
        *REPLAY_KEYS,
    ]
    CSS_PATH = "screen.tcss"
    ENABLE_COMMAND_PALETTE = False  # every action has a key

    def __init__(
        self,
        look: Callable[[], Moment],
        *,
        trouble: Callable[[], BaseException | None] = lambda: None,
        folder: Path | None = None,
        plot_span_s: float = 60.0,
        page: str = "split",
        saves: bool = True,
        player: Player | None = None,
    ) -> None:
        super().__init__()
        self.look, self.trouble, self.player = look, trouble, player
        self.folder = folder or Path.cwd()
        self._saves = saves
        self.paused = False
        self.view: Moment | None = None
        self.window = Window(plot_span_s)
        self._first = page
        self._history = History()
        self._shown = self._history  # what a paused plot keeps

    def compose(self) -> ComposeResult:
        yield Static(id="head")
        yield Static(id="waiting")
        with ContentSwitcher(initial=self._first, id="pages"):
            yield SplitPage(self.look().arms)
            yield ErrorPage(id="error")
            yield ParametersPage(id="parameters")
            yield MessagesPage(id="messages")
            yield HealthPage(id="health")
        yield Static(id="notes")
        yield Footer()

    def on_mount(self) -> None:
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
        view = self.look()
        self._history = self._history.extended(view)
        if not self.paused:
            self.view, self._shown = view, self._history
        self.draw()

    def draw(self) -> None:
        """Format the view that is shown."""
        with contextlib.suppress(NoMatches):  # while the screen is put together or taken down
            self._draw()

    def _draw(self) -> None:
        view = self.view
        if view is None or len(self.screen_stack) == 0:
            return
        root = self.screen_stack[0]
        waiting = view.link.state == "waiting"
        pages = root.query_one("#pages", ContentSwitcher)
        pages.display = not waiting
        root.query_one("#waiting").display = waiting
        place = None if self.player is None else words.replay_words(self.player)
        self._put("head", words.head(view, self.size.width - 2, self.paused, place))
        if waiting:
            root.query_one("#notes").display = False
            self._put("waiting", _waiting(view))
            return
        page = pages.visible_content
        if isinstance(page, SplitPage | ErrorPage | MessagesPage | HealthPage | ParametersPage):
            page.draw(Picture(view, self._shown, self.window, None if self.player else datetime.now()))
        notes = words.notes(view)
        root.query_one("#notes").display = bool(notes.plain)
        self._put("notes", notes)

    # -- what the user does ----------------------------------------------------------------------------------

    def action_page(self, name: str) -> None:
        """Show another page."""
        root = self.screen_stack[0]
        root.query_one("#pages", ContentSwitcher).current = name
        # so that the keys up and down scroll what is longer than the screen
        root.set_focus(root.query_one(f"#{name}") if name in ("parameters", "messages") else None)
        # a page that was hidden has no size before the layout has run
        self.call_after_refresh(self.draw)

    def action_pause(self) -> None:
        """Hold the picture, or let it run again."""
        self.paused = not self.paused
        self.tick()

    def action_scroll(self, share: float) -> None:
        """Show earlier or later times in the plots."""
        self.window = self.window.moved(share, self._shown)
        self.draw()

    def action_zoom(self, factor: float) -> None:
        """Show a longer or a shorter time in the plots."""
        self.window = self.window.zoomed(factor).moved(0.0, self._shown)
        self.draw()

    def on_zoomed(self, message: Zoomed) -> None:
        self.action_zoom(message.factor)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Keys of a replay do nothing on a live vehicle."""
        return self.player is not None if action in REPLAY_ACTIONS else True

    def action_play(self) -> None:
        """Replay: stop, or go on."""
        if self.player:
            self.player.toggle()
            self.tick()

    def action_seek(self, by_s: float) -> None:
        """Replay: so many seconds on."""
        if self.player:
            self.player.seek(self.player.position_s + by_s)
            self.tick()

    def action_speed(self, factor: float) -> None:
        """Replay: so many times as fast."""
        if self.player:
            self.player.scale(factor)
            self.draw()

    def action_go_to(self) -> None:
        """Replay: ask for a time and go there."""

        def go(to_s: float | None) -> None:
            if self.player and to_s is not None:
                self.player.seek(to_s)
                self.tick()

        self.push_screen(GoTo(), go)

    def action_help(self) -> None:
        """Show the help."""
        self.push_screen(Help(replay=self.player is not None))

    def action_save(self) -> None:
        """Write the screen as an SVG file beside the user's other files."""
        if not self._saves:
            self.notify("a page of a browser writes no file; take the picture in a terminal", markup=False)
            return
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        path = self.folder / f"coaxlink-monitor-{stamp}.svg"
        try:
            files.write_atomic(path, self.export_screenshot(title=self.TITLE))
        except CoaxlinkError as error:
            self.notify(str(error), severity="error", markup=False)
        else:
            self.notify(f"saved {path}", markup=False)

    def _put(self, name: str, text: Text) -> None:
        put(self.screen_stack[0].query_one(f"#{name}", Static), text)


def _waiting(view: Moment) -> Text:
    return Text.assemble(
        (f"waiting for {view.link.detail}\n\n", f"bold {WARN}"),
        ("no autopilot has been heard yet; the screen fills as soon as one is.\n", ""),
        ("A simulated one:  coaxlink sim --firmware px4", DIM),
    )
