"""Flights on a stand-in in memory: to the end, ended by its pilot, a limit or a lost link; and the verb."""

import json
from contextlib import nullcontext
from pathlib import Path

import pytest
from memory_net import Line, Net, Standin, meet, plugged
from pymavlink.dialects.v20 import common as m
from verb import run

from coaxlink.errors import SafetyRefusal
from coaxlink.fly.commands import Commander, Crashed, ModeWatch, PlanAbandoned, Start
from coaxlink.fly.trajectory import FlightPlan, Hold
from coaxlink.mavlink import connect
from coaxlink.mavlink.station import hear_words

OFFBOARD, POSITION = 6, 3  # main modes of PX4
PLAN = FlightPlan((Hold("hover", (0.0, 0.0, -3.0), 4.0),))


@pytest.fixture(params=["px4", "ardupilot"])
def board(request):
    with plugged(Net()) as net:
        board = Standin(net, request.param)
        yield board
        board.close()


@pytest.fixture
def px4():
    with plugged(Net()) as net:
        board = Standin(net)
        yield board
        board.close()


def take_over(board, when):
    """The pilot's own link: position mode as soon as `when(heartbeat)`; what it heard since then."""
    link = meet(board, source_system=255, source_component=190)
    heard = []

    def watch(message):
        if message.get_type() == "HEARTBEAT":
            if not heard and when(message):
                heard.append(message)
                link.send(m.MAVLink_command_long_message(1, 1, 176, 0, 1, POSITION, 0, 0, 0, 0, 0))
            elif heard:
                heard.append(message)

    link.subscribe(watch)
    return link, heard


def offboard(beat):
    return beat.custom_mode >> 16 & 0xFF == OFFBOARD


def fly(board, capsys, tmp_path, *options):
    """Exit code, stdout, stderr and the JSON of one call, without MAVSDK: it has a clock of its own."""
    path = tmp_path / "fly.json"
    path.unlink(missing_ok=True)
    words = ("fly", "--connect", board.url, "--out", str(tmp_path), "--json", str(path), "--no-log")
    code, out, err = run(capsys, *words, *options)
    return code, out, err, json.loads(path.read_text()) if path.is_file() else {}


@pytest.mark.slow
def test_a_plan_is_flown_from_where_it_took_off_and_landed(board):
    with meet(board) as session:
        commander = Commander(session)
        commander.arm()
        commander.take_off(3.0)
        start = Start((2.0, 0.0, 0.0), 0.5)
        track = commander.follow(PLAN, start=start)
        assert len(track.time_s) > 40 and set(track.segment) == {"hover"}
        flown = track.flown_m[-1]
        assert flown[0] == pytest.approx(2.0, abs=0.5) and flown[2] == pytest.approx(-3.0, abs=0.5)
        commander.land()
        assert not session.armed


@pytest.mark.slow
def test_a_vehicle_that_leaves_the_mode_ends_the_plan(px4):
    with meet(px4) as session:
        commander = Commander(session)
        commander.arm()
        commander.take_off(3.0)
        link, _ = take_over(px4, offboard)
        with link, pytest.raises(PlanAbandoned, match="left the plan of 4 s"):
            commander.follow(PLAN)


@pytest.mark.slow
def test_a_mode_that_set_points_came_too_late_for_is_asked_for_again(px4):
    with meet(px4) as session:
        commander = Commander(session)
        commander.arm()
        commander.take_off(3.0)
        mode = commander._mode

        def refused_once(main, sub=0):
            commander._mode = mode
            raise SafetyRefusal("mode change: the autopilot refused")

        commander._mode = refused_once
        assert len(commander.follow(PLAN).time_s) > 40


def test_a_refused_arming_is_in_the_vehicles_own_words(px4, monkeypatch):
    """They are longer than one message, and its reasons are said by the checks alone."""
    monkeypatch.setattr(px4.autopilot, "preflight", lambda: ["Preflight Fail: Open Drone ID system missing"])
    with meet(px4) as session, pytest.raises(SafetyRefusal) as refused:
        hear_words(session)
        Commander(session).arm()
    first, reason = "Arming denied: Resolve system health failures first", px4.autopilot.preflight()[0]
    assert str(refused.value).endswith(f"it says: {first}, {reason}")


def test_one_heartbeat_of_another_mode_ends_it_but_not_one_that_was_under_way():
    late = ModeWatch()
    assert [late.left(ours) for ours in (False, True, True, False)] == [False, False, False, True]
    never = ModeWatch()
    assert [never.left(False), never.left(False)] == [False, True]


