"""Run work on numbered cells, in processes here or on a Dask cluster; nothing is lost or doubled.

Work is a function of (payload, cells) that returns a row a cell; it must give the same rows for the same
cells wherever it runs. A bounded number of tasks is under way, so that memory does not grow with their
number. A worker that dies loses its task, which is given out again.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, ProcessPoolExecutor, wait
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any

from coaxlink import _interrupts
from coaxlink.errors import CheckFailed, InputError, LinkError
from coaxlink.threads import ONE_THREAD

AHEAD = 3  # tasks a worker, under way or waiting: none waits for the next
DEATHS = 4  # of workers in a row, without one task done between, before it is given up
CONNECT_S = 20.0
ENDS_S = 0.3  # for a worker to put its own things away

Row = dict[str, Any]
Work = Callable[[Any, Sequence[int]], list[Row]]


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


@dataclass(frozen=True)
class _Pool:
    """What `concurrent.futures` and Dask's client have in common."""

    submit: Callable[..., Any]
    wait: Callable[..., Any]  # of futures, until one is done
    workers: int


def run(
    work: Work, payload: Any, cells: Iterable[int], machine: Machine, size: int = 1
) -> Generator[list[Row], None, None]:
    """Rows of all cells, a task of `size` cells at a time, in the order in which they are done.

    Raises LinkError where no scheduler answers or it goes away, CheckFailed where workers die again and
    again, and what the work raises.
    """
    numbers = iter(cells)
    waiting: list[tuple[int, ...]] = []  # tasks to give out: the next, or those whose worker died
    deaths = 0
    while deaths < DEATHS:
        underway: dict[Any, tuple[int, ...]] = {}
        try:
            with _pool(machine) as pool:
                while True:
                    while len(underway) < AHEAD * pool.workers:
                        if not waiting and (task := tuple(islice(numbers, size))):
                            waiting.append(task)
                        if not waiting:
                            break
                        future = pool.submit(work, payload, waiting[-1])  # a broken pool refuses
                        underway[future] = waiting.pop()
                    if not underway:
                        return
                    for future in pool.wait(list(underway)).done:
                        rows = future.result()
                        del underway[future]
                        deaths = 0
                        yield rows
        except BrokenExecutor:
            deaths += 1
        except CancelledError as error:  # by nobody here: Dask does so when it lost its scheduler
            raise LinkError(machine.scheduler or "", "the scheduler is gone") from error
        except Exception as error:
            if type(error).__name__ != "KilledWorker":  # Dask's, which need not be installed
                raise
            deaths = DEATHS  # Dask has tried it several times itself
        waiting += underway.values()
    first, last = min(waiting)[0], max(max(task) for task in waiting)
    raise CheckFailed(f"workers died again and again at cells {first} to {last}: out of memory?")


@contextlib.contextmanager
def _pool(machine: Machine) -> Iterator[_Pool]:
    _interrupts.begin()
    if machine.scheduler is None:
        for name in ONE_THREAD:  # a process each: further threads would only wait for each other
            os.environ[name] = "1"
        executor = ProcessPoolExecutor(machine.here, multiprocessing.get_context("spawn"), _ignore_interrupt)
        try:
            yield _Pool(executor.submit, partial(wait, return_when="FIRST_COMPLETED"), machine.here)
        except (KeyboardInterrupt, GeneratorExit, BrokenExecutor):  # here, in what takes the rows, or killed
            _end_workers()  # one that waits for what a killed one held takes no notice of a termination
            raise
        finally:
            executor.shutdown(wait=True, cancel_futures=True)
        return
    try:
        import distributed
    except ImportError as error:
        raise InputError("`scheduler`", "", "Dask is needed: pip install 'coaxlink[cluster]'") from error
    for name in ("distributed", "distributed.client"):  # they log tracebacks of what is a line here
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(machine.scheduler, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise LinkError(machine.scheduler, "no Dask scheduler answers there") from error
    try:
        threads = sum(client.nthreads().values())
        if not threads:
            raise LinkError(machine.scheduler, "the scheduler has no workers")
        first_done = partial(distributed.wait, return_when="FIRST_COMPLETED")
        yield _Pool(partial(client.submit, pure=False), first_done, threads)
    finally:
        client.close()


def _ignore_interrupt() -> None:
    """A worker's start: Ctrl-C is for the process that hands out the work, which ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # a scratch folder is taken away


def _end_workers() -> None:
    """What they are at is done again by the next run; a flight takes seconds, and nobody waits for it."""
    end = time.monotonic() + ENDS_S
    workers = multiprocessing.active_children()
    for worker in workers:
        worker.terminate()
    for worker in workers:
        worker.join(max(end - time.monotonic(), 0.0))
        worker.kill()
