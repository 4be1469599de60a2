"""MAVLink 2 signing of a vehicle: one key and one book of timestamps for all its links.

As ArduPilot's `signing_streams` (GCS_Signing.cpp), shared between channels: what came by one link is a replay
on every other. The signature is checked before its timestamp is noted.
"""

from __future__ import annotations

import hashlib
import time
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

EPOCH_S = 1420070400  # 2015, where MAVLink's signing clock starts


class Signing:
    """The state of one vehicle; after a restart it knows the time of day again, and no sender."""

    def __init__(self, key: bytes) -> None:
        self._state = mavlink.MAVLinkSigning()
        self._state.secret_key, self._state.sign_outgoing = key, True
        self._state.timestamp = round((time.time() - EPOCH_S) * 1e5)
        self._key = key

    def attach(self, mav: Any) -> None:
        """Make an encoder or decoder sign and check."""
        mav.signing = self._state
        noted = mavlink.MAVLink.check_signature

        def check(frame: bytearray, system: int, component: int) -> bool:
            signature = hashlib.sha256(self._key + bytes(frame[:-6])).digest()[:6]
            return signature == bytes(frame[-6:]) and noted(mav, frame, system, component)

        mav.check_signature = check


def detach(mav: Any) -> None:
    """Neither sign nor check any more."""
    mav.signing = mavlink.MAVLinkSigning()
    mav.__dict__.pop("check_signature", None)
