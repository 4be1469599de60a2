"""What the pages tell a reader to type, and typing it against a stand-in."""

from __future__ import annotations

import re
import shlex
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest

from coaxlink.cli import main
from sim.testing import standin

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
ADDRESSES = ("udpin:0.0.0.0:14550", "udpin:127.0.0.1:14540", "/dev/serial0,921600")
_BLOCK = re.compile(r"(?:<!-- (?P<mark>[^\n]*?) -->\n)?```sh\n(?P<text>.*?)```", re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A ```sh block and the remark above it that says how it is run ("" where there is none)."""

    page: str
    mark: str
    lines: tuple[str, ...]


def blocks(page: str) -> list[Block]:
    """Of a page of docs/, in order."""
    found = _BLOCK.finditer((DOCS / page).read_text())
    return [Block(page, m["mark"] or "", tuple(filter(None, m["text"].splitlines()))) for m in found]


class Reader:
    """Somebody who types every block into terminals in one folder; `said` keeps what came back by line."""

    def __init__(self, folder: Path, capture: pytest.CaptureFixture[str], vehicle: ExitStack) -> None:
        self.folder, self.capture, self.vehicle = folder, capture, vehicle
        self.address = self.world = ""
        self.reported: dict[str, tuple[str, str]] = {}

    def start(self, *arguments: str, speed: int = 1) -> None:
        """A vehicle on the line, instead of the last one; in flight it waits for a busy machine."""
        self.vehicle.close()
        port = self.vehicle.enter_context(standin("--lockstep", "--speed", str(speed), *arguments))
        self.address = f"udpout:127.0.0.1:{port}"

    def follow(self, page: str) -> None:
        """Type a page from top to bottom; a vehicle that flew ends after the last verb that needs it."""
        lines = [block.lines for block in blocks(page)]
        flies = any(line.startswith("coaxlink fly") for block in lines for line in block)
        for number, block in enumerate(blocks(page)):
            if flies and not any("--connect" in line for later in lines[number:] for line in later):
                self.vehicle.close()
            self._type(block, 4 if flies else 1)

    def _type(self, block: Block, speed: int) -> None:
        mark = block.mark
        if mark.startswith("second terminal"):
            (line,) = block.lines
            self.start(*shlex.split(line)[2:], speed=speed)
        elif mark.startswith("third terminal"):
            (line,) = block.lines
            self.verb(f"{line} --once --seconds 2", 0)
        elif mark == "run in the shell":
            subprocess.run(["bash", "-ec", "\n".join(block.lines)], cwd=self.folder, check=True)
        elif mark == "run" or mark.startswith("run: "):
            self._meet(mark.removeprefix("run").removeprefix(": "))
            expected = int(mark.removeprefix("run: exit ")) if "exit" in mark else 0
            for line in block.lines:
                self.verb(line, expected)

    def _meet(self, world: str) -> None:
        """The vehicle that a mark names ("px4:1.13, signed"), where it is not on the line already."""
        if not world or world == self.world or world.startswith("exit "):
            return
        firmware, _, signed = world.partition(", ")
        key = ("--signing-key", str(self.folder / "signing.key")) if signed else ()
        self.start("--firmware", firmware, *key)
        self.world = world

    def verb(self, line: str, expected: int) -> None:
        """Type one verb; the exit code is what the page says."""
        words = shlex.split(self._here(line))
        assert words[0] == "coaxlink", line
        if words[1] == "identify" and "--airframe" not in words:
            words += [
                "--max-order",
                "2",
            ]  # a page is followed for its words: the whole ladder is tried elsewhere
        with pytest.raises(SystemExit) as ended:
            main(words[1:])
        out, err = self.capture.readouterr()
        self.reported[line] = (out, err)
        assert ended.value.code == expected, f"{line}\n{out}\n{err}"

    def _here(self, line: str) -> str:
        for address in ADDRESSES:
            line = line.replace(address, self.address)
        if "backups/FILE.params" in line:
            newest = max((self.folder / "backups").glob("*.params"), key=lambda p: p.stat().st_mtime_ns)
            line = line.replace("backups/FILE.params", str(newest))
        return line


def typed_lines(text: str) -> Iterator[str]:
    """Every `coaxlink VERB ...` that stands in a code block of a page, fenced or indented."""
    fenced = False
    for line in text.splitlines():
        if line.lstrip().startswith("```"):
            fenced = not fenced
        elif (fenced or line.startswith("    ")) and re.match(r"\s*coaxlink [a-z]", line):
            yield line.strip().partition("  #")[0]
