"""What a board itself says its parameters may be: the `parameters.json.xz` that ground stations fetch.

PX4 keeps it in its own image and serves it by MAVFTP; it belongs to one build, so it is read once a build and
kept in the state folder. A board that has none is checked by our own table alone.
"""

from __future__ import annotations

import lzma
from collections.abc import Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from coaxlink import files
from coaxlink.errors import CheckFailed, InputError, SafetyRefusal
from coaxlink.files import state_folder
from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.identity import Identity
from firmware_params import bounded

PATH = "/etc/extras/parameters.json.xz"
_LARGEST = 8_000_000  # bytes unpacked; PX4's has 1.2 million
_MEMORY = 64 << 20  # bytes that unpacking may take; xz -6, as PX4 packs it, takes 9 MB


@dataclass(frozen=True)
class Limits:
    """Both inclusive; None where the board names none."""

    minimum: float | None
    maximum: float | None
    volatile: bool = False  # the firmware changes it by itself


def board_limits(board: Files, identity: Identity) -> Mapping[str, Limits] | None:
    """Limits by name as the board has them, None when it has none to read. Raises LinkError."""
    if not (identity.capabilities or 0) & mavlink.MAV_PROTOCOL_CAPABILITY_FTP:
        return None
    cached = state_folder() / f"parameters-{identity.git_hash}.json" if identity.git_hash.strip("0") else None
    try:
        if cached and cached.exists():
            return parse_limits(files.read_text(cached))
        data = board.read(PATH)
        if data is None:
            return None
        text = lzma.LZMADecompressor(memlimit=_MEMORY).decompress(data, _LARGEST).decode()
        limits = parse_limits(text)
        if cached:
            files.write_atomic(cached, text)
        return limits
    except (
        CheckFailed,
        InputError,
        bounded.Unreadable,
        lzma.LZMAError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
    ):
        return None  # its own list is a second opinion; ours stands


def parse_limits(text: str) -> dict[str, Limits]:
    """The limits in a `parameters.json`. Raises Unreadable, ValueError, KeyError, TypeError on
    anything else."""
    found = {}
    for row in bounded.parse_json(text)["parameters"]:
        low, high = (None if row.get(key) is None else float(row[key]) for key in ("min", "max"))
        found[str(row["name"])] = Limits(low, high, bool(row.get("volatile", False)))
    return found


def refuse_beyond(params: Mapping[str, float | int], limits: Mapping[str, Limits], firmware: str) -> None:
    """Raise SafetyRefusal for a value that the board's own list does not allow."""
    for name, value in params.items():
        known = limits.get(name, Limits(None, None))
        low = float("-inf") if known.minimum is None else known.minimum
        high = float("inf") if known.maximum is None else known.maximum
        slack = 1e-6 * max(abs(value), 1.0)  # its numbers are decimal, the value a float32
        if not low - slack <= value <= high + slack:
            raise SafetyRefusal(
                f"{name} = {value:g} is outside {low:g}..{high:g}, the limits of this {firmware}"
            )
