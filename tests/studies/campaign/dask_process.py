"""A Dask cluster of two worker processes, one of which is killed on the way; rows to FOLDER.

A process of its own: what a dying cluster leaves to the garbage is not the test's.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import dask
import distributed
from campaign_work import COLUMNS, work

from coaxlink.studies.campaign import dataset as data
from coaxlink.studies.campaign.engine import Machine, run


def main(folder: Path, cells: int, dies: int) -> None:
    """Print the cells that were given back, in the order of their coming."""
    data.RANGE = 100
    dask.config.set({"distributed.comm.timeouts.connect": "60s"})
    payload = {"flag": str(folder / "flag"), "dies": dies}
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1",
        local_directory=str(folder),
    ) as cluster, data.Dataset(folder / "dask", COLUMNS, cells, {"digest": "x"}) as rows:  # fmt: skip
        received: list[int] = []
        for done in run(work, payload, rows.missing(), Machine(scheduler=cluster.scheduler_address)):
            received += done.cells
            rows.add(done.rows)
    sys.stdout.write(json.dumps(received))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
