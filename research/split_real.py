"""`fly --plan split` on the real ArduCopter and PX4, in worlds of raw stand maps: found, and true there.

    ARDUCOPTER_SITL=.../arducopter PX4_MODULE_SITL=.../bin/px4 python research/split_real.py KEEP
        [--only mn4014_16in_zD055] [--ways ardupilot module] [--flights 2] [--minutes 6] [--reach 0.12]
        [--share 0.51] [--calm] [--abort]

KEEP gets a folder a map: `rotor.toml`, `x8.toml`, and `coax_px4`, the module of that vehicle; where the
binary of PX4 is of another vehicle its flights are refused, and say so. The world is that of
`research/split_flown.py` (its gusts, windings, pack and power module), behind the firmware's own simulation
interface and looked at by a recorder at the plant; at real time, in the real-time class. Every flight but
the first has those before in `--after`. Then `identify`, `refine` and `health` of its logs. `--share` puts
the table of that share on board of ArduCopter first. With `--abort` the pilot takes every flight over by a
mode change, once the split has been far from that on board for FAR_S: seconds until it is back, height lost.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink import mavutil
from split_flown import HERE, TRUTH, Found, Simulation, judged, logs, prepared, show
from table_worth_real import settings

from coaxlink.live.onboard.description import board_law
from coaxlink.mavlink import connect
from coaxlink.studies.simulator import free_port
from coaxlink.vehicle import load_vehicle
from sim.physics.plant import Plant
from sim.simulation import Simulation as SimWorld
from sim.simulation import build_bridge
from sim.truth import Truth
from sim.vehicle import LOWER

sys.path.insert(0, str(HERE.parent / "tests" / "real"))
from real_autopilots import Px4, arducopter, free_instance, real_time
from test_real_ardupilot import FACTORY

EVERY_S = 0.02  # between two looks at the plant
FAR, NEAR, FAR_S = 0.05, 0.01, 5.0  # of the share, from that on board
LOST_S = 1.0  # in which the height is looked at: a landing sinks by less than that
HOLD, BRAKE = (1, 4, 3, 0, 0, 0, 0), (1, 17, 0, 0, 0, 0, 0)  # base mode, PX4's Hold; ArduCopter's Brake
PATIENCE_S = 240.0  # wall time until an estimator has settled


class Watched(Truth):
    """A world that keeps a row of its plant: s, share from above, W of the rotors, m high, wall s. Sets `far`
    once the share has been far for FAR_S from what it was when first in the air for as long."""

    def __init__(self, truth: Truth, gusts: int, far: Any) -> None:
        super().__init__(truth.effects, gusts)
        self.rows: list[tuple[float, ...]] = []
        self._last_s, self._far = -1.0, far
        self._air_s, self._board, self._since_s = math.inf, math.nan, math.inf

    def act(self, plant: Plant) -> None:
        super().act(plant)
        if plant.time_s < self._last_s:  # it restarted
            self.rows.clear()
            self._last_s = -1.0
        if plant.time_s - self._last_s >= EVERY_S:
            self._last_s = plant.time_s
            upper = np.asarray(plant.vehicle.level) != LOWER
            share = plant.thrust[upper].sum() / max(plant.thrust.sum(), 1e-9)
            watts = float(plant.rotor_watts().sum())
            self.rows.append((plant.time_s, float(share), watts, plant.height, time.monotonic()))
            self._look(plant.time_s, float(share), plant.height)

    def _look(self, now: float, share: float, height: float) -> None:
        if height < 2.0:
            self._air_s = now
        elif now - self._air_s < FAR_S:
            self._board = share if math.isnan(self._board) else self._board + 0.02 * (share - self._board)
        elif abs(share - self._board) < FAR:
            self._since_s = now
        elif now - self._since_s > FAR_S:
            self._far.set()


def _world(to: str, world: SimWorld, address: str, gusts: int, over: Any, far: Any, pipe: Any) -> None:
    """The plant's process: serve the firmware until `over`, then give the rows."""
    bridge = build_bridge(world, to, address, 1.0, battery=True)
    bridge.truth = truth = Watched(bridge.truth, gusts, far)
    pipe.send(int(bridge.name.rpartition(":")[2]))
    try:
        bridge.run(over.is_set)
    finally:
        bridge.close()
    pipe.send((np.array(truth.rows), bridge.status()))


class Served:
    """The world as a process; `port` while it runs, `rows` and `status` after."""

    def __init__(self, to: str, world: SimWorld, address: str, gusts: int) -> None:
        self._of = (to, world, address, gusts)
        self.rows: NDArray[np.float64] = np.empty((0, 5))
        self.status = ""
        self._context = multiprocessing.get_context("spawn")
        self.far = self._context.Event()

    def __enter__(self) -> int:
        context = self._context
        self._over = context.Event()
        self._pipe, theirs = context.Pipe()
        words = (*self._of, self._over, self.far, theirs)
        self._process = context.Process(target=_world, args=words, daemon=True)
        self._process.start()
        return int(self._pipe.recv())

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self.rows, self.status = self._pipe.recv()
        self._process.join(10.0)


