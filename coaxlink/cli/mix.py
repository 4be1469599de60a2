"""`coaxlink mix`: the companion in the loop, wrench demand in, motor commands out."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli._shell import JsonOption, console, talk
from coaxlink.cli.allocate import rotor_path
from coaxlink.errors import CheckFailed, LinkError

if TYPE_CHECKING:
    from coaxlink.link.mixing import LiveMixer

QUIET_S = 3.0  # wall time without a heartbeat after which the link counts as lost


def mix(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    connect: Annotated[
        str, typer.Option(metavar="URL", help="udpin:0.0.0.0:14540, tcp:..., /dev/tty...,baud")
    ],
    law: Annotated[str, typer.Option(help="standard, reduced, coaxial, exact, ...")] = "coaxial",
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    rate: Annotated[float, typer.Option(min=1, max=1000, help="Demands a second to ask for.")] = 250.0,
    seconds: Annotated[float | None, typer.Option(min=0.1, help="Stop by itself after this long.")] = None,
    json_file: JsonOption = None,
) -> None:
    """Mix live: answer every wrench demand of the autopilot with motor commands, until interrupted."""
    from coaxlink import files, mixer
    from coaxlink.airframe import load_airframe
    from coaxlink.link import connect as open_session
    from coaxlink.link.mixing import LiveMixer
    from coaxlink.rotor.model import load_rotor_model

    frame = load_airframe(airframe)
    model = load_rotor_model(rotor_path(frame.rotor_model, rotor, airframe))
    chosen = mixer.make_law(law, frame, model)
    with open_session(connect) as session:
        live = LiveMixer(session, frame, chosen, model, rate_hz=rate)
        lost = None
        with live:
            try:
                lost = _watch(live, seconds)
            except KeyboardInterrupt:
                talk().print("stopping: the autopilot flies its own mixer again")
        summary = live.summary()
    if json_file:
        files.write_json(json_file, summary)
    console().print(_line(summary))
    if lost:
        raise LinkError(connect, lost)
    if summary["unanswered"]["failures"]:
        raise CheckFailed(f"live mixing stopped itself and fell silent: {live.error}")
    if not summary["cycles"]:
        raise CheckFailed("the autopilot sent no wrench demand (ACTUATOR_CONTROL_TARGET)")


def _watch(live: LiveMixer, seconds: float | None) -> str | None:
    """Show the state until the time is up, the loop failed or the link is lost (then the reason)."""
    from rich.live import Live

    started = time.monotonic()
    with Live(console=talk(), refresh_per_second=4) as screen:
        while seconds is None or time.monotonic() - started < seconds:
            if live.failed.wait(0.25 if seconds is None else min(0.25, seconds)):
                return None
            screen.update(_line(live.summary()))
            if live.session.silence_s > QUIET_S:
                return f"no heartbeat for {QUIET_S:.0f} s"
    return None


def _line(s: dict[str, Any]) -> str:
    error = s["allocation_error"]["mean"]
    return (
        f"{s['law']}: {s['cycles']} demands answered in {s['seconds']:.1f} s ({s['rate_hz']:.0f} Hz), "
        f"latency {s['latency_us']['p50']:.0f} / {s['latency_us']['p99']:.0f} us, "
        f"error {error[0]:.2g} N, {max(error[1:]):.2g} N m, "
        f"unanswered {sum(s['unanswered'].values())}"
    )


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("mix")(mix)
