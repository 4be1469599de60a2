"""Rows of a campaign as a Parquet dataset: FOLDER/rows, readable by DuckDB, pandas and polars at any time.

Rows are written every few seconds, in parts in the order of their coming. When all cells are there the parts
become one file sorted by cell: a finished campaign holds the same bytes whoever flew it, in whatever order.
FOLDER/manifest.json holds what decides the rows (the campaign's hash, versions, seeds) and the SHA-256 of
every file of rows, written before the file is. A file that is not what was written is put aside as
NAME.not-ours, and its cells are flown again; nothing is hashed a second time.
"""

from __future__ import annotations

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
from coaxlink.mavlink.locks import lock
from coaxlink.studies.engine import Row

if TYPE_CHECKING:
    import pyarrow as pa

FLUSH_S = 5.0
MANIFEST, LOCK, SORTED = "manifest.json", ".lock", "cells.parquet"
WHOLE, TEXT, YES, NUMBER = "int64", "string", "bool", "float64"  # kinds of columns, by Arrow's names


def _need_pyarrow() -> None:
    """Raise InputError where the extra is not installed."""
    try:
        import pyarrow  # noqa: F401
    except ImportError as error:
        problem = "pyarrow is needed for its rows: pip install 'coaxlink[campaign]'"
        raise InputError("campaign", "", problem) from error


