"""Nothing is lost or doubled: whoever runs the cells, in whatever order, whatever dies or is stopped."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import os
import subprocess
import sys
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from pathlib import Path

import pytest
from campaign_work import COLUMNS, work

from coaxlink.errors import CheckFailed, InputError, LinkError
from coaxlink.studies.campaign import dataset as data
from coaxlink.studies.campaign import engine
from coaxlink.studies.campaign.dataset import Dataset, columns_of
from coaxlink.studies.campaign.engine import AHEAD, Done, Machine, _Todo, run

CELLS = 230


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(data, "RANGE", 100)
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))


def _hashes(folder: Path) -> dict[str, str]:
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted((folder / "rows").iterdir())}


def _here(folder: Path, order=lambda cells: cells, upto: int = CELLS) -> None:
    with Dataset(folder, COLUMNS, CELLS, {"digest": "x"}) as rows:
        cells = order(list(rows.missing()))[:upto]
        for k in range(0, len(cells), 9):
            rows.add(work({}, cells[k : k + 9]))


def test_rows_are_the_same_bytes_in_any_order_and_after_any_stop(tmp_path) -> None:
    _here(tmp_path / "a")
    _here(tmp_path / "b", lambda cells: cells[::-1])
    for _ in range(6):  # stopped and taken up again, each time where it was
        _here(tmp_path / "c", lambda cells: cells[::2] + cells[1::2], upto=45)
    assert _hashes(tmp_path / "a") == _hashes(tmp_path / "b") == _hashes(tmp_path / "c")
    assert list(_hashes(tmp_path / "a")) == [f"cells-{k:09d}.parquet" for k in (0, 100, 200)]
    found = columns_of(tmp_path / "c")
    assert found["cell"].tolist() == list(range(CELLS))
    assert data.files.read_json(tmp_path / "c" / "manifest.json")["rows"] == _hashes(tmp_path / "c")


def test_a_stopped_campaign_is_readable_and_knows_what_is_missing(tmp_path) -> None:
    _here(tmp_path, lambda cells: cells[::-1], upto=90)
    assert sorted(columns_of(tmp_path)["cell"].tolist()) == list(range(CELLS - 90, CELLS))
    with Dataset(tmp_path, COLUMNS, CELLS, {"digest": "x"}) as rows:
        assert list(rows.missing()) == list(range(CELLS - 90)) and not rows.complete
        with (
            pytest.raises(InputError, match="another campaign is writing"),
            Dataset(tmp_path, COLUMNS, CELLS, {"digest": "x"}),
        ):
            pass


def test_loose_rows_that_a_kill_left_beside_their_sorted_file_are_not_counted_twice(tmp_path) -> None:
    _here(tmp_path, upto=90)
    loose = next((tmp_path / "rows").glob("loose-*"))
    content = loose.read_bytes()
    _here(tmp_path)
    loose.write_bytes(content)  # as if killed between the two
    assert columns_of(tmp_path)["cell"].tolist() == list(range(CELLS))
    with Dataset(tmp_path, COLUMNS, CELLS, {"digest": "x"}) as rows:
        assert rows.complete and not list(rows.missing()) and not loose.exists()


def test_another_campaigns_folder_and_a_broken_file_are_refused_in_one_line(tmp_path) -> None:
    _here(tmp_path, upto=90)
    with (
        pytest.raises(InputError, match="digest: the folder holds another"),
        Dataset(tmp_path, COLUMNS, CELLS, {"digest": "y"}),
    ):
        pass
    loose = next((tmp_path / "rows").glob("loose-*"))
    loose.write_bytes(b"PAR1 and nothing")
    with (
        pytest.raises(InputError, match="is no Parquet file"),
        Dataset(tmp_path, COLUMNS, CELLS, {"digest": "x"}),
    ):
        pass


def test_a_killed_worker_of_this_machine_costs_no_row(tmp_path) -> None:
    _here(tmp_path / "plain")
    payload = {"flag": str(tmp_path / "flag"), "dies": 60}
    with Dataset(tmp_path / "killed", COLUMNS, CELLS, {"digest": "x"}) as rows:
        done_cells = []
        for done in run(work, payload, rows.missing(), Machine(2)):
            done_cells += done.cells
            rows.add(done.rows)
    assert (tmp_path / "flag").exists() and sorted(done_cells) == list(range(CELLS))
    assert _hashes(tmp_path / "plain") == _hashes(tmp_path / "killed")


def test_a_pool_that_breaks_while_tasks_are_given_out_costs_no_row(monkeypatch) -> None:
    """It refuses the task at hand, which no future then stands for."""

    class Breaking(ThreadPoolExecutor):
        def submit(self, *args, **kwargs):
            if next(counted) == 3:
                raise BrokenExecutor
            return super().submit(*args, **kwargs)

    @contextlib.contextmanager
    def executor(machine):
        with Breaking(1) as pool:
            yield pool, machine.here

    counted = itertools.count()
    monkeypatch.setattr(engine, "_executor", executor)
    done_cells = [cell for done in run(work, {}, iter(range(CELLS)), Machine(2)) for cell in done.cells]
    assert sorted(done_cells) == list(range(CELLS))


@pytest.mark.parametrize("system", ["Linux", "macOS"])
def test_as_many_workers_as_were_asked_for(system, monkeypatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    if system == "macOS":
        monkeypatch.delattr(os, "sched_getaffinity", raising=False)
        assert Machine().here == 3
    assert Machine(5).here == 5


def test_a_cell_that_kills_every_worker_ends_with_its_place(tmp_path) -> None:
    with pytest.raises(CheckFailed, match=r"workers died 4 times in a row at cells 0 to"):
        list(run(work, {"always": 0}, iter(range(3)), Machine(1)))


def test_on_dask_the_rows_are_the_same_and_a_killed_worker_costs_none(tmp_path) -> None:
    pytest.importorskip("distributed")
    _here(tmp_path / "plain")
    command = [
        sys.executable,
        str(Path(__file__).with_name("dask_process.py")),
        str(tmp_path),
        str(CELLS),
        "60",
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "flag").exists() and sorted(json.loads(done.stdout)) == list(range(CELLS))
    assert _hashes(tmp_path / "plain") == _hashes(tmp_path / "dask")


def test_no_scheduler_is_one_line() -> None:
    pytest.importorskip("distributed")
    program = (
        "from coaxlink.studies.campaign import engine\nengine.CONNECT_S = 0.5\n"
        "try:\n    list(engine.run(print, {}, iter(range(3)), engine.Machine(scheduler='tcp://127.0.0.1:9')))\n"
        "except engine.LinkError as error:\n    print(error)\n"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert said.stdout == "tcp://127.0.0.1:9: no Dask scheduler answers there\n", said.stderr


def test_a_result_that_its_worker_took_along_is_made_again(monkeypatch) -> None:
    """As Dask relays it: the result of a future that is lost is taken for an error's three parts."""
    relay: dict[str, object] = {"__name__": "distributed.cfexecutor"}
    exec("def relayed(result):\n    typ, exc, tb = result", relay)

    class Lossy(ThreadPoolExecutor):
        def submit(self, function, *args, **kwargs):
            if next(counted) == 1:
                return super().submit(lambda: relay["relayed"](function(*args, **kwargs)))
            return super().submit(function, *args, **kwargs)

    @contextlib.contextmanager
    def executor(machine):
        with Lossy(1) as pool:
            yield pool, 1

    counted = itertools.count()
    monkeypatch.setattr(engine, "_executor", executor)
    done = [n for d in run(work, {}, iter(range(CELLS)), Machine(scheduler="tcp://x:1")) for n in d.cells]
    assert sorted(done) == list(range(CELLS)) and next(counted) > 2


