"""`coaxlink monitor`: the terminal screen, or one look without it."""

from __future__ import annotations

import os
import shlex
import socket
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli.shared.shell import JsonOption, console, say

if TYPE_CHECKING:
    from rich.text import Text

    from coaxlink.monitor.config import Config
    from coaxlink.monitor.player import Player
    from coaxlink.monitor.state import View
    from coaxlink.monitor.watch import Watch


_SERVED = "TEXTUAL_DRIVER" in os.environ  # by textual-serve, to a browser


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("monitor", short_help="Show thrust and split of every arm, live or replayed.")(monitor)


def monitor(
    connect: Annotated[
        str | None,
        typer.Option("--connect", metavar="URL", help="Where to listen (default: udpin:0.0.0.0:14550)."),
    ] = None,
    airframe: Annotated[
        Path | None,
        typer.Option("--airframe", metavar="FILE", help="Airframe TOML (default: the paper's X8)."),
    ] = None,
    rotor: Annotated[
        Path | None,
        typer.Option("--rotor", metavar="FILE", help="Rotor model TOML (default: the airframe's)."),
    ] = None,
    replay: Annotated[
        Path | None, typer.Option("--replay", metavar="FILE", help="Play a tlog, ULog or .bin instead.")
    ] = None,
    speed: Annotated[
        float, typer.Option("--speed", min=0.02, max=1000.0, help="Of --replay, times real time.")
    ] = 1.0,
    start: Annotated[
        float, typer.Option("--start", min=0.0, metavar="S", help="Where --replay begins, in s.")
    ] = 0.0,
    theme: Annotated[
        str | None, typer.Option("--theme", help="dark, light, or none: without colour (as with NO_COLOR).")
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE", help="Settings (default: ~/.config/coaxlink/monitor.toml)."),
    ] = None,
    web: Annotated[
        bool, typer.Option("--web", help="Show the screen in a browser of this machine (coaxlink[web]).")
    ] = False,
    port: Annotated[
        int, typer.Option("--port", min=1, max=65535, help="Of --web, on 127.0.0.1 only.")
    ] = 8000,
    once: Annotated[bool, typer.Option("--once", help="No screen: print one look and leave.")] = False,
    seconds: Annotated[
        float, typer.Option("--seconds", min=0.2, max=3600.0, help="How long --once and --json listen.")
    ] = 4.0,
    json: JsonOption = None,
) -> None:
    """Live thrust of upper and lower rotors, split, balance, table on board and link."""
    from coaxlink.monitor.config import load_config
    from coaxlink.monitor.feed import check_address
    from coaxlink.monitor.screen.format import replay_words

    settings = load_config(config)
    settings = replace(settings, theme=_theme(theme or settings.theme))
    url = connect or settings.connect
    watch = _watch(str(replay) if replay else url, airframe or settings.airframe, rotor or settings.rotor)
    player = None if replay is None else _player(replay, watch, speed, start)
    if player is None:
        check_address(url)
    if once or json is not None:
        if player is None:
            _look_once(watch, seconds, json)
        else:
            tape = player.recording
            where = replay_words(tape.name, player.position_s, tape.length_s, 1.0, False)
            _show(player.look_once(), json, where)
        return
    if web:
        _serve(port)
        return
    if not _SERVED and not (sys.stdin.isatty() and sys.stdout.isatty()):
        from coaxlink.errors import InputError

        raise InputError("monitor", "", "the screen needs a terminal; without one use --once or --json FILE")
    _screen(watch, settings, player)


def _serve(port: int) -> None:
    """This very command line without --web, once for every browser that comes; Ctrl-C ends it."""
    from coaxlink.errors import InputError

    try:
        from textual_serve.server import Server
    except ImportError as error:
        problem = "textual-serve is needed, which is not installed: pip install 'coaxlink[web]'"
        raise InputError("--web", "", problem) from error
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise InputError("--port", "", f"{port} cannot be had ({error.strerror})") from error
    arguments = [a for a in sys.argv[1:] if a != "--web"]
    # without a shell between, so that the monitor sees its server go
    command = "exec " + shlex.join([sys.executable, "-m", "coaxlink", *arguments])
    Server(command, host="127.0.0.1", port=port, title="coaxlink monitor").serve()


