"""Undo on the real autopilots: verify and restore after a flight, and a plug pulled in the middle of a write.

PX4_SITL and ARDUCOPTER_SITL name the binaries; the stand-ins hold the same in
tests/uploading/test_uploading_undo.py.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Protocol

import pytest
from real_autopilots import (
    AIRFRAME,
    Pulled,
    arducopter,
    coaxlink,
    cut_upload,
    held,
    hover,
    px4,
    take_off,
    undo,
    upload,
    verified,
)
from test_real_ardupilot import FACTORY
from test_real_px4 import factory

from coaxlink.mavlink import connect
from coaxlink.uploading.plan import load_plan

PULLS = 10
# a table of class 15 is a script of some 15 requests and a few parameters, a loader's one packed file
STEP, SPAN = {("px4", "15"): 1, ("ardupilot", "15"): 7, ("ardupilot", "17"): 1}, {"15": 12, "17": 4}
pytestmark = pytest.mark.timeout(1800)


class Boot(Protocol):
    """One power-up of a board in a folder, ended as when the plug is pulled if `cut`."""

    def __call__(self, *, cut: bool = False) -> AbstractContextManager[str]: ...


@pytest.fixture(params=["px4", "ardupilot"])
def firmware(request: pytest.FixtureRequest) -> str:
    name = {"px4": "PX4_SITL", "ardupilot": "ARDUCOPTER_SITL"}[request.param]
    if not os.environ.get(name):
        pytest.skip(f"{name} names no binary")
    return str(request.param)


@pytest.fixture
def boot(firmware: str, tmp_path: Path) -> Iterator[Boot]:
    folder = tmp_path / "board"
    folder.mkdir()
    if firmware == "ardupilot":
        binary = Path(os.environ["ARDUCOPTER_SITL"])

        def on_ardupilot(*, cut: bool = False) -> AbstractContextManager[str]:
            return arducopter(binary, folder, FACTORY, "--airframe", str(AIRFRAME), cut=cut)

        yield on_ardupilot
        return
    preset = factory(tmp_path / "standard")
    with px4(Path(os.environ["PX4_SITL"]), folder, "--airframe", str(AIRFRAME), "--speed", "0") as board:

        @contextmanager
        def on_px4(*, cut: bool = False) -> Iterator[str]:
            first = {} if (folder / "parameters.bson").exists() else preset
            with board.boot(first, cut=cut) as url:
                yield url

        yield on_px4


def _table(firmware: str, law: str, folder: Path, *options: str) -> Path:
    coaxlink(
        "table", str(AIRFRAME), "--firmware", firmware, "--law", law, *options, "--out", str(folder / law)
    )
    return folder / law


def test_verified_and_undone_after_a_flight(firmware: str, boot: Boot, tmp_path: Path) -> None:
    tables = _table(firmware, "fitted", tmp_path)
    names = set(load_plan(tables).params)
    with boot() as url:
        before = held(url, names)
        backup = upload(url, tables, tmp_path)["backup"]
        with connect(url, timeout_s=60.0) as session:
            hover(session, take_off(session))
        answer = verified(url, tables, tmp_path)
        assert {row["name"] for row in answer["learned"]} <= {"MOT_THST_HOVER"}
        undo(url, str(tmp_path / backup), tmp_path)
        after = held(url, names)
        assert after == {name: before[name] for name in after}
        other = coaxlink("verify", str(tables), "--connect", url, fails=True)
        sys.stdout.write(
            f"\n{firmware}, verify after restore, exit {other.returncode}: {other.stdout}{other.stderr}"
        )
        assert other.returncode == 1 and "learned" not in other.stdout and "e+0" not in other.stdout
        rest = undo(url, str(tmp_path / backup), tmp_path, "--all")
        assert not rest["passed_over"]  # whatever it refuses is on our list


@pytest.mark.parametrize("frame_class", ["15", "17"])
def test_a_plug_pulled_in_the_middle_of_the_write(
    firmware: str, boot: Boot, tmp_path: Path, frame_class: str
) -> None:
    """Two tables in turn; each write is cut somewhere else, and the same upload makes it whole."""
    if firmware == "px4" and frame_class == "17":
        pytest.skip("PX4 has no frame classes")
    options = ("--frame-class", frame_class) if firmware == "ardupilot" else ()
    laws = [_table(firmware, law, tmp_path, *options) for law in ("standard", "reduced")]
    with boot() as url:
        upload(url, laws[0], tmp_path)
    for pull in range(PULLS):
        tables = laws[(pull + 1) % 2]
        with pytest.raises(Pulled), boot(cut=True) as url:
            cut_upload(url, tables, tmp_path, 1 + pull * STEP[firmware, frame_class] % SPAN[frame_class])
        with boot() as url:
            _restored(url, tables, tmp_path)
            verified(url, tables, tmp_path)


def _restored(url: str, tables: Path, folder: Path) -> None:
    """The same upload again. A busy machine may cost its link the restart: then the old table is whole."""
    for _ in range(3):
        done = coaxlink("upload", str(tables), "--connect", url, "--yes", cwd=folder, fails=True)
        if done.returncode == 0:
            return
        assert "rolled back, the vehicle holds its old table" in done.stderr
    raise AssertionError(done.stderr)
