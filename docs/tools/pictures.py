"""The pictures of README and docs, made anew from what they show: python docs/tools/pictures.py [tutorial|demo|screen]

The screen is the monitor's own export beside a hovering stand-in; the rest is what the tutorial's verbs draw, and
one is the demo's. Two minutes.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import shutil
import struct
import subprocess
import sys
import tempfile
import termios
import threading
from pathlib import Path

from coaxlink.files import example
from coaxlink.fly.trajectory import mixer_flight
from coaxlink.studies.flight import fly
from sim.testing import standins

PICTURES = Path(__file__).parents[1] / "pictures"
FLOWN_S = 16.0  # of the flight, until the screen is kept
SIZE = (40, 64)  # lines, columns: letters that can be read where the picture is 400 px wide
SEED = "1"  # of the demo's hidden effect


def main() -> None:
    """Make all of them in a folder of their own, then put them in place."""
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        (work / "made").mkdir()
        for make in (tutorial, demo, screen):
            if not sys.argv[1:] or make.__name__ in sys.argv[1:]:
                make(work)
        for picture in sorted((work / "made").iterdir()):
            shutil.copy(picture, PICTURES / picture.name)
            sys.stdout.write(f"{PICTURES / picture.name}  {picture.stat().st_size // 1024} kB\n")


def coaxlink(work: Path, *words: str) -> None:
    """A verb in the folder, as a user types it."""
    environment = {**os.environ, "COAXLINK_STATE": str(work / "state")}
    subprocess.run(
        [sys.executable, "-m", "coaxlink", *words], cwd=work, check=True, capture_output=True, env=environment
    )


def tutorial(work: Path) -> None:
    """What the tutorial's steps draw."""
    made = work / "made"
    coaxlink(work, "examples", "stand_eq17.csv", "x8_demo.toml", "truth_weak_lower_rotor.toml")
    coaxlink(work, "identify", "stand_eq17.csv", "--out", "rotor.toml", "--plot", "plots")
    shutil.copy(work / "plots" / "surfaces.png", made)
    coaxlink(work, "compare", "x8_demo.toml", "--rotor", "rotor.toml", "--out", str(made / "compare.png"))
    coaxlink(work, "airframe", "x8_demo.toml", "--picture", str(made / "airframe.png"))
    world = ("--airframe", "x8_demo.toml", "--truth", "truth_weak_lower_rotor.toml")
    coaxlink(work, "sim", *world, "--fly", "paper", "--log", "flight.csv")
    held = ("--airframe", "x8_demo.toml", "--rotor", "rotor.toml", "--plot", "figures")
    coaxlink(work, "refine", "flight.csv", *held)
    shutil.copy(work / "figures" / "residual.png", made / "refine.png")


def demo(work: Path) -> None:
    """The demo's own picture."""
    coaxlink(work, "demo", "--seed", SEED)
    shutil.copy(work / "demo" / "demo.png", work / "made")


def screen(work: Path) -> None:
    """The monitor in a narrow terminal while a stand-in flies: its own key saves the screen."""
    airframe, listen = str(example("x8_demo.toml")), ("--listen", "udpin:127.0.0.1:0")
    world = ("--firmware", "px4", "--airframe", airframe, *listen)
    coaxlink(work, "table", airframe, "--firmware", "px4", "--out", "tables")
    with standins(*world) as (first, second):
        coaxlink(work, "upload", "tables", "--yes", "--connect", f"udpout:127.0.0.1:{first}")
        command = [sys.executable, "-m", "coaxlink", "monitor", "--airframe", airframe]
        command += ["--connect", f"udpout:127.0.0.1:{second}"]
        process, terminal = in_terminal(command, work)
        flown = threading.Event()

        def watch(_: str, seconds: float) -> None:
            if seconds > FLOWN_S and not flown.is_set():
                flown.set()
                os.write(terminal, b"s")

        fly("picture", f"udpout:127.0.0.1:{first}", mixer_flight(), work / "picture.tlog", watch=watch)
        os.write(terminal, b"q")
        process.wait(20)
    (saved,) = work.glob("coaxlink-monitor-*.svg")
    shutil.copy(saved, work / "made" / "monitor.svg")


def in_terminal(command: list[str], folder: Path) -> tuple[subprocess.Popen[bytes], int]:
    """A process in a terminal of its own, read away in the background, and the terminal."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", *SIZE, 0, 0))
    environment = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor"}
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
    )
    os.close(theirs)

    def drain() -> None:
        with contextlib.suppress(OSError):
            while os.read(ours, 65536):
                pass

    threading.Thread(target=drain, daemon=True).start()
    return process, ours


if __name__ == "__main__":
    main()