def _theme(name: str | None) -> str:
    from coaxlink.errors import InputError
    from coaxlink.monitor.screen.themes import PALETTES

    if name is not None and name not in PALETTES:
        raise InputError("--theme", "", f"one of {', '.join(PALETTES)} is expected, found {name!r}")
    return name or ("none" if os.environ.get("NO_COLOR") else "dark")


def _player(path: Path, watch: Watch, speed: float, start_s: float) -> Player:
    from coaxlink.monitor.player import Player
    from coaxlink.monitor.tape import load_tape

    tape = load_tape(path)
    watch.line = lambda: list(tape.notes)
    return Player(tape, watch, speed=speed, start_s=start_s)


def _watch(connect: str, airframe_path: Path | None, rotor_path: Path | None) -> Watch:
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.monitor.watch import Watch
    from coaxlink.vehicle import Vehicle, load_rotors

    airframe = load_airframe(airframe_path or files.example("x8_paper.toml"))
    model = load_rotors(rotor_path or airframe.rotor_model or files.example("rotor_paper.toml"))
    vehicle = Vehicle(airframe, model)
    for name, why in vehicle.left_out.items():
        say(f"not in the rotors shown: {name}: {why}")
    return Watch(connect, vehicle)


def _screen(watch: Watch, settings: Config, player: Player | None) -> None:
    from coaxlink.monitor.board.desk import Desk
    from coaxlink.monitor.feed import Feed
    from coaxlink.monitor.screen.app import Monitor

    shown: dict[str, Any] = {
        "folder": settings.snapshots,
        "plot_span_s": settings.plot_s,
        "page": settings.page,
        "palette": settings.theme,
    }
    if _SERVED:
        _end_with(os.getppid())
    if player is not None:
        Monitor(player.look, player=player, **shown).run()
        return
    # who opens a page of this machine has not sat down at the terminal: a browser writes nothing
    desk = None if _SERVED else Desk(settings.backups or Path("backups"))
    shown["why_no_desk"] = "in a browser the monitor only watches: use it in a terminal"
    feed = Feed(watch, desk=desk)
    feed.start()
    try:
        Monitor(watch.look, trouble=lambda: feed.failure, desk=desk, table=settings.table, **shown).run()
    finally:
        feed.stop()
    if feed.failure is not None:
        raise feed.failure


def _end_with(server: int) -> None:
    """End this process when its server has: Textual's reader of a closed pipe spins, and keeps the screen."""
    import threading

    def watch() -> None:
        while os.getppid() == server:
            time.sleep(0.5)
        os._exit(0)  # it only watches: nothing is left to write

    threading.Thread(target=watch, daemon=True).start()


def _look_once(watch: Watch, seconds: float, json: Path | None) -> None:
    from coaxlink.mavlink import connect
    from coaxlink.monitor.board.table_reader import TableReader
    from coaxlink.monitor.feed import COMPONENT, begin
    from coaxlink.monitor.telemetry.streams import Streams

    end = time.monotonic() + seconds
    patience_s = max(seconds, 3.0)
    with connect(
        watch.address, timeout_s=patience_s, source_component=COMPONENT, listen_only=True
    ) as session:
        begin(watch, session)
        session.wait((), min(1.2, seconds / 2))
        Streams(watch, session).request_missing()
        TableReader(watch, session).refresh()
        view = watch.look(time.monotonic())
        while (left := end - time.monotonic()) > 0.0:
            session.wait((), min(left, 0.2))
            view = watch.look(time.monotonic())  # a steady hover is told from several looks
    _show(view, json)


def _show(view: View, json: Path | None, replay: Text | None = None) -> None:
    from coaxlink import files
    from coaxlink.monitor.screen.format import summary
    from coaxlink.monitor.screen.themes import DARK, dress
    from coaxlink.monitor.watch import to_json

    if json is not None:
        files.write_json(json, to_json(view))
    console().print(dress(summary(view, replay), DARK))
