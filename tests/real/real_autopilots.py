"""Start a real autopilot's own simulation binary behind `coaxlink sim --bridge`, on loopback.

Nothing of theirs is here: the binary is named by PX4_SITL or ARDUCOPTER_SITL; PX4's start-up scripts are
looked for beside it, in ../etc.
"""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from losing_world import Loss, losing_bridge
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as m

from coaxlink.errors import CheckFailed, CoaxlinkError
from coaxlink.fly.commands import Commander
from coaxlink.fly.trajectory import FlightPlan, Hold, table_4_flight
from coaxlink.mavlink import connect
from coaxlink.mavlink.parameters import Parameters
from coaxlink.mavlink.session import Session
from coaxlink.studies.simulator import free_port
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.worker import Uploader

ROOT = Path(__file__).parents[2]
AIRFRAME = ROOT / "examples" / "x8_demo.toml"
PAIRS = ((0, 5), (1, 4), (2, 7), (3, 6))  # upper, lower
LOOP_HZ = 800  # of its simulation: at least 1.8 times its own loop


@contextmanager
def bridge(to: str, *options: str, port: int = 0) -> Iterator[int]:
    """`coaxlink sim --bridge` as a process of its own; yields its port."""
    kind = "tcpin" if to == "px4" else "udpin"
    command = [sys.executable, "-m", "coaxlink", "sim", "--bridge", to, *options]
    command += ["--listen", f"{kind}:127.0.0.1:{port}"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        assert process.stdout is not None
        ready = process.stdout.readline()
        assert ready.startswith("ready"), ready
        yield int(ready.strip().rpartition(":")[2])
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=600)


@contextmanager
def real_time() -> Iterator[None]:
    """What starts in here goes before other processes: a companion has 20 ms of wall time, come what may."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(5))
    except PermissionError as error:
        raise CheckFailed(
            "no real-time class for us: on a machine with other work answers come late"
        ) from error
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class Px4:
    """PX4's SITL in `folder`, behind a bridge; `boot` starts it, again and again if need be."""

    def __init__(self, binary: Path, folder: Path, instance: int) -> None:
        self.binary, self.folder, self.instance = binary, folder, instance
        self.address = f"udpin:127.0.0.1:{14540 + instance}"

    @contextmanager
    def boot(self, params: Mapping[str, float] | None = None, *, cut: bool = False) -> Iterator[str]:
        """One power-up, `params` set before it starts; yields the companion link's address.

        With `cut` it ends as when the plug is pulled: SIGKILL.
        """
        etc = self.binary.resolve().parent.parent / "etc"
        clean = {k: v for k, v in os.environ.items() if not k.startswith("PX4_")}
        preset = {f"PX4_PARAM_{name}": repr(value) for name, value in (params or {}).items()}
        command = [str(self.binary), "-d", "-i", str(self.instance), "-w", str(self.folder), str(etc)]
        with _running(command, self.folder, clean | preset | {"PX4_SYS_AUTOSTART": "10016"}, cut):
            yield self.address

    def shell(self, *words: str) -> str:
        """What its console answers to a command; asserts that the command held."""
        command = [str(self.binary.parent / f"px4-{words[0]}"), "--instance", str(self.instance), *words[1:]]
        done = subprocess.run(command, capture_output=True, text=True, cwd=self.folder, timeout=60)
        assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
        return done.stdout

    def extras(self) -> str:
        """What its console answers to the card's `extras.txt`, which a board runs at boot."""
        script = f". {self.binary.parent}/px4-alias.sh {self.instance}\n. fs/microsd/etc/extras.txt\n"
        environment = os.environ | {"PATH": f"{self.binary.parent}:{os.environ['PATH']}"}
        command = ["bash", "-O", "expand_aliases", "-c", script]
        done = subprocess.run(
            command, capture_output=True, text=True, cwd=self.folder, env=environment, timeout=60
        )
        return done.stdout + done.stderr

    def start_module(self, hover: float) -> None:
        """As `extras.txt` does on a board."""
        self.shell("control_allocator", "stop")
        self.shell("coax_mixer", "start")
        self.shell("param", "set", "MPC_THR_HOVER", f"{hover:g}")


