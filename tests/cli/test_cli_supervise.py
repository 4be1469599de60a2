"""`--supervise`: a plain parent that starts its work again, at a bounded rate, and says so."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
EXAMPLES = Path(__file__).parents[2] / "examples"

SCRIPT = """
import os, signal, sys, time
import typer
from coaxlink.cli.shared import supervise
from coaxlink.errors import CheckFailed, LinkError, SafetyRefusal

def work(life):
    print(f"life {life} {os.getpid()}", flush=True)
    if sys.argv[1] == "killed" and life < 3:
        os.kill(os.getpid(), signal.SIGKILL)
    if sys.argv[1] == "lost" and life < 2:
        raise LinkError("there", "gone")
    if sys.argv[1] == "crashed" and life < 2:
        raise ZeroDivisionError("nobody meant this")
    if sys.argv[1] == "refused":
        raise SafetyRefusal("no")
    if sys.argv[1] == "failed":
        raise CheckFailed("no")
    if sys.argv[1] in ("storm", "wait"):
        while sys.argv[1] == "wait":
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGKILL)

app = typer.Typer()
app.command()(lambda: supervise.supervise(work))
from coaxlink.cli.shared.shell import run
sys.exit(run(app, []))
"""


def supervised(what: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", SCRIPT, what], capture_output=True, text=True, timeout=300, check=False
    )


@pytest.mark.parametrize(
    ("what", "lives", "why"),
    [("killed", 4, "killed by signal 9"), ("lost", 3, "code 3"), ("crashed", 3, "code 70")],
)
def test_it_starts_again_what_died_and_says_why(what: str, lives: int, why: str) -> None:
    done = supervised(what)
    assert done.returncode == 0
    assert [line.split()[1] for line in done.stdout.splitlines()] == [str(n) for n in range(lives)]
    said = [line for line in done.stderr.splitlines() if line.startswith("supervisor:")]
    assert len(said) == lives - 1
    assert all(why in line for line in said)


@pytest.mark.parametrize(("what", "code"), [("refused", 4), ("failed", 1)])
def test_a_no_is_not_asked_again(what: str, code: int) -> None:
    done = supervised(what)
    assert done.returncode == code
    assert len(done.stdout.splitlines()) == 1
    assert done.stderr.splitlines() == ["coaxlink: refused: no" if code == 4 else "coaxlink: no"]


def test_a_storm_of_deaths_waits_for_its_turn_and_the_wait_can_be_ended() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, "storm"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None and process.stdout is not None
    try:
        while "5 starts within 60 s" not in process.stderr.readline():
            assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        process.wait(120.0)
        assert len(process.stdout.read().splitlines()) == 5
        assert process.returncode == 130
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_told_to_stop_it_stops_its_child(number: int) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, "wait"], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    child = int(process.stdout.readline().split()[2])
    try:
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # as a terminal does
        else:
            process.send_signal(number)
        process.wait(120.0)
        assert process.returncode == 130
        end = time.monotonic() + 600.0
        while Path(f"/proc/{child}").exists() and time.monotonic() < end:
            time.sleep(0.02)
        with pytest.raises(ProcessLookupError):
            os.kill(child, 0)
    finally:
        process.kill()
        process.communicate()


def test_it_goes_not_with_a_motor_test_or_a_bounded_time() -> None:
    for option in (["--props-off"], ["--seconds", "1"]):
        command = [sys.executable, "-m", "coaxlink", "mix", str(EXAMPLES / "x8_demo.toml"), "--supervise"]
        done = subprocess.run(
            [*command, "--connect", "udpin:127.0.0.1:1", *option], capture_output=True, text=True, check=False
        )
        assert done.returncode == 2
        assert "--supervise" in done.stderr
