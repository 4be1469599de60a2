"""`coaxlink mix`: the companion in the loop, wrench demand in, motor commands out."""

from __future__ import annotations

import gc
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli.shared.completion import laws
from coaxlink.cli.shared.effects import say_effects, vehicle_of
from coaxlink.cli.shared.line import address_of, tell_news, vehicle_at
from coaxlink.cli.shared.next import unanswered
from coaxlink.cli.shared.shell import JsonOption, figure, say, talk
from coaxlink.cli.upload import NewGeometryOption, SigningOption, SystemOption, VehicleConnectOption
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import CheckFailed, LinkError, SafetyRefusal
from coaxlink.threads import SWITCH_S

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.live.effects import LiveEffects
    from coaxlink.live.mixer import LiveMixer
    from coaxlink.live.record import LiveRecord
    from coaxlink.mavlink import Session
    from coaxlink.vehicle import Vehicle

LOST_S = 10.0  # without a word of the vehicle the link counts as lost; PX4's own default (COM_DL_LOSS_T)
POLL_S = 0.2  # how often the verb looks at its loop
SAYS = {"bridge": "own count", "outputs": "outputs", "timesync": "answers on the same line"}


def mix(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    connect: VehicleConnectOption = None,
    law: Annotated[
        str, typer.Option(help="standard, reduced, coaxial, exact, ...", autocompletion=laws)
    ] = "exact",
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    rate: Annotated[float, typer.Option(min=1, max=1000, help="Demands a second to ask for.")] = 250.0,
    seconds: Annotated[float | None, typer.Option(min=0.1, help="Stop by itself after this long.")] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Compute and show, send no motor command.")
    ] = False,
    record: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep mix.live and mix.tlog there.")
    ] = None,
    witness: Annotated[
        bool,
        typer.Option("--witness/--no-witness", help="Let go when the motors do not follow our commands."),
    ] = True,
    air_temperature: Annotated[
        float | None,
        typer.Option(
            min=-60, max=60, metavar="C", help="Of the air, for air_density; a barometer knows its board's."
        ),
    ] = None,
    lost: Annotated[
        float, typer.Option(min=1, metavar="S", help="So long without a word of the vehicle: exit code 3.")
    ] = LOST_S,
    new_geometry: NewGeometryOption = False,
    system: SystemOption = None,
    signing_key: SigningOption = None,
    json_file: JsonOption = None,
) -> None:
    """Mix live: answer every wrench demand of the autopilot with motor commands, until interrupted.

    Arming stays with the pilot. Begin with `coaxlink motors`, then --dry-run.
    """
    from coaxlink import files
    from coaxlink.live.geometry import refuse_other_vehicle
    from coaxlink.live.health_watch import HealthWatch
    from coaxlink.live.mixer import LiveMixer
    from coaxlink.live.mixer_core import live_law
    from coaxlink.live.paths import may_be_bridged, own_curve
    from coaxlink.mavlink.confirm import alone

    where = address_of(connect, airframe)
    sys.setswitchinterval(SWITCH_S)
    vehicle, _ = vehicle_of(airframe, rotor, measured_live=True)  # the rest is measured in flight
    say_effects(vehicle)
    frame = vehicle.airframe
    with talk().status(f"preparing the {law} law (compiled once for a release)"):
        chosen = live_law(law, vehicle)
    if not getattr(chosen, "compiled", True):
        say("numba is not installed: a demand that jumps out of reach is answered 0.1 s late, on a Pi later")
    log = record / "mix.tlog" if record else None
    with vehicle_at(where, system=system, signing_key=signing_key, record=log) as session:
        alone(session)
        _require_path(session)
        for line in refuse_other_vehicle(session, frame, new_geometry=new_geometry):
            say(line)
        live_record = _record(record, vehicle, law)
        live = LiveMixer(
            session, vehicle, chosen, rate_hz=rate, dry_run=dry_run, witness=witness, record=live_record,
            compensation=_effects(session, vehicle, air_temperature), own_curve=own_curve(session),
        )  # fmt: skip
        if not may_be_bridged(session.identity.autopilot, session.identity.version):
            _warn_of_hand_over(live, frame)
        gc.collect()
        gc.freeze()  # what has been built so far is here to stay: no pause to look through it again
        problem = None
        try:
            with live, HealthWatch(live, say) as health:
                try:
                    problem = _watch(live, seconds, lost)
                except KeyboardInterrupt:
                    say("stopping: the autopilot flies its own mixer again")
        finally:
            if live_record:
                live_record.close()
        summary = {**live.summary(), "health": health.account()}
        if health.problem:
            say(f"rotors were not judged to the end: {health.problem}")
        if json_file:
            files.write_json(json_file, summary)
        sys.stdout.write(_line(summary) + "\n")
        if why := unanswered(summary["unanswered"]):
            say(why)
        if problem:
            raise LinkError(session.address, problem)
        _judge(live, summary)


