"""`coaxlink monitor`: the terminal screen, or one look without it."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli._shell import JsonOption, console, say

if TYPE_CHECKING:
    from coaxlink.monitor.watch import Watch

DEFAULT_URL = "udpin:0.0.0.0:14550"


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("monitor")(monitor)


def monitor(
    connect: Annotated[str, typer.Option("--connect", metavar="URL", help="Where to listen.")] = DEFAULT_URL,
    airframe: Annotated[
        Path | None,
        typer.Option("--airframe", metavar="FILE", help="Airframe TOML (default: the paper's X8)."),
    ] = None,
    rotor: Annotated[
        Path | None,
        typer.Option("--rotor", metavar="FILE", help="Rotor model TOML (default: the airframe's)."),
    ] = None,
    once: Annotated[bool, typer.Option("--once", help="No screen: print one look and leave.")] = False,
    seconds: Annotated[
        float, typer.Option("--seconds", min=0.2, max=3600.0, help="How long --once and --json listen.")
    ] = 4.0,
    json: JsonOption = None,
) -> None:
    """Live thrust of upper and lower rotors, split, balance, table on board and link."""
    from coaxlink.monitor.feed import check_address

    watch = _watch(connect, airframe, rotor)
    check_address(connect)
    if once or json is not None:
        _look_once(watch, seconds, json)
        return
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        from coaxlink.errors import InputError

        raise InputError("monitor", "", "the screen needs a terminal; without one use --once or --json FILE")
    _screen(watch)


def _watch(connect: str, airframe_path: Path | None, rotor_path: Path | None) -> Watch:
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.monitor.watch import Watch
    from coaxlink.rotor import load_rotor_model
    from coaxlink.vehicle import Vehicle

    airframe = load_airframe(airframe_path or files.example("x8_paper.toml"))
    model = load_rotor_model(rotor_path or airframe.rotor_model or files.example("rotor_paper.toml"))
    vehicle = Vehicle(airframe, model)
    for name, why in vehicle.left_out.items():
        say(f"not in the rotors shown: {name}: {why}")
    return Watch(connect, vehicle)


def _screen(watch: Watch) -> None:
    from coaxlink.monitor.feed import Feed
    from coaxlink.monitor.screen import Monitor

    feed = Feed(watch)
    feed.start()
    try:
        Monitor(watch.look, trouble=lambda: feed.failure).run()
    finally:
        feed.stop()
    if feed.failure is not None:
        raise feed.failure


def _look_once(watch: Watch, seconds: float, json: Path | None) -> None:
    from coaxlink import files
    from coaxlink.mavlink import connect
    from coaxlink.monitor.feed import COMPONENT, begin
    from coaxlink.monitor.format import summary
    from coaxlink.monitor.streams import Streams
    from coaxlink.monitor.table_reader import TableReader
    from coaxlink.monitor.themes import DARK, dress
    from coaxlink.monitor.watch import to_json

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
    if json is not None:
        files.write_json(json, to_json(view))
    console().print(dress(summary(view), DARK))
