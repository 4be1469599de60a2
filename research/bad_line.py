"""Uploads to the stand-in over a line that loses, doubles, reorders, delays and corrupts, with kills.

    python research/bad_line.py [--firmware px4|ardupilot] [--uploads 1000] [--workers 6] [--keep FILE]

Each worker has a stand-in (`coaxlink sim --memory`), a relay process that spoils the line, and uploads tables
in turn (ArduPilot: two of FRAME_CLASS 17, two of 15, so that scripts come, go and change), each from a
process of its own that may be killed with SIGKILL; the stand-in may freeze, reboot, or be killed and started
again, at any time and just after a table was verified. After every upload the board is read over a clean line
by a reader of its own: parameters, and on ArduPilot the scripts' checksums. It must hold one of the tables
whole, or the mixture must be known: a journal on disk. Then the journal is resumed over the same bad line, by
an upload of the same table, of another one, or by restoring its backup, until it is closed, and the board is
read again. The faults of the line are drawn here, not by the product's simulator.

SIGTERM ends it with a table of what there is; with `--keep`, the next call goes on from there.
"""

from __future__ import annotations

import argparse
import collections
import json
import multiprocessing
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from boards import ROOT, Standin, ardupilot_tables, fate, px4_tables

LOSSES = (0.0, 0.05, 0.1, 0.2, 0.3)


def upload_in_a_child(url: str, source: Path, folder: Path, result: Path) -> int:
    """Fork; the child uploads a table, or restores a backup (a file), and leaves its JSON."""
    pid = os.fork()
    if pid:
        return pid
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    code = 70
    try:
        from coaxlink.mavlink import connect
        from coaxlink.uploading.backup import read_backup
        from coaxlink.uploading.plan import load_plan
        from coaxlink.uploading.worker import Uploader

        with connect(url, timeout_s=20.0) as session:
            worker = Uploader(session, backup_folder=folder / "backups", reboot_s=2.5)
            if source.is_dir():
                outcome = worker.upload(load_plan(source))
            else:
                outcome = worker.restore(read_backup(source))
        result.write_text(json.dumps(outcome.to_json()))
        code = 0
    except BaseException as error:
        result.write_text(json.dumps({"result": "failed", "reason": repr(error), "retries": 0}))
    finally:
        os._exit(code)


