"""`coaxlink monitor --web`: the screen in a browser of this machine, and in no other page or program.

Every session is a process of its own with Textual's web driver, which speaks packets over its pipes: a letter
(D: what a terminal shows, M: a word about the session), four bytes of length, the rest. The terminal on the
page is textual-serve's, the page is ours: keys as buttons, sized for a phone, a lost session begins anew.
What keeps others out:

    Host, Origin   have to be the address that is served: a name that was bent to 127.0.0.1 or a foreign page
                   gets nothing
    token          in the address that the terminal shows, new for every start
    the browser    only types and resizes, within bounds; nothing that it says writes a file
    SESSIONS       at a time, fewer where the line cannot be shared; a process ends with its page
"""

from __future__ import annotations

import asyncio
import html
import json
import logging
import os
import secrets
import signal
import socket
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Sequence
from importlib.resources import files as resources
from pathlib import Path
from typing import Any

import jinja2
from aiohttp import WSMsgType, web

from coaxlink.errors import InputError
from firmware_params.plain import plain_lines

HOST = "127.0.0.1"
SESSIONS = 4
LEAVING_S = 3.0  # a page that is loaded anew: so long its old process may take to end
SIDES = ((20, 500), (5, 200))  # columns, rows of a page
MESSAGE = 1 << 16  # bytes that a browser may say at once
REPORTED, WIDTH = 8, 100  # malformed requests that are told, characters of each
TEXT = 4096  # bytes kept of what a process reported last
LEFT = 4001  # how a page is closed whose screen was left by its own key; another close is a broken line
READY = b"__GANGLION__\n"
KEYS = (  # buttons below the screen: what a phone has no keys for
    ("Split", "1"), ("Error", "2"), ("Parameters", "3"), ("Messages", "4"), ("Health", "5"), ("Pause", "p"),
    ("\N{LEFTWARDS ARROW}", "\x1b[D"), ("\N{RIGHTWARDS ARROW}", "\x1b[C"), ("Now", "\x1b[F"),
    ("+", "+"), ("-", "-"), ("Help", "?"),
)  # fmt: skip


def bind(port: int) -> socket.socket:
    """The port of this machine's own address. Raises InputError when it cannot be had."""
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise InputError(f"port {port}", "", f"cannot be had ({error.strerror})") from error
    return listener


class WebMonitor:
    """Serves `command`, a monitor without --web, on a bound socket.

    `why_few` completes "another page shows this monitor already" where it has fewer `sessions` than SESSIONS.
    """

    def __init__(
        self, command: Sequence[str], listener: socket.socket, sessions: int = SESSIONS, why_few: str = ""
    ) -> None:
        self._command, self._listener = command, listener
        self._sessions, self._why_few = sessions, why_few
        self._own = f"{HOST}:{listener.getsockname()[1]}"
        self._token = secrets.token_urlsafe(24)
        self._running: set[Process] = set()
        self._killed: set[Process] = set()  # once each: a second signal may reap it before asyncio does
        self._starting = 0
        parts = Path(str(resources("textual_serve")))
        self._static = parts / "static"
        self._page = jinja2.Template(Path(str(resources("coaxlink.monitor") / "page.html")).read_text())

    @property
    def url(self) -> str:
        """What to open."""
        return f"http://{self._own}/?token={self._token}"

    def serve(self) -> None:
        """Until SIGINT or SIGTERM; then the port is free."""
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        app = web.Application(middlewares=[self._guard])
        app.add_routes([
            web.get("/", self._index), web.get("/ws", self._session), web.get("/ws/{token}", self._session),
            web.static("/static", self._static),
        ])  # fmt: skip
        app.on_shutdown.append(self._end_all)
        runner = web.AppRunner(app, access_log=None, logger=_one_line_each(), shutdown_timeout=0.5)
        await runner.setup()
        await web.SockSite(runner, self._listener).start()
        stop, loop = asyncio.Event(), asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, stop.set)
        sys.stdout.write(f"monitor at {self.url} (Ctrl-C ends it)\n")
        sys.stdout.flush()
        try:
            await stop.wait()
        finally:
            await runner.cleanup()

    # -- who may come in -------------------------------------------------------------------------------------

    @web.middleware
    async def _guard(self, request: web.Request, handler: Any) -> web.StreamResponse:
        origin = request.headers.get("Origin")
        if request.headers.get("Host") != self._own or origin not in (None, f"http://{self._own}"):
            return _reported(403, f"This monitor is at {self._own} and for its own page only.")
        token = request.match_info.get("token") or request.query.get("token", "")
        if not request.path.startswith("/static/") and not secrets.compare_digest(
            token.encode(), self._token.encode()
        ):
            return _reported(403, "Open the address that the terminal shows: its token lets you in.")
        return await handler(request)

    async def _full(self) -> str:
        """Why no further session can begin, "" when one can; one that is ending is waited for."""
        end = asyncio.get_running_loop().time() + LEAVING_S
        while len(self._running) + self._starting >= self._sessions:
            if asyncio.get_running_loop().time() > end:
                pages = "another page shows" if self._sessions == 1 else f"{self._sessions} pages show"
                return f"{pages} this monitor already{self._why_few}. Close one and load this page again."
            await asyncio.sleep(0.05)
        return ""

    # -- page and session ------------------------------------------------------------------------------------

    async def _index(self, request: web.Request) -> web.Response:
        if full := await self._full():
            return _reported(503, full[0].upper() + full[1:])
        text = self._page.render(
            socket=f"ws://{self._own}/ws/{self._token}", keys=json.dumps(KEYS), left=LEFT
        )
        inline = "'self' 'unsafe-inline'"
        policy = (
            f"default-src 'self'; script-src {inline}; style-src {inline}; img-src 'self' data:; "
            f"connect-src 'self' ws://{self._own}; frame-ancestors 'none'"
        )
        headers = {
            "Content-Security-Policy": policy, "Referrer-Policy": "no-referrer", "Cache-Control": "no-store",
        }  # fmt: skip
        return web.Response(text=text, content_type="text/html", headers=headers)

    async def _session(self, request: web.Request) -> web.StreamResponse:
        if full := await self._full():
            return _reported(503, full)
        self._starting += 1
        try:
            page = web.WebSocketResponse(heartbeat=15.0, max_msg_size=MESSAGE)
            await page.prepare(request)
            process = await self._start(request.query.get("width"), request.query.get("height"))
            self._running.add(process)
        finally:
            self._starting -= 1
        showing = asyncio.create_task(self._show(process, page))
        try:
            await _obey(page, process)
        finally:
            self._kill(process)  # it only watches
            await showing
        return page

    async def _start(self, width: str | None, height: str | None) -> Process:
        columns, rows = (_side(n, given) for n, given in enumerate((width, height)))
        textual = {
            "TEXTUAL_DRIVER": "textual.drivers.web_driver:WebDriver", "TEXTUAL_COLOR_SYSTEM": "truecolor",
            "TERM_PROGRAM": "textual", "COLUMNS": str(columns), "ROWS": str(rows),
        }  # fmt: skip
        return await asyncio.create_subprocess_exec(
            *self._command, stdin=PIPE, stdout=PIPE, stderr=PIPE, env=os.environ | textual
        )

    async def _show(self, process: Process, page: web.WebSocketResponse) -> None:
        """All that it draws, and at its end what it reported of it."""
        assert process.stdout is not None and process.stderr is not None
        errors_of = asyncio.create_task(process.stderr.read())
        try:
            while (line := await process.stdout.readline()) and line != READY:
                pass
            while True:
                kind = await process.stdout.readexactly(1)
                data = await process.stdout.readexactly(
                    int.from_bytes(await process.stdout.readexactly(4), "big")
                )
                if kind == b"D":
                    await page.send_bytes(data)
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            if page.closed:
                self._kill(process)
            code = await process.wait()
            self._running.discard(process)
            self._killed.discard(process)
            reported = plain_lines((await errors_of).decode(errors="replace")[-TEXT:]).replace("\n", "\r\n")
        if code == 0:
            await page.close(code=LEFT)
        elif not page.closed:  # it stays on the page until that is left
            await page.send_bytes(b"\x1b[2J\x1b[H" + (reported or f"ended with code {code}").encode())

    async def _end_all(self, _: web.Application) -> None:
        for process in self._running:
            self._kill(process)

    def _kill(self, process: Process) -> None:
        if process.returncode is None and process not in self._killed:
            self._killed.add(process)
            process.kill()


