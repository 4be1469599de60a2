"""MAVLink 2 signing: a key file only its owner can read, timestamps that never go back, replays refused.

Every message out is signed, every message in must be (radio status alone excepted). The last timestamps, ours
and each sender's, are kept on disk, so a recording of yesterday's flight is refused today.
"""

from __future__ import annotations

import hashlib
import json
import stat
import time
from pathlib import Path
from typing import Any

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import common as mavlink

from coaxlink import files
from coaxlink.errors import InputError, SafetyRefusal

_EPOCH_S = 1420070400  # 2015-01-01, where MAVLink's signing clock starts
_TICKS = 100_000  # a second, in its 10 us
_UNSIGNED_OK = (
    {mavlink.MAVLINK_MSG_ID_RADIO_STATUS} if hasattr(mavlink, "MAVLINK_MSG_ID_RADIO_STATUS") else {109}
)


def load_key(path: Path) -> bytes:
    """The 32 bytes of a key: raw, 64 hex digits, or a passphrase (its SHA-256, as ground stations do).

    Raises InputError when it cannot be read, SafetyRefusal when others can read it.
    """
    try:
        mode = path.stat().st_mode
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, "", f"the signing key cannot be read ({error.strerror})") from error
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise SafetyRefusal(
            f"the signing key {path} can be read by others (mode {mode & 0o777:o}): chmod 600 it"
        )
    if len(data) == 32:
        return data
    text = data.strip()
    if not text:
        raise InputError(
            path, "", "an empty signing key: 32 bytes, 64 hex digits or a passphrase are expected"
        )
    if len(text) == 64:
        try:
            return bytes.fromhex(text.decode("ascii"))
        except ValueError:
            pass
    return hashlib.sha256(text).digest()


class Signer:
    """The signing state of one session: shared by its sender and its receiver."""

    def __init__(self, key: bytes, folder: Path, link_id: int = 1) -> None:
        self.state = mavlink.MAVLinkSigning()
        self.state.secret_key = key
        self.state.sign_outgoing = True
        self.state.link_id = link_id
        self.state.allow_unsigned_callback = self._unsigned
        self.unsigned = 0  # messages refused because nobody signed them
        name = hashlib.sha256(b"coaxlink" + key).hexdigest()[:16]
        self._path = folder / f"{name}.signing.json"
        self._load()

    def attach(self, mav: Any) -> None:
        """Make a pymavlink encoder or decoder sign and check."""
        mav.signing = self.state
        plain = mav.check_signature

        def check(frame: bytearray, system: int, component: int) -> bool:
            stream = (frame[-13], system, component)
            last = self.state.stream_timestamps.get(stream)
            if plain(frame, system, component):
                return True
            if last is None:  # a forged frame must not move the clock of the true sender
                self.state.stream_timestamps.pop(stream, None)
            else:
                self.state.stream_timestamps[stream] = last
            return False

        mav.check_signature = check

    def tick(self) -> None:
        """Before a message is signed: the clock moves on with the time of day."""
        now = int((time.time() - _EPOCH_S) * _TICKS)
        self.state.timestamp = max(self.state.timestamp, now)

    def seal(self, frame: bytes, seed: bytes) -> bytes:
        """An unsigned MAVLink 2 frame, of a message with that CRC seed, signed as pymavlink would."""
        self.tick()
        state = self.state
        body = bytearray(frame[:-2])
        body[2] |= 0x01  # the checksum covers the flag
        body += mcrf4xx(bytes(body[1:]) + seed).to_bytes(2, "little")
        body += bytes([state.link_id]) + int(state.timestamp).to_bytes(6, "little")
        state.timestamp += 1
        return bytes(body) + hashlib.sha256(state.secret_key + body).digest()[:6]

    @property
    def refused(self) -> int:
        """Messages that came unsigned, with another key, or twice."""
        return self.unsigned + int(self.state.reject_count)

    def save(self) -> None:
        """Keep the timestamps. Raises InputError."""
        streams = [[*stream, last] for stream, last in list(self.state.stream_timestamps.items())]
        files.write_json(self._path, {"timestamp": self.state.timestamp, "streams": streams})

    def _load(self) -> None:
        if self._path.exists():
            try:
                raw = json.loads(files.read_text(self._path))
                self.state.timestamp = int(raw["timestamp"]) + 1
                self.state.stream_timestamps = {(a, b, c): int(last) for a, b, c, last in raw["streams"]}
            except (ValueError, KeyError, TypeError) as error:
                raise InputError(
                    self._path, "", f"damaged ({error}); without it replays cannot be told"
                ) from error
        self.tick()

    def _unsigned(self, mav: Any, message_id: int) -> bool:
        if message_id in _UNSIGNED_OK:
            return True
        self.unsigned += 1
        return False
