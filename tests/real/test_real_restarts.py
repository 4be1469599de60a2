"""ArduCopter's SITLs, which all have one uid: restarted quickly it is one board, two of them are two."""

import os
import sys
import time
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from real_autopilots import AIRFRAME, Pulled, arducopter, coaxlink, cut_upload, upload, verified
from test_real_ardupilot import FACTORY

from coaxlink.errors import LinkError
from coaxlink.mavlink import connect
from coaxlink.mavlink.confirm import confirm
from coaxlink.mavlink.session import Session
from coaxlink.studies.simulator import free_port

BINARY = os.environ.get("ARDUCOPTER_SITL", "")
pytestmark = [
    pytest.mark.skipif(not BINARY, reason="ARDUCOPTER_SITL names no binary"),
    pytest.mark.timeout(1800),
]
WORLD = ("--airframe", str(AIRFRAME))


def confirmed(session: Session, seconds: float = 60.0) -> None:
    """Until the board answers; raises SafetyRefusal where two are thought to be there."""
    end = time.monotonic() + seconds
    while True:
        try:
            return confirm(session)
        except LinkError:
            assert time.monotonic() < end


def test_restarted_twice_quickly_it_is_one_board(tmp_path: Path) -> None:
    port = free_port()

    def boot() -> AbstractContextManager[str]:
        return arducopter(Path(BINARY), tmp_path, FACTORY, *WORLD, port=port, cut=True)

    with boot() as url:
        session = connect(url, timeout_s=60.0)
    with session:
        first, end = session.bound.peer, time.monotonic() + 60.0
        with boot():
            while session.bound.peer == first and not (seen := list(session.bound.strangers)):
                assert time.monotonic() < end
                time.sleep(0.1)
            moved = session.bound.peer != first  # a busy machine boots it late: the first is silent by then
            second = session.bound.peer if moved else seen[0].address
        with boot():
            while session.bound.peer in (first, second):
                confirmed(session)
        sys.stdout.write(f"\nat {first}, {second}, {session.bound.peer}: {session.bound.news()}")
        assert session.bound.peer not in (first, second)


def test_an_upload_that_was_cut_is_one_boards(tmp_path: Path) -> None:
    tables, ports = tmp_path / "table", (free_port(), free_port())
    coaxlink("table", str(AIRFRAME), "--firmware", "ardupilot", "--law", "fitted", "--out", str(tables))

    def boot(number: int, *, cut: bool = False) -> AbstractContextManager[str]:
        folder = tmp_path / f"board{number}"
        folder.mkdir(exist_ok=True)
        return arducopter(Path(BINARY), folder, FACTORY, *WORLD, port=ports[number], cut=cut)

    def determined(url: str) -> str:
        done = coaxlink("upload", str(tables), "--connect", url, "--dry-run", cwd=tmp_path, fails=True)
        return done.stdout + done.stderr

    with pytest.raises(Pulled), boot(0, cut=True) as url:
        cut_upload(url, tables, tmp_path, 5)
    with boot(1) as url:
        other = determined(url)
    with boot(0) as url:
        own = determined(url)
        upload(url, tables, tmp_path)
        verified(url, tables, tmp_path)
    sys.stdout.write(f"\nthe other board: {other}\nits own: {own}")
    assert "did not end" in own and "did not end" not in other
