"""Nothing is lost or doubled: whoever runs the cells, in whatever order, whatever dies or is stopped."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor, wait
from functools import partial
from pathlib import Path

import pytest
from case_table import case_table
from engine_work import COLUMNS, DEAF_S, work

from coaxlink import files
from coaxlink.errors import CheckFailed, InputError, LinkError
from coaxlink.studies import engine
from coaxlink.studies.campaign.rows import Dataset, columns_of
from coaxlink.studies.engine import Machine, run

CELLS = 60


@pytest.fixture(autouse=True)
def workers_find_their_work(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent), prepend=os.pathsep)


def dataset(folder, digest="x"):
    return Dataset(folder, COLUMNS, CELLS, {"digest": digest})


def here(folder, order=lambda cells: cells, upto=CELLS):
    """Fill a dataset in this process."""
    with dataset(folder) as rows:
        cells = order(rows.missing())[:upto]
        for k in range(0, len(cells), 9):
            rows.add(work({}, cells[k : k + 9]))
            rows.flush()


def written(folder):
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted((folder / "rows").iterdir())}


def test_rows_are_the_same_bytes_in_any_order_and_after_any_stop(tmp_path):
    here(tmp_path / "a")
    here(tmp_path / "b", lambda cells: cells[::-1])
    for _ in range(6):  # stopped and taken up again, each time where it was
        here(tmp_path / "c", lambda cells: cells[::2] + cells[1::2], upto=11)
    assert written(tmp_path / "a") == written(tmp_path / "b") == written(tmp_path / "c")
    assert list(written(tmp_path / "a")) == ["cells.parquet"]
    assert columns_of(tmp_path / "c")["cell"].tolist() == list(range(CELLS))
    assert files.read_json(tmp_path / "c" / "manifest.json")["rows"] == written(tmp_path / "c")


def test_a_stopped_campaign_is_readable_and_knows_what_is_missing(tmp_path):
    here(tmp_path, lambda cells: cells[::-1], upto=20)
    assert columns_of(tmp_path)["cell"].tolist() == list(range(CELLS - 20, CELLS))
    with dataset(tmp_path) as rows:
        assert rows.missing() == list(range(CELLS - 20))
        with pytest.raises(InputError, match="another campaign is writing"), dataset(tmp_path):
            pass


def test_parts_that_a_kill_left_beside_the_sorted_file_are_not_counted_twice(tmp_path):
    here(tmp_path, upto=20)
    part = next((tmp_path / "rows").glob("part-*"))
    content, listed = part.read_bytes(), written(tmp_path)
    here(tmp_path)
    finished = written(tmp_path)
    part.write_bytes(content)  # as if killed between the two
    manifest = files.read_json(tmp_path / "manifest.json")
    files.write_json(tmp_path / "manifest.json", {**manifest, "rows": finished | listed, "finished": False})
    assert columns_of(tmp_path)["cell"].tolist() == list(range(CELLS))
    here(tmp_path)
    assert written(tmp_path) == finished


def test_another_campaigns_folder_is_refused_in_one_line(tmp_path):
    here(tmp_path, upto=20)
    with pytest.raises(InputError, match="digest: the folder holds another"), dataset(tmp_path, "y"):
        pass
    (tmp_path / "manifest.json").unlink()
    with pytest.raises(InputError, match="rows without a manifest"), dataset(tmp_path):
        pass


def test_rows_that_are_not_what_was_written_are_run_again_and_never_vouched_for(tmp_path):
    import pyarrow.parquet as pq

    def altered(path):
        pq.write_table(pq.read_table(path).slice(0, 54), path)

    spoils = {
        "cut": lambda path: path.write_bytes(path.read_bytes()[:400]),
        "rows dropped": altered,
        "gone": Path.unlink,
        "one byte": lambda path: path.write_bytes(path.read_bytes()[:-9] + b"x" + path.read_bytes()[-8:]),
    }
    with case_table() as case:
        for upto in (20, CELLS):
            for name, spoil in spoils.items():
                with case(f"{name}, {upto} of {CELLS}"):
                    folder = tmp_path / name / str(upto)
                    here(folder)
                    finished = written(folder)
                    again = folder / "again"
                    here(again, upto=upto)
                    spoil(next((again / "rows").glob("*.parquet")))
                    with dataset(again) as rows:
                        assert rows.missing() and len(rows.put_aside) == (name != "gone")
                        assert all(p.suffix == ".not-ours" and p.exists() for p in rows.put_aside)
                    here(again)
                    assert written(again)["cells.parquet"] == finished["cells.parquet"]
                    assert files.read_json(again / "manifest.json")["rows"] == finished


@pytest.mark.slow
def test_a_killed_worker_of_this_machine_costs_no_row(tmp_path):
    payload = {"flag": str(tmp_path / "flag"), "dies": 30}
    given = [row["cell"] for rows in run(work, payload, range(CELLS), Machine(2), 9) for row in rows]
    assert (tmp_path / "flag").exists() and sorted(given) == list(range(CELLS))


@pytest.mark.slow
def test_nobody_waits_for_a_worker_that_takes_no_notice_once_another_was_killed(tmp_path):
    """It may wait for a lock that the killed one held: CI stood still for ten minutes."""
    payload = {"flag": str(tmp_path / "flag"), "dies": 30, "deaf": 0}
    begun = time.monotonic()
    given = [row["cell"] for rows in run(work, payload, range(CELLS), Machine(2), 9) for row in rows]
    assert (tmp_path / "flag.deaf").exists() and sorted(given) == list(range(CELLS))
    assert time.monotonic() - begun < 0.7 * DEAF_S


@pytest.mark.slow
def test_a_cell_that_kills_every_worker_ends_with_its_place():
    with pytest.raises(CheckFailed, match=r"workers died again and again at cells 0 to 2"):
        list(run(work, {"always": 0}, range(3), Machine(1), 3))


@pytest.mark.slow
def test_on_dask_the_rows_are_the_same_and_a_killed_worker_costs_none(tmp_path):
    pytest.importorskip("distributed")
    here(tmp_path / "plain")
    program = str(Path(__file__).with_name("engine_work.py"))
    command = [sys.executable, program, str(tmp_path), str(CELLS), "30"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "flag").exists() and written(tmp_path / "plain") == written(tmp_path / "dask")


@pytest.mark.slow
def test_no_scheduler_is_one_line(monkeypatch):
    pytest.importorskip("distributed")
    program = (
        "from coaxlink.studies import engine\nengine.CONNECT_S = 0.5\n"
        "try:\n    list(engine.run(print, {}, range(3), engine.Machine(scheduler='tcp://127.0.0.1:9')))\n"
        "except engine.LinkError as error:\n    print(error)\n"
    )
    reported = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert reported.stdout == "tcp://127.0.0.1:9: no Dask scheduler answers there\n", reported.stderr


def in_threads(monkeypatch, submit):
    """The engine on one thread, whose `submit(pool, *arguments)` may go wrong."""

    @contextlib.contextmanager
    def pool(machine):
        with ThreadPoolExecutor(1) as threads:
            yield engine._Pool(partial(submit, threads), partial(wait, return_when="FIRST_COMPLETED"), 1)

    monkeypatch.setattr(engine, "_pool", pool)


def test_a_pool_that_breaks_while_tasks_are_given_out_costs_no_row(monkeypatch):
    """It refuses the task at hand, which no future then stands for."""
    counted = itertools.count()

    def submit(threads, *arguments):
        if next(counted) == 2:
            raise BrokenExecutor
        return threads.submit(*arguments)

    in_threads(monkeypatch, submit)
    given = [row["cell"] for rows in run(work, {}, range(CELLS), Machine(1), 7) for row in rows]
    assert sorted(given) == list(range(CELLS))


def test_a_scheduler_that_goes_away_is_one_line_and_the_rows_so_far_are_kept(monkeypatch):
    counted, given = itertools.count(), []

    def submit(threads, *arguments):
        if next(counted) < 3:
            return threads.submit(*arguments)
        lost = Future()
        lost.cancel()
        lost.set_running_or_notify_cancel()
        return lost

    in_threads(monkeypatch, submit)
    with pytest.raises(LinkError, match="tcp://x:1: the scheduler is gone"):
        for rows in run(work, {}, range(CELLS), Machine(scheduler="tcp://x:1"), 7):
            given += [row["cell"] for row in rows]
    assert 0 < len(given) == len(set(given)) < CELLS


def test_as_many_workers_as_were_requested(monkeypatch):
    assert Machine(5).here == 5
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)  # macOS
    assert Machine().here == 3
