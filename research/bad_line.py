"""Uploads over a line that loses, doubles, reorders, delays and corrupts, struck by kills and power cuts.

    python research/bad_line.py [--uploads 1000] [--clients 8] [--small]

Tables go in turn to the stand-ins of both firmwares (ArduPilot: two of FRAME_CLASS 17, two of 15, so that
scripts come, go and change), in memory on a virtual clock. The upload's process may die at any moment; the
board may freeze, reboot, or lose its power, also just after a table was verified. Then it must hold one of
the tables whole, or a journal on disk must know of the mixture; the journal is resumed over the same bad
line, by the same table, another one, or its backup, until it is closed, and the board is looked at again. The
faults of the line are the tests' own (tests/helpers/memory_net.py), the board is looked at in its memory.

With `--clients` the 17 values by which two tables differ go over a real, equally bad UDP line by coaxlink's
session, MAVSDK's parameter plugin and pymavlink's helper, and are read back over a clean one.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import io
import json
import multiprocessing
import os
import random
import select
import socket
import statistics
import struct
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any
from unittest import mock

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "helpers")]
LOSSES = (0.0, 0.05, 0.1, 0.2, 0.3)
COPIES, DISORDER, CORRUPTION = 0.02, 0.05, 0.005
FATES = {"none": 0.50, "kill": 0.25, "freeze": 0.08, "reboot": 0.07, "power": 0.10}
SCRIPTS = ("coaxlink_matrix.lua", "coaxlink_loader.lua")
TABLES = {
    "px4": [("reduced",), ("standard",)],
    "ardupilot": [(law, "--frame-class", c) for c in ("17", "15") for law in ("reduced", "standard")],
}


class Killed(BaseException):
    """As SIGKILL: nothing of the upload runs after it, and nothing is sent."""


def make_tables(firmware: str, folder: Path) -> list[Path]:
    """Folders as the verb writes them."""
    from coaxlink.cli import main

    made = []
    for law, *more in TABLES[firmware]:
        made.append(folder / "-".join((firmware, law, *more[1:])))
        options = ["--firmware", firmware, "--law", law, *more, "--out", str(made[-1])]
        quiet = io.StringIO()
        with (
            contextlib.suppress(SystemExit),
            contextlib.redirect_stdout(quiet),
            contextlib.redirect_stderr(quiet),
        ):
            main(["table", str(ROOT / "examples" / "x8_paper.toml"), *options])
    return made


class Bench:
    """One stand-in, its line, and what befalls it."""

    def __init__(self, firmware: str, folder: Path, tables: list[Path], seed: int) -> None:
        from memory_net import Net, Standin

        from coaxlink.uploading.plan import load_plan

        self.firmware, self.folder, self.draw = firmware, folder, random.Random(seed)
        self.net = Net(seed=seed)
        self._start = lambda **where: Standin(self.net, firmware, memory=folder / "memory.json", **where)
        self.board = self._start()
        self._pulled = object()
        self.net.clock.sleep(1.0)
        plans = {table.name: load_plan(table) for table in tables}
        self.wholes = {name: self._of_plan(plan) for name, plan in plans.items()}
        keys = {key for held in self.wholes.values() for key in held}
        first = self.held(keys)
        self.wholes["initial"] = {k: v for k, v in first.items() if v is not None or "/" in k}

    def _of_plan(self, plan: Any) -> dict[str, bytes | None]:
        """SCR_LD_CHECKSUM is the board's, of all scripts that are there."""
        values = {n: struct.pack("<f", v) for n, v in plan.params.items() if n != "SCR_LD_CHECKSUM"}
        if self.firmware == "px4":
            return values
        return values | {f"scripts/{name}": plan.scripts.get(name) for name in SCRIPTS}

    def held(self, keys: Any) -> dict[str, bytes | None]:
        """Bits of parameters and files, as the board has them in its memory; None for what is not there."""
        values, files = self.board.autopilot.store.memory(), self.board.autopilot.files.files
        found = {k: None if k not in values else struct.pack("<f", values[k]) for k in keys if "/" not in k}
        return found | {k: bytes(files[k]) if k in files else None for k in keys if "/" in k}

    def look(self) -> str:
        """The name of the table on board, "mixture" for none."""
        self.net.clock.sleep(0.5)  # what is still under way arrives
        whole = (n for n, held in self.wholes.items() if self.held(held) == held)
        return next(whole, "mixture")

    def cut(self, seconds: float) -> None:
        """Pull its plug, and put it in again; one that is still out stays out until the last of them."""
        self.board.close()
        pulled = self._pulled = object()

        def on() -> None:
            if self._pulled is pulled:  # or two boards would live on one memory
                self.board = self._start(address=self.board.address)

        self.net.clock.later(seconds, on)

    def strike(self, what: str) -> None:
        """In the middle of whatever is waited for."""
        if what == "kill":
            raise Killed
        if what == "freeze":
            self.board.freeze(self.draw.uniform(0.3, 4.0))
        elif what == "power":
            self.cut(self.draw.uniform(0.0, 2.0))
        elif what == "reboot":
            self.board.reboot()

    def upload(self, source: Path, what: str = "none", usual_s: float = 2.0) -> dict[str, Any]:
        """Upload a folder or restore a file; `what` befalls it, mostly while it writes."""
        from memory_net import meet

        from coaxlink.errors import CoaxlinkError
        from coaxlink.uploading.backup import read_backup
        from coaxlink.uploading.journal import Journal
        from coaxlink.uploading.plan import load_plan
        from coaxlink.uploading.worker import Uploader

        begin, clock, struck = Journal.begin, self.net.clock, []

        def strike() -> None:
            if not struck and not over:
                struck.append(what)
                self.strike(what)

        def begun(journal: Journal, entry: Any) -> None:
            begin(journal, entry)
            clock.later(self.draw.uniform(0.0, 0.15 * usual_s + self.net.loss), strike)

        over: list[bool] = []
        if what != "none" and self.draw.random() < 0.4:
            clock.later(self.draw.uniform(0.2, 1.2 * usual_s), strike)
        try:
            with (
                mock.patch.object(Journal, "begin", begun if what != "none" else begin),
                meet(self.board, timeout_s=20.0) as session,
            ):
                send = session.send

                def alive(message: Any) -> None:
                    if "kill" in struck:
                        raise Killed
                    send(message)

                session.send = alive
                worker = Uploader(session, backup_folder=self.folder / "backups", reboot_s=2.5)
                if source.is_dir():
                    return worker.upload(load_plan(source), spin_from_table=True).to_json()
                return worker.restore(read_backup(source)).to_json()
        except Killed:
            return {"result": "killed", "retries": 0}
        except CoaxlinkError as error:
            return {"result": "failed", "retries": 0, "reason": str(error)}
        finally:
            over.append(True)


