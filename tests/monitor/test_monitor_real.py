"""The monitor as people run it: one look, in a terminal (tmux), served to a browser (headless Chromium)."""

from __future__ import annotations

import asyncio
import base64
import io
import json
import os
import shutil
import signal
import struct
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.files import example
from coaxlink.monitor.screen.marks import LOWER, UPPER
from coaxlink.studies.simulator import free_port
from sim.testing import standin

pytestmark = pytest.mark.slow
WAIT_S = 120.0  # for a machine with other things to do
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
BROWSER = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--window-size=1280,800",
]  # fmt: skip


def wait(what: Callable[[], bool]) -> bool:
    """Until it is so, or too long."""
    end = time.monotonic() + WAIT_S
    while not what():
        if time.monotonic() > end:
            return False
        time.sleep(0.1)
    return True


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with standin("--firmware", "px4", "--airframe", str(example("x8_demo.toml"))) as port:
        yield f"udpout:127.0.0.1:{port}"


def monitor(address: str, *options: str) -> list[str]:
    return [sys.executable, "-m", "coaxlink", "monitor", "--connect", address, *options]


def test_one_look_at_a_vehicle(address: str, tmp_path: Path) -> None:
    target = tmp_path / "look.json"
    done = subprocess.run(
        monitor(address, "--once", "--seconds", "2", "--json", str(target)), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "front right" in done.stdout and "disarmed" in done.stdout
    look = json.loads(target.read_text())
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


async def drawn(address: str, colours: set[Any], folder: Path) -> bool:
    """Whether headless Chromium shows all these colours there before long; by its DevTools protocol."""
    from aiohttp import ClientSession

    port = free_port()
    switches = [f"--remote-debugging-port={port}", "--remote-allow-origins=*", f"--user-data-dir={folder}"]
    browser = subprocess.Popen([str(CHROMIUM), *BROWSER, *switches, address], stderr=subprocess.DEVNULL)
    try:
        async with ClientSession() as http:
            end = time.monotonic() + WAIT_S
            while time.monotonic() < end:
                await asyncio.sleep(0.5)
                try:
                    async with http.get(f"http://127.0.0.1:{port}/json") as answer:
                        pages = [page for page in await answer.json() if page["url"].startswith(address)]
                except OSError:
                    continue
                for page in pages:
                    async with http.ws_connect(page["webSocketDebuggerUrl"], max_msg_size=0) as line:
                        await line.send_json({"id": 1, "method": "Page.captureScreenshot"})
                        shown = (await line.receive_json())["result"]["data"]
                    if colours <= colours_of(base64.b64decode(shown)):
                        return True
        return False
    finally:
        browser.terminate()
        browser.wait(WAIT_S)


async def left_by(served: subprocess.Popen[bytes], address: str) -> int:
    """The process behind a page that is still open when its server is killed."""
    from aiohttp import ClientSession, WSMsgType

    async with ClientSession() as http, http.ws_connect(f"{address}ws?width=80&height=24") as page:
        while (said := await page.receive(WAIT_S)).type != WSMsgType.BINARY or len(said.data) < 1000:
            assert said.type in (WSMsgType.BINARY, WSMsgType.TEXT)  # until the screen is drawn
        of_server = ["pgrep", "-P", str(served.pid)]
        screen = int(subprocess.run(of_server, capture_output=True, text=True).stdout.split()[-1])
        served.kill()
        served.wait()
    return screen


def colours_of(picture: bytes) -> set[Any]:
    """Those that more than twenty pixels have."""
    from PIL import Image

    image = Image.open(io.BytesIO(picture)).convert("RGB")
    return {colour for count, colour in image.getcolors(1 << 24) or () if count > 20}


@contextmanager
def serving(*command: str) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """The server of a monitor's command, and its address."""
    pytest.importorskip("textual_serve")
    port = free_port()
    served = subprocess.Popen([*command, "--web", "--port", str(port)], stdout=subprocess.DEVNULL)
    url = f"http://127.0.0.1:{port}/"

    def answers() -> bool:
        try:
            return bool(urllib.request.urlopen(url, timeout=5).status == 200)
        except OSError:
            return False

    try:
        assert wait(answers)
        yield served, url
    finally:
        served.kill()
        served.wait()


@pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed")
def test_in_a_browser(address: str, tmp_path: Path) -> None:
    with serving(*monitor(address)) as (_, url):
        bars = {tuple(int(colour[k : k + 2], 16) for k in (1, 3, 5)) for colour in (UPPER, LOWER)}
        assert asyncio.run(drawn(url, bars, tmp_path / "profile"))  # the rotors' bars and names


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="processes are looked up in /proc")
@pytest.mark.parametrize("what", ["live", "replay"])
def test_no_screen_outlives_its_server(what: str, tmp_path: Path) -> None:
    recording = tmp_path / "flight.tlog"
    link = mavlink.MAVLink(None, 1, 1)
    beat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(link)
    recording.write_bytes(
        b"".join(struct.pack(">Q", 1_700_000_000_000_000 + k * 1_000_000) + beat for k in range(90))
    )
    options = (
        ["--replay", str(recording)] if what == "replay" else ["--connect", f"udpin:127.0.0.1:{free_port()}"]
    )
    with serving(sys.executable, "-m", "coaxlink", "monitor", *options) as (served, url):
        screen = asyncio.run(left_by(served, url))
        try:
            assert wait(lambda: not Path(f"/proc/{screen}").exists())
        finally:
            with suppress(ProcessLookupError):
                os.kill(screen, signal.SIGKILL)
