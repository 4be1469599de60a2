"""Missions by the protocol, flown on both stand-ins by bare pymavlink and by MAVSDK."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from ground import client, command, get, mavsdk_system, until
from mavsdk.plugins.action import Action
from mavsdk.plugins.mission import Mission, MissionItem, MissionPlan
from mavsdk.plugins.telemetry import FlightMode, Telemetry
from pymavlink.dialects.v20 import common as m

from sim.testing import standin

LAT, LON, METRE = 47.397742, 8.545594, 1 / 111319.49
WAYPOINT, RTL, LAND, TAKEOFF, JUMP = 16, 20, 21, 22, 177


@contextmanager
def flown(*arguments: str) -> Iterator[Any]:
    with standin(*arguments) as port, client(port) as link:
        yield link


def item(seq: int, number: int, north: float, east: float, up: float, *p: float, frame: int = 6) -> Any:
    params = [*p, *[0.0] * (3 - len(p)), math.nan]
    lon = LON + east * METRE / math.cos(math.radians(LAT))
    x, y = round(1e7 * (LAT + north * METRE)), round(1e7 * lon)
    return m.MAVLink_mission_item_int_message(1, 1, seq, frame, number, 0, 1, *params, x, y, up, 0)


def upload(link: Any, items: list[Any]) -> tuple[int, list[int]]:
    """Result of the upload, and what was asked for."""
    link.mav.mission_count_send(1, 1, len(items), 0)
    requested = []
    while (answer := get(link, ["MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK"])) is not None:
        if answer.get_type() == "MISSION_ACK":
            return answer.type, requested
        requested.append(answer.seq)
        link.mav.send(items[answer.seq])
    raise AssertionError(f"the upload ends without a word after {requested}")


def square(first: int) -> list[Any]:
    """Up, two corners, and down at the second; ArduPilot's first item is home."""
    home = [item(0, WAYPOINT, 0, 0, 0, frame=0)] if first else []
    flown = [
        item(first, TAKEOFF, 0, 0, 3.0),
        item(first + 1, WAYPOINT, 4, 0, 3.0, 0.5, 0.4),
        item(first + 2, WAYPOINT, 4, 4, 4.0, 0, 0.4),
        item(first + 3, LAND, 4, 4, 0),
    ]
    return home + flown


@pytest.mark.parametrize(("firmware", "first", "mode"), [("px4", 0, 67371008), ("ardupilot", 1, 3)])
def test_pymavlink_flies_a_mission(firmware: str, first: int, mode: int) -> None:
    with flown("--firmware", firmware, "--speed", "8") as link:
        items = square(first)
        result, requested = upload(link, items)
        assert result == 0 and sorted(set(requested)) == list(range(len(items)))
        link.mav.mission_request_list_send(1, 1, 0)
        assert get(link, "MISSION_COUNT").count == len(items)
        for sent in items:
            link.mav.mission_request_int_send(1, 1, sent.seq, 0)
            back = get(link, "MISSION_ITEM_INT", met=lambda i, seq=sent.seq: i.seq == seq)
            assert (back.command, back.frame, back.x, back.y) == (sent.command, sent.frame, sent.x, sent.y)
        link.mav.mission_ack_send(1, 1, 0, 0)
        for unread in (30, 31, 83, 85, 105, 132, 291, 375):
            link.mav.command_long_send(1, 1, 511, 0, unread, -1, 0, 0, 0, 0, 0)
        assert command(link, 511, 32, 100000) == 0 and command(link, 511, 42, 500000) == 0
        if first:  # ArduCopter is armed in GUIDED, and AUTO waits for a start
            assert command(link, 176, 1, 4) == 0 and command(link, 400, 1) == 0
            assert command(link, 176, 1, 3) == 0
        assert command(link, 300) == 0
        if not first:
            assert get(link, "HEARTBEAT", met=lambda h: h.base_mode & 128 > 0) is not None
        reached, modes, path = [], set(), []
        while (message := get(link, ["MISSION_ITEM_REACHED", "LOCAL_POSITION_NED", "HEARTBEAT"])) is not None:
            kind = message.get_type()
            if kind == "MISSION_ITEM_REACHED":
                reached.append(message.seq)
            elif kind == "LOCAL_POSITION_NED":
                path.append((message.x, message.y, message.z))
            elif message.get_srcSystem() == 1:
                modes.add(message.custom_mode)
                if not message.base_mode & 128 and reached:
                    break
        assert mode in modes
        assert reached == [first, first + 1, first + 2, first + 3]
        for corner in ((4, 0, -3), (4, 4, -4)):
            assert min(math.dist(p, corner) for p in path) < 0.5
        assert math.dist(path[-1][:2], (4, 4)) < 0.5 and path[-1][2] > -0.3
        assert all(p[0] < 0.5 for p in path if -p[2] < 1.0 and p[1] < 1.0)  # it went straight up first


