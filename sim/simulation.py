"""Put a world together from files and options."""

from __future__ import annotations

import contextlib
import hashlib
import string
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from firmware_params import bounded
from sim.documents import write_atomic
from sim.errors import SimulationError
from sim.line.links import Port, open_port
from sim.line.memory import Memory
from sim.line.wire import Clock, parse_faults
from sim.physics.escs import KINDS, MEASURED
from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.px4.coax_module import CoaxFirmware
from sim.standin import Standin
from sim.truth import Truth, hidden_truth, read_truth, truth_text
from sim.vehicle import SimVehicle, read_vehicle, refuse_body

CURRENT = (1, 16, 1)
OLDEST = (1, 13)  # before it there are no CA_ parameters
NEW_TABLE, NEW_ROTORS, OLD_ROTORS = (1, 14, 0), 12, 8  # CA_ROTOR_COUNT at the most
LAST_PATCH = {(1, 13): 3, (1, 14): 4, (1, 15): 4, (1, 16): 1}
# where PX4's own simulation sends: a ground station and a companion
SITL = ("udpout:127.0.0.1:14550", "udpout:127.0.0.1:14540")


KEY_FILE = 4096  # bytes; a passphrase is shorter
LEAST_LEVER_M = 1e-3  # of the rotors about an axis: no multirotor flies on less
UID_BITS = 96  # an STM32's
SCRIPTS_START_S = 2.0  # of an ArduPilot's start; it speaks again 1.5 s after a reboot


@dataclass(frozen=True)
class Simulation:
    """Everything that decides a world."""

    airframe: Path
    rotor: Path | None = None  # else the airframe's own
    firmware: str = "px4"
    truth: Path | None = None
    hidden_seed: int | None = None
    truth_out: Path | None = None
    seed: int = 0
    wire: str = ""  # faults, as `wire.parse_faults` reads them
    signing_key: Path | None = None
    lockstep: bool = False
    memory: Path | None = None  # what survives a power cut
    uid: str = ""  # of the board, hex
    escs: str = MEASURED  # what they tell, of `escs.KINDS`
    module: CoaxFirmware | None = None  # PX4: built into the firmware, started by the card's extras.txt


def open_links(addresses: Sequence[str]) -> list[Port]:
    """The ports to listen on, or PX4's own two. Raises WorldError, PortError; then none stays open."""
    ports: list[Port] = []
    try:
        for address in addresses or SITL:
            ports.append(open_port(address))
    except Exception:
        for port in ports:
            port.close()
        raise
    return ports


def build(
    simulation: Simulation,
    ports: Sequence[Port],
    speed: float = 1.0,
    clock: Clock = time.monotonic,
) -> Standin:
    """A stand-in ready to run. Raises WorldError."""
    from sim.px4.autopilot import Autopilot
    from sim.px4.logger import UlogLogger

    ardupilot = simulation.firmware.partition(":")[0] == "ardupilot"
    version = CURRENT if ardupilot else firmware_version(simulation.firmware)
    faults = parse_faults(simulation.wire) if simulation.wire else None
    uid = read_uid(simulation.uid) if simulation.uid else Autopilot.uid
    plant, truth = build_plant(simulation)
    _refuse_frame(simulation, plant.vehicle, ardupilot, version)
    common: dict[str, Any] = {"speed": speed, "faults": faults, "seed": simulation.seed, "clock": clock}
    common["lockstep"] = simulation.lockstep
    common["key"] = None if simulation.signing_key is None else read_key(simulation.signing_key)
    if ardupilot:
        from sim.ardupilot.copter import Copter
        from sim.ardupilot.logger import DataFlashLogger
        from sim.ardupilot.protocol import ApConversation

        copter = Copter(plant, truth, version=version, seed=simulation.seed)
        copter.scripts_start_s = SCRIPTS_START_S
        DataFlashLogger(copter)
        copter.uid = uid
        copter.escs = _escs(simulation.escs)
        common["memory"] = _memory(simulation.memory, copter, clock, lazy=False)
        return Standin(copter, ports, manners=ApConversation, **common)
    autopilot = Autopilot(plant, truth, version=version, seed=simulation.seed)
    UlogLogger(autopilot)
    autopilot.uid = uid
    autopilot.escs = _escs(simulation.escs)
    autopilot.firmware_module = simulation.module
    autopilot.files.make("etc")
    common["memory"] = _memory(simulation.memory, autopilot, clock, lazy=True)
    return Standin(autopilot, ports, **common)


