"""A rotor stops in flight: found from telemetry, flown without; all in the simulated vehicle's own time."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from live_flight import Companion, Flight
from live_line import Session

from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.live.health_watch import HealthWatch
from coaxlink.live.in_air import Call, InAir, weakened
from coaxlink.live.mixer import LiveMixer
from coaxlink.live.mixer_core import MixCore
from coaxlink.live.reallocation import Reallocation, law_without
from coaxlink.mixer import make_law
from coaxlink.vehicle import load_vehicle
from sim.effects import FORMS, Effect
from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.px4 import telemetry
from sim.px4.autopilot import Autopilot, Mode
from sim.truth import Truth
from sim.vehicle import read_vehicle

ROTORS = example("rotor_paper.toml")
WAITS = 3  # ticks of 4 ms from a message to the law: the watch looks every 10 ms
CALM_S, AFTER_S = 6.0, 3.0


class Mixed:
    """A vehicle in the air, its companion's loop and its health, turn by turn."""

    def __init__(self, name, reallocate=True, escs="none", rotor=None, kind="weak_motor", wind=4.0):
        self.vehicle = load_vehicle(example(name), ROTORS)
        self.a = Autopilot(Plant(read_vehicle(example(name)), read_pair(ROTORS)), Truth(), version=(1, 13, 3))
        self.a.escs = escs
        self.a.exchange = self._answer
        self.core = MixCore(self.vehicle, "exact", own_curve=1.0)
        self.in_air = InAir(self.vehicle, stops=reallocate)
        self.reallocation = Reallocation(self) if reallocate else None
        self.calls, self.due, self.tilt, self.turn = [], [], [], 0
        self.a.store.write("THR_MDL_FAC", 9, 1.0)
        self.a.arm()
        self.a.take_off(6.0)
        while self.a.mode != Mode.HOLD:
            self.a.step()
        if wind:
            FORMS["wind"].apply(self.a.plant, Effect("wind", wind, 0.0, {"direction_deg": 70.0}, "steady"))
        self.fly(CALM_S)
        self.onset_s = self.a.plant.time_s
        self.before = self.core.law
        if rotor:
            extra = {"rotor": float(rotor)}
            FORMS["degraded_rotor"].apply(self.a.plant, Effect("degraded_rotor", 1.0, 0.0, extra, kind))

    def adopt(self, law, vehicle):
        self.due.append((self.turn + WAITS, law, vehicle))

    def _answer(self, demand):
        while self.due and self.due[0][0] <= self.turn:
            self.core.adopt(*self.due.pop(0)[1:])
            self.adopted_s = self.a.plant.time_s
        controls = [demand.roll, demand.pitch, demand.yaw, demand.thrust]
        commands = self.core.step(telemetry.stamp_us(self.a), 0, controls)
        if commands is not None:
            self.a.drive(np.array(commands))

    def fly(self, seconds):
        a = self.a
        for _ in range(round(seconds / 0.004)):
            a.step()
            self.turn += 1
            if self.turn % 5 == 0:  # 50 Hz
                self.hear(telemetry.highres_imu(a))
            if self.turn % 13 == 0 and a.escs != "none":
                for message in telemetry.esc_status(a):
                    self.hear(message)
            if self.turn % 250 == 1:
                self.hear(telemetry.heartbeat(a))
                self.hear(telemetry.extended_sys_state(a))
            _, x, y, _ = a.plant.quaternion.tolist()
            self.tilt.append(math.degrees(math.acos(1.0 - 2.0 * (x * x + y * y))))

    def hear(self, message):
        self.in_air.commanded(self.core.last_us * 1e-6, self.core.sent[: self.core.count])
        call = self.in_air.heard(message)
        if call is not None:
            self.calls.append(call)
            if self.reallocation is not None:
                self.reallocation.answer(call, self.in_air)


@pytest.mark.parametrize(
    ("name", "rotor", "kind"),
    [
        ("x8_demo.toml", 2, "weak_motor"), ("x8_demo.toml", 7, "weak_motor"), ("x8_demo.toml", 4, "tip"),
        ("y6.toml", 3, "weak_motor"), ("y6.toml", 1, "tip"),
    ],
)  # fmt: skip
def test_a_rotor_that_stops_is_flown_without_within_200_ms(name, rotor, kind):
    flight = Mixed(name, rotor=rotor, kind=kind)
    height = flight.a.plant.height
    flight.fly(AFTER_S)
    assert [c.rotor for c in flight.calls] == [rotor] and flight.calls[0].stopped
    assert flight.adopted_s - flight.onset_s < 0.2
    assert flight.core.sent[rotor - 1] == 0.0
    assert max(flight.tilt[-round(AFTER_S / 0.004) :]) < 25.0 and flight.tilt[-1] < 8.0
    assert flight.a.plant.height > height - 1.5
    assert flight.reallocation.done[0] | {"time_s": 0} == {"rotor": rotor, "time_s": 0, "thrust_left": 0.0}


def test_measured_rpm_makes_it_sooner():
    alone, measured = (Mixed("x8_demo.toml", escs=e, rotor=2) for e in ("none", "measured"))
    for flight in (alone, measured):
        flight.fly(0.4)
        assert flight.calls[0].rotor == 2
    assert (
        measured.adopted_s <= alone.adopted_s and measured.calls[0].probability > alone.calls[0].probability
    )


def test_rpm_that_fails_alone_stops_nobody():
    flight = Mixed("x8_demo.toml", escs="measured")
    reading = telemetry.reported_escs

    def torn(a):
        escs = reading(a)
        escs.rpm[3] = 0.0
        return escs

    telemetry.reported_escs = torn
    try:
        flight.fly(2.0)
    finally:
        telemetry.reported_escs = reading
    assert not flight.calls and flight.core.law is flight.before


