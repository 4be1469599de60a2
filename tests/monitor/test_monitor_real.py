"""The monitor as people run it: one look, in a terminal (tmux), served to a browser (headless Chromium)."""

from __future__ import annotations

import asyncio
import base64
import io
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from browser import CHROMIUM, WAIT_S, Browser, wait

from coaxlink.files import example
from coaxlink.monitor.screen.marks import LOWER, UPPER
from coaxlink.studies.simulator import free_port
from sim.testing import standin

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with standin("--firmware", "px4", "--airframe", str(example("x8_demo.toml"))) as port:
        yield f"udpout:127.0.0.1:{port}"


def monitor(address: str, *options: str) -> list[str]:
    return [sys.executable, "-m", "coaxlink", "monitor", "--connect", address, *options]


def test_one_look_at_a_vehicle(address: str, tmp_path: Path) -> None:
    target = tmp_path / "look.json"
    look: dict[str, Any] = {"board": {"state": "not looked at"}}
    for seconds in ("2", "20", "100"):  # a busy machine is listened to for longer
        command = monitor(address, "--once", "--seconds", seconds, "--json", str(target))
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode == 0 and (look := json.loads(target.read_text()))["board"]["state"] == "read":
            break
    assert done.returncode == 0, done.stderr
    assert "front right" in done.stdout and "disarmed" in done.stdout
    assert look["link"]["state"] == "live" and look["board"]["state"] == "read"
    assert look["balance"]["thrust_N"] == 0.0 and look["parameters"]["CA_ROTOR_COUNT"] == 8.0


@pytest.mark.skipif(not shutil.which("tmux"), reason="tmux is not installed")
def test_in_a_terminal_of_80_by_24(address: str, tmp_path: Path) -> None:
    def tmux(*words: str) -> str:
        done = subprocess.run(
            ["tmux", "-S", str(tmp_path / "socket"), *words], capture_output=True, text=True
        )
        return done.stdout

    def on_screen(*words: str) -> bool:
        shown = tmux("capture-pane", "-p")
        return all(word in shown for word in words)

    tmux("new-session", "-d", "-x", "80", "-y", "24", "--", *monitor(address))
    try:
        assert wait(lambda: on_screen("front right", "rear left", "table on board", "5 Health"))
        for key, words in {
            "2": ("allocation error",),
            "5": ("rotors' health in the air", "not judged", "rotors: not judged"),
            "?": ("coaxlink monitor", "upper"),
        }.items():
            tmux("send-keys", key)
            assert wait(lambda words=words: on_screen(*words)), tmux("capture-pane", "-p")  # type: ignore[misc]
        assert all(len(line) <= 80 for line in tmux("capture-pane", "-p").splitlines())
        tmux("send-keys", "?")
        assert wait(lambda: on_screen("rotors' health in the air"))
        tmux("send-keys", "q")
        assert wait(lambda: not tmux("list-sessions"))  # it left by itself
    finally:
        tmux("kill-server")


def shows_rotors(browser: Browser, page: str) -> bool:
    """Whether the bars of upper and lower rotors are on a page before long."""
    from PIL import Image

    bars = {tuple(int(colour[k : k + 2], 16) for k in (1, 3, 5)) for colour in (UPPER, LOWER)}

    def drawn() -> bool:
        picture = base64.b64decode(browser.ask(page, "Page.captureScreenshot")["data"])
        image = Image.open(io.BytesIO(picture)).convert("RGB")
        return bars <= {colour for count, colour in image.getcolors(1 << 24) or () if count > 20}

    return wait(drawn)


@contextmanager
def serving(*command: str, at: int | None = None) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The server of a monitor's command, and the address that it prints."""
    pytest.importorskip("textual_serve")
    port = ("--web", "--port", str(at or free_port()))
    served = subprocess.Popen([*command, *port], stdout=subprocess.PIPE, text=True)
    assert served.stdout is not None
    with served.stdout as reported:
        try:
            yield served, reported.readline().split()[2]
        finally:
            served.kill()
            served.wait()


