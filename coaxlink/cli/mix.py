"""`coaxlink mix`: the companion in the loop, wrench demand in, motor commands out."""

from __future__ import annotations

import gc
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli._effects import refuse_no_lift, rotor_path, say_effects
from coaxlink.cli._shell import JsonOption, say
from coaxlink.cli.upload import SigningOption, SystemOption
from coaxlink.errors import CheckFailed, InputError, LinkError, SafetyRefusal

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.link import Session
    from coaxlink.link.mixing import LiveMixer
    from coaxlink.mixer import Law
    from coaxlink.rotor import RotorModel

QUIET_S = 3.0  # wall time without a heartbeat after which the link counts as lost
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
        str | None, typer.Option(metavar="HOST:PORT", help="Share the line with a ground station (UDP).")
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
            help="The exact law and the loop around it compiled (15 s of work, once; 50 MB). "
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
    system: SystemOption = None,
    signing_key: SigningOption = None,
    json_file: JsonOption = None,
) -> None:
    """Mix live: answer every wrench demand of the autopilot with motor commands, until interrupted.

    Arming stays with the pilot. Begin with --props-off, then --dry-run.
    """
    from coaxlink import mixer
    from coaxlink.airframe import load_airframe
    from coaxlink.link import connect as open_session
    from coaxlink.rotor.model import load_rotor_model

    sys.setswitchinterval(SWITCH_S)
    frame = load_airframe(airframe)
    path = rotor_path(frame.rotor_model, rotor, airframe)
    model = load_rotor_model(path)
    refuse_no_lift(model, path)
    seen = mixer.see(frame, model, surfaces_only=True)  # the rest is compensated from telemetry
    say_effects(seen)
    model = seen.model
    chosen = mixer.make_law(law, frame, model)
    native = _native(compiled) if law == "exact" and not dry_run else None
    # the first call compiles, or fills caches: never in flight
    chosen.speeds([9.80665 * frame.mass_kg, 0.0, 0.0, 0.0])
    leading = _lead(frame, lead, rate)
    log = record / "mix.tlog" if record else None
    with open_session(connect, target_system=system, signing_key=signing_key, record=log) as session:
        if props_off:
            _motors(session, frame, json_file)
            return
        options = _Options(
            rate, seconds, dry_run, record, plot, forward, witness, airframe if loop else None, leading,
            air_temperature,
        )  # fmt: skip
        gc.collect()
        gc.freeze()  # what has been built so far is here to stay: no pause to look through it again
        _fly(session, frame, chosen, model, options, json_file, native)


def _native(compiled: bool | None) -> Any:
    """The compiled loop if it is asked for, or there and not unwanted."""
    from coaxlink.link import hot_build

    if compiled is False or (compiled is None and not hot_build.kept()):
        return None
    if not hot_build.available():
        raise InputError("--compiled", "", "the compiled loop runs on 64-bit Linux only")
    if not hot_build.kept():
        say("compiling the live loop, once for this processor and version: 15 s or more")
    try:
        return hot_build.load()
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

    whole = 1.0 - exp(-1.0 / (rate_hz * quick)) if quick > 0 else 1.0
    gain = whole / (1.0 - exp(-1.0 / (rate_hz * lag)))
    what = f"motors led from {1e3 * lag:g} to {1e3 * quick:g} ms"
    say(f"{what}: a step in the demand is commanded {gain:.1f} times as high")
    return lag, quick


class _Options:
    def __init__(
        self, rate: float, seconds: float | None, dry_run: bool, record: Path | None, plot: bool,
        forward: str | None, witness: bool, loop: Path | None, lead_s: tuple[float, float],
        air_C: float | None,
    ) -> None:  # fmt: skip
        self.rate, self.seconds, self.dry_run, self.record = rate, seconds, dry_run, record
        self.plot, self.forward, self.witness, self.loop = plot, forward, witness, loop
        self.lead_s, self.air_C = lead_s, air_C


