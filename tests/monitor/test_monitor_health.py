"""A rotor that loses thrust in the air, on the screen: messages made of the simulated world's flight."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from monitor_messages import Scene, heartbeat
from pymavlink.dialects.v20 import common as mavlink
from textual.widgets import Static

from coaxlink.files import example
from coaxlink.monitor.screen import words
from coaxlink.monitor.screen.app import Monitor
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import load_vehicle
from sim.effects import HiddenEffect
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.vehicle import read_vehicle

pytestmark = pytest.mark.slow
FRAME, ROTORS = Path(example("x8_demo.toml")), Path(example("rotor_paper.toml"))
ONSET_S, ROTOR = 12.0, 6


@pytest.fixture(scope="module")
def flight():
    vehicle = load_vehicle(FRAME, ROTORS)
    made = make_design(read_vehicle(FRAME), read_pair(ROTORS), report_px4(vehicle, "fitted").params)
    wind = HiddenEffect("wind", 4.0, 0.0, {"direction_deg": 40.0}, "dryden")
    weak = HiddenEffect("degraded_rotor", 0.1, ONSET_S, {"rotor": float(ROTOR)})
    return vehicle, fly_quick(made, FlightWorld((wind, weak), 2, "wander", 12.0), 8)[1]


def played(vehicle, log, *, landed=2, armed=True, boot_s=5.0, to_s=99.0, every=1):
    """A watch that heard the flight: rates at 50 Hz, outputs at 50 Hz / `every` with 32 bit stamps."""
    scene = Scene(vehicle)
    scene.hear(heartbeat(armed), mavlink.MAVLink_extended_sys_state_message(0, landed))
    for k, t in enumerate(log["time_s"].tolist()):
        stamp = round(1e6 * (t + boot_s))
        if t > to_s:
            break
        if k % every == 0:
            pulses = [round(1000 + 1000 * log[f"motor{i + 1}"][k]) for i in range(8)] + [0] * 8
            scene.hear(mavlink.MAVLink_servo_output_raw_message(stamp % 2**32, 0, *pulses))
        gyro = [float(log[f"gyro_{a}_rad_s"][k]) for a in "xyz"]
        accel = [float(log[f"accel_{a}_m_s2"][k]) for a in "xyz"]
        imu = mavlink.MAVLink_highres_imu_message(stamp, *accel, *gyro, *[0.0] * 7, 0x3F, 0)
        scene.hear(imu)
    return scene.look()


@pytest.mark.parametrize("boot_s", [5.0, 4290.0])  # the outputs' clock wraps in the second flight
def test_the_rotor_is_marked_and_said(flight, boot_s):
    view = played(*flight, boot_s=boot_s)
    assert view.health.word == "called" and [c.rotor for c in view.health.calls] == [ROTOR]
    call = view.health.calls[0]
    assert 0.0 < call.time_s - boot_s - ONSET_S < 2.0 and 0.05 < call.loss < 0.15
    marks = {r.number: r.health for arm in view.arms for r in (arm.upper, arm.lower)}
    assert marks == {n: "x" if n == ROTOR else "" for n in range(1, 9)}
    assert f"rotor {ROTOR} (x) lost" in words.notes(view).plain
    assert "rotors: flagged" in words.summary(view).plain and f"{ROTOR}x" in words.summary(view).plain
    assert view.to_json()["health"]["calls"][0]["rotor"] == ROTOR
    assert len(call.text.encode()) <= 50


def page_of(view):
    """The page of health in text: table, border, plot."""

    async def story():
        app = Monitor(lambda: view)
        async with app.run_test(size=(80, 24)) as pilot:
            await pilot.press("5")
            await pilot.pause()
            app.draw()
            rotors, plot = app.query_one("#rotors", Static), app.query_one("#suspicion")
            assert rotors.region.height > 8 and plot.region.bottom <= 24
            shown = "\n".join(s.text for s in app.screen._compositor.render_strips())
            return str(rotors.visual), str(rotors.border_subtitle), shown

    return asyncio.run(story())


def test_the_page_of_health_has_a_line_a_rotor(flight):
    table, border, _ = page_of(played(*flight))
    lines = table.splitlines()
    assert len(lines) == 9 and "rotors: flagged" in border
    own = next(line for line in lines if f"{ROTOR}x" in line)
    assert "chance" in lines[0] and "+/-" in own and not own.split("%")[0].endswith("sound")
    assert sum("sound" in line for line in lines) == 7
    assert all(len(line.rstrip()) <= 60 for line in lines)


def test_on_the_ground_the_page_of_health_says_that_nothing_is_judged(flight):
    table, border, shown = page_of(played(*flight, landed=1))
    assert table.count("not judged") == 8 and "judged in the air only" in border
    assert "no verdict" in shown


def test_before_it_and_on_the_ground_nothing_is_said(flight):
    assert played(*flight, to_s=ONSET_S - 0.2).health.word == "sound"
    for landed, armed in ((1, True), (2, False), (0, True)):
        view = played(*flight, landed=landed, armed=armed)
        assert view.health.word == "" and not view.health.calls
        assert "not judged" in words.summary(view).plain


def test_what_comes_too_slowly_is_no_verdict(flight):
    view = played(*flight, every=5, to_s=ONSET_S - 0.2)
    assert view.health.word == "" and not view.health.calls
    assert view.health.why == "cannot judge: motor commands at 10 Hz, 20 Hz and more are needed"
    assert "sound" not in words.summary(view).plain
