"""A tlog: eight bytes of time (us since 1970, big endian), then the frame, over and over."""

from __future__ import annotations

import struct
import time
from pathlib import Path

from coaxlink.errors import InputError


class TLog:
    """What passed a line, as ground stations keep it."""

    def __init__(self, path: Path) -> None:
        """Start the file. Raises InputError."""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("wb")
        except OSError as error:
            raise InputError(path, "", f"cannot be written ({error.strerror})") from error

    def write(self, frame: bytes) -> None:
        """Keep a frame with the time of day; readers take time from the messages themselves."""
        self._file.write(struct.pack(">Q", time.time_ns() // 1000) + frame)

    def close(self) -> None:
        """Finish the file."""
        self._file.close()
