"""The monitor's page: who may open it, how many, what a browser may say, and what is left when it goes."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from case_table import case_table
from monitor_messages import Scene

from coaxlink.cli import main

pytest.importorskip("textual_serve")
from aiohttp import ClientSession, WSMsgType, WSServerHandshakeError

from coaxlink.errors import InputError
from coaxlink.monitor import web
from coaxlink.monitor.screen.app import Monitor

WAIT_S = 120.0  # for a machine with other things to do
# as Textual's web driver speaks: what it is sent it says again
ECHO = r"""
import sys
out, into = sys.stdout.buffer, sys.stdin.buffer
def say(data): out.write(b"D" + len(data).to_bytes(4, "big") + data); out.flush()
out.write(b"__GANGLION__\n"); say(b"a screen is here")
while kind := into.read(1):
    said = into.read(int.from_bytes(into.read(4), "big"))
    if said == b"q": sys.exit(0)
    say(kind + said)
"""
REFUSES = "import sys; sys.stderr.write('coaxlink: port 14550 is in use\\n'); sys.exit(3)"


class Served:
    """A page that is served, and what comes of asking for it."""

    def __init__(self, monitor: web.WebMonitor, http: ClientSession) -> None:
        self.monitor, self.http = monitor, http
        self.own = monitor.url.split("/?")[0]
        self.token = monitor.url.split("token=")[1]

    async def get(self, path: str, **headers: str) -> tuple[int, str]:
        async with self.http.get(self.own + path, headers=headers) as answer:
            return answer.status, await answer.text()

    async def open(self, path: str | None = None, **headers: str) -> Any:
        """A session; the status instead where it is refused."""
        path = path or f"/ws/{self.token}?width=120&height=40"
        try:
            return await self.http.ws_connect(self.own + path, headers=headers)
        except WSServerHandshakeError as error:
            return error.status

    async def until_running(self, count: int) -> None:
        async with asyncio.timeout(WAIT_S):
            while len(self.monitor._running) != count:
                await asyncio.sleep(0.01)


@asynccontextmanager
async def serving(script: str = ECHO, **options: Any) -> AsyncIterator[Served]:
    listener = web.bind(0)
    port = listener.getsockname()[1]
    monitor = web.WebMonitor([sys.executable, "-c", script], listener, **options)
    server = asyncio.create_task(monitor._serve())
    try:
        async with ClientSession() as http:
            yield Served(monitor, http)
    finally:
        server.cancel()
        await asyncio.gather(server, return_exceptions=True)
        assert not monitor._running
        web.bind(port).close()  # it is free at once


def run(check: Callable[[Served], Awaitable[None]], script: str = ECHO, **options: Any) -> None:
    async def whole() -> None:
        async with serving(script, **options) as served:
            await check(served)

    asyncio.run(whole())


async def shown(page: Any, part: bytes) -> bytes:
    """What a page got, until this was in it."""
    got = b""
    while part not in got:
        reported = await page.receive(WAIT_S)
        assert reported.type == WSMsgType.BINARY, (reported, got)
        got += reported.data
    return got


def test_only_its_own_page_with_the_token_gets_in() -> None:
    async def check(s: Served) -> None:
        port, token = s.own.rsplit(":", 1)[1], s.token
        good, ws = f"/?token={token}", f"/ws/{token}"
        foreign: list[tuple[str, dict[str, str]]] = [
            (path, headers)
            for path in (good, ws)
            for headers in (
                {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": f"https://127.0.0.1:{port}"},
                {"Origin": "http://127.0.0.1:1"}, {"Origin": f"http://localhost:{port}"},
                {"Host": "evil.example"}, {"Host": f"evil.example:{port}"}, {"Host": "127.0.0.1"},
                {"Host": ""},
            )
        ]  # fmt: skip
        for path in (
            "/",
            "/?token=",
            f"/?token={token[:-1]}",
            f"/?token={token}x",
            "/ws",
            "/ws/none",
            "/ws/%ff",
        ):
            foreign += [(path, {}), (path, {"Origin": s.own})]
        with case_table() as case:
            for path, headers in foreign:
                with case(f"{path} {headers}"):
                    status, text = await s.get(path, **headers)
                    assert status == 403 and "xterm" not in text
                    assert await s.open(path, **headers) == 403
        status, text = await s.get(good)
        assert status == 200 and f"{ws}" in text
        page = await s.open(Origin=s.own)
        await shown(page, b"a screen is here")

    run(check)


def test_the_fifth_page_says_why_and_a_page_that_goes_makes_room() -> None:
    async def check(s: Served) -> None:
        s.monitor_pages = [await s.open() for _ in range(web.SESSIONS)]  # type: ignore[attr-defined]
        await s.until_running(web.SESSIONS)
        status, text = await s.get(f"/?token={s.token}")
        assert status == 503 and "4 pages show this monitor already" in text
        assert await s.open() == 503
        processes = list(s.monitor._running)
        s.monitor_pages[0]._response.connection.transport.abort()  # type: ignore[attr-defined]  # killed
        await s.until_running(web.SESSIONS - 1)
        assert [p.returncode is None for p in processes].count(False) == 1
        assert (await s.get(f"/?token={s.token}"))[0] == 200

    web_leaving, web.LEAVING_S = web.LEAVING_S, 0.1
    try:
        run(check)
    finally:
        web.LEAVING_S = web_leaving


def test_what_a_browser_says_is_keys_and_bounded_sizes() -> None:
    async def check(s: Served) -> None:
        page = await s.open()
        await page.send_json(["stdin", "s"])
        await shown(page, b"Ds")
        await page.send_json(["resize", {"width": 3000, "height": 1e300}])
        size = (await shown(page, b"}")).partition(b"M")[2]
        assert json.loads(size) == {"type": "resize", "width": 500, "height": 200}
        await page.send_json(["stdin", "q"])  # as it ends by itself, so does its page
        assert (await page.receive(WAIT_S)).type == WSMsgType.CLOSE
        await page.close()
        for rubbish in (
            "",
            "{",
            "7",
            '{"a": 1}',
            '["resize", 3]',
            '["stdin", null]',
            "[" * 5000,
            "x" * 100_000,
        ):
            page = await s.open()
            await page.send_str(rubbish)
            while (reported := await page.receive(WAIT_S)).type == WSMsgType.BINARY:
                pass
            assert reported.type == WSMsgType.CLOSE, rubbish
            await page.close()
        await s.until_running(0)

    run(check)


def test_why_a_screen_could_not_begin_stays_on_the_page() -> None:
    async def check(s: Served) -> None:
        page = await s.open()
        await shown(page, b"port 14550 is in use")
        await page.close()

    run(check, REFUSES)


def test_a_port_that_is_taken_is_one_line() -> None:
    taken = web.bind(0)
    with pytest.raises(InputError, match="cannot be had"):
        web.bind(taken.getsockname()[1])
    taken.close()


def test_a_browser_saves_no_picture(tmp_path: Path) -> None:
    async def pressed() -> None:
        app = Monitor(Scene().watch.look, folder=tmp_path, saves=False)
        async with app.run_test() as pilot:
            await pilot.press("s")
            await pilot.pause()

    asyncio.run(pressed())
    assert not list(tmp_path.iterdir())


def test_a_browser_needs_textual_serve(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "textual_serve.server", None)
    with pytest.raises(SystemExit, match="2"):
        main(["monitor", "--web", "--connect", "tcp:127.0.0.1:9"])
    reported = capsys.readouterr().err
    assert reported == (
        "coaxlink: --web: textual-serve is needed, which is not installed: "
        "pip install 'coaxlink[web]', in a clone pip install -e '.[web]'\n"
    )


def test_malformed_requests_are_a_line_each_and_no_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    """No Host, a header above aiohttp's 8 kB, two Hosts, no HTTP at all: 400, and a few lines in all."""
    host = b"Host: 127.0.0.1:1\r\n"
    requests = (b"GET / HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\n" + host + b"X: " + b"a" * 9000 + b"\r\n\r\n",
                b"GET / HTTP/1.1\r\n" + host + host + b"\r\n", b"\x16\x03\x01 no http\r\n\r\n")  # fmt: skip

    async def ask(page: Served) -> None:
        port = int(page.own.rpartition(":")[2])
        for request in requests * 4:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(request)
            assert b" 400 " in await asyncio.wait_for(reader.readline(), WAIT_S)
            writer.close()

    run(ask)
    reported = capsys.readouterr().err.splitlines()
    assert 0 < len(reported) <= web.REPORTED and all(
        "malformed request was refused: " in line for line in reported
    )
