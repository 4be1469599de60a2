"""Who else is on a line of the real PX4 and ArduCopter: two vehicles, a busy machine, a station that writes.

VERIFIES and LOAD say how often `verify` is asked, beside how many busy processes on its own core (200 and 20
are issue 61's).
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path

import pytest
from pymavlink import mavutil
from real_autopilots import AIRFRAME, Px4, arducopter, coaxlink, held, px4
from test_real_ardupilot import FACTORY
from test_real_px4 import factory

from coaxlink.errors import LinkError
from coaxlink.mavlink import connect
from coaxlink.studies.simulator import free_port
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.verify import verify

BINARIES = {"px4": os.environ.get("PX4_SITL", ""), "ardupilot": os.environ.get("ARDUCOPTER_SITL", "")}
VERIFIES, LOAD = int(os.environ.get("VERIFIES", "10")), int(os.environ.get("LOAD", "0"))
WRITTEN = {"px4": "CA_ROTOR2_CT", "ardupilot": "MOT_THST_EXPO"}
pytestmark = pytest.mark.timeout(3600)
firmwares = pytest.mark.parametrize(
    "firmware",
    [
        pytest.param(name, marks=pytest.mark.skipif(not path, reason=f"no {name} binary is named"))
        for name, path in BINARIES.items()
    ],
)


@contextmanager
def board(
    firmware: str, folder: Path, second_port: int, system: int = 1, port: int = 0
) -> Iterator[tuple[str, int]]:
    """One of either firmware on the ground: its line and its number, PX4's being that of its instance. It
    speaks to `port` or one of its own, and to `second_port`."""
    home = folder / f"{firmware}{system}"
    home.mkdir()
    with ExitStack() as stack:
        if firmware == "ardupilot":
            who = {"MAV_SYSID": system, "SYSID_THISMAV": system}  # its name until 4.6
            kind = {"speed": 1.0, "port": port, "second_port": second_port}
            world = ("--airframe", str(AIRFRAME))
            yield (
                stack.enter_context(
                    arducopter(Path(BINARIES[firmware]), home, FACTORY | who, *world, **kind)
                ),
                system,
            )
            return
        world = ("--airframe", str(AIRFRAME), "--speed", "1")
        one: Px4 = stack.enter_context(px4(Path(BINARIES[firmware]), home, *world))
        url = stack.enter_context(one.boot(factory(home / "standard"), cut=True))
        with connect(url, timeout_s=60.0):
            pass
        for to in filter(None, (port, second_port)):
            link = ("-x", "-u", str(free_port()), "-o", str(to), "-r", "4000000", "-m", "onboard")
            one.shell("mavlink", "start", *link)
        yield f"udpin:127.0.0.1:{port}" if port else url, one.instance + 1


def tables_for(firmware: str, folder: Path) -> Path:
    tables = folder / "tables"
    coaxlink("table", str(AIRFRAME), "--firmware", firmware, "--out", str(tables))
    return tables


@firmwares
def test_two_vehicles_on_one_line_are_listed_and_one_is_named(firmware: str, tmp_path: Path) -> None:
    port = free_port()
    tables, line = tables_for(firmware, tmp_path), f"udpin:127.0.0.1:{port}"
    own = [free_port(), free_port()]
    with ExitStack() as stack:
        boards = [stack.enter_context(board(firmware, tmp_path, own[n - 1], n, port)) for n in (1, 2)]
        first, second = (str(system) for _, system in boards)
        probes = {name: held(f"udpin:127.0.0.1:{own[0]}", [name]) for name in (WRITTEN[firmware],)}
        verbs = {
            "upload": (str(tables), "--yes"), "verify": (str(tables),),
            "mix": (str(AIRFRAME), "--dry-run", "--seconds", "1"),
            "fly": ("--dry-run", "--battery", "0"), "init": (str(tmp_path / "i.toml"), "--mass", "20"),
        }  # fmt: skip
        for verb, words in verbs.items():
            done = coaxlink(verb, *words, "--connect", line, cwd=tmp_path, fails=True)
            sys.stdout.write(f"\n{verb}: exit {done.returncode}: {done.stderr.strip()}")
            assert done.returncode == 4, verb
            assert (
                all(f"system {n} " in done.stderr for n in (first, second)) and "--system" in done.stderr
            ), verb
        done = coaxlink("upload", str(tables), "--yes", "--connect", line, "--system", second, cwd=tmp_path)
        sys.stdout.write(f"\n{done.stdout}{done.stderr}")
        assert f"system {second}" in done.stderr + done.stdout
        done = coaxlink("verify", str(tables), "--connect", line, "--system", second, cwd=tmp_path)
        assert f"system {second}" in done.stderr + done.stdout
        other = coaxlink(
            "verify", str(tables), "--connect", line, "--system", first, cwd=tmp_path, fails=True
        )
        assert other.returncode == 1
        for name, before in probes.items():
            assert held(f"udpin:127.0.0.1:{own[0]}", [name]) == before


def _busy() -> None:
    while True:
        pass


@contextmanager
def crowded() -> Iterator[None]:
    """This process, what it starts and LOAD others on one core."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    others = [multiprocessing.get_context("fork").Process(target=_busy, daemon=True) for _ in range(LOAD)]
    for one in others:
        one.start()
    try:
        yield
    finally:
        for one in others:
            one.kill()
        os.sched_setaffinity(0, before)


