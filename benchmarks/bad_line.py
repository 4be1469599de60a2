"""Uploads to the stand-in over a line that loses, doubles, reorders, delays and corrupts, with kills.

    python benchmarks/bad_line.py [--firmware px4|ardupilot] [--uploads 1000] [--workers 3] [--json FILE]

Each worker has a stand-in (`coaxlink sim`), a relay process that spoils the line, and uploads tables in turn
(ArduPilot: two of FRAME_CLASS 17, two of 15, so that scripts come, go and change), each from a process of
its own that may be killed with SIGKILL; the stand-in may freeze or reboot. After every upload the board is
read over a clean line by a reader of its own: parameters, and on ArduPilot the scripts' checksums. It must
hold one of the tables whole, or the mixture must be known: a journal on disk. Then the journal is resumed
over the same bad line, by an upload of the same table, of another one, or by restoring its backup, until it
is closed, and the board is read again. The faults of the line are drawn here, not by the product's simulator.
"""

from __future__ import annotations

import argparse
import collections
import json
import multiprocessing
import os
import random
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from spoiled_line import Clean, relay

LOSSES = (0.0, 0.05, 0.1, 0.2, 0.3)
PIECE = 10  # uploads to one stand-in
ROOT = Path(__file__).parents[1]


def ardupilot_tables(folder: Path) -> list[tuple[Path, dict[str, bytes | None]]]:
    """Four tables as files, and what the board holds of each: bits of parameters, CRCs of both scripts."""
    made = []
    for law, frame_class in (("reduced", 17), ("standard", 17), ("reduced", 15), ("standard", 15)):
        place = folder / f"{law}{frame_class}"
        command = [sys.executable, "-m", "coaxlink", "table", str(ROOT / "examples" / "x8_paper.toml")]
        command += ["--firmware", "ardupilot", "--law", law, "--frame-class", str(frame_class)]
        subprocess.run([*command, "--out", str(place)], check=True, capture_output=True)
        (path,) = place.glob("*.param")
        lines = [line.split(",") for line in path.read_text().splitlines() if not line.startswith("#")]
        held: dict[str, bytes | None] = {n: struct.pack("<f", float(v)) for n, v in lines}
        for name in ("coaxlink_matrix.lua", "coaxlink_loader.lua"):
            script = place / "scripts" / name
            crc = zlib.crc32(script.read_bytes(), 0xFFFFFFFF) ^ 0xFFFFFFFF if script.exists() else None
            held[f"/APM/scripts/{name}"] = None if crc is None else struct.pack("<I", crc)
        made.append((place, held))
    return made


def tables(folder: Path) -> list[tuple[Path, dict[str, bytes]]]:
    """Two tables as files, and their bits."""
    from firmware_params import px4

    made = []
    for law in ("reduced", "standard"):
        command = [sys.executable, "-m", "coaxlink", "table", str(ROOT / "examples" / "x8_paper.toml")]
        command += ["--firmware", "px4", "--law", law, "--out", str(folder / law)]
        subprocess.run(command, check=True, capture_output=True)
        (path,) = (folder / law).glob("*.params")
        read = px4.read_params_file(path)
        bits = {n: struct.pack("<i" if read.types[n] == 6 else "<f", v) for n, v in read.params.items()}
        made.append((folder / law, bits))
    return made


