"""Uploads over a line that loses, doubles, reorders, delays and corrupts, struck by kills and power cuts.

    python research/bad_line.py [--uploads 1000] [--small]

Tables go in turn to the stand-ins of both firmwares (ArduPilot: two of FRAME_CLASS 17, two of 15, so that
scripts come, go and change), in memory on a virtual clock. The upload's process may die at any moment; the
board may freeze, reboot, or lose its power, also just after a table was verified. Then it must hold one of
the tables whole, or a journal on disk must know of the mixture; the journal is resumed over the same bad
line, by the same table, another one, or its backup, until it is closed, and the board is looked at again. The
faults of the line are the tests' own (tests/helpers/memory_net.py), the board is looked at in its memory.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import io
import json
import os
import random
import statistics
import struct
import sys
import tempfile
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


def main() -> None:
    """Run, print the tables; exit 1 when something was wrong."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--uploads", type=int, default=1000, help="to each firmware")
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--small", action="store_true", help="four uploads to each firmware")
    asked = options.parse_args()
    uploads = 4 if asked.small else asked.uploads
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
    sys.exit(any(map(wrong, rows)))


if __name__ == "__main__":
    main()
