"""`coaxlink fly`: a plan on a real autopilot, its log down again (through MAVSDK) and into refine."""

from __future__ import annotations

import itertools
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli.shared.line import address_of, vehicle_at
from coaxlink.cli.shared.shell import JsonOption, console, say, talk
from coaxlink.cli.shared.stand import at_a_terminal
from coaxlink.cli.upload import SigningOption, SystemOption, TimeoutOption, VehicleConnectOption

if TYPE_CHECKING:
    from coaxlink.cli.shared.split import Split
    from coaxlink.fly.flight import Flown
    from coaxlink.fly.limits import FlightLimits, PositionState
    from coaxlink.fly.logs import Logs
    from coaxlink.fly.trajectory import FlightPlan
    from coaxlink.mavlink import Session
    from coaxlink.vehicle import Vehicle


def fly(
    connect: VehicleConnectOption = None,
    plan: Annotated[
        str,
        typer.Option(
            metavar="PLAN",
            help="hover, circle, steps, identify, paper, split, or a PLAN.toml of refine or identify.",
        ),
    ] = "hover",
    height: Annotated[float, typer.Option(metavar="M", help="Height of the named plans.")] = 4.0,
    reach: Annotated[float, typer.Option(metavar="M", help="How far the named plans go.")] = 2.0,
    fence: Annotated[float, typer.Option(metavar="M", help="Never further away than this.")] = 30.0,
    ceiling: Annotated[float, typer.Option(metavar="M", help="Never higher than this.")] = 15.0,
    battery: Annotated[
        float, typer.Option(min=0.0, max=0.95, help="Lands when less of the charge is left; 0: no limit.")
    ] = 0.3,
    minutes: Annotated[float, typer.Option(min=0.1, max=60.0, help="Of hover, for the plan `split`.")] = 10.0,
    split_reach: Annotated[
        float, typer.Option(min=0.01, max=0.15, help="`split`: so far to both sides of the share on board.")
    ] = 0.12,
    after: Annotated[
        list[Path] | None,
        typer.Option(metavar="FLY.json", help="`split`: goes on from this flight, with a fresh pack."),
    ] = None,
    tables: Annotated[
        bool,
        typer.Option("--tables", help="`split`, where nothing is mixed live: one hover a table, in turn."),
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="All checks, then leave on the ground.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before arming.")] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Where the logs go; a folder of this time in it, if there are some already."
        ),
    ] = None,
    log: Annotated[bool, typer.Option("--log/--no-log", help="Fetch the autopilot's log.")] = True,
    airframe: Annotated[
        Path | None, typer.Option(metavar="AIRFRAME.toml", help="Refine the log against this vehicle.")
    ] = None,
    rotor: Annotated[
        Path | None, typer.Option(metavar="ROTOR.toml", help="Refine against this (default: the airframe's).")
    ] = None,
    json: JsonOption = None,
    timeout: TimeoutOption = 10.0,
    system: SystemOption = None,
    signing_key: SigningOption = None,
) -> None:
    """Fly a plan within limits of our own; the pilot's mode change ends it at once."""
    from coaxlink import files
    from coaxlink.cli.shared.split import PLAN as SPLIT
    from coaxlink.cli.shared.split import Split
    from coaxlink.errors import InputError
    from coaxlink.fly.commands import Crashed, PlanAbandoned
    from coaxlink.fly.flight import Flown, OverLimit, Pilot
    from coaxlink.fly.limits import FlightLimits
    from coaxlink.fly.logs import Logs
    from coaxlink.fly.plans import peaks, plan_of
    from coaxlink.mavlink.station import hear_words

    _positive(("--height", height), ("--reach", reach), ("--fence", fence), ("--ceiling", ceiling))
    body = _vehicle_files(airframe, rotor)
    connect = address_of(connect, airframe)
    if tables and plan != SPLIT:
        raise InputError("--tables", "", f"goes with --plan {SPLIT}")
    split = Split(body, airframe, minutes, split_reach, after or [], tables) if plan == SPLIT else None
    planned = (
        split.hover(height) if split
        else plan_of(plan, height, reach, *(_doublets(body) if plan == "identify" else ()))
    )  # fmt: skip
    limits = FlightLimits(radius_m=fence, ceiling_m=ceiling, battery=battery)
    files.refuse_unwritable(json)
    out = _PLACE if dry_run else _new_folder(out)
    flown = Flown(planned.duration_s)
    found: dict[str, Any] = {}
    most = peaks(planned)
    say(
        f"{plan}: {planned.duration_s:.0f} s, {most['lowest_m']:.1f} to {most['highest_m']:.1f} m high, "
        f"{most['radius_m']:.1f} m away at most, {most['speed_m_s']:.1f} m/s, {most['tilt_deg']:.0f} degrees"
    )
    try:
        record = None if dry_run else out / "flight.tlog"
        with vehicle_at(
            connect, timeout_s=timeout, system=system, signing_key=signing_key, record=record
        ) as session:
            hear_words(session)
            pilot = Pilot(session, limits)
            pilot.check(planned)
            if split:
                split.prepare(session)
            logs = Logs(session)
            before = logs.entries() if log else []
            left = pilot.battery()
            charge = "" if left is None else f", battery at {100 * left:.0f} %"
            say(f"ready: disarmed, its own checks pass{charge}; limits {_words(limits)}")
            if dry_run:
                console().print("checked: it would fly; nothing was armed")
                return
            _confirm(yes, session.identity.name)
            _record(session, log, before is not None)
            try:
                _in_the_air(pilot, planned, flown, split)
            except (OverLimit, Crashed, PlanAbandoned) as end:
                if log and not isinstance(end, PlanAbandoned):
                    found = _bring_down(logs, out, before)  # what went wrong is in it
                if split:
                    split.tell_cut_short(json)
                raise
            if flown.swing is not None and flown.swing > REPORTED:
                gain = f"{flown.swing:.1f} times"
                say(
                    f"the first small swing went {gain} as far as asked: the others were flown {gain} smaller"
                )
            say(f"landed after {flown.flown_s:.0f} s, {flown.worst_m:.2f} m off its set-points at most")
            found = _bring_down(logs, out, before) if log else {}
    finally:
        if json and not dry_run:
            found |= split.as_json() if split else {}
            files.write_json(json, {**flown.as_json(), "tlog": str(out / "flight.tlog"), **found})
    path = _usable(out, found)
    console().print(f"flown: {plan}, {flown.flown_s:.0f} s; {path}", soft_wrap=True)
    if split:
        split.tell(out)
    elif airframe is not None:
        _refine(path, airframe, rotor, out)
    else:
        say(f"next: coaxlink refine {path} --airframe AIRFRAME.toml")