def test_what_cannot_be_flown_is_refused() -> None:
    with flown("--speed", "4") as link:
        assert command(link, 176, 1, 4, 4) == 0 and command(link, 300) == 2  # no mission yet
        assert upload(link, [item(0, 31010, 0, 0, 0)])[0] == 3
        assert upload(link, [item(0, WAYPOINT, 0, 0, 3, frame=17)])[0] == 2
        assert upload(link, [item(0, WAYPOINT, 0, 0, math.nan)])[0] == 5
        link.mav.mission_count_send(1, 1, 2, 0)
        requested = [get(link, "MISSION_REQUEST_INT").seq for _ in range(3)]
        assert requested == [0, 0, 0]  # what does not come is asked for again
        link.mav.send(item(1, WAYPOINT, 0, 0, 3))  # not what was asked for
        assert get(link, "MISSION_REQUEST_INT").seq == 0
        assert get(link, "MISSION_ACK").type == 15
        assert upload(link, [item(0, WAYPOINT, 0, 0, 3)])[0] == 0
        link.mav.mission_request_int_send(1, 1, 7, 0)
        assert get(link, "MISSION_ACK").type == 13
        link.mav.mission_clear_all_send(1, 1, 255)
        assert get(link, "MISSION_ACK").type == 0
        link.mav.mission_request_list_send(1, 1, 0)
        assert get(link, "MISSION_COUNT").count == 0


def test_an_ardupilot_mission_starts_with_a_takeoff_and_jumps() -> None:
    with flown("--firmware", "ardupilot", "--speed", "8") as link:
        home = item(0, WAYPOINT, 0, 0, 0, frame=0)
        assert command(link, 176, 1, 3) == 0 and command(link, 400, 1) == 4  # "AUTO mode not armable"
        assert upload(link, [home, item(1, WAYPOINT, 3, 0, 3)])[0] == 0
        assert command(link, 176, 1, 4) == 0 and command(link, 400, 1) == 0
        assert command(link, 176, 1, 3) == 4  # "Missing Takeoff Cmd"
        legs = [
            item(2, WAYPOINT, 3, 0, 3),
            item(3, WAYPOINT, 0, 3, 3),
            item(4, JUMP, 0, 0, 0, 2, 1),
            item(5, RTL, 0, 0, 0),
        ]
        assert upload(link, [home, item(1, TAKEOFF, 0, 0, 3), *legs])[0] == 0
        assert command(link, 300) == 0
        reached: list[int] = []
        while not reached or reached[-1] != 5:
            message = get(link, "MISSION_ITEM_REACHED")
            assert message is not None, reached
            reached.append(message.seq)
        assert [seq for seq in reached if seq != 4] == [1, 2, 3, 2, 3, 5]


def test_mavsdk_flies_a_mission() -> None:
    def corner(north: float, east: float, up: float) -> MissionItem:
        lon = LON + east * METRE / math.cos(math.radians(LAT))
        nothing = float("nan")
        return MissionItem(
            LAT + north * METRE, lon, up, 2.0, north == 0, nothing, nothing,
            MissionItem.CameraAction.NONE, nothing, nothing, 0.5, nothing, nothing,
            MissionItem.VehicleAction.NONE,
        )  # fmt: skip

    with standin("--speed", "8") as port, mavsdk_system(port) as system:
        telemetry, action, mission = Telemetry(system), Action(system), Mission(system)
        plan = [corner(4, 0, 3), corner(4, 4, 3.5), corner(0, 4, 3)]
        mission.upload_mission(MissionPlan(plan))
        back = mission.download_mission().mission_items
        assert [round(i.relative_altitude_m, 1) for i in back] == [3.0, 3.5, 3.0]
        until(telemetry.health_all_ok, "never healthy")
        action.arm()
        mission.start_mission()
        until(lambda: telemetry.flight_mode() == FlightMode.MISSION, "no mission mode")
        until(lambda: mission.mission_progress().current >= 2, "does not come on")
        until(mission.is_mission_finished, "does not finish")
        p = telemetry.position_velocity_ned().position
        assert math.dist((p.north_m, p.east_m, p.down_m), (0, 4, -3)) < 1.0
        until(lambda: telemetry.flight_mode() == FlightMode.HOLD, "does not hold")
        action.land()
        until(lambda: not telemetry.armed(), "did not land")
