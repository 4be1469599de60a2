"""Logs of what a client flew: CSV and tlog of one flight agree, and are stamped by the vehicle's clock."""

import math
import os
import time
from pathlib import Path

import numpy as np
import pytest

os.environ.setdefault("MAVLINK20", "1")
from pymavlink import mavutil

from sim.testing import standin


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_a_clients_flight_is_kept(tmp_path: Path, firmware: str) -> None:
    csv, tlog = tmp_path / "a.csv", tmp_path / "a.tlog"
    logs = ["--log", str(csv), "--tlog", str(tlog)]
    with standin("--firmware", firmware, "--speed", "5", "--wire", "loss=0.1", *logs) as port:
        address = f"udpout:127.0.0.1:{port}"
        link = mavutil.mavlink_connection(address, source_system=255, dialect="ardupilotmega")
        link.mav.heartbeat_send(6, 8, 0, 0, 4)
        assert link.wait_heartbeat(timeout=600) is not None
        height, end = 0.0, time.monotonic() + 600.0
        while height < 1.6:  # above the origin, 0.2 m higher in the log
            assert time.monotonic() < end
            if height < 0.3:  # any of these may be lost on the way
                if firmware == "ardupilot":  # it streams what it is asked for
                    link.mav.command_long_send(1, 1, 511, 0, 32, 20_000, 0, 0, 0, 0, 0)
                    link.mav.command_long_send(1, 1, 176, 0, 1, 4, 0, 0, 0, 0, 0)
                link.mav.command_long_send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
                up = 3.0 if firmware == "ardupilot" else math.nan
                link.mav.command_long_send(1, 1, 22, 0, 0, 0, 0, math.nan, math.nan, math.nan, up)
            position = link.recv_match(type="LOCAL_POSITION_NED", blocking=True, timeout=0.3)
            height = height if position is None else -position.z
        link.close()
    rows = np.genfromtxt(csv, delimiter=",", names=True)
    assert rows["height_m"].max() > 1.5 and len(rows) > 500
    assert np.diff(rows["time_s"]) == pytest.approx(0.008)
    reader = mavutil.mavlink_connection(str(tlog), dialect="ardupilotmega")
    by_type: dict[str, list] = {}
    while (message := reader.recv_match()) is not None:
        by_type.setdefault(message.get_type(), []).append(message)
    reader.close()
    needed = {"HEARTBEAT", "ATTITUDE", "LOCAL_POSITION_NED", "SERVO_OUTPUT_RAW", "DISTANCE_SENSOR"}
    assert needed <= set(by_type)
    positions = by_type["LOCAL_POSITION_NED"]
    gaps = np.diff([p.time_boot_ms for p in positions])
    assert np.median(gaps) == 20 and gaps.max() <= 24  # none lost: the log has no wire
    assert positions[-1]._timestamp == pytest.approx(positions[-1].time_boot_ms / 1000, abs=0.01)
    top = max(-p.z for p in positions)
    assert top == pytest.approx(rows["height_m"].max() - 0.2, abs=0.15)  # the origin stands 0.2 m high
