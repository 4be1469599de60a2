"""A headless Chromium, spoken to by its DevTools protocol."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import signal
import subprocess
import time
import urllib.parse
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from coaxlink.studies.simulator import free_port

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


class Browser:
    """Headless Chromium, spoken to by its DevTools protocol."""

    def __init__(self, folder: Path, *switches: str) -> None:
        self._port = free_port()
        own = [
            f"--remote-debugging-port={self._port}",
            "--remote-allow-origins=*",
            f"--user-data-dir={folder}",
        ]
        self.process = subprocess.Popen(
            [str(CHROMIUM), *BROWSER, *own, *switches, "about:blank"],
            stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def kill(self) -> None:
        """With all its processes, as when the machine has no memory left."""
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait(WAIT_S)

    def open(self, address: str) -> str:
        """A page more; the address of its DevTools."""

        def opened() -> bool:
            nonlocal page
            what = f"http://127.0.0.1:{self._port}/json/new?{urllib.parse.quote(address, safe='')}"
            with suppress(OSError):
                answer = urllib.request.urlopen(urllib.request.Request(what, method="PUT"), timeout=20)
                page = json.loads(answer.read())["webSocketDebuggerUrl"]
            return bool(page)

        page = ""
        assert wait(opened)
        return page

    def ask(self, page: str, method: str, **params: Any) -> Any:
        """One word of the protocol."""

        async def asked() -> Any:
            from aiohttp import ClientSession

            async with ClientSession() as http, http.ws_connect(page, max_msg_size=0) as line:
                await line.send_json({"id": 1, "method": method, "params": params})
                return (await line.receive_json())["result"]

        return asyncio.run(asked())

    def value(self, page: str, what: str) -> Any:
        """What an expression of the page's script is worth."""
        return self.ask(page, "Runtime.evaluate", expression=what, returnByValue=True)["result"].get("value")

    def says(self, page: str, part: str, what: str = "document.body.innerText") -> bool:
        """Whether a page says so before long."""
        return wait(lambda: part in str(self.value(page, what)))

    def mouse(self, page: str, kind: str, x: float, y: float, clicks: int = 1) -> None:
        """One event of the left button at a place in the page."""
        where = {"x": x, "y": y, "button": "left", "buttons": 1, "clickCount": clicks}
        self.ask(page, "Input.dispatchMouseEvent", type=kind, **where)
