"""A rotor stops in flight: found from telemetry, flown without; all in the simulated vehicle's own time."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from live_flight import Companion, Flight
from live_line import Session

from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.live.health_watch import ESC_HZ, HealthWatch
from coaxlink.live.in_air import Call, weakened
from coaxlink.live.mixer import LiveMixer
from coaxlink.live.mixer_core import MixCore
from coaxlink.live.reallocation import Reallocation, law_without
from coaxlink.mixer import make_law
from coaxlink.vehicle import load_vehicle
from firmware_params.px4.messages import ESC_STATUS
from sim.effects import FORMS, HiddenEffect

ROTORS = example("rotor_paper.toml")
FOUND_S, AFTER_S = 0.2, 3.0
slow = pytest.mark.slow


class Mixed:
    """A vehicle in the air in wind, its companion's loop and its health beside it, looked at every 10 ms."""

    def __init__(self, name="x8_demo.toml", *, reallocate=True, escs="none", wind=4.0):
        self.flight, self.calls = Flight(airframe=name), []
        self.a, self.plant = self.flight.autopilot, self.flight.autopilot.plant
        self.a.escs = escs
        companion = Companion(self.flight)
        self.live = companion.mix(vehicle=load_vehicle(example(name), ROTORS))
        reallocation = Reallocation(self.live) if reallocate else None
        self.watch = HealthWatch(self.live, self.calls.append, None, reallocation)
        if escs != "none":
            companion.session.request_stream(ESC_STATUS, ESC_HZ)
        self.watch.listen()
        self._work()
        if wind:
            self.spoil("wind", wind, "steady", direction_deg=70.0)
        self.flight.fly(20.0, until=lambda: self.watch.in_air.now.word == "sound")
        self.flight.fly(4.0)
        self.before = self.live.core.law
        self.flight.rows.clear()

    def _work(self):
        self.watch.work()
        self.flight.clock.later(0.01, self._work)

    def spoil(self, effect, size, kind, **extra):
        FORMS[effect].apply(self.plant, HiddenEffect(effect, size, 0.0, extra, kind))

    def lose(self, rotor, share=1.0, kind="weak_motor"):
        """A rotor loses that share of its thrust; seconds until the law was another."""
        self.spoil("degraded_rotor", share, kind, rotor=float(rotor))
        return self.flight.fly(5.0, until=lambda: self.live.core.law is not self.before)


@slow
@pytest.mark.parametrize(
    ("name", "rotor", "kind"),
    [("x8_demo.toml", 2, "weak_motor"), ("x8_demo.toml", 4, "tip"), ("y6.toml", 3, "weak_motor")],
)
def test_a_rotor_that_stops_is_flown_without_within_200_ms(name, rotor, kind):
    mixed = Mixed(name)
    height = mixed.plant.height
    assert mixed.lose(rotor, kind=kind) < FOUND_S
    mixed.flight.fly(AFTER_S)
    assert [c.rotor for c in mixed.calls] == [rotor] and mixed.calls[0].stopped and not mixed.watch.problem
    assert mixed.live.core.sent[rotor - 1] == 0.0 and not mixed.live.failed.is_set()
    assert max(row.tilt_deg for row in mixed.flight.rows) < 25.0 and mixed.flight.rows[-1].tilt_deg < 8.0
    assert mixed.plant.height > height - 1.5 and mixed.flight.outputs_are_sound()
    done = mixed.watch.account()["reallocated"][0]
    assert (done["rotor"], done["thrust_left"]) == (rotor, 0.0)


@slow
def test_a_sound_flight_keeps_its_law_and_another_law_is_not_taken_back():
    mixed = Mixed("y6.toml")
    mixed.a.go_to((6.0, 3.0, -6.0), 1.5)
    mixed.flight.fly(8.0)
    assert not mixed.calls and mixed.live.core.law is mixed.before
    mixed.lose(2)
    law = mixed.live.core.law
    mixed.plant.geometry[mixed.plant.index.G_SPEED, 1] = 1.0  # it would turn again
    mixed.flight.fly(1.0)
    assert mixed.live.core.law is law and mixed.live.core.sent[1] == 0.0


@slow
def test_a_weak_rotor_has_its_share_in_the_law():
    mixed = Mixed(wind=0.0)
    mixed.lose(4, 0.2, "share")
    mixed.flight.fly(0.5)
    assert {c.rotor for c in mixed.calls} == {4} and not any(c.stopped for c in mixed.calls)
    assert mixed.watch.account()["reallocated"][0]["thrust_left"] == pytest.approx(0.8, abs=0.04)
    gains = [r.thrust_gain for r in mixed.watch.in_air.vehicle.airframe.rotors]
    assert gains[3] == pytest.approx(0.8, abs=0.04) and gains[:3] == [1, 1, 1]
    # what was delivered is accounted by the rotors that there are
    assert max(abs(e) for e in mixed.live.core.error) < 1e-3


@slow
def test_without_it_nothing_is_changed():
    mixed = Mixed(reallocate=False)
    mixed.lose(2)
    assert mixed.live.core.law is mixed.before and not any(c.stopped for c in mixed.calls)


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
