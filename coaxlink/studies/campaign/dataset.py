"""Rows of a campaign as a Parquet dataset: FOLDER/rows, readable by DuckDB, pandas and polars at any time.

Rows are written as they are done, in loose files in the order of their coming. As soon as all cells of a
range of RANGE are there, they become one file, sorted by cell, and the loose ones go: a finished campaign
holds the same bytes whoever flew it, in whatever order. FOLDER/manifest.json holds what decides the rows (the
campaign's hash, versions, seeds) and, at the end, each file's SHA-256. Only the rows of ranges under way are
in memory.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import platform
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coaxlink import files
from coaxlink._version import __version__
from coaxlink.errors import InputError
from coaxlink.studies.campaign.engine import Rows

if TYPE_CHECKING:
    import pyarrow as pa

RANGE = 1000  # cells of a sorted file
FLUSH_S, FLUSH_ROWS = 5.0, 2000  # loose rows are written this often
MANIFEST, LOCK = "manifest.json", ".lock"
WHOLE, TEXT, YES, NUMBER = "int64", "string", "bool", "float64"


def need_pyarrow() -> None:
    """Raise InputError where the extra is not installed."""
    try:
        import pyarrow  # noqa: F401
    except ImportError as error:
        problem = "pyarrow is needed for its rows: pip install 'coaxlink[campaign]'"
        raise InputError("campaign", "", problem) from error


class Dataset:
    """The rows of one campaign on disk; `columns` are its names and kinds, the first one the cell's number.

    Raises InputError where the folder holds another campaign, or another process writes it.
    """

    def __init__(
        self, folder: Path, columns: Mapping[str, str], cells: int, decides: Mapping[str, Any]
    ) -> None:
        need_pyarrow()
        self.folder, self.columns, self.cells = folder, dict(columns), cells
        self.rows = folder / "rows"
        self._key = next(iter(columns))
        self._decides = {**decides, "columns": self.columns, "cells": cells, "versions": versions()}
        self._open: dict[int, dict[int, tuple[Any, ...]]] = {}  # range: cell: row
        self._fresh: list[tuple[Any, ...]] = []
        self._flushed = time.monotonic()
        self._loose: dict[Path, set[int]] = {}
        self._settled: set[int] = set()  # ranges that are one file
        self.done = 0

    def __enter__(self) -> Dataset:
        try:
            self.rows.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(self.folder, "", f"cannot be written ({error.strerror})") from error
        self._lock = (self.folder / LOCK).open("w")
        with contextlib.suppress(ImportError):  # Windows
            import fcntl

            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                self._lock.close()
                raise InputError(self.folder, "", "another campaign is writing there now") from error
        try:
            self._resume()
        except BaseException:
            self._lock.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()
        if self.complete:
            self._finish()
        self._lock.close()

    @property
    def complete(self) -> bool:
        """Whether every cell has its row."""
        return self.done == self.cells

    def missing(self) -> Iterator[int]:
        """Cells without a row when it was opened, in order."""
        have = {number for rows in self._open.values() for number in rows}
        settled = set(self._settled)
        for number in range(self.cells):
            if number // RANGE not in settled and number not in have:
                yield number

    def add(self, rows: Rows) -> None:
        """Take rows in; what is there already is left as it is."""
        for row in zip(*(rows[name] for name in self.columns), strict=True):
            number = int(row[0])
            if number // RANGE in self._settled or number in self._open.get(number // RANGE, {}):
                continue
            self._open.setdefault(number // RANGE, {})[number] = row
            self._fresh.append(row)
            self.done += 1
        full = [k for k, finished_rows in self._open.items() if len(finished_rows) == self._size(k)]
        for k in full:
            self._settle(k)
        if len(self._fresh) >= FLUSH_ROWS or time.monotonic() - self._flushed > FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Write what is not on disk yet, as a loose file."""
        self._flushed = time.monotonic()
        if not self._fresh:
            return
        numbers = {int(row[0]) for row in self._fresh}
        tag = hashlib.sha256(repr(sorted(numbers)).encode()).hexdigest()[:8]
        path = self.rows / f"loose-{min(numbers):09d}-{tag}.parquet"
        _write(path, self.columns, self._fresh)
        self._loose[path] = numbers
        self._fresh = []

    def _size(self, k: int) -> int:
        return min(RANGE, self.cells - k * RANGE)

    def _file(self, k: int) -> Path:
        return self.rows / f"cells-{k * RANGE:09d}.parquet"

    def _settle(self, k: int) -> None:
        """All rows of a range as one sorted file; loose files that are no longer needed go."""
        finished_rows = self._open.pop(k)
        _write(self._file(k), self.columns, [finished_rows[number] for number in sorted(finished_rows)])
        self._settled.add(k)
        self._fresh = [row for row in self._fresh if int(row[0]) // RANGE != k]
        for path, numbers in list(self._loose.items()):
            numbers -= set(finished_rows)
            if not numbers:
                path.unlink(missing_ok=True)
                del self._loose[path]

    def _resume(self) -> None:
        """Take up what is there. Raises InputError where it is of another campaign."""
        path = self.folder / MANIFEST
        if path.exists():
            found = files.read_json(path)
            for key, wanted in self._decides.items():
                if not isinstance(found, dict) or found.get(key) != json.loads(json.dumps(wanted)):
                    problem = (
                        "the folder holds another campaign, or rows of another version: name another `out`"
                    )
                    raise InputError(path, key, problem)
        elif any(self.rows.iterdir()):
            raise InputError(self.rows, "", "rows without a manifest: name another `out`")
        else:
            files.write_json(path, {**self._decides, "finished": False})
        for k in range(-(-self.cells // RANGE)):
            if self._file(k).exists():
                self._settled.add(k)
                self.done += self._size(k)
        for loose in sorted(self.rows.glob("loose-*.parquet")):
            table = read_table(loose)
            rows = list(zip(*(table[name].to_pylist() for name in self.columns), strict=True))
            numbers = set()
            for row in rows:
                k = int(row[0]) // RANGE
                if k in self._settled:
                    continue  # killed between writing the range and removing this
                numbers.add(int(row[0]))
                if int(row[0]) not in self._open.setdefault(k, {}):
                    self._open[k][int(row[0])] = row
                    self.done += 1
            if numbers:
                self._loose[loose] = numbers
            else:
                loose.unlink()
        for k in [k for k, finished_rows in self._open.items() if len(finished_rows) == self._size(k)]:
            self._settle(k)

    def _finish(self) -> None:
        hashes = {path.name: files.sha256(path) for path in sorted(self.rows.glob("cells-*.parquet"))}
        files.write_json(self.folder / MANIFEST, {**self._decides, "finished": True, "rows": hashes})


def versions() -> dict[str, str]:
    """Of everything that may move the last bit of a row."""
    import numba
    import numpy
    import pyarrow
    import scipy

    found = {m.__name__: str(m.__version__) for m in (numba, numpy, pyarrow, scipy)}
    python = ".".join(map(str, sys.version_info[:2]))
    return {"coaxlink": __version__, "python": python, "machine": platform.machine(), **found}


def columns_of(folder: Path, names: Sequence[str] | None = None) -> dict[str, Any]:
    """Columns (rows,) of a dataset in the order of cells, numpy arrays by name; NaN for what is missing.

    Raises InputError where no rows are.
    """
    need_pyarrow()
    import numpy as np
    import pyarrow.parquet as pq

    paths = sorted((folder / "rows").glob("*.parquet"))
    if not paths:
        raise InputError(folder, "", "no rows there")
    tables = [pq.read_table(path, columns=names) for path in paths]
    merged: dict[str, Any] = {}
    for name in tables[0].column_names:
        parts = [t[name].to_numpy(zero_copy_only=False) for t in tables]
        merged[name] = np.concatenate(parts)
    key = tables[0].column_names[0] if names is None else None
    if key is not None:
        _, first = np.unique(merged[key], return_index=True)  # a reader may come between two renames
        merged = {name: column[first] for name, column in merged.items()}
    return merged


def read_table(path: Path) -> pa.Table:
    """One Parquet file. Raises InputError where it is none."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        problem = f"is no Parquet file ({str(error).splitlines()[0]}); remove it, its cells are run again"
        raise InputError(path, "", problem) from error


def _write(path: Path, columns: Mapping[str, str], rows: Sequence[tuple[Any, ...]]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {WHOLE: pa.int64(), TEXT: pa.string(), YES: pa.bool_(), NUMBER: pa.float64()}
    schema = pa.schema([(name, kinds[kind]) for name, kind in columns.items()])
    table = pa.table([list(column) for column in zip(*rows, strict=True)], schema=schema)
    stream = io.BytesIO()
    pq.write_table(table, stream, compression="zstd")
    files.write_atomic(path, stream.getvalue())
