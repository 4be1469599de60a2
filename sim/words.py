"""What an autopilot says in words, as both send it: long texts in pieces of 50 bytes that share an id."""

from __future__ import annotations

import zlib

from pymavlink.dialects.v20 import common as m

PIECE = 50  # bytes of one STATUSTEXT


def spoken(severity: int, text: str) -> list[m.MAVLink_message]:
    """STATUSTEXT, one or more; a short text has id 0."""
    raw = text.encode()
    number = zlib.crc32(raw) & 0xFFFF | 1 if len(raw) > PIECE else 0
    return [
        m.MAVLink_statustext_message(severity, raw[at : at + PIECE], number, k)
        for k, at in enumerate(range(0, max(len(raw), 1), PIECE))
    ]