def _refuse_frame(
    simulation: Simulation, vehicle: SimVehicle, ardupilot: bool, version: tuple[int, int, int]
) -> None:
    """Raises WorldError for rotors that the firmware has no frame for."""
    if ardupilot:
        from sim.ardupilot.frame import own_frame, why_none

        if own_frame(vehicle) is None:
            raise SimulationError(simulation.airframe, "rotors", why_none(vehicle))
        return
    most = NEW_ROTORS if version >= NEW_TABLE else OLD_ROTORS
    if vehicle.rotors > most:
        name = ".".join(map(str, version))
        raise SimulationError(
            simulation.airframe, "rotors", f"PX4 {name} holds {most}, found {vehicle.rotors}"
        )


def _memory(path: Path | None, autopilot: Any, clock: Clock, *, lazy: bool) -> Memory | None:
    """What it knew before its power was cut. Raises WorldError."""
    if path is None:
        return None
    memory = Memory(path, autopilot, lazy=lazy, clock=clock)
    memory.load()
    return memory


def read_uid(text: str) -> int:
    """A board's id: 1 to 24 hex digits, 0 for a board that has none. Raises WorldError."""
    most = UID_BITS // 4
    if not 1 <= len(text) <= most or not set(text) <= set(string.hexdigits):
        raise SimulationError("--uid", "", f"1 to {most} hex digits are expected, found {text!r}")
    return int(text, 16)


def _escs(kind: str) -> str:
    if kind not in KINDS:
        raise SimulationError("--esc", "", f"one of {', '.join(KINDS)} is expected, found '{kind}'")
    return kind


def read_key(path: Path) -> bytes:
    """A signing key: 32 bytes, 64 hex digits, or a passphrase (its SHA-256). Raises WorldError."""
    try:
        data = bounded.read_bytes(path, KEY_FILE)
    except OSError as error:
        raise SimulationError(path, "", f"cannot be read ({error.strerror})") from error
    except bounded.Unreadable as error:
        raise SimulationError(path, error.where, error.problem) from error
    text = data.strip()
    if len(data) == 32:
        return data
    if len(text) == 64:
        with contextlib.suppress(ValueError):
            return bytes.fromhex(text.decode("ascii", "replace"))
    if not text:
        raise SimulationError(path, "", "a signing key is expected, found nothing")
    return hashlib.sha256(text).digest()


def build_plant(simulation: Simulation) -> tuple[Plant, Truth]:
    """The vehicle, and what is true of it. Raises WorldError."""
    vehicle = read_vehicle(simulation.airframe)
    rotor = simulation.rotor or vehicle.rotor_file
    if rotor is None:
        raise SimulationError(simulation.airframe, "rotor_model", "a rotor file is expected")
    pair = read_pair(rotor)
    _refuse_what_cannot_fly(simulation.airframe, vehicle, rotor, pair)
    truth = Truth()
    if simulation.truth is not None:
        truth = read_truth(simulation.truth)
        grown = {n: sum(e.size for e in truth.effects if e.name == n) for n in ("mass_change", "rotor_lag")}
        mass, lag = vehicle.mass_kg + grown["mass_change"], vehicle.motor_lag_s + grown["rotor_lag"]
        refuse_body(simulation.truth, mass, lag)
    elif simulation.hidden_seed is not None:
        truth = hidden_truth(simulation.hidden_seed, vehicle.rotors)
    if simulation.truth_out is not None:
        write_atomic(simulation.truth_out, truth_text(truth))
    return Plant(vehicle, pair), truth