def _fly(
    session: Session,
    frame: Airframe,
    law: Law,
    model: RotorModel,
    o: _Options,
    json_file: Path | None,
    native: Any = None,
) -> None:
    from coaxlink import files
    from coaxlink.link.attitude_loop import AttitudeLoop, load_gains
    from coaxlink.link.live_effects import LiveEffects
    from coaxlink.link.live_paths import require_path
    from coaxlink.link.live_record import LiveRecord
    from coaxlink.link.mixing import LiveMixer

    identity = session.identity
    if not identity.is_ardupilot:  # there a bridge decides, which has to be listened for
        require_path(identity.autopilot, identity.version)
    led = o.lead_s[1] if o.lead_s[0] else None
    effects = (
        LiveEffects(session, frame, model, lag_s=led, air_temperature_C=o.air_C) if model.effects else None
    )
    if effects and "air_density" in effects.names and o.air_C is None:
        say("air_density: nothing is done before the vehicle sends HYGROMETER_SENSOR (or --air-temperature)")
    for name, why in effects.left_out.items() if effects else ():
        say(f"not compensated live: {name} ({why})")
    about = {"law": law.name, "airframe": frame.name, "rotors": len(frame.rotors), "rotor_form": model.form}
    kept = LiveRecord(o.record / "mix.live", about) if o.record else None
    live = LiveMixer(
        session, frame, law, model, rate_hz=o.rate, dry_run=o.dry_run, witness=o.witness,
        compensation=effects, record=kept, own_curve=_own_curve(session),
        loop=AttitudeLoop(frame.inertia_kg_m2, load_gains(o.loop)) if o.loop else None,
        lead_s=o.lead_s, native=native,
    )  # fmt: skip
    if identity.is_px4:
        _warn_of_hand_over(live, frame)
    lost = None
    try:
        with _sharing(session, o.forward) as ground, live:
            try:
                lost = _watch(live, o, ground)
            except KeyboardInterrupt:
                say("stopping: the autopilot flies its own mixer again")
    finally:
        if kept:
            kept.close()
    summary = live.summary()
    if json_file:
        files.write_json(json_file, summary)
    sys.stdout.write(_line(summary) + "\n")
    if lost:
        raise LinkError(session.address, lost)
    if isinstance(live.error, SafetyRefusal):
        raise live.error
    if summary["unanswered"]["failures"]:
        raise CheckFailed(f"live mixing stopped itself and fell silent: {live.error}")
    if not summary["cycles"]:
        raise CheckFailed("no wrench demand (ACTUATOR_CONTROL_TARGET) came that could be answered")


def _own_curve(session: Session) -> float:
    """THR_MDL_FAC on board; 0, its default, where it does not say."""
    if not session.identity.is_px4:
        return 0.0
    from coaxlink.link.parameters import Parameters

    found = Parameters(session).read_many(["THR_MDL_FAC"], missing_ok=True)
    return float(found["THR_MDL_FAC"].value) if "THR_MDL_FAC" in found else 0.0


def _warn_of_hand_over(live: LiveMixer, frame: Airframe) -> None:
    weight = 9.80665 * frame.mass_kg
    own = live.core.hand_over_thrust(weight)
    if own < 0.8 * weight:
        say(
            f"warning: handed back in hover, the autopilot's own mixer first gives {own:.0f} N of "
            f"{weight:.0f} N; with THR_MDL_FAC = 1 it would lose less height"
        )


def _sharing(session: Session, where: str | None) -> Any:
    from contextlib import nullcontext

    if where is None:
        return nullcontext()
    from coaxlink.link.forward import Forwarder

    return Forwarder(session, where)


def _watch(live: LiveMixer, o: _Options, ground: Any) -> str | None:
    """Show the state until the time is up, the loop failed or the link is lost (then the reason)."""
    from coaxlink.link.live_plot import Plotter

    plotter = Plotter(live, ground) if o.plot else None
    screen = sys.stderr.isatty()
    if not screen:
        say("dry run: no motor command is sent" if o.dry_run else "live mixing")
    started = time.monotonic()
    while o.seconds is None or time.monotonic() - started < o.seconds:
        if live.failed.wait(0.2 if o.seconds is None else min(0.2, o.seconds)):
            return None
        if plotter:
            plotter.send()
        if screen:
            sys.stderr.write(f"\r\x1b[K{_line(live.summary())}")
            sys.stderr.flush()
        if live.session.silence_s > QUIET_S:
            return f"no heartbeat for {QUIET_S:.0f} s"
    return None


def _motors(session: Session, frame: Airframe, json_file: Path | None) -> None:
    from coaxlink import files
    from coaxlink.link.live_motor_test import turn_motors

    typed = typer.prompt("Are all propellers off? Type: they are off", err=True)
    if typed.strip() != "they are off":
        raise SafetyRefusal("motors are tested with the propellers off")

    def ask(number: int, place: str) -> bool:
        return typer.confirm(f"motor {number}: did this one turn: {place}?", err=True)

    answers = turn_motors(session, frame, ask)
    if json_file:
        files.write_json(json_file, {"motors": [a.to_json() for a in answers]})
    for a in answers:
        sys.stdout.write(f"motor {a.number}: {a.place}: {'right' if a.right else 'WRONG'}\n")
    wrong = [str(a.number) for a in answers if not a.right]
    if wrong:
        raise CheckFailed(
            f"motors {', '.join(wrong)} are not where, or not turning as, the airframe file says"
        )


def _line(s: dict[str, Any]) -> str:
    error = s["allocation_error"]["mean"]
    return (
        f"{s['law']}{' (dry run)' if s['dry_run'] else ''}, {s['state']}: "
        f"{s['cycles']} demands answered in {s['seconds']:.1f} s ({s['rate_hz']:.0f} Hz), "
        f"latency {s['latency_us']['p50']:.0f} / {s['latency_us']['p99']:.0f} us, "
        f"error {error[0]:.2g} N, {max(error[1:]):.2g} N m, "
        f"unanswered {sum(s['unanswered'].values())}"
    )


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("mix")(mix)
