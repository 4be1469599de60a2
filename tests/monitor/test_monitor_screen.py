"""The screen driven by Textual's pilot, fed by hand-made messages."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import pytest
from monitor_messages import EscStatus, Sender, attitude, battery, heartbeat, position, servo
from rich.text import Text
from test_monitor_board import table
from textual.widgets import Static
from textual.widgets._footer import FooterKey

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.monitor.screen.app import Monitor
from coaxlink.monitor.watch import Watch
from coaxlink.rotor import load_rotor_model
from coaxlink.vehicle import Vehicle


class Scene:
    """A watch and its screen, with a vehicle played by hand."""

    def __init__(self, folder: Path) -> None:
        airframe = load_airframe(files.example("x8_paper.toml"))
        model = load_rotor_model(files.example("rotor_paper.toml"))
        self.watch = Watch("udpin:0.0.0.0:14550", Vehicle(airframe, model))
        self.now_s = 1000.0  # stands still: how old a message is does not depend on how busy the machine is
        self.app = Monitor(lambda _: self.watch.look(self.now_s), folder=folder)
        self.sender = Sender()

    def hear(self, *messages: Any, ago_s: float = 0.0) -> None:
        for message in messages:
            self.watch.collector.take(self.sender(message), self.now_s - ago_s)
        self.app.tick()

    def fly(self, boot_ms: int = 1000, upper_rpm: int = 2381) -> None:
        self.hear(heartbeat(), servo(), attitude(boot_ms=boot_ms), position(boot_ms=boot_ms), battery())
        self.hear(EscStatus(0, [upper_rpm] * 4), EscStatus(4, [3499] * 4))

    def text(self, name: str) -> str:
        widget = self.app.screen_stack[0].query_one(f"#{name}", Static)
        return str(widget.visual)

    def border(self, name: str) -> str:
        return Text.from_markup(self.app.screen_stack[0].query_one(f"#{name}").border_subtitle or "").plain


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return Scene(tmp_path)


def run(story: Coroutine[Any, Any, None]) -> None:
    asyncio.run(story)


def test_waits_then_fills_and_fits_80_by_24(scene: Scene) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            await pilot.pause()
            assert "waiting for a heartbeat" in scene.text("waiting")
            assert not scene.app.query_one("#pages").display
            scene.fly()
            await pilot.pause()
            scene.app.draw()
            assert not scene.app.query_one("#waiting").display
            assert "2381" in scene.text("arm0") and "▼6" in scene.text("arm0")
            assert "front right" in str(scene.app.query_one("#arm0").border_title)
            assert "ARMED" in scene.text("head")
            assert scene.border("vehicle") == "ESC_STATUS rpm"
            assert scene.app.screen.max_scroll_y == 0
            for name in ("arm0", "arm3", "balance", "board", "plot"):
                assert scene.app.query_one(f"#{name}").region.bottom <= 24

    run(story())


@pytest.mark.parametrize("page", "12345")
def test_help_and_quit_stand_at_the_bottom_of_every_page_of_80_columns(scene: Scene, page: str) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            scene.fly()
            await pilot.press(page)
            await pilot.pause()
            keys = {k.description: k.region for k in scene.app.query(FooterKey)}
            assert keys.keys() >= {"Help", "Quit"}
            assert all(r.width > 0 and r.right <= 80 and r.y == 23 for r in keys.values())

    run(story())


@pytest.mark.parametrize(("size", "rows"), [((80, 24), 2), ((200, 50), 1)])
def test_arms_stand_side_by_side_where_there_is_room(scene: Scene, size: tuple[int, int], rows: int) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=size) as pilot:
            scene.fly()
            await pilot.pause()
            assert len({scene.app.query_one(f"#arm{k}").region.y for k in range(4)}) == rows

    run(story())


@pytest.mark.parametrize("size", [(20, 5), (40, 12), (300, 90)])
def test_odd_sizes_do_no_harm(scene: Scene, size: tuple[int, int]) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=size) as pilot:
            scene.fly()
            await pilot.pause()
            scene.fly(2000)
            await pilot.resize_terminal(90, 30)
            await pilot.pause()
            assert "2381" in scene.text("arm0")

    run(story())


def test_pause_holds_the_picture_and_says_so(scene: Scene) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            scene.fly()
            await pilot.press("p")
            scene.fly(2000, upper_rpm=3000)
            await pilot.pause()
            assert "PAUSED" in scene.text("head") and "2381" in scene.text("arm0")
            await pilot.press("p")
            await pilot.pause()
            assert "PAUSED" not in scene.text("head") and "3000" in scene.text("arm0")

    run(story())


def test_save_writes_an_svg_and_a_bad_folder_is_only_told(scene: Scene, tmp_path: Path) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            scene.fly()
            await pilot.pause()
            await pilot.press("s")
            await pilot.pause()
            (saved,) = tmp_path.glob("coaxlink-monitor-*.svg")
            text = saved.read_text()
            assert text.startswith("<svg") and "front&#160;right" in text
            (tmp_path / "file").write_text("")
            scene.app.folder = tmp_path / "file" / "below"
            await pilot.press("s")
            await pilot.pause()
            assert any("cannot be written" in n.message for n in scene.app._notifications)

    run(story())


def test_help_opens_and_closes_while_the_picture_runs(scene: Scene) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            scene.fly()
            await pilot.press("question_mark")
            await pilot.pause()
            assert scene.app.screen.query("#help")
            scene.fly(2000, upper_rpm=2500)
            await pilot.press("escape")
            await pilot.pause()
            assert not scene.app.screen.query("#help")
            assert "2500" in scene.text("arm0")

    run(story())


@pytest.mark.parametrize("key", ["q", "ctrl+c"])
def test_quit(scene: Scene, key: str) -> None:
    async def story() -> None:
        async with scene.app.run_test() as pilot:
            await pilot.press(key)
            await pilot.pause()
            assert not scene.app.is_running

    run(story())


def test_link_lost_is_written_across_and_table_is_named(scene: Scene) -> None:
    async def story() -> None:
        async with scene.app.run_test(size=(100, 30)) as pilot:
            scene.watch.collector.follow(1, 1)
            scene.watch.collector.put_parameters(table(46.95, 69.89))
            scene.hear(heartbeat(), servo(), ago_s=6.0)
            await pilot.pause()
            assert re.match(r"LINK LOST (\d+)[. ]", scene.text("notes"))
            assert "lost" in scene.text("head")
            assert "reduced" in scene.text("board") and "47.0* / 69.9*" in scene.text("board")

    run(story())


@pytest.mark.parametrize("size", [(80, 24), (200, 60)])
def test_a_source_that_is_passed_over_is_named_on_the_screen(scene: Scene, size: tuple[int, int]) -> None:
    """PX4's simulation: 6000 rpm at full command on rotors of 5400, in hover."""

    async def story() -> None:
        async with scene.app.run_test(size=size) as pilot:
            rpm = [2646] * 4 + [3888] * 4
            for k in range(16):
                ms = 1000 + 200 * k
                scene.hear(heartbeat(), servo(), attitude(boot_ms=ms), position(boot_ms=ms), battery())
                scene.hear(EscStatus(0, rpm[:4]), EscStatus(4, rpm[4:]))
            await pilot.pause()
            scene.app.draw()
            assert scene.border("vehicle") == "SERVO_OUTPUT_RAW"
            assert "ESC_STATUS rpm passed over" in scene.text("notes")
            assert "2381" in scene.text("arm0")  # by the command, as a 5400 rpm rotor turns
            notes = scene.app.query_one("#notes")
            assert notes.region.bottom <= size[1] and "the weight is 196 N" in scene.text("notes")

    run(story())