@firmwares
def test_verify_never_fails_a_good_board(firmware: str, tmp_path: Path) -> None:
    tables = tables_for(firmware, tmp_path)
    began: list[float] = []
    with board(firmware, tmp_path, 0) as (url, _):
        coaxlink("upload", str(tables), "--yes", "--connect", url, cwd=tmp_path)
        plan, wrong, silent = load_plan(tables), [], []
        for pid in _ours():
            os.sched_setaffinity(pid, {min(os.sched_getaffinity(0))})
        with crowded():
            for _ in range(VERIFIES):
                began.append(time.monotonic())
                try:
                    with connect(url, timeout_s=60.0, station=True) as session:
                        found = verify(session, plan)
                    if found.mismatches or found.interrupted:
                        wrong.append(str(found.mismatches))
                except LinkError as error:  # silence is called silence
                    silent.append(str(error))
    took = [b - a for a, b in pairwise(began)]
    sys.stdout.write(
        f"\n{firmware}: {len(began)} times beside {LOAD}, {len(wrong)} false: {wrong[:3]}, "
        f"{len(silent)} called silent: {silent[:3]}; "
        f"{max(took):.1f} s at most"
    )
    assert not wrong


def _ours() -> Iterator[int]:
    """Processes under this one."""
    children: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            pid, rest = int(stat.parent.name), stat.read_text().rpartition(")")[2].split()
        except (OSError, ValueError):
            continue
        children.setdefault(int(rest[1]), []).append(pid)
    waiting = [os.getpid()]
    while waiting:
        for pid in children.get(waiting.pop(), []):
            waiting.append(pid)
            yield pid


@firmwares
def test_a_station_that_writes_on_is_named(firmware: str, tmp_path: Path) -> None:
    """Another station on another link sets one value of the table every 20 ms once the upload has written it:
    never "verified", and never "rolled back" over its value."""
    tables, port, over = tables_for(firmware, tmp_path), free_port(), threading.Event()
    name, out, theirs = WRITTEN[firmware], tmp_path / "up.json", 0.12 if firmware == "ardupilot" else 11.0
    wanted = float(load_plan(tables).params[name])
    with board(firmware, tmp_path, port) as (url, _):
        thread = threading.Thread(target=_write_on, args=(port, name, wanted, theirs, over))
        thread.start()
        try:
            done = coaxlink(
                "upload", str(tables), "--yes", "--connect", url, "--json", str(out), cwd=tmp_path, fails=True
            )
        finally:
            over.set()
            thread.join()
        found = json.loads(out.read_text())
        now = held(url, [name])[name]
    sys.stdout.write(f"\n{firmware}: exit {done.returncode}, {found['result']}, {name} {now}: {done.stderr}")
    assert done.returncode != 0
    assert "system 250" in done.stderr or "another station" in done.stderr
    assert found["result"] == ("failed" if now == pytest.approx(theirs) else "rolled_back")


def _write_on(port: int, name: str, wanted: float, theirs: float, over: threading.Event) -> None:
    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=250)
    link.wait_heartbeat(timeout=60)
    kind, written = mavutil.mavlink.MAV_PARAM_TYPE_REAL32, False
    while not over.wait(0.02):
        to = link.target_system, link.target_component
        while (heard := link.recv_msg()) is not None:  # also follows it to another port
            if heard.get_type() == "PARAM_VALUE" and heard.param_id == name:
                written = written or abs(heard.param_value - wanted) < 1e-4 * abs(wanted)
        if written:
            link.mav.param_set_send(*to, name.encode(), theirs, kind)
        else:
            link.mav.param_request_read_send(*to, name.encode(), -1)
    link.close()
