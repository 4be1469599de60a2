"""`coaxlink sim`: the world: a stand-in autopilot on a plant of its own, or a virtual thrust stand."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink import files
from coaxlink.absent import refuse_windows
from coaxlink.cli.shared.completion import one_of
from coaxlink.cli.shared.next import on_simulator
from coaxlink.cli.shared.shell import say
from coaxlink.errors import InputError, LinkError
from firmware_params import FIRMWARES

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from coaxlink.vehicle import Vehicle
    from sim.px4.coax_module import CoaxFirmware


def sim(
    firmware: Annotated[
        str,
        typer.Option(
            help="px4, px4:1.13, px4:MAJOR.MINOR.PATCH or ardupilot.",
            autocompletion=one_of(*FIRMWARES, "px4:1.13"),
        ),
    ] = "px4",
    airframe: Annotated[Path | None, typer.Option(help="The simulated vehicle.")] = None,
    rotor: Annotated[Path | None, typer.Option(help="Its rotors; else the airframe's.")] = None,
    truth: Annotated[Path | None, typer.Option(help="Effects and faults that are true here.")] = None,
    hidden_seed: Annotated[int | None, typer.Option(help="Draw one hidden effect from this seed.")] = None,
    truth_out: Annotated[Path | None, typer.Option(help="For a judge: write what is true here.")] = None,
    listen: Annotated[
        list[str] | None, typer.Option(help="udpin:HOST:PORT or tcpin:HOST:PORT; may be given again.")
    ] = None,
    speed: Annotated[float, typer.Option(help="Times real time; 0 is as fast as it goes.")] = 1.0,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="Wait for each set-point and live answer, as long as it takes.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of all noise.")] = 0,
    wire: Annotated[
        str, typer.Option(help="Faults: loss=P,copies=P,disorder=P,corruption=P,delay=S,dead=S:S,reboot=N.")
    ] = "",
    signing_key: Annotated[Path | None, typer.Option(help="Sign all links, take nothing unsigned.")] = None,
    memory: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Parameters and files that survive kill -9.")
    ] = None,
    uid: Annotated[str, typer.Option(metavar="HEX", help="The board's id, 0: none.")] = "",
    esc: Annotated[
        str, typer.Option(help="What ESCs report: measured, sitl (as the real simulations) or none.")
    ] = "measured",
    module: Annotated[
        bool,
        typer.Option(
            "--module", help="PX4: its firmware has the module of `bridge`; /etc/extras.txt starts it."
        ),
    ] = False,
    bridge: Annotated[str, typer.Option(help="The plant behind a real autopilot: px4, ardupilot.")] = "",
    pack: Annotated[
        bool,
        typer.Option("--pack", help="--bridge px4: tell it the plant's pack, as a smart battery would."),
    ] = False,
    flight: Annotated[
        str,
        typer.Option(
            "--fly",
            help="Fly without a client: what fly --plan flies (hover, circle, steps, identify, paper, "
            "PLAN.toml), and vigorous.",
        ),
    ] = "",
    log: Annotated[Path | None, typer.Option(metavar="OUT.csv", help="Keep the flight's log.")] = None,
    tlog: Annotated[
        Path | None, typer.Option(metavar="OUT.tlog", help="Keep its telemetry, not with --fly.")
    ] = None,
    truth_log: Annotated[
        Path | None, typer.Option(metavar="OUT.csv", help="With --fly: log the plant itself, for a judge.")
    ] = None,
    stand: Annotated[
        Path | None, typer.Option(metavar="OUT.csv", help="Run the virtual thrust stand and leave.")
    ] = None,
    schedule: Annotated[
        Path | None,
        typer.Option(metavar="PLAN.toml", help="With --stand: what to run, as refine --plan has it."),
    ] = None,
) -> None:
    """Fly a stand-in autopilot on a simulated vehicle, or measure a simulated rotor pair."""
    refuse_windows("sim")
    if not 0.0 <= speed < 1e6:
        raise InputError("--speed", "", f"a positive number, or 0, is expected, found {speed}")
    if truth is not None and hidden_seed is not None:
        raise InputError("--hidden-seed", "", "not with --truth")
    if flight and not firmware.startswith("px4"):
        raise InputError("--fly", "", "flies PX4's stand-in alone; others: --listen, and coaxlink fly")
    if memory is not None:
        files.refuse_unwritable(memory)
    if (log or tlog) and bridge:
        raise InputError("--log, --tlog", "", "not with --bridge")
    if pack and bridge != "px4":
        raise InputError("--pack", "", "goes with --bridge px4")
    if tlog and flight:
        raise InputError("--tlog", "", "not with --fly")
    with world_errors():
        if stand is not None:
            _measure(stand, rotor, truth, seed, schedule)
            return
        from sim.simulation import Simulation, build, build_bridge, open_links

        world = Simulation(
            airframe or files.example("x8_demo.toml"),
            rotor,
            firmware,
            truth,
            hidden_seed,
            truth_out,
            seed,
            wire,
            signing_key,
            lockstep,
            memory,
            uid,
            esc,
            _module(airframe or files.example("x8_demo.toml"), rotor, firmware) if module else None,
        )
        if flight:
            _alone(build(world, []).autopilot, flight, log, truth_log)
            return
        if bridge:
            tell = partial(_tell, bridge)
            _bridge(build_bridge(world, bridge, (listen or [""])[0], speed, tell, pack), bridge)
            return
        ports: list[Any] = open_links(listen or [])
        try:
            standin = build(world, ports, speed)
            _record(standin, log, tlog)
            ports = standin.ports
            _fly(standin.run, firmware, ports)
            if standin.recorder is not None:
                standin.recorder.close()
        finally:
            for port in ports:
                port.close()


def coax_firmware(vehicle: Vehicle) -> CoaxFirmware:
    """Python's law for the C++ one: what a board with the module of this vehicle runs. Raises InputError."""
    import numpy as np

    from coaxlink.live.onboard.description import board_law
    from coaxlink.mixer.shares import LeaningLaw
    from sim.px4.coax_module import CoaxFirmware

    about, law, frame = board_law(vehicle), LeaningLaw(vehicle), vehicle.airframe

    def speeds(roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        return law.speeds(about.wrench @ (roll, pitch, yaw, thrust))

    def delivered(u: NDArray[np.float64]) -> NDArray[np.float64]:
        return frame.wrench(*frame.loads(vehicle.model, u))[about.units.order] / about.units.scale

    def commands(u: NDArray[np.float64]) -> NDArray[np.float64]:
        if about.edge.straight:
            return u
        return np.clip(about.edge.commands(about.edge.nominals(u.tolist())), 0.0, 1.0)

    shares = np.column_stack([about.shares.share, about.shares.lean])
    own = about.shares.own
    return CoaxFirmware(about.identity, speeds, delivered, about.wrench, law.lean, shares, own, commands)


def _module(airframe: Path, rotor: Path | None, firmware: str) -> Any:
    from coaxlink.vehicle import load_vehicle

    if not firmware.startswith("px4"):
        raise InputError("--module", "", f"--firmware px4 is expected, found {firmware}")
    # a map is what the rotors are; what the board was built with is in the vehicle's own file
    is_map = rotor is not None and rotor.suffix.lower() == ".csv"
    return coax_firmware(load_vehicle(airframe, None if is_map else rotor))


def _measure(out: Path, rotor: Path | None, truth: Path | None, seed: int, schedule: Path | None) -> None:
    from sim.physics.rotors import read_pair
    from sim.stand.effects import StandSetup, measure, read_bench
    from sim.stand.grid import stand_rows, write_stand
    from sim.stand.schedule import read_schedule

    pair = read_pair(rotor or files.example("rotor_paper.toml"))
    if truth is None and schedule is None:
        rows = stand_rows(pair, seed=seed)
        write_stand(out, rows)
    else:
        import numpy as np

        bench = StandSetup() if truth is None else read_bench(truth)
        steps = None if schedule is None else read_schedule(schedule)
        columns = measure(pair, bench, seed=seed, schedule=steps)
        rows = np.column_stack(list(columns.values()))
        write_stand(out, rows, list(columns))
    say(f"{out}: {len(rows)} points")


def _alone(autopilot: Any, plan: str, log: Path | None, truth_log: Path | None) -> None:
    from coaxlink.fly.plans import NAMED
    from sim.flights import PLANS, fly, write_flight
    from sim.line.truthlog import TruthLog

    if plan.endswith(".toml"):
        from sim.manoeuvres import read_plan

        PLANS[plan] = read_plan(Path(plan))
    if plan not in PLANS:
        PLANS[plan] = named_plan(plan, (*NAMED, "vigorous"))
    true = TruthLog()
    flown = fly(autopilot, plan, true.watch if truth_log is not None else None)
    if truth_log is not None:
        write_flight(truth_log, true.columns())
        say(f"{truth_log}: the plant itself")
    seconds = autopilot.plant.time_s
    if log is not None:
        write_flight(log, flown)
        say(f"{log}: {len(flown['time_s'])} rows, {seconds:.0f} s of flight")


def named_plan(plan: str, names: Sequence[str]) -> tuple[Callable[[float], Any], float]:
    """A plan of `coaxlink fly` at its usual size, as the simulator follows it. Raises InputError."""
    from coaxlink.fly.plans import HEIGHT_M, REACH_M, plan_of
    from sim.px4.cascade import Goal

    if plan not in names:
        raise InputError("--fly", "", f"a plan file or one of {', '.join(names)} is expected, found '{plan}'")
    flown = plan_of(plan, HEIGHT_M, REACH_M)

    def follow(t: float) -> Goal:
        at = flown.at(t)[1]
        return Goal(at.position_m, at.velocity_m_s, at.acceleration_m_s2, at.yaw_rad)

    return follow, flown.duration_s


def _record(standin: Any, log: Path | None, tlog: Path | None) -> None:
    from sim.recorder import CsvRecorder, TlogPort

    if log is not None:
        standin.recorder = CsvRecorder(standin.autopilot, log)
    if tlog is not None:
        standin.ports.append(TlogPort(standin.autopilot, tlog))


def _tell(to: str, text: str) -> None:
    say(f"bridge {to}: {text}")


def _bridge(bridge: Any, to: str) -> None:
    try:
        _fly(bridge.run, f"bridge {to}", [bridge])
    finally:
        bridge.close()


def _fly(run: Callable[[Callable[[], bool]], None], firmware: str, ports: Any) -> None:
    """Until someone says stop."""
    stopping = False

    def stop(*_: object) -> None:
        nonlocal stopping
        stopping = True

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        sys.stdout.write(f"ready {firmware} {' '.join(port.name for port in ports)}\n")
        sys.stdout.flush()
        if not firmware.startswith("bridge"):
            say(on_simulator(firmware, ", ".join(port.name for port in ports)))
        run(lambda: stopping)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def world_errors() -> Iterator[None]:
    """The world's errors as coaxlink's."""
    from sim.errors import PortError, SimulationError

    try:
        yield
    except SimulationError as error:
        raise InputError(error.source, error.where, error.problem) from error
    except PortError as error:
        raise LinkError(error.address, error.problem) from error
