"""The page of parameters with a stand-in autopilot: difference, backup, a confirmed upload, never armed."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from monitor_messages import heartbeat, servo
from test_monitor_screen import Scene
from test_monitor_standin import coaxlink
from textual.widgets import Button

from coaxlink import files
from coaxlink.mavlink import connect
from coaxlink.mavlink.parameters import Parameters
from coaxlink.monitor.board.desk import Desk, Report
from coaxlink.monitor.feed import Feed
from coaxlink.monitor.screen.app import Monitor
from coaxlink.monitor.watch import Watch
from coaxlink.uploading.backup import read_backup
from coaxlink.vehicle import load_vehicle
from sim.testing import standin

X8 = files.example("x8_paper.toml")


def ct_on_board(address: str) -> float:
    with connect(address) as session:
        return float(Parameters(session).read("CA_ROTOR0_CT").value)


@pytest.mark.timeout(1800)
def test_difference_backup_and_an_upload_that_is_confirmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    table, backups = tmp_path / "table", tmp_path / "backups"
    coaxlink("table", str(X8), "--firmware", "px4", "--law", "reduced", "--out", str(table))

    async def story(address: str) -> None:
        watch, desk = Watch(address, load_vehicle(X8)), Desk(backups)
        feed = Feed(watch, desk=desk)
        feed.start()
        app = Monitor(watch.look, trouble=lambda: feed.failure, desk=desk, table=table)

        def on_screen() -> str:
            return str(app.screen_stack[0].query_one("#told").visual)

        async def until(met: Callable[[], bool]) -> None:
            end = time.monotonic() + 600.0
            while not met():
                assert time.monotonic() < end, on_screen()
                await asyncio.sleep(0.05)
                app.tick()

        try:
            async with app.run_test(size=(80, 24)) as pilot:
                await until(lambda: app.view is not None and app.view.board.state == "read")
                await pilot.press("3", "d")
                await until(lambda: "CA_ROTOR0_CT" in on_screen())
                assert "difference to" in on_screen() and not backups.exists()
                await pilot.press("b")
                await until(lambda: "all parameters of the board" in on_screen())
                (saved,) = backups.glob("*.params")
                assert read_backup(saved).params["CA_ROTOR0_CT"] == 6.5
                await pilot.press("u")
                await until(lambda: len(app.screen_stack) == 2)
                await pilot.press("n")
                await until(lambda: "not confirmed; nothing was changed" in on_screen())
                assert app.view.board.upper_ct == 6.5
                await pilot.press("u")
                await until(lambda: len(app.screen_stack) == 2)
                app.screen_stack[0].query_one("#pages")
                await app.action_quit()  # not in the middle of it
                assert app.is_running
                await pilot.press("y")
                await until(lambda: "written and read back" in on_screen())
                await until(lambda: app.view.board.kind == "reduced")
        finally:
            feed.stop()
        assert feed.failure is None

    with standin("--firmware", "px4", "--airframe", str(X8)) as port:
        address = f"udpout:127.0.0.1:{port}"
        asyncio.run(story(address))
        assert ct_on_board(address) > 30.0


def test_an_armed_vehicle_is_left_alone_and_a_screen_without_a_desk_says_why(tmp_path: Path) -> None:
    async def story(armed: bool, desk: Desk | None) -> str:
        scene = Scene(tmp_path)
        app = scene.app
        app.desk = desk
        async with app.run_test(size=(80, 24)) as pilot:
            scene.hear(heartbeat(armed), servo())
            await pilot.press("3")
            await pilot.pause()
            scene.hear(heartbeat(armed), servo())
            await pilot.press("b", "u", "d")
            disabled = {button.disabled for button in app.query(Button)}
            assert disabled == {armed or desk is None}
            return scene.text("told")

    desk = Desk(tmp_path)
    assert "is armed" in asyncio.run(story(True, desk)) and not desk.busy
    assert "only watches" in asyncio.run(story(False, None))


def test_a_desk_takes_one_task_at_a_time_and_says_what_is_missing(
    tmp_path: Path,
) -> None:
    reports: list[Report] = []
    desk = Desk(tmp_path)
    desk.backup(reports.append)
    desk.difference(tmp_path / "absent", reports.append)
    assert reports[0].error == "wait: backup is under way"
    desk.work(None)
    assert reports[1].error == "no link to the vehicle" and not desk.busy
    desk.difference(tmp_path / "absent", reports.append)
    desk.work(object())  # the file is read first
    assert "absent" in reports[2].error and not desk.busy
