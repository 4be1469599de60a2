"""mix.live as a flight log: its commands, and the rest from the mix.tlog beside it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.data import read_flight_log
from coaxlink.errors import InputError
from coaxlink.live.guard import LIVE
from coaxlink.live.record import LiveRecord


def test_the_commands_are_the_records_and_the_motion_the_tlogs(tmp_path: Path) -> None:
    path, packer = tmp_path / "mix.live", mavlink.MAVLink(None, 1, 1)
    record, frames = LiveRecord(path, {"law": "exact", "airframe": "X8", "rotors": 8}), b""
    for k in range(200):
        us = 5_000_000 + 20_000 * k
        record.add(
            us, 0.02 * k, (0.0,) * 4, [0.4 + 0.001 * k + 0.01 * n for n in range(8)], (0.0,) * 4, 1e-4, LIVE
        )
        for message in (
            mavlink.MAVLink_heartbeat_message(14, 12, 128, 0, 4, 3),
            mavlink.MAVLink_highres_imu_message(us, 0.0, 0.0, -9.8, 0.1, 0.0, 0.0, *[0.0] * 7, 0x3F, 0),
            mavlink.MAVLink_attitude_message(us // 1000, 0.0, 0.0, 0.2, 0.1, 0.0, 0.0),
        ):
            frames += struct.pack(">Q", 1_700_000_000_000_000 + 20_000 * k) + message.pack(packer)
    record.close()
    with pytest.raises(InputError, match=r"mix\.tlog .* is needed beside it"):
        read_flight_log(path)
    path.with_suffix(".tlog").write_bytes(frames)
    log = read_flight_log(path)
    np.testing.assert_allclose(log["motor8"], 0.47 + 0.05 * (log["time_s"] - 5.0), atol=1e-5)
    assert log.source == str(path) and log.rows > 190 and not log.premises
    np.testing.assert_allclose(log["gyro_x_rad_s"], 0.1, atol=1e-6)