class _OneLine(logging.Handler):
    """What the server complains of, a line each on stderr; anybody may ask anything, so only a few."""

    left = REPORTED

    def emit(self, record: logging.LogRecord) -> None:
        if self.left:
            self.left -= 1
            why = record.exc_info[1] if record.exc_info else None
            reported = plain_lines(str(why or record.getMessage())).strip().splitlines() or ["no request"]
            more = "" if self.left else " (further ones are not shown)"
            sys.stderr.write(f"a malformed request was refused: {reported[0][:WIDTH]}{more}\n")
            sys.stderr.flush()


def _one_line_each() -> logging.Logger:
    logger = logging.getLogger("coaxlink.monitor.web")
    logger.handlers, logger.propagate = [_OneLine()], False
    return logger


async def _obey(page: web.WebSocketResponse, process: Process) -> None:
    """Hand on keys and sizes until the page is left, or says what no page of ours says."""
    async for message in page:
        if message.type != WSMsgType.TEXT:
            continue
        try:
            kind, *rest = json.loads(message.data)
            given: Any = rest[0] if rest else None
            if kind == "stdin":
                _tell(process, b"D", given.encode())
            elif kind == "resize":
                size = {"width": _side(0, given["width"]), "height": _side(1, given["height"])}
                _tell(process, b"M", json.dumps({"type": "resize", **size}).encode())
            elif kind in ("focus", "blur"):
                _tell(process, b"M", json.dumps({"type": kind}).encode())
            elif kind == "ping":
                await page.send_json(["pong", given])
            else:
                raise ValueError
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            await page.close()
        except ConnectionError:
            return


def _tell(process: Process, kind: bytes, data: bytes) -> None:
    if process.stdin is not None and process.returncode is None:
        process.stdin.write(kind + len(data).to_bytes(4, "big") + data)


def _side(which: int, given: Any) -> int:
    """Columns (0) or rows (1), within bounds."""
    least, most = SIDES[which]
    try:
        return min(max(int(given), least), most)
    except (TypeError, ValueError, OverflowError):
        return (80, 24)[which]


def _reported(status: int, text: str) -> web.Response:
    phone = '<meta name="viewport" content="width=device-width,initial-scale=1">'
    style = "<style>body{margin:2rem;background:#0c181f;color:#dde;font:1.1rem system-ui,sans-serif}</style>"
    page = f"<!DOCTYPE html>{phone}<title>coaxlink monitor</title>{style}<p>{html.escape(text)}</p>"
    return web.Response(status=status, text=page, content_type="text/html")