SLOW_S, EACH_SHARE = 5.0, 0.1  # a log that takes longer is told of, at each such share
REPORTED = 1.1  # times as far as asked: less is no news
_PLACE = Path("flight")  # where flights lie, each in a folder of its time


def _new_folder(named: Path | None) -> Path:
    """A folder without a flight: `named` itself while none lies in it, else one of this time in it.

    Made by exclusive creation: no flight is written over another. Raises InputError.
    """
    from coaxlink.errors import InputError

    place = _PLACE if named is None else named
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    later = (place / (stamp if n == 1 else f"{stamp}-{n}") for n in itertools.count(1))
    try:
        place.mkdir(parents=True, exist_ok=True)
        if named is not None and not any(place.glob("flight.*")):
            (place / "flight.tlog").open("x").close()
            return place
        for folder in later:
            try:
                folder.mkdir()
            except FileExistsError:
                continue
            say(f"this flight's logs go to {folder}")
            return folder
    except OSError as error:
        raise InputError(place, "", f"cannot be written ({error.strerror})") from error
    raise AssertionError


def _positive(*options: tuple[str, float]) -> None:
    from coaxlink.errors import InputError

    for name, value in options:
        if not 0.0 < value < 1e4:
            raise InputError(name, "", f"metres above 0 are expected, found {value:g}")


def _vehicle_files(airframe: Path | None, rotor: Path | None) -> Vehicle | None:
    """The vehicle to refine against, read once: a slip shows before take-off, not after the landing."""
    from coaxlink.errors import InputError
    from coaxlink.vehicle import load_vehicle

    if airframe is None:
        if rotor is not None:
            raise InputError("--rotor", "", "is for refining: name the vehicle with --airframe")
        return None
    return load_vehicle(airframe, rotor)