@contextmanager
def px4(
    binary: Path, folder: Path, *options: str, loss: Loss | None = None, speed: float = 1.0
) -> Iterator[Px4]:
    """A PX4 that is ready to boot; `options` are the bridge's, or `speed` where something is lost."""
    instance = free_instance()
    port = 4560 + instance
    with losing_bridge("px4", AIRFRAME, loss, speed, port) if loss else bridge("px4", *options, port=port):
        yield Px4(binary, folder, instance)


def free_instance() -> int:
    """An instance number of PX4 whose ports nobody has (from 9 on they share a companion's port)."""
    for instance in random.sample(range(1, 9), 8):
        try:
            for kind, port in (
                (socket.SOCK_STREAM, 4560 + instance),
                (socket.SOCK_DGRAM, 14540 + instance),
                (socket.SOCK_DGRAM, 14580 + instance),
                (socket.SOCK_DGRAM, 18570 + instance),
            ):
                with socket.socket(socket.AF_INET, kind) as probe:
                    probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        return instance
    raise AssertionError("no PX4 instance is free on this machine")


@contextmanager
def arducopter(
    binary: Path,
    folder: Path,
    params: Mapping[str, float],
    *options: str,
    speed: float = 3.0,
    port: int = 0,
    second_port: int = 0,
    cut: bool = False,
    loss: Loss | None = None,
    world: AbstractContextManager[int] | None = None,
) -> Iterator[str]:
    """ArduCopter's SITL in `folder` on the JSON bridge; yields its first serial port's address.

    A reboot it does by itself, in the same process. `options` are the bridge's. It speaks to `port` of
    loopback or one that is free, and on `second_port` too, if there is one. With `cut` it ends as when the
    plug is pulled: SIGKILL. `world` is one of the caller's in place of the bridge, and yields its port.
    """
    defaults = folder / "defaults.parm"
    defaults.write_text("".join(f"{name} {value:.9g}\n" for name, value in params.items()))
    link = port or free_port()
    of = world or (losing_bridge("ardupilot", AIRFRAME, loss) if loss else bridge("ardupilot", *options))
    with of as sim_port:
        command = [str(binary), "--model", "JSON:127.0.0.1", "--sim-port-out", str(sim_port)]
        command += ["--speedup", str(speed), "--rate", str(LOOP_HZ), "--defaults", str(defaults)]
        command += ["--home", "47.397742,8.545594,488,0", "--serial0", f"udpclient:127.0.0.1:{link}"]
        second = f"udpclient:127.0.0.1:{second_port}" if second_port else "none"
        command += ["--serial1", "none", "--serial2", second]
        with _running(command, folder, dict(os.environ), cut):
            yield f"udpin:127.0.0.1:{link}"


@contextmanager
def _running(
    command: list[str], folder: Path, environment: dict[str, str], cut: bool = False
) -> Iterator[None]:
    with (folder / "autopilot.log").open("a") as talk:
        process = subprocess.Popen(
            command,
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=talk,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            yield
        finally:
            os.killpg(process.pid, signal.SIGKILL if cut else signal.SIGTERM)
            try:
                process.wait(60.0)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def coaxlink(*arguments: str, cwd: Path = ROOT, fails: bool = False) -> subprocess.CompletedProcess[str]:
    """The verb as a user types it."""
    command = [sys.executable, "-m", "coaxlink", *arguments]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment, timeout=120)
    assert fails or done.returncode == 0, done.stderr
    return done


def take_off(session: Session) -> Commander:
    """Arm and climb to 3 m as soon as the vehicle lets us."""
    vehicle, end = Commander(session), time.monotonic() + 600.0
    while True:
        try:
            vehicle.arm()
            vehicle.take_off(3.0)
            return vehicle
        except CoaxlinkError as error:  # its estimator has not settled yet
            assert time.monotonic() < end, error
            time.sleep(0.5)


def fly_the_factory_table(url: str, tables: Path) -> float:
    """Take off, be refused an upload in the air, fly the paper's circle, land; its rms distance (m)."""
    with connect(url, timeout_s=60.0) as session:
        take_off(session)
    refused = coaxlink("upload", str(tables), "--connect", url, "--yes", fails=True)
    assert refused.returncode == 4 and "armed" in refused.stderr
    with connect(url, timeout_s=60.0) as session:
        vehicle = Commander(session)
        track = vehicle.follow(table_4_flight())
        vehicle.land()
    far = np.linalg.norm(np.array(track.wanted_m) - np.array(track.flown_m), axis=1)
    return float(np.sqrt((far**2).mean()))