def verb(*words: Any, timeout_s: float = 1500.0) -> tuple[int, str]:
    """`coaxlink` as a process of its own: its exit code and what it said."""
    command = [sys.executable, "-m", "coaxlink", *map(str, words)]
    environment = os.environ | {"PYTHONPATH": str(HERE.parent)}
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment, timeout=timeout_s, check=False
    )
    return done.returncode, done.stdout + done.stderr


@contextmanager
def ardupilot(frame: Path, folder: Path, served: Any, share: float | None) -> Iterator[str]:
    """ArduCopter with the bridge's script, and with the table of a share."""
    params = FACTORY | {"BATT_MONITOR": 4.0, "BATT_CAPACITY": 20000.0, "FS_GCS_ENABLE": 0.0}
    made = [("bridge", frame)]
    if share is not None:
        made.append(("table", frame, "--firmware", "ardupilot", "--share", share))
    binary, pilot = Path(os.environ["ARDUCOPTER_SITL"]), free_port()
    served.pilot = f"udpin:127.0.0.1:{pilot}"
    with arducopter(binary, folder, params, speed=1.0, world=served, second_port=pilot) as url:
        for words in made:
            files = folder / words[0]
            told(*words, "--out", files)
            told("upload", files, "--connect", url, "--yes", "--reboot", "--timeout", 60)
        yield url


def told(*words: Any) -> str:
    """What a verb says that must hold. Raises RuntimeError."""
    code, said = verb(*words)
    if code:
        raise RuntimeError(f"{words[0]}: exit {code}: {said.strip()[-400:]}")
    return said


@contextmanager
def module(frame: Path, folder: Path, served: Any, share: float | None) -> Iterator[str]:
    """PX4 with the module of this very vehicle."""
    instance = int(served.instance)
    board = Px4(Path(os.environ["PX4_MODULE_SITL"]), folder, instance)
    params = settings(frame, "module", stock=False) | {"SIM_BAT_ENABLE": 0.0, "COM_FLTT_LOW_ACT": 1.0}
    served.pilot = f"udpout:127.0.0.1:{18570 + instance}"
    with served, board.boot(params, cut=True) as url:
        with connect(url, timeout_s=90.0):
            board.start_module(board_law(load_vehicle(frame)).hover)
        yield url


def aborted(served: Any, words: list[Any]) -> None:
    """The verb, and a pilot who takes over while the split is far; leaves when in `served.taken_s`."""
    link: Any = mavutil.mavlink_connection(served.pilot, source_system=250)
    done = threading.Event()

    def pilot() -> None:
        while not done.is_set() and not served.far.wait(0.2):
            link.mav.heartbeat_send(6, 8, 0, 0, 4)
            while link.recv_msg() is not None:
                pass
        served.taken_s = time.monotonic()
        mode = HOLD if served.pilot.startswith("udpout") else BRAKE
        for _ in range(3):
            link.mav.command_long_send(link.target_system or served.instance + 1, 1, 176, 0, *mode)
            time.sleep(0.05)

    thread = threading.Thread(target=pilot)
    thread.start()
    try:
        _, served.said = verb(*words)
        time.sleep(2.0)
    finally:
        done.set()
        thread.join()
        link.close()


def ended(name: str, served: Any) -> None:
    """What the rows of an aborted flight say."""
    if not served.far.is_set():
        raise RuntimeError(f"never far from the split on board: {served.said[-300:]}")
    wall, share, height = served.rows[:, 4], served.rows[:, 1], served.rows[:, 3]
    after = wall >= served.taken_s
    air = np.argmax(height > 2.0)
    board = float(np.median(share[air : air + int(FAR_S / EVERY_S)]))
    far = np.abs(share - board) > NEAR
    until = served.taken_s + 3.0
    last = wall[after & far & (wall < until)]
    back = float(last[-1] - served.taken_s) if len(last) else 0.0
    moved = height[after & (wall < served.taken_s + back + LOST_S)] - height[after][0]
    ending = served.said.strip().splitlines()[-1]
    print(
        f"{name}: share {share[after][0]:.3f}, {board:.3f} on board; back {back:.2f} s after the pilot's "
        f"word; height {moved.min():+.2f} to {moved.max():+.2f} m until {LOST_S:g} s after: {ending}",
        flush=True,
    )