@pytest.mark.slow
def test_the_verb_flies_a_plan_and_its_telemetry_is_a_log(board, capsys, tmp_path):
    plan = tmp_path / "short.toml"
    plan.write_text('height_m = 3.0\n[[pieces]]\nwhat = "north"\nseconds = 4.0\nnorth_m = 2.0\n')
    code, out, err, found = fly(board, capsys, tmp_path, "--plan", str(plan), "--yes")
    assert code == 0, err
    assert out.startswith("flown: ") and found["result"] == "flown"
    assert found["segments"] == ["settle", "north"] and found["worst_off_plan_m"] < 1.0
    assert Path(found["tlog"]).stat().st_size > 10_000


@pytest.mark.slow
def test_refusals_leave_the_motors_off(px4, capsys, tmp_path):
    unasked = fly(px4, capsys, tmp_path)
    far = fly(px4, capsys, tmp_path, "--yes", "--plan", "circle", "--reach", "40")
    checked = fly(px4, capsys, tmp_path, "--dry-run")
    assert (unasked[0], far[0], checked[0]) == (4, 4, 0)
    assert "--yes" in unasked[2] and unasked[3]["result"] == "not armed"
    assert "distance reaches 40.0 m" in far[2]
    assert "nothing was armed" in checked[1]
    assert not px4.autopilot.armed


@pytest.mark.slow
def test_the_battery_limit_lands(px4, capsys, tmp_path):
    code, _, err, found = fly(px4, capsys, tmp_path, "--yes", "--battery", "0.94")
    assert code == 4
    assert "battery at 93 %, 94 is the limit" in err
    assert found["result"] == "limit" and found["flown_s"] < 20.0
    assert not px4.autopilot.armed


@pytest.mark.slow
def test_the_pilots_mode_change_ends_it_at_once(px4, capsys, tmp_path):
    link, heard = take_over(px4, offboard)
    with link:
        code, _, err, found = fly(px4, capsys, tmp_path, "--yes")
        assert code == 1, err
        assert "its pilot or its own failsafe has it" in err and found["result"] == "pilot"
        link.clock.sleep(3.0)
    # nobody took it back: still armed, in the pilot's mode
    assert heard[-1].base_mode & 128 and heard[-1].custom_mode >> 16 & 0xFF == POSITION


@pytest.mark.slow
def test_a_crash_is_called_a_crash(px4, capsys, tmp_path):
    """Somebody's kill switch, three metres high."""
    link = meet(px4, source_system=255, source_component=190)
    killed = []

    def kill(message):
        if message.get_type() == "HEARTBEAT" and offboard(message) and not killed:
            killed.append(message)
            link.send(m.MAVLink_command_long_message(1, 1, 400, 0, 0, 21196, 0, 0, 0, 0, 0))

    link.subscribe(kill)
    with link:
        code, _, err, found = fly(px4, capsys, tmp_path, "--yes")
    assert code == 1 and found["result"] == "crash", err
    assert "crashed: its motors stopped" in err and "landed" not in err


@pytest.mark.parametrize(("roll", "height_m", "what"), [(2.0, 3.0, "by 115 degrees"), (2.0, 0.1, None)])
def test_upside_down_is_a_crash_in_the_air_alone(px4, roll, height_m, what):
    with meet(px4) as session:
        commander = Commander(session)
        commander._ground_z = 0.0
        commander.telemetry.hear(m.MAVLink_attitude_message(0, roll, 0.0, 0.0, 0.0, 0.0, 0.0))
        place = m.MAVLink_local_position_ned_message(0, 0.0, 0.0, -height_m, 0.0, 0.0, 0.0)
        session.take = lambda *_: place
        session.listen = lambda *_: nullcontext([])
        positions = commander._positions("the plan", 4, OFFBOARD)
        if what is None:
            assert next(positions)[1] is place
        else:
            with pytest.raises(Crashed, match=what):
                next(positions)


@pytest.mark.slow
def test_a_lost_link_leaves_it_to_the_autopilots_failsafe(px4, capsys, tmp_path):
    net = px4.net

    def cut(beat):
        net.loss = 1.0
        return False

    line = Line(net, px4.address)
    with connect(px4.url, transport=line, clock=net.clock, source_system=255) as link:
        link.subscribe(lambda x: cut(x) if x.get_type() == "HEARTBEAT" and offboard(x) else None)
        code, _, err, found = fly(px4, capsys, tmp_path, "--yes")
    assert code == 3 and found["result"] == "link", err
    assert "its own failsafe for a lost link has the vehicle now" in err


@pytest.mark.slow
@pytest.mark.parametrize("acts", [0, 2])
def test_no_ground_station_is_stood_in_for_in_flight(px4, capsys, tmp_path, acts):
    """A board that acts on a lost station arms where the pilot's own is heard, or not at all."""
    px4.autopilot.store.preset("NAV_DLL_ACT", acts)
    code, _, err, found = fly(px4, capsys, tmp_path, "--yes")
    if acts:
        assert code == 4 and found["result"] == "not armed" and "arming" in err
    else:
        assert code == 0, err
        links = px4.autopilot.links
        assert links._heard_s is not None and not links.there(px4.autopilot.plant.time_s)
