"""What `coaxlink mix` does once the line is open: fly and say how it went, or turn the motors."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from coaxlink.cli.shared.line import tell_news
from coaxlink.cli.shared.next import unanswered
from coaxlink.cli.shared.shell import figure, say
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import CheckFailed, LinkError, SafetyRefusal

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.live.health_watch import HealthWatch
    from coaxlink.live.mixer import LiveMixer
    from coaxlink.mavlink import Session
    from coaxlink.mixer import Law
    from coaxlink.vehicle import Vehicle

POLL_S = 0.2  # how often the verb looks at its loop
SAYS = {"bridge": "own count", "outputs": "outputs", "timesync": "answers on the same line"}


@dataclass(frozen=True)
class Options:
    """What the user typed."""

    airframe: Path
    connect: str
    law: str
    rotor: Path | None
    rate: float
    seconds: float | None
    dry_run: bool
    props_off: bool
    record: Path | None
    plot: bool
    forward: str | None
    witness: bool
    loop: bool
    compiled: bool | None
    lead: float | None
    air_C: float | None
    lost_s: float
    system: int | None
    signing_key: Path | None
    json_file: Path | None
    reallocate: bool = False


def fly(
    session: Session,
    vehicle: Vehicle,
    law: Law,
    o: Options,
    lead_s: tuple[float, float],
    native: Any,
) -> None:
    """Mix until it is over, and say how it went.

    Raises LinkError, SafetyRefusal, and CheckFailed when the loop failed or a noteworthy share of the
    commands never arrived.
    """
    from coaxlink import files
    from coaxlink.live import arrival as live_arrival
    from coaxlink.live.attitude_loop import AttitudeLoop, load_gains
    from coaxlink.live.effects import LiveEffects
    from coaxlink.live.mixer import LiveMixer
    from coaxlink.live.paths import require_path
    from coaxlink.live.record import LiveRecord

    frame, model = vehicle.airframe, vehicle.model
    identity = session.identity
    if not identity.is_ardupilot:  # there a bridge decides, which has to be listened for
        require_path(identity.autopilot, identity.version)
    led = lead_s[1] if lead_s[0] else None
    effects = (
        LiveEffects(session, vehicle, lag_s=led, air_temperature_C=o.air_C) if vehicle.live_effects else None
    )
    if effects and "air_density" in effects.names and o.air_C is None:
        say("air_density: nothing is done before the vehicle sends HYGROMETER_SENSOR (or --air-temperature)")
    for name, why in effects.left_out.items() if effects else ():
        say(f"not compensated live: {name} ({why})")
    about = {"law": law.name, "airframe": frame.name, "rotors": len(frame.rotors), "rotor_form": model.form}
    live_record = LiveRecord(o.record / "mix.live", about) if o.record else None
    live = LiveMixer(
        session, vehicle, law, rate_hz=o.rate, dry_run=o.dry_run, witness=o.witness,
        compensation=effects, record=live_record, own_curve=_own_curve(session),
        loop=AttitudeLoop(frame.inertia_kg_m2, load_gains(o.airframe)) if o.loop else None,
        lead_s=lead_s, native=native,
    )  # fmt: skip
    if identity.is_px4:
        _warn_of_hand_over(live, frame)
    lost = None
    try:
        with _sharing(session, o.forward) as ground, live, _health(live, ground, o.reallocate) as health:
            try:
                lost = _watch(live, o, ground)
            except KeyboardInterrupt:
                say("stopping: the autopilot flies its own mixer again")
    finally:
        if live_record:
            live_record.close()
    summary = {**live.summary(), "health": health.account()}
    if health.problem:
        say(f"rotors were not judged to the end: {health.problem}")
    if o.json_file:
        files.write_json(o.json_file, summary)
    sys.stdout.write(_line(summary) + "\n")
    if why := unanswered(summary["unanswered"]):
        say(why)
    if lost:
        raise LinkError(session.address, lost)
    if isinstance(live.error, SafetyRefusal):
        raise live.error
    if summary["unanswered"]["failures"]:
        raise CheckFailed(f"live mixing stopped itself and fell silent: {live.error}")
    if not summary["cycles"]:
        raise CheckFailed("no wrench demand (ACTUATOR_CONTROL_TARGET) came that could be answered")
    arrival = live_arrival.of(live)
    if arrival and arrival.noteworthy:
        raise CheckFailed(
            f"{_lost(summary['arrival'])}: the vehicle flew on its own mixer or on old commands"
        )


def _lost(arrival: dict[str, Any]) -> str:
    """In words."""
    exact = "" if arrival["by"] == "bridge" else "about "
    return (
        f"{exact}{arrival['never_arrived']} of {arrival['sent']} motor commands never arrived "
        f"({100 * arrival['share']:.0f} %, by the vehicle's {SAYS[arrival['by']]})"
    )


def _own_curve(session: Session) -> float:
    """THR_MDL_FAC on board; 0, its default, where it does not say."""
    if not session.identity.is_px4:
        return 0.0
    from coaxlink.mavlink.parameters import Parameters

    found = Parameters(session).read_many(["THR_MDL_FAC"], missing_ok=True)
    return float(found["THR_MDL_FAC"].value) if "THR_MDL_FAC" in found else 0.0


def _warn_of_hand_over(live: LiveMixer, frame: Airframe) -> None:
    weight = GRAVITY_M_S2 * frame.mass_kg
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
    from coaxlink.live.forward import Forwarder

    sharing = Forwarder(session, where)
    if sharing.exposed:
        say(
            f"--forward {where}: whoever of the network speaks there first is the ground station and "
            "commands the vehicle through this line; leave the host out to listen on this machine only"
        )
    return sharing


def _health(live: LiveMixer, ground: Any, reallocate: bool) -> HealthWatch:
    """Beside the loop: rotors that lose thrust are said here, on the line and to the ground station."""
    from coaxlink.live.health_watch import HealthWatch
    from coaxlink.live.reallocation import Reallocation

    reallocation = Reallocation(live) if reallocate else None
    return HealthWatch(live, lambda call: say(call.text), ground, reallocation)


def _watch(live: LiveMixer, o: Options, ground: Any) -> str | None:
    """Show the state until the time is up, the loop failed or the link is lost (then the reason)."""
    from coaxlink.live.plot import Plotter
    from coaxlink.live.stall import Absence

    plotter = Plotter(live, ground) if o.plot else None
    screen = sys.stderr.isatty()
    if not screen:
        say("dry run: no motor command is sent" if o.dry_run else "live mixing")
    started = time.monotonic()
    absence = Absence(started, POLL_S)
    while o.seconds is None or time.monotonic() - started < o.seconds:
        if live.failed.wait(POLL_S if o.seconds is None else min(POLL_S, o.seconds)):
            return None
        if plotter:
            plotter.send()
        if screen:
            sys.stderr.write(f"\r\x1b[K{_line(live.summary())}")
            sys.stderr.flush()
        tell_news(live.session)
        now = time.monotonic()
        silent_s = absence.silent_s(now, max(now - live.session.silence_s, live.guard.last))
        if absence.slept_s:
            say(f"stopped for {absence.slept_s:.1f} s; three good demands and the law fades in again")
        if silent_s > o.lost_s:
            return f"no word of the vehicle for {o.lost_s:g} s"
    return None


def _line(s: dict[str, Any]) -> str:
    error, others = s["allocation_error"]["mean"], s["not_believed"]
    lost = s["arrival"]["never_arrived"] if s["arrival"] else 0
    return (
        f"{s['law']}{' (dry run)' if s['dry_run'] else ''}, {s['state']}: "
        f"{s['cycles']} demands answered in {s['seconds']:.1f} s ({s['rate_hz']:.0f} Hz), "
        f"latency {s['latency_us']['p50']:.0f} / {s['latency_us']['p99']:.0f} us, "
        f"error {figure(error[0], 2)} N, {figure(max(error[1:]), 2)} N m, "
        f"unanswered {sum(s['unanswered'].values())}"
        + (f", never arrived {lost}" if lost else "")
        + (f", {others} datagrams under its ids not believed" if others else "")
    )


def motors(session: Session, frame: Airframe, json_file: Path | None) -> None:
    """Turn the motors one by one and ask. Raises SafetyRefusal, and CheckFailed when one is wrong."""
    from coaxlink import files
    from coaxlink.live.motor_test import turn_motors

    typed = typer.prompt("Are all propellers off? Type: they are off", err=True)
    if typed.strip() != "they are off":
        raise SafetyRefusal("motors are tested with the propellers off")

    def ask(number: int, mount: str) -> bool:
        return typer.confirm(f"rotor {number}: did this one turn: {mount}?", err=True)

    answers = turn_motors(session, frame, ask)
    if json_file:
        files.write_json(json_file, {"motors": [a.to_json() for a in answers]})
    for a in answers:
        sys.stdout.write(f"rotor {a.number}: {a.mount}: {'right' if a.right else 'WRONG'}\n")
    wrong = [str(a.number) for a in answers if not a.right]
    if wrong:
        raise CheckFailed(f"rotor {', '.join(wrong)}: not where, or not turning as, the airframe file says")
