"""What the stand-ins write into their own parameters, and what they let nobody write."""

import struct
from pathlib import Path

import pytest
from case_table import case_table
from sim_pilot import Pilot

from sim.simulation import Simulation, build

X8 = Path(__file__).parents[2] / "examples" / "x8_demo.toml"


def _standin(firmware):
    return build(Simulation(X8, firmware=firmware), []).autopilot


def _fly(vehicle, seconds, ardupilot):
    def run(s):
        for _ in range(round(250 * s)):
            vehicle.step()

    run(3.0)
    if ardupilot:
        vehicle.set_ap_mode(4)
        vehicle.arm()
    else:
        vehicle.arm()
    vehicle.take_off(3.0)
    run(seconds)
    assert vehicle.reading.height > 2.0
    in_the_air = vehicle.store.values()
    if ardupilot:
        vehicle.set_ap_mode(9)
    else:
        vehicle.set_mode(type(vehicle.mode).LAND)
    for _ in range(250 * 40):
        vehicle.step()
        if not vehicle.armed:
            break
    assert not vehicle.armed
    return in_the_air


@pytest.mark.slow
def test_an_arducopter_learns_its_hover_throttle_and_saves_it_on_disarming():
    copter = _standin("ardupilot")
    model = copter.store["MOT_THST_HOVER"]
    copter.store.write("MOT_THST_HOVER", 0.5)
    in_the_air = _fly(copter, 25.0, True)
    learned = copter.store["MOT_THST_HOVER"]
    assert abs(learned - model) < abs(in_the_air["MOT_THST_HOVER"] - model) + 1e-3
    assert learned == pytest.approx(0.5 + (model - 0.5) * (1 - 2.718 ** (-2.5)), abs=0.04)  # 10 s filter
    assert copter.store.memory()["MOT_THST_HOVER"] == learned
    copter.boot()
    assert copter.store["MOT_THST_HOVER"] == learned


@pytest.mark.slow
def test_what_is_not_saved_is_gone_with_the_next_start():
    with case_table() as case:
        for learn, saved in ((0, True), (1, True), (2, False)):
            with case(f"{learn}, {saved}"):
                copter = _standin("ardupilot")
                copter.store.write("MOT_THST_HOVER", 0.5)
                copter.store.write("MOT_HOVER_LEARN", float(learn))
                in_the_air = _fly(copter, 10.0, True)
                assert (in_the_air["MOT_THST_HOVER"] == 0.5) == (learn == 0)
                copter.boot()
                assert (copter.store["MOT_THST_HOVER"] == 0.5) == saved


@pytest.mark.slow
def test_an_arducopter_counts():
    copter = _standin("ardupilot")
    before = copter.store.values()
    _fly(copter, 35.0, True)
    copter.boot()
    after = copter.store.values()
    assert after["STAT_BOOTCNT"] == before["STAT_BOOTCNT"] + 1
    assert 35 <= after["STAT_FLTTIME"] - before["STAT_FLTTIME"] <= 60
    assert after["STAT_RUNTIME"] > after["STAT_FLTTIME"]
    assert after["BARO1_GND_PRESS"] != before["BARO1_GND_PRESS"]
    copter.store.write("STAT_RESET", 0.0)
    copter.step()
    assert copter.store["STAT_FLTTIME"] == 0 and copter.store["STAT_RESET"] == 1


def test_an_internal_parameter_is_refused_as_the_real_one_does():
    """GCS_Param.cpp, handle_param_set: a text, PARAM_ERROR, and the value as it is."""
    pilot = Pilot("ardupilot")
    store = pilot.autopilot.store
    for name in ("BARO1_GND_PRESS", "MIS_TOTAL"):
        held = store[name]
        assert [v.param_value for v in pilot.set(name, 7.0)] == [held]
        assert pilot.heard("STATUSTEXT")[-1].text == f"Param write denied ({name})"
        assert pilot.heard("PARAM_ERROR")[-1].error == 3 and store[name] == held
    pilot.set("BRD_OPTIONS", 5.0)
    pilot.set("BARO1_GND_PRESS", 7.0)
    assert store["BARO1_GND_PRESS"] == 7.0


def test_a_packed_file_passes_over_what_is_internal():
    copter = _standin("ardupilot")
    store = copter.store
    held = store["BARO1_GND_PRESS"]
    body = bytes([4, 14 << 4]) + b"BARO1_GND_PRESS" + struct.pack("<f", 7.0)
    body += bytes([4, 12 << 4]) + b"MOT_THST_EXPO" + struct.pack("<f", 0.25)
    data = struct.pack("<HHH", 0x671B, 2, len(body) + 6) + body
    assert store.unpack(data)
    assert store["BARO1_GND_PRESS"] == held and store["MOT_THST_EXPO"] == 0.25


@pytest.mark.slow
def test_a_px4_counts_its_flights_and_keeps_its_hover_thrust():
    px4 = _standin("px4")
    before = px4.store.values()
    _fly(px4, 20.0, False)
    after = px4.store.values()
    changed = {n for n in before if before[n] != after[n]}
    assert changed == {
        "COM_FLIGHT_UUID",
        "LND_FLIGHT_T_LO",
        "EKF2_MAG_DECL",
        *(f"CAL_GYRO0_{axis}OFF" for axis in "XYZ"),
    }
    assert after["COM_FLIGHT_UUID"] == before["COM_FLIGHT_UUID"] + 1
    assert 20e6 <= after["LND_FLIGHT_T_LO"] - before["LND_FLIGHT_T_LO"] <= 60e6
    assert after["MPC_THR_HOVER"] == before["MPC_THR_HOVER"]


def test_a_px4_s_hover_thrust_is_held_within_its_bounds():
    px4 = _standin("px4")
    reported = []
    px4.say = lambda severity, text: reported.append(text)
    px4.store.write("MPC_THR_HOVER", 9, 0.05)
    assert px4.store["MPC_THR_HOVER"] == px4.store["MPC_THR_MIN"]
    assert reported == ["Hover thrust has been constrained by min/max"]
