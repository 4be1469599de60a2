"""What stands on the screen, letter by letter, against the texts in snapshots/.

COAXLINK_SNAPSHOTS=write python -m pytest tests/monitor/test_monitor_snapshots.py writes them anew;
`git diff` shows what changed.
"""

from __future__ import annotations

import asyncio
import html
import os
import re
from pathlib import Path
from types import SimpleNamespace

import pytest
from monitor_messages import EscStatus, attitude, battery, heartbeat, position, servo
from test_monitor_screen import Scene

from coaxlink.monitor.screen import app as screen

FOLDER = Path(__file__).parent / "snapshots"
TEXT = re.compile(
    r'<text class="[^"]*-r\d+" x="([\d.]+)" y="([\d.]+)" textLength="([\d.]+)"[^>]*>([^<]*)</text>'
)
CELL, LINE = 12.2, 24.4  # of Rich's picture of a terminal, its own units


def lines(svg: str) -> str:
    """The letters of a picture of the screen where they stand."""
    rows: dict[int, dict[int, str]] = {}
    for x, y, _, text in TEXT.findall(svg):
        row = rows.setdefault(round(float(y) / LINE), {})
        for k, letter in enumerate(html.unescape(text).replace("\xa0", " ")):
            row[round(float(x) / CELL) + k] = letter
    first = min(rows)
    drawn = (
        "".join(row.get(k, " ") for k in range(max(row) + 1)).rstrip() for _, row in sorted(rows.items())
    )
    assert first >= 0
    return "\n".join(drawn) + "\n"


def weak(scene: Scene) -> None:
    """A vehicle whose first rotor turns slower than it is told to."""
    scene.hear(heartbeat(), servo(), attitude(), position(), battery())
    scene.hear(EscStatus(0, [2100, 2381, 2381, 2381]), EscStatus(4, [3499] * 4))


def lost(scene: Scene) -> None:
    """One that was heard eight seconds ago."""
    scene.hear(heartbeat(), servo(), attitude(), position(), battery(), ago_s=8.0)


SHOWN = {
    "waiting": (lambda scene: None, ""),
    "split": (Scene.fly, ""),
    "split-weak": (weak, ""),
    "split-lost": (lost, ""),
    "parameters": (Scene.fly, "3"),
    "messages": (Scene.fly, "4"),
    "health": (Scene.fly, "5"),
    "help": (Scene.fly, "question_mark"),
}


@pytest.mark.parametrize("name", SHOWN)
def test_the_screen_is_as_it_was_looked_at(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene(tmp_path)
    monkeypatch.setattr(screen, "time", SimpleNamespace(monotonic=lambda: scene.now_s))
    played, key = SHOWN[name]

    async def story() -> str:
        async with scene.app.run_test(size=(80, 24)) as pilot:
            played(scene)
            if key:
                await pilot.press(key)
            await pilot.pause()
            scene.app.tick()
            await pilot.pause()
            return scene.app.export_screenshot()

    found, path = lines(asyncio.run(story())), FOLDER / f"{name}.txt"
    if os.environ.get("COAXLINK_SNAPSHOTS") == "write":
        path.write_text(found)
    assert found == path.read_text()