def screens_of(served: subprocess.Popen[str]) -> list[int]:
    """The processes of its sessions."""
    found = subprocess.run(["pgrep", "-P", str(served.pid)], capture_output=True, text=True)
    return [int(number) for number in found.stdout.split()]


@pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed")
def test_in_a_browser(address: str, tmp_path: Path) -> None:
    with serving(*monitor(address)) as (served, url), Browser(tmp_path / "profile") as browser:
        assert shows_rotors(browser, browser.open(url))
        browser.kill()
        assert wait(lambda: not screens_of(served))
        served.send_signal(signal.SIGINT)
        assert served.wait(WAIT_S) == 0


@pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed")
def test_a_page_whose_line_broke_begins_again_or_says_why_not(tmp_path: Path) -> None:
    port, line = free_port(), f"udpin:127.0.0.1:{free_port()}"
    with Browser(tmp_path / "profile") as browser:
        with serving(*monitor(line), at=port) as (_, url):
            page = browser.open(url)
            assert browser.says(page, "-first-byte", "document.body.className")
            browser.value(page, "document.title = 'before'; line.close(4000)")
            assert browser.says(page, "-first-byte coax", "`${document.body.className} ${document.title}`")
        assert browser.says(page, "does not answer")
        assert browser.value(page, "getComputedStyle(terminal).opacity < 0.5")  # old numbers look it
        with serving(*monitor(line), at=port):
            assert browser.says(page, "started anew. Open the address that the terminal shows")


@pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed")
def test_a_browser_does_not_bring_others_in(tmp_path: Path) -> None:
    with (
        serving(*monitor(f"udpin:127.0.0.1:{free_port()}")) as (served, url),
        Browser(tmp_path / "profile", "--host-resolver-rules=MAP evil.example 127.0.0.1") as browser,
    ):
        own, token = url.split("/?token=")
        bent = own.replace("127.0.0.1", "evil.example")
        assert browser.says(browser.open(own), "its token lets you in")
        assert browser.says(browser.open(f"{bent}/?token={token}"), "for its own page only")
        script = f"""
            const line = new WebSocket("{own.replace("http", "ws")}/ws/{token}?width=80&height=24");
            line.onopen = () => document.title = "came in";
            line.onerror = () => document.title = "kept out";
            fetch("{url}").then(a => a.text()).then(t => document.body.append("read it"), e => {{}});
        """
        page = browser.open(f"data:text/html,here<script>{script}</script>")  # of somebody else: Origin null
        assert browser.says(page, "kept out", "document.title") and browser.says(page, "here")
        assert "read it" not in str(browser.value(page, "document.body.innerText"))
        assert not screens_of(served)
        first = browser.open(url)
        assert browser.says(first, "-first-byte", "document.body.className")
        second = browser.open(url)  # a line that one process alone can have
        assert browser.says(second, "only one process at a time can have udpin")
        assert len(screens_of(served)) == 1


async def left_by(served: subprocess.Popen[str], url: str) -> int:
    """The process behind a page that is still open when its server is killed."""
    from aiohttp import ClientSession, WSMsgType

    own, token = url.split("/?token=")
    async with ClientSession() as http, http.ws_connect(f"{own}/ws/{token}?width=80&height=24") as page:
        while (reported := await page.receive(WAIT_S)).type != WSMsgType.BINARY or len(reported.data) < 1000:
            assert reported.type in (WSMsgType.BINARY, WSMsgType.TEXT)  # until the screen is drawn
        (screen,) = screens_of(served)
        served.kill()
        served.wait()
    return screen


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="processes are looked up in /proc")
def test_no_screen_outlives_its_server() -> None:
    with serving(*monitor(f"udpin:127.0.0.1:{free_port()}")) as (served, url):
        screen = asyncio.run(left_by(served, url))
        try:
            assert wait(lambda: not Path(f"/proc/{screen}").exists())
        finally:
            with suppress(ProcessLookupError):
                os.kill(screen, signal.SIGKILL)