def test_an_ardupilot_s_table_fits_its_panel(scene: Scene) -> None:
    from test_monitor_ardupilot import on_board

    async def story() -> None:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            sent = heartbeat(autopilot=3), servo(), attitude(), position(), battery()
            scene.hear(*sent)
            scene.watch.collector.put_parameters(
                on_board(scene.watch.vehicle.declared, scene.watch.vehicle.rotors, "reduced")
            )
            scene.app.tick()
            assert "being read" in scene.text("board")  # the link's thread compares it: that takes seconds
            scene.watch.judge_table()
            scene.hear(*sent)
            await pilot.pause()
            lines = scene.text("board").splitlines()
            assert lines[0] == "reduced (model's)" and lines[2] == "FRAME_CLASS 15"
            assert lines[3].startswith("factor 0.6") and lines[4].startswith("THST_EXPO 0.9")
            panel = scene.app.query_one("#board").content_size
            assert len(lines) <= panel.height and max(map(len, lines)) <= panel.width

    run(story())


def test_a_dead_feed_ends_the_screen(scene: Scene) -> None:
    async def story() -> None:
        async with scene.app.run_test() as pilot:
            scene.app.trouble = lambda: RuntimeError("boom")
            scene.app.tick()
            await pilot.pause()
            assert not scene.app.is_running

    run(story())
