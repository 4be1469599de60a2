"""Work for the engine's tests, in a module of its own: workers are processes that import it.

As a program: a Dask cluster of two workers, one of which is killed on the way; a process of its own, since
what a dying cluster leaves to the garbage is not the test's.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

DEAF_S = 30.0
COLUMNS = {"cell": "int64", "law": "string", "value": "float64"}


def work(payload: dict[str, object], cells: Sequence[int]) -> list[dict[str, object]]:
    """Rows that follow from the cell; whoever first does cell `dies` (once, by a flag file) is killed, and
    whoever first does cell `deaf` is deaf to termination, and busy until after that.
    """
    flag, dies = payload.get("flag"), payload.get("dies")
    if payload.get("deaf") in cells and not Path(f"{flag}.deaf").exists():
        Path(f"{flag}.deaf").write_text("deaf")
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while not Path(str(flag)).exists():
            time.sleep(0.01)
        time.sleep(DEAF_S)
    if flag and dies in cells and not Path(str(flag)).exists():
        Path(str(flag)).write_text("dead")
        os.kill(os.getpid(), signal.SIGKILL)
    if payload.get("always") in cells:
        os.kill(os.getpid(), signal.SIGKILL)
    return [{"cell": c, "law": "ab"[c % 2], "value": None if c % 7 == 0 else c**0.5} for c in cells]


def on_dask(folder: Path, cells: int, dies: int) -> None:
    """All cells into FOLDER/dask."""
    import dask
    import distributed

    from coaxlink.studies.campaign.rows import Dataset
    from coaxlink.studies.engine import Machine, run

    dask.config.set({"distributed.comm.timeouts.connect": "60s"})
    payload = {"flag": str(folder / "flag"), "dies": dies}
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1",
        local_directory=str(folder),
    ) as cluster, Dataset(folder / "dask", COLUMNS, cells, {"digest": "x"}) as rows:  # fmt: skip
        for done in run(work, payload, rows.missing(), Machine(scheduler=cluster.scheduler_address), 9):
            rows.add(done)


if __name__ == "__main__":
    on_dask(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