def _doublets(vehicle: Vehicle | None) -> tuple[float]:
    """Yaw acceleration of the plan's doublets, rad/s^2, and in words where it comes from."""
    from coaxlink.errors import InputError
    from coaxlink.fly.plans import CAUTIOUS_RAD_S2, DOUBLETS, DOUBLETS_S
    from coaxlink.mixer.authority import doublet_acceleration, doublet_deg

    size, why = CAUTIOUS_RAD_S2, "no --airframe: small enough for a vehicle that hardly yaws"
    if vehicle is not None:
        try:
            size, why = doublet_acceleration(vehicle), "half of what this vehicle's fitted table has in hover"
        except InputError as error:
            why = f"small, since the vehicle's own yaw is not known: {error}"
    say(f"yaw doublets of {doublet_deg(size, DOUBLETS_S, DOUBLETS):.0f} degrees ({why})")
    return (size,)


def _words(limits: FlightLimits) -> str:
    charge = f", battery above {100 * limits.battery:.0f} %" if limits.battery > 0 else ""
    return f"{limits.radius_m:g} m away, {limits.ceiling_m:g} m high{charge}"


def _confirm(yes: bool, name: str) -> None:
    """Raises SafetyRefusal where nobody says yes."""
    from coaxlink.errors import SafetyRefusal

    if yes:
        return
    if not at_a_terminal():
        raise SafetyRefusal("nobody is at the terminal to say that the area is clear (--yes says it)")
    question = f"{name}: props on, area clear, a pilot at the sticks? Arms and takes off"
    if not typer.confirm(question, err=True):
        raise SafetyRefusal("not confirmed, nothing was armed")


def _record(session: Session, wanted: bool, served: bool) -> None:
    """Where no log comes down the telemetry is the log: ask for all that refine needs."""
    from coaxlink.studies.flight import AP_STREAMS, STREAMS

    if wanted and served:
        return
    why = "it serves no log" if wanted else "--no-log"
    say(f"{why}: its telemetry is recorded instead, as fast as the line lets it through")
    for number, rate in (AP_STREAMS if session.identity.is_ardupilot else STREAMS).items():
        session.request_stream(number, rate)


def _in_the_air(pilot: Any, planned: FlightPlan, flown: Flown, split: Split | None = None) -> None:
    with talk().status("arming, taking off") as status:

        def watch(segment: str, t: float, state: PositionState) -> None:
            if split and segment == "split":
                split.watch(t)
            charge = "" if state.battery is None else f", {100 * state.battery:.0f} %"
            status.update(
                f"{segment}: {t:.0f} of {planned.duration_s:.0f} s, {state.height_m:.1f} m high, "
                f"{state.off_plan_m:.2f} m off{charge}"
            )

        pilot.fly(planned, flown, watch, *([split.mixing] if split else []))


def _bring_down(logs: Logs, out: Path, before: list[Any] | None) -> dict[str, Any]:
    """The autopilot's log into `out`; without one, why not, reported."""
    from coaxlink.errors import CheckFailed

    began, shown = time.monotonic(), [0.0]

    def coming(share: float, size: int) -> None:
        status.update(f"log, {100 * share:.0f} % of {size / 1e6:.1f} MB")
        if time.monotonic() - began > SLOW_S and share - shown[0] >= EACH_SHARE:  # a short one is no news
            shown[0] = share
            left = (time.monotonic() - began) * (1.0 - share) / share
            say(f"log: {100 * share:.0f} % of {size / 1e6:.1f} MB, {left:.0f} s to go")

    with talk().status("fetching the log") as status:
        try:
            got = logs.fetch(out, before, coming)
        except CheckFailed as error:
            say(f"no log from the autopilot: {error}")
            return {"log": None, "why_no_log": str(error)}
    say(f"{got.path}: {got.size} bytes, CRC32 {got.crc}")
    return {"log": str(got.path), "sha256": got.sha256, "crc": got.crc}


def _usable(out: Path, found: dict[str, Any]) -> Path:
    """The autopilot's log where it can be read, else the telemetry."""
    from coaxlink.fly.logs import readable

    tlog = out / "flight.tlog"
    if not found.get("log"):
        return tlog
    path = Path(found["log"])
    if why := readable(path):
        say(f"{why}: the telemetry is used")
        return tlog
    return path


def _refine(path: Path, airframe: Path, rotor: Path | None, out: Path) -> None:
    from coaxlink.cli.refine import refine
    from coaxlink.errors import CheckFailed, InputError

    model, answer = out / "rotor_refined.toml", out / "refine.json"
    try:
        refine([path], airframe=airframe, rotor=rotor, out=model, json=answer)
    except (
        CheckFailed,
        InputError,
    ) as unjudged:  # the flight was flown and its log is here: that much was asked for
        say(str(unjudged))
