"""Tables to upload, and stand-ins behind a spoiled line to upload them to; for the benchmarks of uploads."""

from __future__ import annotations

import contextlib
import multiprocessing
import random
import signal
import socket
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path

from spoiled_line import Clean, relay

ROOT = Path(__file__).parents[1]
SCRIPTS = ("coaxlink_matrix.lua", "coaxlink_loader.lua")


def ardupilot_tables(folder: Path) -> list[tuple[Path, dict[str, bytes | None]]]:
    """Four tables as files, and what the board holds of each: bits of parameters, CRCs of both scripts."""
    made = []
    for law, frame_class in (("reduced", 17), ("standard", 17), ("reduced", 15), ("standard", 15)):
        table_folder = folder / f"{law}{frame_class}"
        _table("ardupilot", law, table_folder, "--frame-class", str(frame_class))
        (path,) = table_folder.glob("*.param")
        lines = [line.split(",") for line in path.read_text().splitlines() if not line.startswith("#")]
        held: dict[str, bytes | None] = {n: struct.pack("<f", float(v)) for n, v in lines}
        for name in SCRIPTS:
            script = table_folder / "scripts" / name
            crc = zlib.crc32(script.read_bytes(), 0xFFFFFFFF) ^ 0xFFFFFFFF if script.exists() else None
            held[f"/APM/scripts/{name}"] = None if crc is None else struct.pack("<I", crc)
        made.append((table_folder, held))
    return made


def px4_tables(folder: Path) -> list[tuple[Path, dict[str, bytes | None]]]:
    """Two tables as files, and their bits."""
    from firmware_params import px4

    made = []
    for law in ("reduced", "standard"):
        _table("px4", law, folder / law)
        (path,) = (folder / law).glob("*.params")
        read = px4.read_params_file(path)
        bits = {n: struct.pack("<i" if read.types[n] == 6 else "<f", v) for n, v in read.params.items()}
        made.append((folder / law, bits))
    return made


def _table(firmware: str, law: str, out: Path, *more: str) -> None:
    command = [sys.executable, "-m", "coaxlink", "table", str(ROOT / "examples" / "x8_paper.toml")]
    command += ["--firmware", firmware, "--law", law, "--out", str(out), *more]
    subprocess.run(command, check=True, capture_output=True)


class Standin:
    """`coaxlink sim` with a memory that survives kill -9, behind a relay whose loss can be set."""

    def __init__(self, firmware: str, folder: Path, seed: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._firmware, self._memory = firmware, folder / "memory.json"
        self._process: subprocess.Popen | None = None
        self._port = 0
        self._loss = multiprocessing.Value("d", 0.0)
        self._start()
        self.clean = Clean(("127.0.0.1", self._port))
        listen = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        listen.bind(("127.0.0.1", 0))
        self.url = f"udpout:127.0.0.1:{listen.getsockname()[1]}"
        self._relay = multiprocessing.Process(
            target=relay, args=(listen, ("127.0.0.1", self._port), self._loss, seed), daemon=True
        )
        self._relay.start()

    def _start(self) -> None:
        command = [sys.executable, "-m", "coaxlink", "sim", "--firmware", self._firmware]
        command += ["--listen", f"udpin:127.0.0.1:{self._port}", "--memory", str(self._memory)]
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        said = self._process.stdout.readline().strip()
        assert said.startswith("ready"), "the stand-in does not start"
        self._port = int(said.rpartition(":")[2])

    def lose(self, loss: float) -> None:
        """From now on; with 0 the line is clean in every way."""
        self._loss.value = loss

    def freeze(self, seconds: float) -> None:
        """Stop, and go on."""
        self._process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        self._process.send_signal(signal.SIGCONT)

    def cut(self, seconds: float) -> None:
        """Pull its plug (SIGKILL), and put it in again."""
        self._process.kill()
        self._process.wait()
        self._process.stdout.close()
        time.sleep(seconds)
        self._start()

    def close(self) -> None:
        """The end of both."""
        self._relay.kill()
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGCONT)
        self._process.terminate()
        try:
            self._process.wait(30)
        except subprocess.TimeoutExpired:
            self._process.kill()


def fate(draw: random.Random) -> str:
    """What happens to an upload."""
    fates = ("none", "kill", "freeze", "reboot", "power")
    return draw.choices(fates, (0.50, 0.25, 0.08, 0.07, 0.10))[0]
