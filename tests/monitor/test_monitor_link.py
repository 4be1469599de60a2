"""The link's thread with the stand-in autopilots in memory: connect, streams, table, upload, loss, return."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from memory_net import Net, Standin, meet
from monitor_messages import INTEGERS, X8, px4_table

from coaxlink.cli import main
from coaxlink.errors import InputError, LinkError
from coaxlink.files import example
from coaxlink.mavlink.parameters import Parameters
from coaxlink.monitor.incoming.heard import Heard
from coaxlink.monitor.incoming.link import COMPONENT, LinkThread, check_address
from coaxlink.monitor.state.moment import Moment
from coaxlink.monitor.state.watch import Watch
from coaxlink.uploading.outcome import VERIFIED, Talk
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.worker import Uploader

pytestmark = pytest.mark.slow


class Watched:
    """A stand-in, the link to it, and who looks at it while time passes."""

    def __init__(self, firmware: str = "px4", **world: object) -> None:
        self.net = Net()
        self.board: Standin | None = Standin(self.net, firmware, **world)
        self.clock = self.net.clock
        self.heard = Heard(self.clock.monotonic)
        self.watch = Watch(self.heard, X8, "here")
        self.link = LinkThread(self.heard, "here", clock=self.clock, open_session=self._open)
        self.opened = 0

    def _open(self, url: str, patience_s: float) -> object:
        self.opened += 1
        if self.board is None:
            self.clock.sleep(patience_s)
            raise LinkError(url, "no autopilot heard")
        return meet(self.board, timeout_s=patience_s, source_component=COMPONENT, listen_only=True)

    def until(self, met: Callable[[Moment], bool], within_s: float = 30.0) -> Moment:
        """Run the link until that is seen."""
        seen: list[Moment] = []

        def look() -> None:
            moment = self.watch.look()
            if met(moment):
                seen.append(moment)
            if seen or self.clock.now > end:
                self.link.stop()
            else:
                self.clock.later(0.1, look)

        end = self.clock.now + within_s
        self.link._stopping.clear()
        self.clock.later(0.1, look)
        self.link.run()
        assert self.link.failure is None
        assert seen, f"not seen in {within_s} s: {self.watch.look()}"
        return seen[0]


def upload(board: Standin, values: dict[str, float]) -> None:
    with meet(board) as session:
        parameters = Parameters(session)
        for name, value in values.items():
            parameters.write(name, value, 6 if name in INTEGERS else 9)


def test_waits_then_lives_then_reads_the_table_and_sees_an_upload() -> None:
    watched = Watched()
    board, watched.board = watched.board, None
    assert board is not None
    watched.until(lambda m: watched.opened > 1 and m.link.state == "waiting")
    watched.board = board
    first = watched.until(lambda m: m.board.state == "read" and m.balance.thrust_N is not None)
    assert first.link.state == "live" and first.board.kind == "standard"
    assert first.vehicle is not None and first.vehicle.firmware == "PX4" and first.vehicle.version
    assert first.vehicle.voltage_V is not None and not first.vehicle.armed
    upload(board, px4_table(46.95, 69.89))
    second = watched.until(lambda m: m.board.kind == "reduced")
    assert second.board.digest != first.board.digest


def test_an_unchanged_table_is_not_read_over_and_over(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    read = Parameters.answering

    def counted(self: Parameters, names: object, **rest: object) -> object:
        asked.extend(names := tuple(names))  # type: ignore[arg-type]
        return read(self, names, **rest)  # type: ignore[arg-type]

    monkeypatch.setattr(Parameters, "answering", counted)
    Watched().until(lambda m: asked.count("_HASH_CHECK") >= 3)
    assert asked.count("CA_ROTOR0_CT") == 1


def test_link_lost_is_shown_and_heals_with_another_session() -> None:
    watched = Watched()
    watched.until(lambda m: m.balance.thrust_N is not None)
    board = watched.board
    assert board is not None
    watched.net.loss = 1.0
    watched.until(lambda m: m.link.state == "lost" and m.arms[0].upper.thrust_N is not None)
    opened = watched.opened
    watched.clock.later(15.0, lambda: setattr(watched.net, "loss", 0.0))
    watched.until(lambda m: m.link.state == "live" and not m.speeds_stale, 60.0)
    assert watched.opened > opened


@pytest.mark.parametrize("frame", ["15", "17"])
def test_an_ardupilot_is_read_like_a_px4(tmp_path: Path, frame: str) -> None:
    """Battery, table (script or loader), ESCs, of a vehicle that streams nothing by itself."""
    table = tmp_path / "table"
    made = ["--firmware", "ardupilot", "--law", "reduced", "--frame-class", frame, "--out", str(table)]
    with contextlib.suppress(SystemExit):
        main(["table", str(example("x8_paper.toml")), *made])
    watched = Watched("ardupilot")
    before = watched.until(lambda m: m.board.state == "read" and m.speeds.source != "")
    assert before.board.frame_class == 4
    assert before.vehicle is not None and before.vehicle.firmware == "ArduPilot"
    assert before.speeds.source == "ESC_TELEMETRY rpm" and before.vehicle.voltage_V is not None
    assert not any("mavlink id" in n for n in before.notes)
    assert watched.board is not None
    with meet(watched.board) as session:
        talk = Talk(confirm=lambda: True)
        outcome = Uploader(session, backup_folder=tmp_path, talk=talk).upload(load_plan(table))
    assert outcome.result == VERIFIED
    after = watched.until(lambda m: m.board.frame_class == int(frame), 60.0)
    assert after.board.digest != before.board.digest


def test_a_line_that_cannot_be_opened_is_said_while_it_is_tried_again() -> None:
    watched = Watched()

    def fails(url: str, patience_s: float) -> object:
        watched.opened += 1
        if watched.opened < 3:
            raise LinkError(url, "the device is gone")
        raise InputError(url, "", "the device is gone")

    watched.link._open = fails  # type: ignore[assignment]
    watched.until(lambda m: watched.opened >= 4 and "gone" in m.link.detail)


def test_addresses_are_checked_before_the_screen() -> None:
    with pytest.raises(InputError):
        check_address("carrier-pigeon")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        with pytest.raises(LinkError, match=r"cannot be opened|in use"):
            check_address(f"udpin:127.0.0.1:{holder.getsockname()[1]}")
    with pytest.raises(LinkError):
        check_address("/dev/no-such-line,57600")
    check_address("tcp:127.0.0.1:9")  # a server may come up later


def test_px4s_words_arrive_on_the_ground_and_the_screen_says_why_not_in_flight() -> None:
    watched = Watched()
    board = watched.board
    assert board is not None
    watched.until(lambda m: m.board.state == "read" and not m.unheard)
    watched.clock.later(2.0, board.autopilot.arm)
    armed = watched.until(lambda m: m.vehicle is not None and m.vehicle.armed and bool(m.texts))
    assert "none in flight" in armed.unheard
