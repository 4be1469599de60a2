"""`coaxlink monitor`: the terminal screen, or one look without it."""

from __future__ import annotations

import os
import sys
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli.shared.line import introduced
from coaxlink.cli.shared.options import by_option
from coaxlink.cli.shared.shell import JsonOption, console, say
from coaxlink.cli.upload import SystemOption

if TYPE_CHECKING:
    from rich.text import Text

    from coaxlink.monitor.incoming.recording import Player
    from coaxlink.monitor.state.moment import Moment
    from coaxlink.monitor.state.watch import Watch
    from coaxlink.premises.answer import Reason
    from coaxlink.vehicle import Vehicle

LISTENS = "udpin:0.0.0.0:14550"
_SERVED = "TEXTUAL_DRIVER" in os.environ  # by textual-serve, to a browser


def monitor(
    connect: Annotated[
        str | None,
        typer.Option(
            "--connect", metavar="URL", help=f"Where to listen (default: the airframe's, or {LISTENS})."
        ),
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
    web: Annotated[
        bool, typer.Option("--web", help="Show the screen in a browser of this machine (coaxlink[web]).")
    ] = False,
    port: Annotated[
        int, typer.Option("--port", min=1, max=65535, help="Of --web, on 127.0.0.1 only.")
    ] = 8000,
    once: Annotated[bool, typer.Option("--once", help="No screen: print one look and leave.")] = False,
    system: SystemOption = None,
    seconds: Annotated[
        float, typer.Option("--seconds", min=0.2, max=3600.0, help="How long --once and --json listen.")
    ] = 4.0,
    json: JsonOption = None,
) -> None:
    """Live thrust of upper and lower rotors, split, balance, table on board and link."""
    from coaxlink.monitor.incoming.heard import Heard
    from coaxlink.monitor.incoming.link import check_address
    from coaxlink.monitor.state.watch import Watch

    if replay is not None and airframe is None:
        from coaxlink.errors import InputError

        raise InputError(replay, "", "--airframe is needed: a recording does not say whose flight it is")
    vehicle = _vehicle(airframe, rotor)
    connect = connect or vehicle.declared.connect or LISTENS
    player = None if replay is None else _player(replay, system, speed, start)
    if player is None:
        check_address(connect)
        watch = Watch(Heard(), vehicle, connect)
    else:
        watch = Watch(player.heard, vehicle, str(replay), _against(player, vehicle))
    if once or json is not None:
        if player is None:
            _show(_look_once(watch, seconds, system), json)
        else:
            from coaxlink.monitor.screen.words import replay_words

            player.playing, player.speed = False, 1.0
            end = player.position_s
            player.seek(0.0)  # now that somebody listens: rotors are judged by all of it
            player.play_to(end)
            _show(watch.look(), json, replay_words(player))
        return
    if web:
        _serve(port, None if player else connect)
        return
    if not _SERVED and not (sys.stdin.isatty() and sys.stdout.isatty()):
        from coaxlink.errors import InputError

        raise InputError("monitor", "", "the screen needs a terminal; without one use --once or --json FILE")
    _screen(watch, player, system)


def _serve(port: int, url: str | None) -> None:
    """This very command line without --web, once for every page that is open; Ctrl-C ends it."""
    from coaxlink.errors import InputError
    from coaxlink.mavlink.address import parse_address

    try:
        import textual_serve.server  # noqa: F401 - its page is used, and what it depends on

        from coaxlink.monitor.web import WebMonitor, bind
    except ImportError as error:
        problem = (
            "textual-serve is needed, which is not installed: pip install 'coaxlink[web]', in a clone "
            "pip install -e '.[web]'"
        )
        raise InputError("--web", "", problem) from error
    command = [sys.executable, "-m", "coaxlink", *(a for a in sys.argv[1:] if a != "--web")]
    if url is None or parse_address(url).kind in ("udpout", "tcp"):
        WebMonitor(command, bind(port)).serve()
    else:
        shared = f", and only one process at a time can have {url}"
        WebMonitor(command, bind(port), 1, shared).serve()


def _player(path: Path, system: int | None, speed: float, start_s: float) -> Player:
    from coaxlink.monitor.incoming.recording import Player, load_recording

    recording = load_recording(path, system)
    recording.notes = tuple(map(by_option, recording.notes))
    return Player(recording, speed=speed, start_s=start_s)


def _against(player: Player, vehicle: Vehicle) -> tuple[Reason, ...]:
    """What speaks against any verdict by this recording."""
    from coaxlink.premises import damage
    from coaxlink.residual.refine import vehicle_differs

    flights = player.recording.flights
    return (*vehicle_differs(flights, vehicle.declared), *damage(flights))


def _vehicle(airframe_path: Path | None, rotor_path: Path | None) -> Vehicle:
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.vehicle import Vehicle, load_rotors

    airframe = load_airframe(airframe_path or files.example("x8_paper.toml"))
    model = load_rotors(rotor_path or airframe.rotor_model or files.example("rotor_paper.toml"))
    vehicle = Vehicle(airframe, model)
    for name, why in vehicle.left_out.items():
        say(f"not in the rotors shown: {name}: {why}")
    return vehicle


def _screen(watch: Watch, player: Player | None, system: int | None) -> None:
    from coaxlink.monitor.incoming.link import LinkThread, connect_to
    from coaxlink.monitor.screen.app import Monitor

    shown: dict[str, Any] = {"saves": not _SERVED}
    if _SERVED:
        _end_with(os.getppid())
    if player is not None:

        def played() -> Moment:
            player.advance()
            return watch.look()

        Monitor(played, player=player, **shown).run()
        return
    link = LinkThread(watch.heard, watch.address, open_session=partial(connect_to, system=system))
    link.start()
    try:
        Monitor(watch.look, trouble=lambda: link.failure, **shown).run()
    finally:
        link.stop()
    if link.failure is not None:
        raise link.failure


def _end_with(server: int) -> None:
    """End this process when its server has: Textual's reader of a closed pipe spins, and keeps the screen."""
    import threading

    def watch() -> None:
        while os.getppid() == server:
            time.sleep(0.5)
        os._exit(0)  # it only watches: nothing is left to write

    threading.Thread(target=watch, daemon=True).start()


def _look_once(watch: Watch, seconds: float, system: int | None) -> Moment:
    from coaxlink.monitor.incoming.link import Streams, begin, connect_to
    from coaxlink.monitor.incoming.table_reader import TableReader

    end = time.monotonic() + seconds
    with (
        connect_to(watch.address, max(seconds, 3.0), system) as line,
        introduced(line) as session,
    ):
        begin(watch.heard, session)
        session.wait((), min(1.2, seconds / 2))
        Streams(watch.heard, session).request_missing()
        TableReader(watch.heard, session).refresh()
        moment = watch.look()
        while (left := end - time.monotonic()) > 0.0:
            session.wait((), min(left, 0.2))
            moment = watch.look()
    return moment


def _show(moment: Moment, json: Path | None, replay: Text | None = None) -> None:
    from coaxlink import files
    from coaxlink.errors import CheckFailed
    from coaxlink.monitor.screen.words import summary

    if json is not None:
        files.write_json(json, moment.to_json())
    console().print(summary(moment, replay))
    if moment.health.reasons:
        raise CheckFailed(moment.health.why)
