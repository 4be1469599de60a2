"""The same parameters over the same bad line: coaxlink, MAVSDK's parameter plugin, pymavlink's helper.

    python research/clients.py [--runs 8] [--json FILE]

Every client connects, sets the values by which two tables of the paper's X8 differ, and leaves. What is then
on board is read over a clean line. Each run has its own seed; a run is right when all values are on board.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import json
import multiprocessing
import os
import random
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from boards import px4_tables
from spoiled_line import Clean, relay

LOSSES = (0.0, 0.1, 0.2, 0.3)
LIMIT_S = 90.0


def by_coaxlink(port: int, values: dict[str, float]) -> None:
    """The session and parameter protocol that `upload` stands on, without its backup and read-back."""
    from coaxlink.mavlink import connect
    from coaxlink.mavlink.parameters import Parameters

    with connect(f"udpout:127.0.0.1:{port}", timeout_s=20.0) as session:
        parameters = Parameters(session)
        parameters.write_many([parameters.encode(name, value, 9) for name, value in values.items()])


def by_mavsdk(port: int, values: dict[str, float]) -> None:
    """mavsdk.Param.set_param_float, one after the other."""
    from mavsdk.mavsdk import Configuration, Mavsdk
    from mavsdk.plugins.param import Param

    mavsdk = Mavsdk(Configuration.create_manual(1, 191, True))
    mavsdk.add_any_connection(f"udpout://127.0.0.1:{port}")
    system = mavsdk.first_autopilot(timeout_s=20.0)
    if system is None:
        raise TimeoutError("no autopilot")
    param = Param(system)
    for name, value in values.items():
        param.set_param_float(name, value)


def by_pymavlink(port: int, values: dict[str, float]) -> None:
    """pymavlink's MAVParmDict.mavset, which takes any PARAM_VALUE of that name for success."""
    os.environ["MAVLINK20"] = "1"
    from pymavlink import mavparm, mavutil

    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=245, dialect="common")
    end = time.monotonic() + 20.0
    while link.target_system == 0:
        if time.monotonic() > end:
            raise TimeoutError("no autopilot")
        link.mav.heartbeat_send(6, 8, 0, 0, 4)
        link.recv_match(type="HEARTBEAT", blocking=True, timeout=1)
    store = mavparm.MAVParmDict()
    with contextlib.redirect_stdout(io.StringIO()):
        done = [store.mavset(link, name, value) for name, value in values.items()]
    if not all(done):
        raise RuntimeError(f"{done.count(False)} values without an answer")


CLIENTS: dict[str, Callable[[int, dict[str, float]], None]] = {
    "coaxlink": by_coaxlink,
    "mavsdk": by_mavsdk,
    "pymavlink": by_pymavlink,
}


def run_one(client: str, port: int, values: dict[str, float]) -> tuple[float, bool]:
    """(seconds, did it say it worked), in a process of its own that knows its libraries already."""
    started = time.monotonic()
    pid = os.fork()
    if pid == 0:
        code, quiet = 1, os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        with contextlib.suppress(BaseException):
            CLIENTS[client](port, values)
            code = 0
        os._exit(code)
    while time.monotonic() < started + LIMIT_S:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return time.monotonic() - started, os.waitstatus_to_exitcode(status) == 0
        time.sleep(0.005)
    os.kill(pid, 9)
    os.waitpid(pid, 0)
    return LIMIT_S, False


def main() -> None:
    """Run, print the table."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--runs", type=int, default=8)
    options.add_argument("--json", type=Path)
    args_ = options.parse_args()
    for module in ("coaxlink.mavlink.parameters", "mavsdk.plugins.param", "pymavlink.mavparm"):
        importlib.import_module(module)  # before the forks, so that no client pays for its start

    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        known = [bits for _, bits in px4_tables(Path(scratch))]
    names = [n for n in known[0] if known[0][n] != known[1][n]]
    print(f"{len(names)} values")
    print(*(f"{h:>10}" for h in ("loss", "client", "right", "said so", "median s", "max s")))
    for loss in LOSSES:
        for client in CLIENTS:
            got = series(client, loss, args_.runs, names, known)
            rows += got
            right, said = (sum(r[k] for r in got) for k in ("right", "said"))
            seconds = [r["seconds"] for r in got]
            cells = (f"{loss:.2f}", client, f"{right}/{len(got)}", f"{said}/{len(got)}")
            times = (f"{statistics.median(seconds):.2f}", f"{max(seconds):.2f}")
            print(*(f"{cell:>10}" for cell in (*cells, *times)), flush=True)
    if args_.json:
        args_.json.write_text(json.dumps(rows, indent=1))


def series(
    client: str, loss: float, runs: int, names: list[str], known: list[dict[str, bytes]]
) -> list[dict]:
    """Runs of one client against a stand-in of its own."""
    command = [sys.executable, "-m", "coaxlink", "sim", "--listen", "udpin:127.0.0.1:0"]
    vehicle = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    port = int(vehicle.stdout.readline().strip().rpartition(":")[2])
    clean, rows = Clean(("127.0.0.1", port)), []
    try:
        for run in range(runs):
            listen = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            listen.bind(("127.0.0.1", 0))
            seed = random.Random(f"{loss} {run}").randrange(2**31)
            spoiler = multiprocessing.Process(
                target=relay,
                args=(listen, ("127.0.0.1", port), multiprocessing.Value("d", loss), seed),
                daemon=True,
            )
            spoiler.start()
            bits = known[run % 2]
            values = {n: struct.unpack("<f", bits[n])[0] for n in names}
            seconds, said = run_one(client, listen.getsockname()[1], values)
            spoiler.kill()
            time.sleep(0.2)
            now = clean.table(names)
            right = all(now[n] == bits[n] for n in names)
            rows.append({"client": client, "loss": loss, "seconds": seconds, "said": said, "right": right})
    finally:
        vehicle.terminate()
        vehicle.wait(10)
    return rows


if __name__ == "__main__":
    main()
