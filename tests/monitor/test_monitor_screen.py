"""The screen driven by Textual's pilot on a clock that stands still, fed by hand-made messages.

What stands on it, letter by letter, is held against the texts in snapshots/ (looked at when they were made);
COAXLINK_SNAPSHOTS=write python -m pytest tests/monitor/test_monitor_screen.py writes them anew.
"""

from __future__ import annotations

import asyncio
import os
import re
from collections.abc import Callable, Coroutine
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from monitor_messages import (
    Scene,
    attitude,
    battery,
    heartbeat,
    hover,
    position,
    px4_table,
    servo,
)  # fmt: skip
from rich.text import Text
from textual.events import MouseScrollUp
from textual.pilot import Pilot
from textual.widgets import Static
from textual.widgets._footer import FooterKey

from coaxlink.monitor.screen.app import Monitor
from coaxlink.monitor.screen.plots import TimePlot

pytestmark = pytest.mark.slow
SNAPSHOTS = Path(__file__).parent / "snapshots"


class OnScreen(Scene):
    """A watch and its screen, with a vehicle played by hand."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.app = Monitor(self.watch.look, folder=folder)

    def show(self, *messages: Any) -> None:
        self.hear(*messages)
        self.app.tick()

    def text(self, name: str) -> str:
        return str(self.app.screen_stack[0].query_one(f"#{name}", Static).visual)

    def border(self, name: str) -> str:
        return Text.from_markup(self.app.screen_stack[0].query_one(f"#{name}").border_subtitle or "").plain

    def lines(self) -> list[str]:
        """All letters where they stand."""
        return [strip.text.rstrip() for strip in self.app.screen._compositor.render_strips()]


@pytest.fixture
def scene(tmp_path: Path) -> OnScreen:
    return OnScreen(tmp_path)


def run(story: Coroutine[Any, Any, None]) -> None:
    asyncio.run(story)


async def until(pilot: Pilot[None], so: Callable[[], bool], what: object = "") -> None:
    """Let the screen go on until it is so: a busy machine looks idle to the pilot before all is laid out."""
    for _ in range(300):
        if so():
            return
        await pilot.pause(0.02)
    raise AssertionError(what or "it never came to be so")


def fly_a_minute(scene: OnScreen) -> None:
    """An upper rotor that slowly turns faster, under the table of the reduced allocation."""
    scene.heard.put_parameters(px4_table(46.95, 69.89))
    for k in range(21):
        scene.clock.sleep(3.0)
        scene.show(*hover(boot_ms=3000 * k, upper_rpm=2381 + 12 * k))


def lose_it(scene: OnScreen) -> None:
    scene.hear(heartbeat(), servo(), attitude(), position(), battery())
    scene.clock.sleep(8.0)


SHOWN: dict[str, tuple[Callable[[OnScreen], object], str]] = {
    "waiting": (lambda scene: None, "1"),
    "split": (fly_a_minute, "1"),
    "split-lost": (lose_it, "1"),
    "error": (fly_a_minute, "2"),
    "parameters": (fly_a_minute, "3"),
    "messages": (fly_a_minute, "4"),
    "health": (fly_a_minute, "5"),
    "help": (fly_a_minute, "question_mark"),
}


async def shown(scene: OnScreen, played: Callable[[OnScreen], object], key: str, expected: str) -> str:
    """The letters after that; a busy machine gets time until they are as expected."""

    def lines() -> str:
        return "\n".join(scene.lines()) + "\n"

    async with scene.app.run_test(size=(80, 24)) as pilot:
        played(scene)
        await pilot.press(key)
        await pilot.pause()
        scene.app.tick()
        with suppress(AssertionError):
            await until(pilot, lambda: lines() == expected)
        return lines()


def test_the_screen_is_as_it_was_looked_at(tmp_path: Path) -> None:
    changed, write = [], os.environ.get("COAXLINK_SNAPSHOTS") == "write"
    for name, (played, key) in SHOWN.items():
        path = SNAPSHOTS / f"{name}.txt"
        expected = path.read_text() if path.exists() else ""
        found = asyncio.run(shown(OnScreen(tmp_path), played, key, expected))
        if write:
            path.write_text(found)
        elif found != expected:
            changed.append(f"{name}:\n{found}")
    assert not changed, "\n".join(changed)


def test_waits_then_fills_and_fits_80_by_24(scene: OnScreen) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            await pilot.pause()
            assert "waiting for a heartbeat" in scene.text("waiting")
            assert not scene.app.query_one("#pages").display
            scene.show(*hover())
            await pilot.pause()
            scene.app.draw()
            assert not scene.app.query_one("#waiting").display
            assert "2381" in scene.text("arm0") and "ARMED" in scene.text("head")
            parts = [scene.app.query_one(f"#{n}") for n in ("arm0", "arm3", "balance", "board", "splits")]
            await until(pilot, lambda: all(0 < part.region.bottom <= 24 for part in parts))
            assert scene.app.screen.max_scroll_y == 0

            def keys_fit() -> bool:
                keys = {k.description: k.region for k in scene.app.query(FooterKey)}
                fit = all(r.width > 0 and r.right <= 80 and r.y == 23 for r in keys.values())
                return fit and keys.keys() >= {"Help", "Quit"}

            for page in "12345":
                await pilot.press(page)
                await until(pilot, keys_fit, page)

    run(story())


def test_arms_stand_side_by_side_where_there_is_room_and_odd_sizes_do_no_harm(scene: OnScreen) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            scene.show(*hover())
            for size, rows in (((80, 24), 2), ((20, 5), 2), ((200, 50), 1)):
                await pilot.resize_terminal(*size)
                arms = [scene.app.query_one(f"#arm{k}") for k in range(4)]
                await until(pilot, lambda arms=arms, rows=rows: len({a.region.y for a in arms}) == rows, size)
                scene.show(*hover(2000))
            assert "2381" in scene.text("arm0")

    run(story())


def test_pause_holds_the_picture_and_says_so(scene: OnScreen) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            scene.show(*hover())
            await pilot.press("p")
            scene.show(*hover(2000, upper_rpm=3000))
            assert "PAUSED" in scene.text("head") and "2381" in scene.text("arm0")
            await pilot.press("p")
            assert "PAUSED" not in scene.text("head") and "3000" in scene.text("arm0")

    run(story())


def test_plots_are_moved_and_zoomed_by_keys_and_wheel(scene: OnScreen) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            fly_a_minute(scene)
            await pilot.press("plus", "left")
            assert scene.app.window.span_s == 30.0 and scene.app.window.back_s == 7.5
            assert "up to 0:52.5" in "\n".join(scene.lines())
            await pilot.press("end", "minus")
            assert scene.app.window.span_s == 60.0 and scene.app.window.back_s == 0.0
            await pilot._post_mouse_events([MouseScrollUp], TimePlot)
            await until(pilot, lambda: scene.app.window.span_s == 48.0)

    run(story())


def test_save_writes_an_svg_and_a_bad_folder_is_only_told(scene: OnScreen, tmp_path: Path) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            scene.show(*hover())
            await pilot.pause()
            await pilot.press("s")
            (saved,) = tmp_path.glob("coaxlink-monitor-*.svg")
            text = saved.read_text()
            assert text.startswith("<svg") and "front&#160;right" in text
            (tmp_path / "file").write_text("")
            scene.app.folder = tmp_path / "file" / "below"
            await pilot.press("s")
            assert any("cannot be written" in n.message for n in scene.app._notifications)

    run(story())


def test_help_closes_while_the_picture_runs_and_long_pages_scroll(scene: OnScreen) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            fly_a_minute(scene)
            await pilot.press("question_mark")
            assert scene.app.screen.query("#help")
            scene.show(*hover(61_000, upper_rpm=2600))
            await pilot.press("q")  # any key: it ends the help alone
            assert not scene.app.screen.query("#help") and "2600" in scene.text("arm0")
            await pilot.press("3")
            await pilot.pause()
            page = scene.app.query_one("#parameters")
            await until(pilot, lambda: page.max_scroll_y > 0)
            await pilot.press("down")
            await until(pilot, lambda: page.scroll_target_y > 0)

    run(story())


def test_quit_and_a_dead_link_end_the_screen(tmp_path: Path) -> None:
    for key in ("q", "ctrl+c", ""):
        scene = OnScreen(tmp_path)

        async def story(scene: OnScreen = scene, key: str = key) -> None:
            async with scene.app.run_test() as pilot:
                if key:
                    await pilot.press(key)
                else:
                    scene.app.trouble = lambda: RuntimeError("boom")
                    scene.app.tick()
                await until(pilot, lambda scene=scene: not scene.app.is_running, key)

        run(story())


def test_link_lost_is_written_across_and_table_is_named(scene: OnScreen) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(100, 30)) as pilot:
            scene.heard.put_parameters(px4_table(46.95, 69.89))
            scene.hear(heartbeat(), servo())
            scene.clock.sleep(6.0)
            scene.app.tick()
            await pilot.pause()
            assert re.match(r"LINK LOST (\d+)[. ]", scene.text("notes"))
            assert "lost" in scene.text("head")
            assert "reduced" in scene.text("board") and "47.0* / 69.9*" in scene.text("board")

    run(story())
