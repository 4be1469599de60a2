"""MAVLink 2 signing: a key file only its owner can read, timestamps that never go back, replays refused.

Every message out is signed, every message in must be (radio status alone excepted). The timestamps, ours and
each sender's, are on disk ahead of their use (`signing_book`): a recording is refused, also after kill -9.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import stat
import time
from pathlib import Path
from typing import Any

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.mavlink.signing_timestamps import END, TICKS, Book
from firmware_params import bounded

_EPOCH_S = 1420070400  # 2015-01-01, where MAVLink's signing clock starts
_KEY_FILE = 4096  # bytes; a passphrase is shorter
NEW_STREAM = 60 * TICKS  # a sender never heard may be so far behind: MAVLink's rule
_UNSIGNED_OK = (
    {mavlink.MAVLINK_MSG_ID_RADIO_STATUS} if hasattr(mavlink, "MAVLINK_MSG_ID_RADIO_STATUS") else {109}
)


def load_key(path: Path) -> bytes:
    """The 32 bytes of a key: raw, 64 hex digits, or a passphrase (its SHA-256, as ground stations do).

    Raises InputError when it cannot be read, SafetyRefusal when others can read it.
    """
    try:
        mode = path.stat().st_mode
        data = bounded.read_bytes(path, _KEY_FILE)
    except bounded.Unreadable as error:
        raise InputError(path, error.where, f"the signing key: {error.problem}") from error
    except OSError as error:
        raise InputError(path, "", f"the signing key cannot be read ({error.strerror})") from error
    if os.name != "nt" and mode & (stat.S_IRWXG | stat.S_IRWXO):  # Windows keeps its rights elsewhere
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


def _now() -> int:
    return int((time.time() - _EPOCH_S) * TICKS)


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
        self._book = Book(folder / f"{name}.signing.json")
        self.state.stream_timestamps = dict(self._book.heard)
        # above every sender's, too: who hears us raises its clock to ours, and is past what it sent before
        self.state.timestamp = max(self._book.sent, *self._book.heard.values(), 0) + 1
        if self.state.timestamp >= END:
            problem = "the timestamps of this key are used up (a clock was wrong by decades): take a new key"
            self._book.leave()
            raise InputError(self._book.path, "", problem)
        if _now() >= END:
            self._book.leave()
            today = time.strftime("%Y-%m-%d", time.gmtime(time.time()))
            problem = f"{today} is beyond signing's timestamps: set it right"
            raise InputError("the clock of this machine", "", problem)
        self.tick(cover=False)
        self._book.begin(self.state.timestamp)

    def attach(self, mav: Any) -> None:
        """Make a pymavlink encoder or decoder sign and check."""
        mav.signing = self.state

        def check(frame: bytearray, system: int, component: int) -> bool:
            if not self.genuine(bytes(frame)):  # a forged frame must not move the clock of the true sender
                return False
            stream, stamp = (frame[-13], system, component), int.from_bytes(frame[-12:-6], "little")
            clock = max(self.state.timestamp, stamp)
            self._book.cover(clock, {stream: stamp})
            self.state.stream_timestamps[stream] = stamp
            self.state.timestamp = max(self.state.timestamp, stamp)
            return True

        mav.check_signature = check

    def genuine(self, frame: bytes) -> bool:
        """Whether a frame is signed with this key and new; who was heard when is not noted."""
        if len(frame) < 25 or frame[0] != 0xFD or not frame[2] & 0x01:
            return False
        stream, stamp = (frame[-13], frame[5], frame[6]), int.from_bytes(frame[-12:-6], "little")
        last = self.state.stream_timestamps.get(stream, self.state.timestamp - NEW_STREAM)
        signature = hashlib.sha256(self.state.secret_key + frame[:-6]).digest()[:6]
        return last < stamp < END and hmac.compare_digest(signature, frame[-6:])

    def tick(self, *, cover: bool = True) -> None:
        """Before a message is signed: the clock moves on with the time of day."""
        now = _now()
        self.state.timestamp = max(self.state.timestamp, now if now < END else 0)
        if cover:
            self._book.cover(self.state.timestamp, {})

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

    @property
    def trouble(self) -> str:
        """Why the timestamps cannot be kept just now, "" while they can."""
        return self._book.trouble

    def close(self) -> None:
        """Nothing more is sent or believed: keep the timestamps as they are. Raises InputError."""
        self._book.close(self.state.timestamp, dict(self.state.stream_timestamps))

    def _unsigned(self, mav: Any, message_id: int) -> bool:
        if message_id in _UNSIGNED_OK:
            return True
        self.unsigned += 1
        return False
