"""Uploads to the stand-in over a line that loses, doubles, reorders, delays and corrupts, with kills.

    python benchmarks/bad_line.py [--uploads 1000] [--workers 3] [--json FILE]

Each worker has a stand-in (`coaxlink sim`), a relay process that spoils the line, and uploads two tables in
turn, each from a process of its own that may be killed with SIGKILL; the stand-in may freeze or reboot. After
every upload the table is read over a clean line by a reader of its own and must be one of the two, or the
mixture must be known: a journal on disk, which the next upload ends. The faults of the line are drawn here,
not by the product's simulator.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import json
import multiprocessing
import os
import random
import select
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pymavlink.dialects.v20 import common as m

LOSSES = (0.0, 0.05, 0.1, 0.2, 0.3)
ROOT = Path(__file__).parents[1]


def relay(listen: socket.socket, vehicle: tuple[str, int], loss: float, seed: int) -> None:
    """Carry datagrams both ways: lose `loss`, double 2 %, delay 2 ms, 5 % up to 60 ms late, corrupt 0.5 %."""
    draw = random.Random(seed)
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    peer, late = None, []
    while True:
        now = time.monotonic()
        for row in [r for r in late if r[0] <= now]:
            late.remove(row)
            with contextlib.suppress(OSError):
                row[1].sendto(row[2], row[3])
        wait = min([r[0] for r in late], default=now + 0.2) - now
        for ready in select.select([listen, out], [], [], max(wait, 0.0))[0]:
            try:
                data, source = ready.recvfrom(65536)
            except OSError:
                continue
            if ready is listen:
                peer = source
            there = (out, vehicle) if ready is listen else (listen, peer)
            if there[1] is None or (loss and draw.random() < loss):
                continue
            if loss and draw.random() < 0.005:
                place = draw.randrange(len(data))
                data = data[:place] + bytes([data[place] ^ (1 << draw.randrange(8))]) + data[place + 1 :]
            copies = 2 if loss and draw.random() < 0.02 else 1
            for _ in range(copies):
                slow = 0.06 * draw.random() if loss and draw.random() < 0.05 else 0.0
                late.append((time.monotonic() + (0.002 + slow if loss else 0.0), there[0], data, there[1]))


class Clean:
    """A reader of the table over a line of its own, written for this benchmark."""

    def __init__(self, vehicle: tuple[str, int]) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(0.3)
        self.vehicle, self.out, self.parser = vehicle, m.MAVLink(None, 250, 1), m.MAVLink(None)
        self.parser.robust_parsing = True

    def send(self, message: object) -> None:
        self.socket.sendto(message.pack(self.out), self.vehicle)

    def table(self, names: list[str]) -> dict[str, bytes]:
        """The wire bits of each parameter."""
        self._drain()
        found: dict[str, bytes] = {}
        end = time.monotonic() + 30.0
        while len(found) < len(names):
            assert time.monotonic() < end, "the stand-in does not answer on a clean line"
            for name in [n for n in names if n not in found][:20]:
                self.send(m.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
            until = time.monotonic() + 0.3
            while time.monotonic() < until:
                try:
                    data = self.socket.recv(4096)
                except TimeoutError:
                    break
                for message in self.parser.parse_buffer(data) or []:
                    if message.get_type() == "PARAM_VALUE" and message.param_id in names:
                        found[message.param_id] = bytes(message.get_msgbuf()[10:14])
                if len(found) % 20 == 0:
                    break
        return found

    def _drain(self) -> None:
        # news of earlier changes wait in the socket and are not what the board holds now
        while select.select([self.socket], [], [], 0.0)[0]:
            self.socket.recv(4096)

    def reboot(self) -> None:
        self.send(m.MAVLink_command_long_message(1, 1, 246, 0, 1, 0, 0, 0, 0, 0, 0))


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
    """Fork; the child uploads and leaves its JSON."""
    pid = os.fork()
    if pid:
        return pid
    code = 70
    try:
        from coaxlink.link import connect
        from coaxlink.link.plan import load_plan
        from coaxlink.link.upload import Uploader

        with connect(url, timeout_s=20.0) as session:
            outcome = Uploader(session, backup_folder=folder / "backups").upload(load_plan(source))
        result.write_text(json.dumps(outcome.to_json()))
        code = 0
    except BaseException as error:
        result.write_text(json.dumps({"result": "failed", "reason": repr(error), "retries": 0}))
    finally:
        os._exit(code)


def worker(number: int, jobs: list[tuple[float, int]], folder: Path, rows: multiprocessing.Queue) -> None:
    """Run `jobs` of (loss, uploads)."""
    os.environ["COAXLINK_STATE"] = str(folder / f"state{number}")
    import coaxlink.link.upload  # noqa: F401 - once, before the forks

    draw = random.Random(number)
    known = tables(folder / f"tables{number}")
    for loss, count in jobs:
        command = [sys.executable, "-m", "coaxlink", "sim", "--listen", "udpin:127.0.0.1:0"]
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
            vehicle.wait(10)
    rows.put(None)


def series(draw, loss, count, url, clean, vehicle, known, folder, rows) -> None:
    """Uploads in turn to one stand-in."""
    names = sorted(set(known[0][1]) | set(known[1][1]))
    initial = clean.table(names)
    wholes = {"reduced": known[0][1], "standard": known[1][1], "initial": initial}
    took = [2.0]
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(count):
        source, _ = known[i % 2]
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
        time.sleep(0.15)  # what is still under way arrives
        now = clean.table(names)
        state = next((n for n, w in wholes.items() if all(now[k] == v for k, v in w.items())), "mixture")
        journal = any(Path(os.environ["COAXLINK_STATE"]).glob("*.journal.json"))
        rows.put(
            {
                "loss": loss,
                "fate": fate,
                "result": outcome["result"],
                "wanted": source.name,
                "state": state,
                "journal": journal,
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
    return ""


def main() -> None:
    """Run, print the table."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--uploads", type=int, default=1000)
    options.add_argument("--workers", type=int, default=3)
    options.add_argument("--json", type=Path)
    asked = options.parse_args()
    each = asked.uploads // len(LOSSES)
    pieces = [(loss, 20) for loss in LOSSES for _ in range(each // 20)]
    rows: list[dict] = []
    with tempfile.TemporaryDirectory() as place:
        queue = multiprocessing.Queue()
        running = [
            multiprocessing.Process(target=worker, args=(n, pieces[n :: asked.workers], Path(place), queue))
            for n in range(asked.workers)
        ]
        for one in running:
            one.start()
        left = len(running)
        while left:
            row = queue.get(timeout=400)
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
    print(*(f"{h:>12}" for h in (*heads, "mix, unknown", "wrong", "median s", "p95 s", "repeats")))
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
        cells += [sum(not r["journal"] for r in mixed), sum(bool(wrong(r)) for r in some)]
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