def flown(way: str, path: Path, frame: Path, folder: Path, number: int, o: Any, after: list[Path]) -> Any:
    """One flight by the verb: its JSON and the plant's rows. Raises RuntimeError."""
    folder.mkdir()
    truth = folder / "truth.toml"
    truth.write_text("" if o.calm else TRUTH)
    world = SimWorld(frame, rotor=path, truth=truth, seed=number)
    instance = free_instance()
    to, address = ("px4", f"tcpin:127.0.0.1:{4560 + instance}") if way == "module" else (way, "")
    served = Served(to, world, address or "udpin:127.0.0.1:0", number)
    served.instance = instance  # type: ignore[attr-defined]
    out = folder / "fly.json"
    words: list[Any] = ["fly", "--plan", "split", "--airframe", frame, "--minutes", o.minutes]
    words += ["--split-reach", o.reach, "--battery", 0.1, "--timeout", 60]
    words += [word for path in after for word in ("--after", path)]
    board = ardupilot if way == "ardupilot" else module
    place = Path(tempfile.mkdtemp(dir=folder))
    with real_time(), board(frame, place, served, o.share) as url:
        end, code, said = time.monotonic() + PATIENCE_S, 4, ""
        while code == 4 and time.monotonic() < end:
            code, said = verb(*words, "--connect", url, "--dry-run")
        if code == 0 and o.abort:
            aborted(served, [*words, "--connect", url, "--yes", "--no-log", "--out", folder / "log"])
        elif code == 0:
            code, said = verb(*words, "--connect", url, "--yes", "--out", folder / "log", "--json", out)
    if o.abort:
        return {}, served
    (folder / "said.txt").write_text(said)
    if code:
        raise RuntimeError(f"exit {code}: {said.strip()[-400:]}")
    np.savetxt(folder / "plant.csv", served.rows, delimiter=",")
    sys.stdout.write(f"    {said.strip()}\n    {served.status}\n")
    return json.loads(out.read_text()), served.rows


def true_shares(found: dict[str, Any], rows: NDArray[np.float64]) -> list[list[float]]:
    """The level of every dwell, and the plant's share in it; the plan's start is where both agree best."""
    dwells = np.array([row[:3] for row in found["split"]["dwell_rows"]])
    offsets = np.arange(rows[0, 0], rows[-1, 0] - dwells[-1, 0], 0.2)
    means = np.array([[_mean(rows, t + middle) for middle in dwells[:, 0]] for t in offsets])
    spread = means.std(axis=1)
    agree = [
        np.corrcoef(m, dwells[:, 2])[0, 1] if s > 0.005 else -1.0 for m, s in zip(means, spread, strict=True)
    ]
    best = int(np.argmax(agree))
    return [[level, float(share)] for level, share in zip(dwells[:, 2], means[best], strict=True)]


def _mean(rows: NDArray[np.float64], middle: float) -> float:
    low, high = np.searchsorted(rows[:, 0], [middle - 3.0, middle + 3.0])
    return float(rows[low:high, 1].mean()) if high > low else 0.0


def walk(way: str, path: Path, keep: Path, o: Any) -> None:
    """All flights of a map by one way."""
    folder = keep / path.stem
    folder.mkdir(exist_ok=True)
    frame = prepared(path, folder)
    if not (folder / "coax_px4").exists():
        verb("bridge", frame, "--firmware", "px4", "--out", folder / "coax_px4")
    levels, after = [], []
    for number in range(o.flights):
        found = Found(f"{path.stem} {way} flight {number + 1}")
        place = folder / f"{way}_{'abort' if o.abort else o.share or 'board'}_{number}"
        try:
            answer, rows = flown(way, path, frame, place, number, o, after)
            if o.abort:
                ended(found.name, rows)
                continue
            if "share" not in answer["split"]:
                raise RuntimeError(answer["split"]["why"])
            levels += true_shares(answer, rows)
            after.append(place / "fly.json")
            judged(found, answer["split"], np.array(levels), Simulation(path, frame, place / "truth.toml"))
            found.logs = logs(place / "log", frame)
        except RuntimeError as error:
            found.problem = str(error)
        show(found)


def main() -> int:
    """As the module says."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("keep", type=Path)
    parser.add_argument("--maps", type=Path, default=HERE.parents[1] / "shared" / "data" / "coax")
    parser.add_argument("--only", nargs="+", default=["mn4014_16in_zD055"])
    parser.add_argument("--ways", nargs="+", choices=["ardupilot", "module"], default=["ardupilot", "module"])
    parser.add_argument("--flights", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=6.0)
    parser.add_argument("--reach", type=float, default=0.12)
    parser.add_argument("--share", type=float, help="ardupilot: the table of this share is on board")
    parser.add_argument("--calm", action="store_true", help="a world without any of those effects")
    parser.add_argument("--abort", action="store_true", help="the pilot takes over; how soon, how high")
    o = parser.parse_args()
    needed = {"ardupilot": "ARDUCOPTER_SITL", "module": "PX4_MODULE_SITL"}
    for way in o.ways:
        if not Path(os.environ.get(needed[way], "")).is_file():
            sys.stderr.write(f"nothing to fly {way}: {needed[way]} names the SITL binary\n")
            return 2
    o.keep.mkdir(parents=True, exist_ok=True)
    for stem in o.only:
        for way in o.ways:
            walk(way, o.maps / f"{stem}.csv", o.keep, o)
    return 0


if __name__ == "__main__":
    sys.exit(main())
