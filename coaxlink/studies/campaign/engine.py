"""Run work on numbered cells, in processes of this machine or on a Dask cluster; nothing is lost or doubled.

Work is a function of (payload, cells) that returns rows; it must give the same rows for the same cells
wherever it runs. A task is a run of cells worth about a second, so that handing them out costs little even
where one is 50 ms; a bounded number of tasks is under way, so that memory does not grow with the campaign.
A worker that dies loses its task, which is given out again.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from dataclasses import dataclass
from typing import Any

from coaxlink.errors import CheckFailed, InputError, LinkError
from coaxlink.threads import ONE_THREAD

TASK_S = 1.0  # of work in one task
TASKS_HZ = 50.0  # given out at most, whatever the cluster: a Dask scheduler has some hundreds a second
MOST_CELLS = 2000  # of a task
AHEAD = 3  # tasks a worker, under way or waiting
DEATHS = 4  # of workers in a row, without one task done between, before it is given up
CONNECT_S = 20.0

Rows = dict[str, list[Any]]  # columns by name
Work = Callable[[Any, Sequence[int]], Rows]


@dataclass(frozen=True)
class Done:
    """A task's rows, and what it cost."""

    cells: tuple[int, ...]
    rows: Rows
    seconds: float  # of a processor, in the worker's thread


@dataclass(frozen=True)
class Machine:
    """Where to run: so many processes here, or a Dask scheduler's address."""

    workers: int = 0  # 0: as many as this process may use processors
    scheduler: str | None = None

    @property
    def here(self) -> int:
        """Processes of this machine."""
        if self.workers:
            return self.workers
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run(
    work: Work, payload: Any, cells: Iterator[int], machine: Machine, group: int = 1
) -> Generator[Done, None, None]:
    """Rows of all cells, a task at a time, in the order in which they are done.

    Cells of one `group` (all laws of a draw) stay in one task where they can. Raises LinkError where no
    scheduler answers or it goes away, CheckFailed where workers die again and again, and what the work
    raises.
    """
    todo = _Todo(cells, group)
    waiting: list[tuple[int, ...]] = []  # tasks whose worker died
    deaths = 0
    while True:
        with _executor(machine) as (executor, workers):
            todo.task_s = max(TASK_S, workers / TASKS_HZ)
            underway: dict[Future[Done], tuple[int, ...]] = {}
            try:
                while True:
                    while len(underway) < AHEAD * workers:
                        if not waiting and (task := todo.next()):
                            waiting.append(task)
                        if not waiting:
                            break
                        future = executor.submit(_timed, work, payload, waiting[-1])  # a broken pool refuses
                        underway[future] = waiting.pop()
                    if not underway:
                        return
                    for future in wait(underway, return_when=FIRST_COMPLETED).done:
                        task = underway.pop(future)
                        try:
                            done = future.result()
                        except BaseException:
                            waiting.append(task)
                            raise
                        deaths = 0
                        todo.learn(done)
                        yield done
            except BrokenExecutor:
                deaths += 1
            except CancelledError as error:  # by nobody here: Dask does so when it lost its scheduler
                raise LinkError(machine.scheduler or "", "the scheduler is gone") from error
            except Exception as error:
                if not _of_a_dead_worker(error):
                    raise
                deaths += 1
            finally:
                waiting += underway.values()
                for future in underway:
                    future.cancel()
        if deaths >= DEATHS:
            first, last = min(waiting)[0], max(max(t) for t in waiting)
            raise CheckFailed(
                f"workers died {deaths} times in a row at cells {first} to {last}: out of memory?"
            )


def _of_a_dead_worker(error: BaseException) -> bool:
    """Whether it is Dask's word for a worker that died, or its relay met one that took a result along.

    There `distributed.cfexecutor` takes the result of a future that has just become lost for an error's three
    parts (2026.x).
    """
    trace, room = error.__traceback__, ""
    while trace is not None:
        room = trace.tb_frame.f_globals.get("__name__", "")
        trace = trace.tb_next
    relayed = isinstance(error, TypeError) and room == "distributed.cfexecutor"
    return relayed or type(error).__name__ == "KilledWorker"


def _timed(work: Work, payload: Any, cells: tuple[int, ...]) -> Done:
    start = time.thread_time()
    rows = work(payload, cells)
    return Done(cells, rows, time.thread_time() - start)


class _Todo:
    """Cells not yet given out, cut into tasks by what the ones before cost."""

    def __init__(self, cells: Iterator[int], group: int) -> None:
        self._cells, self._group, self._size, self.task_s = cells, group, group, TASK_S

    def learn(self, done: Done) -> None:
        """Size tasks by the last one's cost; never more than twice as many cells as it had."""
        wanted = self.task_s * len(done.cells) / max(done.seconds, 1e-6)
        size = min(wanted, 2.0 * max(len(done.cells), self._group), MOST_CELLS)
        self._size = max(int(size) // self._group, 1) * self._group

    def next(self) -> tuple[int, ...]:
        """The next task, empty where all are given out."""
        task: list[int] = []
        for number in self._cells:
            task.append(number)
            if len(task) >= self._size and (number + 1) % self._group == 0:
                break
        return tuple(task)


@contextlib.contextmanager
def _executor(machine: Machine) -> Iterator[tuple[Executor, int]]:
    if machine.scheduler is None:
        with _one_thread():
            pool = ProcessPoolExecutor(machine.here, multiprocessing.get_context("spawn"), _deaf)
            try:
                yield pool, machine.here
            finally:
                pool.shutdown(wait=True, cancel_futures=True)
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("`scheduler`", "", "Dask is needed: pip install 'coaxlink[cluster]'") from error
    try:
        client = Client(machine.scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise LinkError(machine.scheduler, "no Dask scheduler answers there") from error
    try:
        threads = sum(client.nthreads().values())
        if not threads:
            raise LinkError(machine.scheduler, "the scheduler has no workers")
        yield client.get_executor(pure=False), threads
    finally:
        client.close()


def _deaf() -> None:
    """A worker's start: Ctrl-C is for the process that hands out the work."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """A process each: libraries that start a thread a core would only wait for each other."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
