"""`coaxlink mix`: the companion in the loop, wrench demand in, motor commands out."""

from __future__ import annotations

import gc
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli.shared.effects import say_effects, vehicle_of
from coaxlink.cli.shared.line import introduced
from coaxlink.cli.shared.mixing import Options, fly, motors
from coaxlink.cli.shared.shell import JsonOption, say
from coaxlink.cli.shared.supervise import supervise
from coaxlink.cli.upload import SigningOption, SystemOption
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe

LOST_S = 10.0  # without a word of the vehicle the link counts as lost; PX4's own default (COM_DL_LOSS_T)
SWITCH_S = 2e-4  # how long the screen may keep the live loop from the interpreter


def mix(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    connect: Annotated[
        str, typer.Option(metavar="URL", help="udpin:0.0.0.0:14540, tcp:..., /dev/tty...,baud")
    ],
    law: Annotated[str, typer.Option(help="standard, reduced, coaxial, exact, ...")] = "exact",
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    rate: Annotated[float, typer.Option(min=1, max=1000, help="Demands a second to ask for.")] = 250.0,
    seconds: Annotated[float | None, typer.Option(min=0.1, help="Stop by itself after this long.")] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Compute and show, send no motor command.")
    ] = False,
    props_off: Annotated[
        bool, typer.Option("--props-off", help="Only turn the motors one by one and ask what turned.")
    ] = False,
    record: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep mix.live and mix.tlog there.")
    ] = None,
    plot: Annotated[
        bool, typer.Option("--plot", help="Send split, error and latency for QGC to plot.")
    ] = False,
    forward: Annotated[
        str | None,
        typer.Option(
            metavar="WHERE",
            help="Share the line with one ground station: its HOST:PORT, or udpin:PORT (this machine), "
            "udpin:0.0.0.0:PORT (the network) to let it come.",
        ),
    ] = None,
    witness: Annotated[
        bool,
        typer.Option("--witness/--no-witness", help="Let go when the motors do not follow our commands."),
    ] = True,
    loop: Annotated[
        bool, typer.Option("--loop", help="Run the attitude and rate loops here too, on ATTITUDE_TARGET.")
    ] = False,
    compiled: Annotated[
        bool | None,
        typer.Option(
            "--compiled/--plain",
            help="The exact law and the loop around it compiled (12 s of work, once; 120 MB). "
            "Default: if it was compiled before.",
        ),
    ] = None,
    lead: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=100,
            metavar="MS",
            help="Lead the motors' declared lag down to so much; amplifies noise in the demand.",
        ),
    ] = None,
    air_temperature: Annotated[
        float | None,
        typer.Option(
            min=-60, max=60, metavar="C", help="Of the air, for air_density; a barometer knows its board's."
        ),
    ] = None,
    reallocate: Annotated[
        bool,
        typer.Option(
            "--reallocate",
            help="Fly on with what is left of a rotor that is called weak, and without one that stopped "
            "(exact law). Not taken back before `mix` is started again.",
        ),
    ] = False,
    lost: Annotated[
        float, typer.Option(min=1, metavar="S", help="So long without a word of the vehicle: exit code 3.")
    ] = LOST_S,
    supervised: Annotated[
        bool, typer.Option("--supervise", help="A parent process starts it again when it dies.")
    ] = False,
    system: SystemOption = None,
    signing_key: SigningOption = None,
    json_file: JsonOption = None,
) -> None:
    """Mix live: answer every wrench demand of the autopilot with motor commands, until interrupted.

    Arming stays with the pilot. Begin with --props-off, then --dry-run.
    """
    if reallocate and law != "exact":
        raise InputError("--reallocate", "", f"only the exact law re-allocates, found --law {law}")
    if supervised and (props_off or seconds is not None):
        raise InputError("--supervise", "", "not with --props-off or --seconds")

    def one(life: int) -> None:
        _mix(Options(
            airframe, connect, law, rotor, rate, seconds, dry_run, props_off, _folder(record, life), plot,
            forward, witness, loop, compiled, lead, air_temperature, lost, system, signing_key, json_file,
            reallocate,
        ))  # fmt: skip

    if supervised:
        supervise(one)
    one(0)


def _folder(record: Path | None, life: int) -> Path | None:
    """Of a start's own record: the one before it died, and is kept."""
    return record / f"start-{life + 1}" if record and life else record


def _mix(o: Options) -> None:
    from coaxlink import mixer
    from coaxlink.mavlink import connect as open_session
    from coaxlink.mavlink.confirm import alone

    sys.setswitchinterval(SWITCH_S)
    vehicle, _ = vehicle_of(o.airframe, o.rotor, measured_live=True)  # the rest is measured in flight
    say_effects(vehicle)
    frame = vehicle.airframe
    chosen = mixer.make_law(o.law, vehicle)
    native = _native(o.compiled) if o.law == "exact" and not o.dry_run else None
    # the first call compiles, or fills caches: never in flight
    chosen.speeds([GRAVITY_M_S2 * frame.mass_kg, 0.0, 0.0, 0.0])
    lead_s = _lead(frame, o.lead, o.rate)
    log = o.record / "mix.tlog" if o.record else None
    with (
        open_session(o.connect, target_system=o.system, signing_key=o.signing_key, record=log) as line,
        introduced(line) as session,
    ):
        alone(session)
        if o.props_off:
            motors(session, frame, o.json_file)
            return
        gc.collect()
        gc.freeze()  # what has been built so far is here to stay: no pause to look through it again
        fly(session, vehicle, chosen, o, lead_s, native)


def _native(compiled: bool | None) -> Any:
    """The compiled loop if it is asked for, or there and not unwanted."""
    from coaxlink.live import compiled as code

    if compiled is False or (compiled is None and not code.cached()):
        if compiled is None and (why := code.refused()):
            say(f"the compiled loop that is kept is not run: {why}; --compiled makes one for this run")
        return None
    if not code.available():
        raise InputError("--compiled", "", "the compiled loop runs on 64-bit Linux only")
    if not code.cached():
        why = code.distrusted()
        times = f"for this run alone ({why})" if why else "once for this processor and version"
        say(f"compiling the live loop, {times}: 12 s or more")
    try:
        return code.load()
    except ImportError as error:
        raise InputError("--compiled", "", "numba is not installed") from error


def _lead(frame: Airframe, lead_ms: float | None, rate_hz: float) -> tuple[float, float]:
    """(lag declared, lag wanted) in s; zeros for no lead. Raises InputError where no lag is declared."""
    if lead_ms is None:
        return 0.0, 0.0
    lag, quick = frame.motor_lag_s, lead_ms / 1e3
    if not quick < lag:
        found = f"motor_lag_s is {lag:g} s"
        raise InputError(
            frame.source or frame.name, "motor_lag_s", f"more than {quick:g} s expected, {found}"
        )
    from math import exp

    wanted = 1.0 - exp(-1.0 / (rate_hz * quick)) if quick > 0 else 1.0
    gain = wanted / (1.0 - exp(-1.0 / (rate_hz * lag)))
    what = f"motors led from {1e3 * lag:g} to {1e3 * quick:g} ms"
    say(f"{what}: a step in the demand is commanded {gain:.1f} times as high")
    return lag, quick


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("mix", short_help="Mix live: answer every demand of the autopilot.")(mix)