def series(firmware: str, losses: list[float], tables: list[Path], seed: int) -> list[dict[str, Any]]:
    """One upload for each of `losses` to one stand-in; a row each."""
    rows, took = [], collections.defaultdict(lambda: [2.0])
    with tempfile.TemporaryDirectory() as scratch, contextlib.redirect_stderr(io.StringIO()):
        folder = Path(scratch)
        os.environ["COAXLINK_STATE"] = str(folder / "state")
        bench = Bench(firmware, folder, tables, seed)
        draw, net = bench.draw, bench.net
        for i, loss in enumerate(losses):
            net.loss, bad = loss, loss > 0
            net.copies, net.disorder = COPIES * bad, DISORDER * bad
            net.corruption, net.delay_s = CORRUPTION * bad, 0.002
            source, what = tables[i % len(tables)], draw.choices(*zip(*FATES.items(), strict=True))[0]
            began = net.clock.now
            outcome = bench.upload(source, what, statistics.median(took[loss][-20:]))
            seconds = net.clock.now - began
            if what == "none":
                took[loss].append(seconds)
            state, ways, after = bench.look(), 0, ""
            journal = next((folder / "state").glob("*.journal.json"), None)
            while journal is not None and journal.exists() and ways < 5:
                other = tables[(i + 1) % len(tables)]
                back = draw.choice((source, other, Path(json.loads(journal.read_text())["backup"])))
                bench.upload(back)
                ways += 1
            if ways:
                after = "open" if journal.exists() else bench.look()
            elif outcome["result"] == "verified" and draw.random() < 0.15:
                bench.cut(0.0)
                net.clock.sleep(0.1)
                after = bench.look()
            row = {"firmware": firmware, "loss": loss, "fate": what, "wanted": source.name, "state": state}
            row |= {"journal": journal is not None, "resumed": ways, "after": after, "seconds": seconds}
            rows.append(row | {key: outcome.get(key, "") for key in ("result", "retries", "reason")})
    return rows


