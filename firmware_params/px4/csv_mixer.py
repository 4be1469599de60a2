"""`mixer.csv` of the research fork UoA-DTRG: the mix itself on the SD card, one row an actuator, six columns.

Columns are [roll, pitch, yaw, thrust x, thrust y, thrust z], FRD, normalised as PX4's own mix (the fork's
DTRG_MIXER_NORM 0), so neither zeroing trap of the geometry table applies: only entries below 1e-3 become 0.
The file lies at /fs/microsd/etc/mixer.csv; DTRG_MIXER_CSV = 1 (DTRG_CSV_MIXER in its first versions, which
also want rows under 99 bytes) and a reboot make it fly. Geometry and anti-windup still come from CA_ROTORn_*.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_params.bounded import lines_of
from firmware_params.errors import ParamsFileError, TableError
from firmware_params.plain import plain
from firmware_params.px4.realise import SMALL_MIX, Px4Mix
from firmware_params.text import read_text

BOARD_PATH = "/fs/microsd/etc/mixer.csv"
FILE_NAME = "mixer.csv"
PARAMETERS = ("DTRG_MIXER_CSV", "DTRG_CSV_MIXER")  # as the fork's versions name the switch
MAX_ROWS, MAX_ROW_BYTES, MAX_CELL = 16, 99, 31


def mixer_csv(mix: ArrayLike) -> str:
    """The file of a mix (N, 6). Raises TableError for what the fork would refuse."""
    rows = np.asarray(mix, float)
    if rows.ndim != 2 or rows.shape[1] != 6 or not 1 <= len(rows) <= MAX_ROWS:
        raise TableError(f"mixer.csv holds 1..{MAX_ROWS} rows of 6 values, found {rows.shape}")
    if not np.isfinite(rows).all() or not rows.any():
        raise TableError("mixer.csv needs finite values that are not all zero")
    lines = [",".join(f"{value:.7g}" for value in row) for row in rows + 0.0]
    for number, line in enumerate(lines, start=1):
        if len(line) >= MAX_ROW_BYTES:
            raise TableError(
                f"mixer.csv row {number} has {len(line)} bytes, under {MAX_ROW_BYTES} are expected"
            )
    return "\n".join(lines) + "\n"


def read_mixer_csv(path: Path) -> NDArray[np.float64]:
    """The mix (N, 6) of a file, as the fork's parser takes it. Raises ParamsFileError with the line."""
    text = read_text(path)
    rows = []
    for number, line in lines_of(text):
        if not line.strip():
            continue
        cells = ["".join(cell.split()) for cell in line.split(",")]
        if len(cells) < 6:
            raise ParamsFileError(path, number, f"6 values are expected, found {len(cells)}")
        try:
            row = [float(cell) if cell else 0.0 for cell in cells]
        except ValueError as error:
            raise ParamsFileError(
                path, number, f"numbers are expected, found '{plain(line.strip(), 40)}'"
            ) from error
        if not all(map(math.isfinite, row)) or max(map(len, cells)) > MAX_CELL:
            raise ParamsFileError(
                path, number, f"finite values of at most {MAX_CELL} characters are expected"
            )
        rows.append(row[:6])
    if not rows or len(rows) > MAX_ROWS or not np.any(rows):
        raise ParamsFileError(
            path, 0, f"1..{MAX_ROWS} rows that are not all zero are expected, found {len(rows)}"
        )
    return np.array(rows, float)


def realise_csv(mix: ArrayLike, geometry: Px4Mix) -> Px4Mix:
    """What the fork makes of a mix: PX4's desaturation and curve over the file's matrix.

    `geometry` is what the vehicle's CA_ parameters realise to. Raises TableError when the rows do not match.
    """
    rows = np.asarray(mix, np.float32).astype(np.float64)
    if rows.shape != geometry.mix.shape:
        raise TableError(f"mixer.csv has {len(rows)} rows, CA_ROTOR_COUNT is {len(geometry.mix)}")
    rows[np.abs(rows) < SMALL_MIX] = 0.0
    return dataclasses.replace(geometry, mix=rows, scale=np.ones(6), warnings=())
