"""Messages by their bytes beside pymavlink's own parser: MAVLink 1 and 2, signed, cut, garbled."""

from __future__ import annotations

import random
import struct
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

import firmware_params.ardupilot.messages
import firmware_params.px4.messages  # noqa: F401  teaches the dialect
from coaxlink.data.logs.mavlink_frames import heard, stamped_frames
from coaxlink.data.logs.tlog import NAMES

KINDS = [kind for kind in common.mavlink_map.values() if kind.msgname in NAMES]


def random_message(kind, dice: random.Random) -> common.MAVLink_message:
    """Of numbers and zeros: zeros at the end are cut on the wire."""
    values = []
    counts = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    for name, form in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        of_one = (lambda: dice.uniform(-9, 9)) if form == "float" else (lambda: dice.choice([0, 1, 100]))
        values.append(
            b"CA_ROTOR0_PX" if form == "char" else [of_one() for _ in range(counts[name])] or of_one()
        )
    return kind(*values)


@pytest.mark.parametrize("version", ["1", "2", "signed"])
def test_fields_are_those_that_pymavlink_reads(tmp_path: Path, version: str) -> None:
    dice, data, garbled = random.Random(version), bytearray(), 0
    expected: dict[tuple[int, int], dict[str, list]] = defaultdict(lambda: defaultdict(list))
    senders = [common.MAVLink(None, srcSystem=1, srcComponent=component) for component in (1, 191)]
    if version == "signed":
        for sender in senders:
            sender.signing.secret_key, sender.signing.sign_outgoing = bytes(32), True
    parser = common.MAVLink(None)
    kinds = [kind for kind in KINDS if version != "1" or kind.id < 256]
    for k in range(20 * len(kinds)):
        sender = dice.choice(senders)
        frame = bytearray(
            random_message(kinds[k % len(kinds)], dice).pack(sender, force_mavlink1=version == "1")
        )
        if dice.random() < 0.1:
            frame[8 if version == "1" else 11] ^= 1
        data += struct.pack(">Q", k) + frame
        try:
            message = parser.decode(frame)
        except common.MAVError:
            garbled += 1
            continue
        expected[message.get_srcSystem(), message.get_srcComponent()][message.get_type()].append((k, message))
    path = tmp_path / "a.tlog"
    path.write_bytes(data + bytes(8) + b"\xfd\x09\0")  # the last frame is torn

    found = heard(path, NAMES)
    assert found.garbled == garbled > 0 and found.left == 11
    assert [stamp for stamp, _ in stamped_frames(path)] == list(range(20 * len(kinds)))
    assert {who: set(rows) for who, rows in found.rows.items()} == {w: set(s) for w, s in expected.items()}
    for who, rows in found.rows.items():
        for name, one in rows.items():
            numbers, messages = zip(*expected[who][name], strict=True)
            assert one.at.tolist() == list(numbers)
            for field in one.fields.dtype.names:
                of_pymavlink = [getattr(message, field) for message in messages]
                if field == "param_id":
                    of_pymavlink = [text.encode() for text in of_pymavlink]
                np.testing.assert_array_equal(
                    one.fields[field], np.array(of_pymavlink, one.fields[field].dtype)
                )
