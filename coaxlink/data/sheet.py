"""Spreadsheets (xlsx, xls, ods) as rows of text cells, read by a process of their own with limits."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path

from coaxlink import _interrupts
from coaxlink.data import sheet_reader
from coaxlink.data.layout import Row
from coaxlink.errors import InputError

MAGIC = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1")  # zip (xlsx, ods), OLE (xls)
MOST_BYTES, MOST_S = 1 << 30, 10  # of memory, of the processor: 2 million cells take 0.5 GB and 5 s
WAIT_S = 120.0  # of the clock, where the machine is busy or the system limits no processor time


def is_sheet(head: bytes) -> bool:
    """Whether a file that begins so is a spreadsheet."""
    return head.startswith(MAGIC)


def read_sheet(path: Path, name: str | None = None) -> tuple[list[Row], str]:
    """Rows in which something stands, and the sheet's name: the one requested, or the only one with numbers.

    Raises InputError: not a spreadsheet, no such sheet, several that have numbers, one that takes more than
    MOST_BYTES or MOST_S to read.
    """
    importlib.import_module("python_calamine")  # where it is absent, it is told here
    # -P: the modules beside the reader are not the standard library's
    command = [sys.executable, "-P", sheet_reader.__file__, str(MOST_BYTES), str(MOST_S), str(path)]
    try:
        _interrupts.begin()
        done = subprocess.run(
            [*command, *([] if name is None else [name])],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=WAIT_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        done = None
    if done is None or done.returncode:
        problem = f"takes more than {MOST_BYTES >> 30} GB or {MOST_S} s to read, or breaks its reader"
        raise InputError(path, "", f"{problem}: save the table as CSV")
    answer = json.loads(done.stdout)
    if "problem" in answer:
        raise InputError(answer["source"] or path, answer["where"], answer["problem"])
    return [(i, cells) for i, cells in answer["rows"]], answer["name"]