def upload_in_a_child(url: str, source: Path, folder: Path, result: Path) -> int:
    """Fork; the child uploads a table, or restores a backup (a file), and leaves its JSON."""
    pid = os.fork()
    if pid:
        return pid
    code = 70
    try:
        from coaxlink.link import connect
        from coaxlink.link.backup import read_backup
        from coaxlink.link.plan import load_plan
        from coaxlink.link.upload import Uploader

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
    number: int, firmware: str, jobs: list[tuple[float, int]], folder: Path, rows: multiprocessing.Queue
) -> None:
    """Run `jobs` of (loss, uploads)."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that the stand-in ends with us
    os.environ["COAXLINK_STATE"] = str(folder / f"state{number}")
    import coaxlink.link.upload  # noqa: F401 - once, before the forks

    draw = random.Random(number)
    make = tables if firmware == "px4" else ardupilot_tables
    known = make(folder / f"tables{number}")
    for loss, count in jobs:
        command = [sys.executable, "-m", "coaxlink", "sim", "--listen", "udpin:127.0.0.1:0"]
        command += ["--firmware", firmware]
        vehicle = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        port = int(vehicle.stdout.readline().strip().rpartition(":")[2])
        listen = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        listen.bind(("127.0.0.1", 0))
        url = f"udpout:127.0.0.1:{listen.getsockname()[1]}"
        spoiler = multiprocessing.Process(
            target=relay, args=(listen, ("127.0.0.1", port), loss, draw.randrange(2**31)), daemon=True
        )
        spoiler.start()
        try:
            series(
                draw,
                loss,
                count,
                url,
                Clean(("127.0.0.1", port)),
                vehicle,
                known,
                folder / f"w{number}",
                rows,
            )
        finally:
            spoiler.kill()
            vehicle.send_signal(signal.SIGCONT)
            vehicle.terminate()
            try:
                vehicle.wait(30)
            except subprocess.TimeoutExpired:
                vehicle.kill()
    rows.put(None)


def series(draw, loss, count, url, clean, vehicle, known, folder, rows) -> None:
    """Uploads in turn to one stand-in."""
    keys = sorted({key for _, held in known for key in held})
    names, paths = [k for k in keys if "/" not in k], [k for k in keys if "/" in k]
    first = clean.board(names, paths)
    # a backup of the first state does not speak of the loader's parameters, which are not there then
    initial = {k: v for k, v in first.items() if v is not None or "/" in k}
    wholes = {source.name: held for source, held in known} | {"initial": initial}

    def look() -> tuple[str, dict[str, list[str]]]:
        """The name of the table on board; for a mixture, by what it differs from each."""
        time.sleep(0.15)  # what is still under way arrives
        now = clean.board(names, paths)
        off = {n: [k for k, v in w.items() if now[k] != v] for n, w in wholes.items()}
        whole = next((n for n, keys in off.items() if not keys), None)
        return (whole, {}) if whole else ("mixture", off)

    took = [2.0]
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(count):
        source, _ = known[i % len(known)]
        result = folder / "result.json"
        result.unlink(missing_ok=True)
        started = time.monotonic()
        pid = upload_in_a_child(url, source, folder, result)
        fate = draw.choices(("none", "kill", "freeze", "reboot"), (0.55, 0.25, 0.12, 0.08))[0]
        when = draw.uniform(0.2, 1.2 * statistics.median(took[-20:]))
        ended = _wait(pid, started + when)
        if not ended and draw.random() < 0.6:  # most faults belong into the short time of writing
            ended = _writing(pid, started + 60.0) or _wait(
                pid, time.monotonic() + draw.uniform(0.0, 0.15 + loss)
            )
        if not ended and fate == "kill":
            os.kill(pid, signal.SIGKILL)
        elif not ended and fate == "freeze":
            vehicle.send_signal(signal.SIGSTOP)
            time.sleep(draw.uniform(0.3, 4.0))
            vehicle.send_signal(signal.SIGCONT)
        elif not ended and fate == "reboot":
            clean.reboot()
        fate = "none" if ended else fate
        if not ended:
            assert _wait(pid, started + 180.0), "an upload hangs"
        seconds = time.monotonic() - started
        outcome = json.loads(result.read_text()) if result.exists() else {"result": "killed", "retries": 0}
        if fate == "none":
            took.append(seconds)
        state, _ = look()
        journal = next(Path(os.environ["COAXLINK_STATE"]).glob("*.journal.json"), None)
        resumed, after, ways, off = 0, "", [], {}
        while journal is not None and journal.exists() and resumed < 5:
            way = draw.choice((source, known[(i + 1) % len(known)][0], None))
            back = way or Path(json.loads(journal.read_text())["backup"])
            again = upload_in_a_child(url, back, folder, folder / "resumed.json")
            assert _wait(again, time.monotonic() + 240.0), "a resumed upload hangs"
            resumed += 1
            ways.append(back.name)
        if resumed:
            after, off = ("open", {}) if journal.exists() else look()
        rows.put(
            {
                "loss": loss,
                "fate": fate,
                "result": outcome["result"],
                "wanted": source.name,
                "state": state,
                "journal": journal is not None,
                "resumed": resumed,
                "after": after,
                "ways": ways,
                "off": {name: keys[:6] for name, keys in off.items()},
                "seconds": seconds,
                "retries": outcome["retries"],
                "reason": outcome.get("reason", ""),
            }
        )


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
    if row["after"] in ("mixture", "open"):
        return f"a resumed journal that ended with the board: {row['after']}"
    return ""


def main() -> None:
    """Run, print the table."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--firmware", choices=("px4", "ardupilot"), default="px4")
    options.add_argument("--uploads", type=int, default=1000)
    options.add_argument("--workers", type=int, default=3)
    options.add_argument("--json", type=Path)
    asked = options.parse_args()
    each = asked.uploads // len(LOSSES)
    pieces = [(loss, PIECE) for _ in range(each // PIECE) for loss in LOSSES]
    rows: list[dict] = []
    with tempfile.TemporaryDirectory() as place:
        queue = multiprocessing.Queue()
        running = [
            multiprocessing.Process(
                target=worker, args=(n, asked.firmware, pieces[n :: asked.workers], Path(place), queue)
            )
            for n in range(asked.workers)
        ]
        for one in running:
            one.start()
        left = len(running)
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        while left:
            try:
                row = queue.get(timeout=900)
            except KeyboardInterrupt:  # enough: report what there is
                for one in running:
                    one.terminate()
                break
            if row is None:
                left -= 1
                continue
            rows.append(row)
            if wrong(row):
                print("WRONG", row, flush=True)
            if len(rows) % 50 == 0:
                print(f"... {len(rows)} uploads", file=sys.stderr, flush=True)
        for one in running:
            one.join()
    report(rows)
    if asked.json:
        asked.json.write_text(json.dumps(rows, indent=1))
    sys.exit(any(map(wrong, rows)))


def report(rows: list[dict]) -> None:
    """The loss-and-kill table."""
    heads = ("loss", "uploads", "verified", "rolled back", "failed", "killed", "journal open", "mix, known")
    heads += ("mix, unknown", "resumed", "then mix", "wrong", "median s", "p95 s", "repeats")
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
        cells += [sum(r["after"] in ("mixture", "open") for r in some), sum(bool(wrong(r)) for r in some)]
        if calm:
            repeats = statistics.mean(r["retries"] for r in some if r["fate"] == "none")
            p95 = calm[int(0.95 * (len(calm) - 1))]
            cells += [f"{statistics.median(calm):.2f}", f"{p95:.2f}", f"{repeats:.1f}"]
        print(*(f"{cell:>12}" for cell in cells))
    fates = collections.Counter((r["fate"], r["result"]) for r in rows)
    for (fate, result), count in sorted(fates.items()):
        print(f"{fate:>8} -> {result:<12} {count}")


if __name__ == "__main__":
    main()