class Dataset:
    """The rows of one campaign on disk; `columns` are their names and kinds, `cell` among them.

    Raises InputError where the folder holds another campaign, or another process writes it.
    """

    def __init__(
        self, folder: Path, columns: Mapping[str, str], cells: int, decides: Mapping[str, Any]
    ) -> None:
        _need_pyarrow()
        self.folder, self.columns, self.cells = folder, dict(columns), cells
        self.rows = folder / "rows"
        self._decides = {**decides, "columns": self.columns, "cells": cells, "versions": versions()}
        self._have: set[int] = set()
        self._hashes: dict[str, str] = {}  # of files of rows, by name
        self.put_aside: list[Path] = []  # files of rows that were not what was written
        self._fresh: list[Row] = []
        self._flushed = time.monotonic()

    def __enter__(self) -> Dataset:
        try:
            self.rows.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(self.folder, "", f"cannot be written ({error.strerror})") from error
        self._lock = (self.folder / LOCK).open("w")
        try:
            try:
                lock(self._lock.fileno(), wait=False)
            except BlockingIOError as error:
                raise InputError(self.folder, "", "another campaign is writing there now") from error
            self._refuse_another()
            self._have = self._vouched_for()
        except BaseException:
            self._lock.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()
        if self.done == self.cells:
            self._finish()
        self._lock.close()

    @property
    def done(self) -> int:
        """Cells that have their row."""
        return len(self._have)

    def missing(self) -> list[int]:
        """Cells without a row, in order."""
        return [number for number in range(self.cells) if number not in self._have]

    def add(self, rows: Sequence[Row]) -> None:
        """Take rows in; they are on disk some seconds later."""
        self._fresh += rows
        self._have |= {row["cell"] for row in rows}
        if time.monotonic() - self._flushed > FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Write what is not on disk yet."""
        import pyarrow as pa

        self._flushed = time.monotonic()
        if self._fresh:
            schema = pa.schema([(name, kind) for name, kind in self.columns.items()])
            numbers = [int(name[5:11]) for name in self._hashes if name.startswith("part-")]
            self._write(
                f"part-{max(numbers, default=-1) + 1:06d}.parquet", pa.Table.from_pylist(self._fresh, schema)
            )
            self._fresh = []

    def _write(self, name: str, table: pa.Table) -> None:
        """A file of rows, its hash first: a kill leaves a hash without a file, never a file without."""
        import pyarrow.parquet as pq

        stream = io.BytesIO()
        pq.write_table(table, stream, compression="zstd")
        self._hashes[name] = hashlib.sha256(stream.getvalue()).hexdigest()
        self._write_manifest(finished=False)
        files.write_atomic(self.rows / name, stream.getvalue())

    def _write_manifest(self, *, finished: bool) -> None:
        value = {**self._decides, "finished": finished, "rows": self._hashes}
        files.write_json(self.folder / MANIFEST, value)

    def _vouched_for(self) -> set[int]:
        """Cells in files that are what was written; the others are put aside."""
        cells: set[int] = set()
        for path in sorted(self.rows.glob("*.parquet")):
            if files.sha256(path) == self._hashes.get(path.name):
                (table,) = _read([path], None)
                found = set(table["cell"].to_pylist())
                kinds = {field.name: str(field.type) for field in table.schema}
                if kinds == _arrow_names(self.columns) and found <= set(range(self.cells)):
                    cells |= found
                    continue
            aside = path.with_name(f"{path.name}.not-ours")
            path.replace(aside)
            self.put_aside.append(aside)
        self._hashes = {name: h for name, h in self._hashes.items() if (self.rows / name).exists()}
        return cells

    def _refuse_another(self) -> None:
        """Raise InputError where what is there is of another campaign; say whose it is where nothing is."""
        path = self.folder / MANIFEST
        if path.exists():
            found = files.read_json(path)
            for key, wanted in self._decides.items():
                if not isinstance(found, dict) or found.get(key) != json.loads(json.dumps(wanted)):
                    problem = (
                        "the folder holds another campaign, or rows of another version: name another `out`"
                    )
                    raise InputError(path, key, problem)
            hashes = found.get("rows")
            self._hashes = hashes if isinstance(hashes, dict) else {}
        elif any(self.rows.iterdir()):
            raise InputError(self.rows, "", "rows without a manifest: name another `out`")
        else:
            self._write_manifest(finished=False)

    def _finish(self) -> None:
        """All parts as one sorted file; a kill in between leaves rows twice, which `read_rows` drops."""
        parts = list(self.rows.glob("part-*.parquet"))
        if parts:
            self._write(SORTED, read_rows(self.folder))
            for part in parts:
                part.unlink()
        self._hashes = {SORTED: self._hashes[SORTED]}
        self._write_manifest(finished=True)


def versions() -> dict[str, str]:
    """Of everything that may move the last bit of a row."""
    import numba
    import numpy
    import pyarrow
    import scipy

    found = {m.__name__: str(m.__version__) for m in (numba, numpy, pyarrow, scipy)}
    python = ".".join(map(str, sys.version_info[:2]))
    return {"coaxlink": __version__, "python": python, "machine": platform.machine(), **found}


def read_rows(folder: Path, names: Sequence[str] | None = None) -> pa.Table:
    """All rows of a campaign's folder in the order of their cells, each cell once.

    Raises InputError where no rows are, or one file is no Parquet.
    """
    _need_pyarrow()
    import numpy as np
    import pyarrow as pa

    paths = sorted((folder / "rows").glob("*.parquet"))
    if not paths:
        raise InputError(folder, "", "no rows there")
    table = pa.concat_tables(list(_read(paths, names)))
    _, first = np.unique(table["cell"].to_numpy(), return_index=True)
    return table.take(first).combine_chunks()


def columns_of(folder: Path) -> dict[str, Any]:
    """`read_rows` as numpy arrays (rows,) by name; NaN for a number that is missing."""
    table = read_rows(folder)
    return {name: table[name].to_numpy() for name in table.column_names}


def _read(paths: Sequence[Path], names: Sequence[str] | None) -> Iterator[pa.Table]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    for path in paths:
        try:
            yield pq.read_table(path, columns=names)
        except (OSError, pa.ArrowException) as error:
            problem = f"is no Parquet file ({str(error).splitlines()[0]}); remove it, its cells are run again"
            raise InputError(path, "", problem) from error


def _arrow_names(columns: Mapping[str, str]) -> dict[str, str]:
    import pyarrow as pa

    return {field.name: str(field.type) for field in pa.schema(list(columns.items()))}