def test_a_scheduler_that_goes_away_is_one_line_and_the_rows_so_far_are_kept(monkeypatch) -> None:
    class Left(ThreadPoolExecutor):
        def submit(self, *args, **kwargs):
            if next(counted) < 3:
                return super().submit(*args, **kwargs)
            lost = Future()
            lost.cancel()
            lost.set_running_or_notify_cancel()
            return lost

    @contextlib.contextmanager
    def executor(machine):
        with Left(1) as pool:
            yield pool, 1

    counted, done_cells = itertools.count(), []
    monkeypatch.setattr(engine, "_executor", executor)
    with pytest.raises(LinkError, match="tcp://x:1: the scheduler is gone"):
        for done in run(work, {}, iter(range(CELLS)), Machine(scheduler="tcp://x:1")):
            done_cells += done.cells
    assert 0 < len(done_cells) == len(set(done_cells)) < CELLS


def test_tasks_grow_to_a_second_of_work_and_keep_groups_whole() -> None:
    todo = _Todo(iter(range(10_000)), 4)
    sizes = []
    for _ in range(8):
        task = todo.next()
        assert task[0] % 4 == 0 and len(task) % 4 == 0
        todo.learn(Done(task, {}, 0.05 * len(task)))
        sizes.append(len(task))
    assert sizes == [4, 8, 16, 20, 20, 20, 20, 20]
    assert AHEAD >= 2  # a worker never waits for the next