def wrong(row: dict[str, Any]) -> str:
    """What must never be, in words; empty when all is well."""
    if row["result"] == "verified" and row["state"] != row["wanted"]:
        return "verified, but the board holds something else"
    if row["result"] == "rolled_back" and row["state"] == "mixture":
        return "rolled back to a mixture"
    if row["state"] == "mixture" and not row["journal"]:
        return "a mixture that nobody knows of"
    if not row["resumed"] and row["after"] not in ("", row["wanted"]):
        return "verified, and lost in a power cut"
    if row["resumed"] and row["after"] in ("mixture", "open"):
        return f"a resumed journal that ended with the board: {row['after']}"
    return ""


def report(rows: list[dict[str, Any]]) -> None:
    """The table of losses and kills."""
    results = ("verified", "rolled_back", "failed", "killed")
    heads = ("firmware", "loss", "uploads", *results, "journal open", "mixtures", "resumed", "cut after")
    print(*(f"{h:>12}" for h in (*heads, "wrong", "median s", "p95 s")))
    for firmware, loss in sorted({(r["firmware"], r["loss"]) for r in rows}):
        some = [r for r in rows if (r["firmware"], r["loss"]) == (firmware, loss)]
        count = collections.Counter(r["result"] for r in some)
        calm = sorted(r["seconds"] for r in some if r["fate"] == "none" and r["result"] == "verified")
        cells = [firmware, f"{loss:.2f}", len(some), *(count[k] for k in results)]
        cells += [sum(r["journal"] for r in some), sum(r["state"] == "mixture" for r in some)]
        cells += [sum(r["resumed"] > 0 for r in some)]
        cells += [sum(not r["resumed"] and r["after"] != "" for r in some), sum(bool(wrong(r)) for r in some)]
        if calm:
            cells += [f"{statistics.median(calm):.2f}", f"{calm[int(0.95 * (len(calm) - 1))]:.2f}"]
        print(*(f"{cell:>12}" for cell in cells))
    for row in filter(wrong, rows):
        print("WRONG", wrong(row), row)


# -- three clients on a real line --------------------------------------------------------------------------


def relay(listen: socket.socket, port: int, loss: float, seed: int) -> None:
    """Carry datagrams both ways with the faults of above."""
    draw, out, peer, late = random.Random(seed), socket.socket(socket.AF_INET, socket.SOCK_DGRAM), None, []
    while True:
        now = time.monotonic()
        for row in [r for r in late if r[0] <= now]:
            late.remove(row)
            with contextlib.suppress(OSError):
                row[1].sendto(row[2], row[3])
        wait = min([r[0] for r in late], default=now + 0.2) - now
        for ready in select.select([listen, out], [], [], max(wait, 0.0))[0]:
            data, source = ready.recvfrom(65536)
            peer = source if ready is listen else peer
            there = (out, ("127.0.0.1", port)) if ready is listen else (listen, peer)
            if draw.random() < loss:
                continue
            if loss and draw.random() < CORRUPTION:
                at = draw.randrange(len(data))
                data = data[:at] + bytes([data[at] ^ (1 << draw.randrange(8))]) + data[at + 1 :]
            for _ in range(2 if loss and draw.random() < COPIES else 1):
                slow = 0.06 * draw.random() if loss and draw.random() < DISORDER else 0.0
                late.append((time.monotonic() + 0.002 + slow, there[0], data, there[1]))


def by_coaxlink(port: int, values: dict[str, float]) -> None:
    """The parameter protocol that `upload` stands on, without its backup and read-back."""
    from coaxlink.mavlink import connect
    from coaxlink.mavlink.parameters import Parameters

    with connect(f"udpout:127.0.0.1:{port}", timeout_s=20.0) as session:
        parameters = Parameters(session)
        parameters.write_many([parameters.encode(name, value, 9) for name, value in values.items()])