def test_a_sound_flight_keeps_its_law_and_the_law_is_not_taken_back():
    flight = Mixed("y6.toml")
    flight.a.go_to((6.0, 3.0, -6.0), 1.5)
    flight.fly(8.0)
    assert not flight.calls and flight.core.law is flight.before
    FORMS["degraded_rotor"].apply(
        flight.a.plant, Effect("degraded_rotor", 1.0, 0.0, {"rotor": 2.0}, "weak_motor")
    )
    flight.fly(0.3)
    law = flight.core.law
    flight.a.plant.geometry[flight.a.plant.index.G_SPEED, 1] = 1.0  # it would turn again
    for message in (telemetry.heartbeat(flight.a), telemetry.extended_sys_state(flight.a)):
        flight.hear(message)
    flight.fly(1.0)
    assert flight.core.law is law and flight.core.sent[1] == 0.0


def test_a_weak_rotor_has_its_share_in_the_law():
    flight = Mixed("x8_demo.toml", wind=0.0)
    extra = {"rotor": 4.0}
    FORMS["degraded_rotor"].apply(flight.a.plant, Effect("degraded_rotor", 0.2, 0.0, extra, "share"))
    flight.fly(4.0)
    assert {c.rotor for c in flight.calls} == {4} and not any(c.stopped for c in flight.calls)
    assert flight.reallocation.done[0]["thrust_left"] == pytest.approx(0.8, abs=0.04)
    gains = [r.thrust_gain for r in flight.in_air.vehicle.airframe.rotors]
    assert gains[3] == pytest.approx(0.8, abs=0.04) and gains[:3] == [1, 1, 1]
    # what was delivered is accounted by the rotors that there are
    assert max(abs(e) for e in flight.core.error) < 1e-3
    assert flight.core.law is not flight.before


def test_without_it_nothing_is_changed():
    flight = Mixed("x8_demo.toml", reallocate=False, rotor=2)
    flight.fly(1.0)
    assert flight.core.law is flight.before and not any(c.stopped for c in flight.calls)


def test_other_laws_do_not_re_allocate():
    class Live:
        core = MixCore(load_vehicle(example("x8_demo.toml"), ROTORS), "standard")

    with pytest.raises(InputError, match="only the exact law"):
        Reallocation(Live())


def test_yaw_is_given_up_first():
    vehicle = load_vehicle(example("y6.toml"), ROTORS)
    weight = 9.80665 * vehicle.airframe.mass_kg
    law = law_without(make_law("exact", vehicle), vehicle, (1,))
    law.speeds([weight, 3.0, -3.0, 20.0])
    assert law.dropped == ("yaw",)
    assert make_law("exact", vehicle).speeds([weight, 0, 0, 0])[0] > 0.3


def by_hand(law="exact", **options):
    """A mixer without a line."""
    vehicle = load_vehicle(example("y6.toml"), ROTORS)
    return LiveMixer(Session(), vehicle, make_law(law, vehicle, **options)), vehicle


def test_bounds_and_priority_of_the_law_stay():
    live, vehicle = by_hand(low=0.2, high=0.9, priority=("yaw", "roll", "pitch", "thrust"), failed=[5])
    answer(live, weakened(vehicle, 3, 0.3), (1,))
    live.take([])
    weight = 9.80665 * vehicle.airframe.mass_kg
    speeds = live.core.law.speeds([0.3 * weight, 0.0, 0.0, 0.0])
    assert speeds[[0, 4]].tolist() == [0.0, 0.0] and speeds[[1, 2, 3, 5]].min() >= 0.2 - 1e-9
    speeds = live.core.law.speeds([3 * weight, 0.0, 0.0, 0.0])
    assert speeds.max() == pytest.approx(0.9)
    assert live.core.law.dropped[0] == "thrust" and "yaw" not in live.core.law.dropped


def answer(live, vehicle, stopped=(), rotor=3):
    call = Call(rotor, 5.0, 0.99, 0.2, 0.02, False, settled=True)
    reallocation = Reallocation(live)
    reallocation.answer(call, SimpleNamespace(vehicle=vehicle, stopped=stopped))
    return reallocation.done


def test_what_is_left_of_a_rotor_counts_all_of_its_calls():
    live, vehicle = by_hand()
    twice = weakened(weakened(vehicle, 3, 0.2), 3, 0.2)
    assert answer(live, twice)[0]["thrust_left"] == pytest.approx(0.64)
    assert answer(live, twice, stopped=(3,))[0]["thrust_left"] == 0.0


@pytest.mark.slow
def test_the_loop_itself_goes_on_without_it():
    flight = Flight()
    companion = Companion(flight)
    live = companion.mix()
    said = []
    watch = HealthWatch(live, said.append, None, Reallocation(live))
    watch.listen()

    def work():
        watch.work()
        flight.clock.later(0.01, work)

    work()
    companion.until_live(live)
    flight.fly(20.0, until=lambda: watch.in_air.now.word == "sound")
    flight.fly(2.0)
    extra = {"rotor": 2.0}
    weak = Effect("degraded_rotor", 1.0, 0.0, extra, "weak_motor")
    FORMS["degraded_rotor"].apply(flight.autopilot.plant, weak)
    flight.rows.clear()
    flight.fly(0.3, until=lambda: live.core.sent[1] == 0.0)
    flight.fly(1.0)
    assert [c.rotor for c in said] == [2] and not watch.problem
    assert watch.account()["reallocated"][0]["rotor"] == 2
    assert live.core.sent[1] == 0.0 and not live.failed.is_set()
    assert flight.outputs_are_sound() and max(row.tilt_deg for row in flight.rows) < 25.0