def upload(url: str, tables: Path, folder: Path) -> dict[str, Any]:
    """The verb, which must verify; its JSON."""
    out = folder / "up.json"
    coaxlink("upload", str(tables), "--connect", url, "--yes", "--json", str(out), cwd=folder)
    written: dict[str, Any] = json.loads(out.read_text())
    assert written["result"] == "verified"
    return written


def held_to_mix(done: NDArray[np.float64], mix: NDArray[np.float64], pure: NDArray[np.float64]) -> None:
    """Each motor (N,) within half a percent of what some control (4,) makes of `mix` (N, 4), and the split of
    each coaxial pair of that of `pure` (N,), the motors in pure thrust."""
    control = np.linalg.lstsq(mix, done, rcond=None)[0]
    assert done == pytest.approx(mix @ control, rel=0.005)
    for upper, lower in PAIRS:
        assert done[lower] / done[upper] == pytest.approx(pure[lower] / pure[upper], rel=0.005)


def hover(session: Session, vehicle: Commander, seconds: float = 20.0) -> NDArray[np.float64]:
    """Pulse widths (rows, 8) of a hover at 3 m, from SERVO_OUTPUT_RAW; lands."""
    position = (0.0, 0.0, -3.0)
    assert session.request_stream(m.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, 50.0)
    vehicle.follow(FlightPlan((Hold("settle", position, 8.0),)))
    with session.listen(("SERVO_OUTPUT_RAW",)) as heard:
        vehicle.follow(FlightPlan((Hold("hover", position, seconds),)))
        rows = []
        while (message := session.take(heard, 0.0)) is not None:
            rows.append([getattr(message, f"servo{n}_raw") for n in range(1, 9)])
    vehicle.land()
    assert len(rows) > 100
    return np.array(rows, float)


class Pulled(Exception):
    """The plug was pulled: nothing is sent any more."""


def cut_upload(url: str, tables: Path, folder: Path, after: int) -> None:
    """Upload until so many writes, of parameters or files, have gone out; raises Pulled then.

    Nothing is put back: the caller kills the board.
    """
    with connect(url, timeout_s=60.0) as session:
        send, left = session.send, [after]

        def until_pulled(message: Any) -> None:
            writes = _writes(message)
            if writes and left[0] <= 0:
                raise Pulled
            left[0] -= writes
            send(message)

        session.send = until_pulled  # type: ignore[method-assign]
        outcome = Uploader(session, backup_folder=folder / "backups").upload(load_plan(tables))
    raise AssertionError(f"the upload ended before its write {after}: {outcome}")


def _writes(message: Any) -> bool:
    if message.get_type() == "FILE_TRANSFER_PROTOCOL":
        return message.payload[3] in (6, 7, 8, 13)  # create, write, remove, rename
    command = message.get_type() == "COMMAND_LONG" and message.command in (245, 246)  # save, restart
    return bool(command or message.get_type() == "PARAM_SET")


def undo(url: str, backup: str, folder: Path, *options: str) -> dict[str, Any]:
    """`coaxlink restore`, which must verify; its JSON."""
    out = folder / "back.json"
    coaxlink("restore", backup, "--connect", url, "--yes", "--json", str(out), *options, cwd=folder)
    answer: dict[str, Any] = json.loads(out.read_text())
    assert answer["result"] == "verified"
    return answer


def verified(url: str, tables: Path, folder: Path) -> dict[str, Any]:
    """`coaxlink verify`, which must hold; its JSON."""
    out = folder / "verify.json"
    coaxlink("verify", str(tables), "--connect", url, "--json", str(out))
    answer: dict[str, Any] = json.loads(out.read_text())
    return answer


def held(url: str, names: Iterable[str]) -> dict[str, float]:
    """What the board holds under these names."""
    with connect(url, timeout_s=60.0) as session:
        found = Parameters(session).read_many(names, missing_ok=True)
    return {name: float(value.value) for name, value in found.items()}
