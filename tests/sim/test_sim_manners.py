"""Manners of the firmwares that a companion stumbles over: lost links, bench tests, versions, indices."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as m
from sim_pilot import GUIDED, LAND, RTL, Pilot

from sim.px4.autopilot import Goal, Mode, Refused


@pytest.fixture
def px4() -> Pilot:
    return Pilot("px4")


@pytest.fixture
def copter() -> Pilot:
    return Pilot("ardupilot")


@pytest.mark.slow
@pytest.mark.parametrize(("action", "mode"), [(1, Mode.HOLD), (2, Mode.RTL), (3, Mode.LAND)])
def test_px4_misses_its_ground_station(px4: Pilot, action: int, mode: Mode) -> None:
    px4.put("NAV_DLL_ACT", action)
    px4.climb()
    away = Goal((6.0, 0.0, -3.0))
    px4.autopilot.offboard(away)
    px4.autopilot.set_mode(Mode.OFFBOARD)
    px4.run(2.5, lambda: px4.autopilot.offboard(away))
    assert px4.autopilot.mode == Mode.OFFBOARD
    px4.run(0.8, lambda: px4.autopilot.offboard(away))  # 10 s by COM_DL_LOSS_T since it was heard
    assert px4.autopilot.mode == mode
    assert any("ground station lost" in t.text for t in px4.heard("STATUSTEXT"))
    px4.ground_station()
    px4.run(0.1)
    assert any("regained" in t.text for t in px4.heard("STATUSTEXT"))


@pytest.mark.slow
def test_px4_without_that_action_flies_on_and_with_it_wants_one_to_arm() -> None:
    px4 = Pilot("px4")
    px4.climb()
    px4.run(8.0)
    assert px4.autopilot.mode == Mode.HOLD and not px4.heard("STATUSTEXT")[-1].text.startswith("Connection")
    alone = Pilot("px4")
    alone.put("NAV_DLL_ACT", 2)
    alone.run(11.0)
    assert alone.command(400, 1) == 1
    alone.ground_station()
    assert alone.command(400, 1) == 0


@pytest.mark.parametrize(("action", "mode"), [(4, Mode.LAND), (3, Mode.RTL), (5, Mode.HOLD), (0, Mode.HOLD)])
def test_px4_loses_its_setpoints(px4: Pilot, action: int, mode: Mode) -> None:
    px4.put("COM_OBL_RC_ACT", action)
    px4.climb()
    px4.autopilot.offboard(Goal((3.0, 0.0, -3.0)))
    px4.autopilot.set_mode(Mode.OFFBOARD)
    px4.run(0.9)
    assert px4.autopilot.mode == Mode.OFFBOARD
    px4.run(0.2)  # COM_OF_LOSS_T is 1 s
    assert px4.autopilot.mode == mode


@pytest.mark.parametrize(("action", "mode"), [(0, GUIDED), (1, RTL), (5, LAND)])
def test_ardupilot_misses_its_ground_station(copter: Pilot, action: int, mode: int) -> None:
    copter.put("FS_GCS_ENABLE", action)
    copter.climb()  # 7 s, and FS_GCS_TIMEOUT is 5 s
    assert copter.autopilot.ap_mode == mode
    assert any(t.text == "GCS Failsafe" for t in copter.heard("STATUSTEXT")) == (action != 0)


def turning(pilot: Pilot) -> set[int]:
    return {n + 1 for n, u in enumerate(pilot.autopilot.plant.speeds.tolist()) if u > 0.05}


@pytest.mark.slow
def test_a_motor_is_turned_on_the_bench(px4: Pilot, copter: Pilot) -> None:
    assert px4.command(310, 0.2, 1.0, 0, 0, 6) == 0
    px4.run(0.5)
    assert turning(px4) == {6}
    assert px4.heard("ESC_STATUS")[-1].index in (0, 4)
    assert px4.command(310, 0.2, 60.0, 0, 0, 99) == 2
    px4.run(3.0)
    assert turning(px4) == set()
    px4.put("COM_MOT_TEST_EN", 0)
    assert px4.command(310, 0.2, 1.0, 0, 0, 6) == 2
    # ArduPilot counts clockwise from the front right, not by motors
    for test_number, motor in ((1, 1), (2, 6), (3, 4), (4, 7), (5, 3), (6, 8), (7, 2), (8, 5)):
        assert copter.command(209, test_number, 0, 20.0, 0.5, 1) == 0
        copter.run(0.4)
        assert turning(copter) == {motor}
        copter.run(0.6)
    assert copter.command(310, 0.2, 1.0, 0, 0, 6) == 3
    for pilot in (px4, copter):
        pilot.climb()
        assert pilot.command(310 if pilot is px4 else 209, 1, 0, 0, 0, 1) in (2, 4)


@pytest.mark.slow
def test_versions_differ() -> None:
    old, middle, new, later = (Pilot(f"px4{v}") for v in (":1.13", ":1.14", "", ":1.17"))
    assert [p.command(511, 140, 4000) for p in (old, middle, new)] == [0, 4, 4]
    assert [p.command(209, 1, 0, 20, 1, 1) for p in (old, new)] == [0, 3]
    for pilot in (new, later):
        pilot.say(m.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
        pilot.say(m.MAVLink_param_set_message(1, 1, b"CA_METHOD", 1.0, 9))
        pilot.run(0.02)
    assert new.heard("PARAM_ERROR") == []
    assert [e.error for e in later.heard("PARAM_ERROR")] == [1, 5]
    for pilot, repeats in ((middle, True), (new, False)):
        pilot.climb()
        pilot.autopilot.plant.speeds[4:] = 0.9  # lowers faster than uppers
        pilot.run(0.004)
        pilot.heard("ESC_STATUS")
        pilot.run(0.1)
        first, second = sorted(pilot.heard("ESC_STATUS")[-2:], key=lambda e: e.index)
        assert (list(first.rpm) == list(second.rpm)) == repeats


def test_ardupilot_answers_names_without_an_index_and_hides_what_is_off(copter: Pilot) -> None:
    names = copter.autopilot.store.names
    assert "SCR_ENABLE" in names and "SCR_LD_CHECKSUM" not in names
    copter.say(m.MAVLink_param_request_read_message(1, 1, b"SCR_LD_CHECKSUM", -1))
    copter.say(m.MAVLink_param_set_message(1, 1, b"SCR_ENABLE", 1.0, 2))
    copter.run(0.02)
    hidden, enabled = copter.heard("PARAM_VALUE")
    assert (hidden.param_id, hidden.param_index) == ("SCR_LD_CHECKSUM", 65535)
    assert enabled.param_index == 65535 and enabled.param_count > hidden.param_count
    assert "SCR_LD_CHECKSUM" in copter.autopilot.store.names
    copter.say(m.MAVLink_param_set_message(1, 1, b"MAV1_POSITION", 5.0, 4))
    copter.run(2.0)
    assert len(copter.heard("LOCAL_POSITION_NED")) == pytest.approx(10, abs=1)


def test_a_reboot_forgets_what_was_asked_for(copter: Pilot) -> None:
    assert copter.command(511, 32, 10000) == 0
    copter.run(0.5)
    assert copter.heard("LOCAL_POSITION_NED")[-1].time_boot_ms > 1000 * copter.autopilot.plant.time_s + 950
    assert copter.command(246, 1) == 0
    copter.run(2.0)
    assert copter.heard("LOCAL_POSITION_NED") == []
    assert copter.command(512, 32) == 0
    assert copter.heard("LOCAL_POSITION_NED")[-1].time_boot_ms < 1000 * copter.autopilot.plant.time_s + 500


@pytest.mark.slow
def test_after_a_landing_px4_is_in_the_mode_chosen_before(px4: Pilot) -> None:
    """UserModeIntention.cpp, and seen on the real one."""
    a = px4.autopilot

    def flown(*, offboard: bool) -> Mode:
        px4.climb()
        if offboard:
            a.offboard(Goal((0.0, 0.0, -3.0)))
            a.set_mode(Mode.OFFBOARD)
        a.set_mode(Mode.LAND)
        px4.until(lambda: not a.armed)
        return a.mode

    assert flown(offboard=False) == Mode.HOLD
    assert flown(offboard=True) == Mode.OFFBOARD
    with pytest.raises(Refused, match="health failures"):
        a.arm()
    a.set_mode(Mode.HOLD)
    a.arm()
    assert a.armed