def _judge(live: LiveMixer, summary: dict[str, Any]) -> None:
    """Raises SafetyRefusal, and CheckFailed when the loop failed or too many commands never arrived."""
    if isinstance(live.error, SafetyRefusal):
        raise live.error
    if summary["unanswered"]["failures"]:
        raise CheckFailed(f"live mixing stopped itself and fell silent: {live.error}")
    if not summary["cycles"]:
        raise CheckFailed(f"no wrench demand ({live.wire.demand.name}) came that could be answered")
    if (arrival := live.arrival) and arrival.noteworthy:
        raise CheckFailed(
            f"{_lost(summary['arrival'])}: the vehicle flew on its own mixer or on old commands"
        )


def _require_path(session: Session) -> None:
    """Before anything is asked of it. Raises SafetyRefusal for an autopilot that takes no motor commands."""
    from coaxlink.live.paths import may_be_bridged, require_path

    identity = session.identity
    if not may_be_bridged(identity.autopilot, identity.version):  # else it has to be listened for
        require_path(identity.autopilot, identity.version)


def _effects(session: Session, vehicle: Vehicle, air_C: float | None) -> LiveEffects | None:
    from coaxlink.live.effects import LiveEffects

    if not vehicle.live_effects:
        return None
    effects = LiveEffects(session, vehicle, air_temperature_C=air_C)
    if "air_density" in effects.names and air_C is None:
        say("air_density: nothing is done before the vehicle sends HYGROMETER_SENSOR (or --air-temperature)")
    for name, why in effects.left_out.items():
        say(f"not compensated live: {name} ({why})")
    return effects


def _record(folder: Path | None, vehicle: Vehicle, law: str) -> LiveRecord | None:
    from coaxlink.live.record import LiveRecord

    frame = vehicle.airframe
    about = {
        "law": law, "airframe": frame.name, "rotors": len(frame.rotors), "rotor_form": vehicle.model.form,
    }  # fmt: skip
    return LiveRecord(folder / "mix.live", about) if folder else None


def _warn_of_hand_over(live: LiveMixer, frame: Airframe) -> None:
    weight = GRAVITY_M_S2 * frame.mass_kg
    own = live.core.hand_over_thrust(weight)
    if own < 0.8 * weight:
        say(
            f"warning: handed back in hover, the autopilot's own mixer first gives {own:.0f} N of "
            f"{weight:.0f} N; with THR_MDL_FAC = 1 it would lose less height"
        )


def _watch(live: LiveMixer, seconds: float | None, lost_s: float) -> str | None:
    """Show the state until the time is up, the loop failed or the link is lost (then the reason)."""
    from coaxlink.live.stall import Absence

    clock, screen = live.session.clock, sys.stderr.isatty()
    if not screen:
        say("dry run: no motor command is sent" if live.dry_run else "live mixing")
    started = clock.monotonic()
    absence = Absence(started, POLL_S)
    while seconds is None or clock.monotonic() - started < seconds:
        if clock.wait(live.failed, POLL_S if seconds is None else min(POLL_S, seconds)):
            return None
        if screen:
            sys.stderr.write(f"\r\x1b[K{_line(live.summary())}")
            sys.stderr.flush()
        tell_news(live.session)
        now = clock.monotonic()
        silent_s = absence.silent_s(now, max(now - live.session.silence_s, live.guard.last))
        if absence.slept_s:
            say(f"stopped for {absence.slept_s:.1f} s; three good demands and the law fades in again")
        if silent_s > lost_s:
            return f"no word of the vehicle for {lost_s:g} s"
    return None


def _line(s: dict[str, Any]) -> str:
    error, others = s["allocation_error"]["mean"], s["not_believed"]
    lost = s["arrival"]["never_arrived"] if s["arrival"] else 0
    failed = (s["board"] or {}).get("failed_motors", 0)
    motors = ", ".join(str(n + 1) for n in range(failed.bit_length()) if failed >> n & 1)
    return (
        f"{s['law']}{' (dry run)' if s['dry_run'] else ''}, {s['state']}: "
        f"{s['cycles']} demands answered in {s['seconds']:.1f} s ({s['rate_hz']:.0f} Hz), "
        f"latency {s['latency_us']['p50']:.0f} / {s['latency_us']['p99']:.0f} us, "
        f"error {figure(error[0], 2)} N, {figure(max(error[1:]), 2)} N m, "
        f"unanswered {sum(s['unanswered'].values())}"
        + (f", never arrived {lost}" if lost else "")
        + (f", motor {motors} failed: the module flies alone and turns down what turns it" if failed else "")
        + (f", {others} datagrams under its ids not believed" if others else "")
    )


def _lost(arrival: dict[str, Any]) -> str:
    """In words."""
    exact = "" if arrival["by"] == "bridge" else "about "
    return (
        f"{exact}{arrival['never_arrived']} of {arrival['sent']} motor commands never arrived "
        f"({100 * arrival['share']:.0f} %, by the vehicle's {SAYS[arrival['by']]})"
    )