def _refuse_what_cannot_fly(airframe: Path, vehicle: SimVehicle, rotor: Path, pair: Any) -> None:
    """Raises WorldError for rotors on one point or one line, and for those that turn by themselves."""
    levers = np.cross(vehicle.position_m, vehicle.axis)[:, :2]
    if np.linalg.matrix_rank(np.column_stack([vehicle.axis[:, 2], levers]), tol=LEAST_LEVER_M) < 3:
        problem = "rotors on one point or one line make no roll or no pitch; metres are expected"
        raise SimulationError(airframe, "rotors.position_m", problem)
    torques = {"upper": pair.loads(1.0, 0.0)[1]}
    if (vehicle.partner >= 0).any():
        torques["lower"] = pair.loads(1.0, 1.0)[3]
    for name, torque in torques.items():
        if not torque > 0.0:
            problem = f"more than 0 N m turns a rotor at full speed, found {torque:.4g} N m"
            raise SimulationError(rotor, f"{name}.torque_Nm", problem)


def build_bridge(
    simulation: Simulation,
    to: str,
    address: str = "",
    speed: float = 0.0,
    say: Callable[[str], None] = lambda _: None,
    battery: bool = False,
) -> Any:
    """A bridge ready to run: `to` is px4 or ardupilot. Raises WorldError, PortError.

    `battery`: PX4 hears of the plant's pack, as ArduPilot always does. `speed` is times real time, 0 as fast
    as it goes; an ArduPilot sets its own pace (its --speedup). `say` takes a line when lock-step was left, a
    link ended, and the counts at the end.
    """
    kinds = {"px4": ("tcpin", 4560), "ardupilot": ("udpin", 9002)}
    if to not in kinds:
        raise SimulationError("--bridge", "", f"px4 or ardupilot is expected, found '{to}'")
    kind, usual = kinds[to]
    given, _, rest = (address or f"{kind}:127.0.0.1:{usual}").partition(":")
    host, _, port = rest.rpartition(":")
    if given != kind or not host or not port.isdecimal() or int(port) > 65535:
        raise SimulationError("--listen", address, f"{kind}:HOST:PORT is expected for a bridge to {to}")
    plant, truth = build_plant(simulation)
    if to == "px4":
        from sim.bridge.px4_hil import Px4Bridge

        return Px4Bridge(
            plant,
            truth,
            host=host,
            port=int(port),
            seed=simulation.seed,
            speed=speed,
            battery=battery,
            say=say,
        )
    from sim.bridge.ardupilot_json import ArduPilotBridge

    return ArduPilotBridge(plant, truth, host=host, port=int(port), say=say)


def firmware_version(firmware: str) -> tuple[int, int, int]:
    """(major, minor, patch) of `px4`, `px4:1.13` or `px4:1.14.3`. Raises WorldError."""
    name, _, wanted = firmware.partition(":")
    if name != "px4":
        raise SimulationError(
            "--firmware", "", f"px4, px4:VERSION or ardupilot is expected, found '{firmware}'"
        )
    if not wanted:
        return CURRENT
    parts = wanted.split(".")
    if not 2 <= len(parts) <= 3 or not all(part.isdecimal() and int(part) < 256 for part in parts):
        raise SimulationError("--firmware", "", f"a version such as 1.13 is expected, found '{wanted}'")
    numbers = [int(part) for part in parts]
    major, minor = numbers[:2]
    if (major, minor) < OLDEST:
        raise SimulationError("--firmware", "", f"PX4 1.13 or later is expected, found '{wanted}'")
    return major, minor, numbers[2] if len(numbers) == 3 else LAST_PATCH.get((major, minor), 0)