def worker(
    number: int, firmware: str, losses: list[float], known: list, folder: Path, rows: multiprocessing.Queue
) -> None:
    """One upload for each of `losses`."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that the stand-in ends with us
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["COAXLINK_STATE"] = str(folder / "state")
    import coaxlink.uploading.worker  # noqa: F401 - once, before the forks

    draw = random.Random(f"{number} {len(losses)}")
    board = Standin(firmware, folder, draw.randrange(2**31))
    try:
        series(draw, losses, board, known, folder, rows)
        rows.put(None)
    finally:
        board.close()


class Looker:
    """Says which table the board holds, by a reader of its own over a clean line."""

    def __init__(self, board: Standin, known: list) -> None:
        self._board = board
        keys = sorted({key for _, held in known for key in held})
        self._names, self._paths = [k for k in keys if "/" not in k], [k for k in keys if "/" in k]
        first = board.clean.board(self._names, self._paths)
        # a backup of the first state does not speak of the loader's parameters, which are not there then
        initial = {k: v for k, v in first.items() if v is not None or "/" in k}
        self._wholes = {source.name: held for source, held in known} | {"initial": initial}

    def look(self) -> tuple[str, dict[str, list[str]]]:
        """The name of the table on board; for a mixture, by what it differs from each."""
        time.sleep(0.15)  # what is still under way arrives
        now = self._board.clean.board(self._names, self._paths)
        off = {n: [k for k, v in w.items() if now[k] != v] for n, w in self._wholes.items()}
        one_table = next((n for n, keys in off.items() if not keys), None)
        return (one_table, {}) if one_table else ("mixture", {n: keys[:6] for n, keys in off.items()})


def series(draw, losses, board, known, folder, rows) -> None:
    """Uploads in turn to one stand-in."""
    looker = Looker(board, known)
    took = collections.defaultdict(lambda: [2.0])
    for i, loss in enumerate(losses):
        board.lose(loss)
        source, _ = known[i % len(known)]
        started = time.monotonic()
        what, outcome = strike(draw, board, source, folder, statistics.median(took[loss][-20:]), loss)
        seconds = time.monotonic() - started
        if what == "none":
            took[loss].append(seconds)
        state, off = looker.look()
        journal = next(Path(os.environ["COAXLINK_STATE"]).glob("*.journal.json"), None)
        ways = []
        while journal is not None and journal.exists() and len(ways) < 5:
            way = draw.choice((source, known[(i + 1) % len(known)][0], None))
            back = way or Path(json.loads(journal.read_text())["backup"])
            again = upload_in_a_child(board.url, back, folder, folder / "resumed.json")
            assert _wait(again, time.monotonic() + 240.0), "a resumed upload hangs"
            ways.append(back.name)
        after = ""
        if ways:
            after, off = ("open", {}) if journal.exists() else looker.look()
        elif outcome["result"] == "verified" and draw.random() < 0.15:
            board.cut(0.0)
            after, off = looker.look()
        rows.put(
            {
                "loss": loss,
                "fate": what,
                "result": outcome["result"],
                "wanted": source.name,
                "state": state,
                "journal": journal is not None,
                "resumed": len(ways),
                "ways": ways,
                "after": after,
                "off": off,
                "seconds": seconds,
                "retries": outcome["retries"],
                "reason": outcome.get("reason", ""),
            }
        )


def strike(draw, board, source, folder, usual_s, loss) -> tuple[str, dict]:
    """One upload, and what befalls it: (what did, its outcome)."""
    result = folder / "result.json"
    result.unlink(missing_ok=True)
    started = time.monotonic()
    pid = upload_in_a_child(board.url, source, folder, result)
    what = fate(draw)
    ended = _wait(pid, started + draw.uniform(0.2, 1.2 * usual_s))
    if not ended and draw.random() < 0.6:  # most faults belong into the short time of writing
        ended = _writing(pid, started + 60.0) or _wait(pid, time.monotonic() + draw.uniform(0.0, 0.15 + loss))
    if ended:
        what = "none"
    elif what == "kill":
        os.kill(pid, signal.SIGKILL)
    elif what == "freeze":
        board.freeze(draw.uniform(0.3, 4.0))
    elif what == "reboot":
        board.clean.reboot()
    elif what == "power":
        board.cut(draw.uniform(0.0, 2.0))
    if not ended:
        assert _wait(pid, time.monotonic() + 180.0), "an upload hangs"
    return what, json.loads(result.read_text()) if result.exists() else {"result": "killed", "retries": 0}


def _writing(pid: int, until: float) -> bool:
    """Wait until the journal stands, so until the first write; True if the child ended before."""
    state = Path(os.environ["COAXLINK_STATE"])
    while time.monotonic() < until:
        if os.waitpid(pid, os.WNOHANG)[0]:
            return True
        if any(state.glob("*.journal.json")):
            return False
        time.sleep(0.003)
    return False


def _wait(pid: int, until: float) -> bool:
    while time.monotonic() < until:
        if os.waitpid(pid, os.WNOHANG)[0]:
            return True
        time.sleep(0.01)
    return False


def wrong(row: dict) -> str:
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


def main() -> None:
    """Run, print the table."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--firmware", choices=("px4", "ardupilot"), default="px4")
    options.add_argument("--uploads", type=int, default=1000)
    options.add_argument("--workers", type=int, default=6)
    options.add_argument("--keep", type=Path, metavar="ROWS.jsonl", help="rows as they come; go on from them")
    args_ = options.parse_args()
    rows = _recorded(args_.keep)
    have = collections.Counter(row["loss"] for row in rows)
    losses = [loss for n in range(args_.uploads // len(LOSSES)) for loss in LOSSES if n >= have[loss]]
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        known = (px4_tables if args_.firmware == "px4" else ardupilot_tables)(folder / "tables")
        queue = multiprocessing.Queue()
        # each worker has its share of every loss, one after the other
        running = [
            multiprocessing.Process(
                target=worker,
                args=(n, args_.firmware, losses[n :: args_.workers], known, folder / f"w{n}", queue),
            )
            for n in range(args_.workers)
        ]
        for one in running:
            one.start()
        try:
            collect(queue, len(running), rows, args_.keep)
        except KeyboardInterrupt:  # enough: report what there is
            for one in running:
                one.terminate()
        for one in running:
            one.join()
    report(rows)
    sys.exit(any(map(wrong, rows)))


def collect(queue: multiprocessing.Queue, left: int, rows: list[dict], keep: Path | None) -> None:
    """Take rows until every worker is done."""
    code = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.strip()
    while left:
        row = queue.get(timeout=900)
        if row is None:
            left -= 1
            continue
        rows.append(row | {"code": code})
        if keep:
            with keep.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
        if wrong(row):
            print("WRONG", wrong(row), row, flush=True)
        if len(rows) % 50 == 0:
            print(f"... {len(rows)} uploads", file=sys.stderr, flush=True)


def _recorded(path: Path | None) -> list[dict]:
    if path is None or not path.exists():
        return []
    return [json.loads(line) for line in path.read_text().splitlines()]


def report(rows: list[dict]) -> None:
    """The loss-and-kill table."""
    heads = ("loss", "uploads", "verified", "rolled back", "failed", "killed", "journal open", "mix, known")
    heads += ("mix, unknown", "resumed", "then mix", "cut after", "wrong", "median s", "p95 s", "repeats")
    print(*(f"{h:>12}" for h in heads))
    for loss in sorted({r["loss"] for r in rows}):
        some = [r for r in rows if r["loss"] == loss]
        results = collections.Counter(r["result"] for r in some)
        calm = sorted(r["seconds"] for r in some if r["fate"] == "none" and r["result"] == "verified")
        mixed = [r for r in some if r["state"] == "mixture"]
        cells = [
            f"{loss:.2f}",
            len(some),
            *(results[k] for k in ("verified", "rolled_back", "failed", "killed")),
        ]
        cells += [sum(r["journal"] for r in some), sum(r["journal"] for r in mixed)]
        cells += [sum(not r["journal"] for r in mixed), sum(r["resumed"] > 0 for r in some)]
        cells += [sum(r["resumed"] > 0 and r["after"] in ("mixture", "open") for r in some)]
        cells += [sum(not r["resumed"] and r["after"] != "" for r in some), sum(bool(wrong(r)) for r in some)]
        if calm:
            repeats = statistics.mean(r["retries"] for r in some if r["fate"] == "none")
            p95 = calm[int(0.95 * (len(calm) - 1))]
            cells += [f"{statistics.median(calm):.2f}", f"{p95:.2f}", f"{repeats:.1f}"]
        print(*(f"{cell:>12}" for cell in cells))
    fates = collections.Counter((r["fate"], r["result"]) for r in rows)
    for (what, result), count in sorted(fates.items()):
        print(f"{what:>8} -> {result:<12} {count}")


if __name__ == "__main__":
    main()