def by_mavsdk(port: int, values: dict[str, float]) -> None:
    """mavsdk.Param.set_param_float, one after the other."""
    from mavsdk.logging import log_subscribe
    from mavsdk.mavsdk import Configuration, Mavsdk
    from mavsdk.plugins.param import Param

    log_subscribe(lambda *_: True)
    sdk = Mavsdk(Configuration.create_manual(1, 191, True))
    sdk.add_any_connection(f"udpout://127.0.0.1:{port}")
    param = Param(sdk.first_autopilot(timeout_s=20.0))
    for name, value in values.items():
        param.set_param_float(name, value)


def by_pymavlink(port: int, values: dict[str, float]) -> None:
    """pymavlink's MAVParmDict.mavset, which takes any PARAM_VALUE of that name for success."""
    os.environ["MAVLINK20"] = "1"
    from pymavlink import mavparm, mavutil

    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=245, dialect="common")
    while link.target_system == 0:
        link.mav.heartbeat_send(6, 8, 0, 0, 4)
        link.recv_match(type="HEARTBEAT", blocking=True, timeout=1)
    store = mavparm.MAVParmDict()
    done = [store.mavset(link, name, value) for name, value in values.items()]
    if not all(done):
        raise TimeoutError("values without an answer")


def compare_clients(tables: list[Path], losses: tuple[float, ...], runs: int) -> None:
    """Right on board of so many runs, and the median seconds, connecting included."""
    from coaxlink.mavlink import connect
    from coaxlink.mavlink.parameters import Parameters
    from coaxlink.uploading.plan import load_plan
    from sim.testing import standin

    first, second = (load_plan(table).params for table in tables)
    values = [{n: float(t[n]) for n in first if first[n] != second[n]} for t in (first, second)]
    context = multiprocessing.get_context("fork")
    print(f"{len(values[0])} values; right on board, median s")
    for loss in losses:
        for client in (by_coaxlink, by_mavsdk, by_pymavlink):
            right, took = 0, []
            with standin() as port, connect(f"udpout:127.0.0.1:{port}") as clean:
                for run in range(runs):
                    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
                        line.bind(("127.0.0.1", 0))
                        spoiler = context.Process(target=relay, args=(line, port, loss, run), daemon=True)
                        spoiler.start()
                        there = line.getsockname()[1]
                        one = context.Process(target=client, args=(there, values[run % 2]), daemon=True)
                        began = time.monotonic()
                        one.start()
                        one.join(90.0)
                        took.append(time.monotonic() - began)
                        one.kill()
                        spoiler.kill()
                    now = Parameters(clean).read_many(values[0])
                    right += all(now[n].bits == struct.pack("<f", v) for n, v in values[run % 2].items())
            name = client.__name__.removeprefix("by_")
            print(f"{loss:>6.2f} {name:>10} {right}/{runs} {statistics.median(took):8.2f}", flush=True)


def main() -> None:
    """Run, print the tables; exit 1 when something was wrong."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--uploads", type=int, default=1000, help="to each firmware")
    options.add_argument("--clients", type=int, default=0, metavar="RUNS", help="runs a client and loss")
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--small", action="store_true", help="four uploads to each firmware")
    asked = options.parse_args()
    uploads, clients = (4, 0) if asked.small else (asked.uploads, asked.clients)
    with tempfile.TemporaryDirectory() as scratch, ProcessPoolExecutor(asked.workers) as pool:
        tables = {firmware: make_tables(firmware, Path(scratch)) for firmware in TABLES}
        share = max(uploads // asked.workers, 1)
        jobs = [
            pool.submit(series, f, [LOSSES[k % len(LOSSES)] for k in range(share)], tables[f], n)
            for f in TABLES
            for n in range(asked.workers)
        ]
        rows = [row for job in jobs for row in job.result()]
        report(rows)
        if clients:
            compare_clients(tables["px4"], LOSSES, clients)
    sys.exit(any(map(wrong, rows)))


if __name__ == "__main__":
    main()
