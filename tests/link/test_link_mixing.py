"""Live mixing: every demand gets one bounded answer or none, and only from an autopilot that takes it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.link.mixing import DemandScale, LiveMixer, MixCore, require_path
from coaxlink.mixer import StandardCoefficients, make_law
from coaxlink.rotor.model import load_rotor_model

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = load_airframe(EXAMPLES / "x8_paper.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
HOVER = [0.0, 0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0]


def core(law: str = "coaxial") -> MixCore:
    return MixCore(X8, make_law(law, X8, CRM), CRM)


class ScriptedSession:
    """A peer that says what the test wants and keeps what it is sent."""

    def __init__(
        self, version: tuple[int, ...] = (1, 13, 3), autopilot: int = mavlink.MAV_AUTOPILOT_PX4
    ) -> None:
        self.identity = SimpleNamespace(system=1, component=1, autopilot=autopilot, version=version)
        self.takes_requests = True
        self.sent: list[Any] = []
        self.requests: list[tuple[int, float]] = []
        self.listeners: list[Callable[[Any], None]] = []

    def subscribe(self, callback: Callable[[Any], None]) -> Callable[[], None]:
        self.listeners.append(callback)
        return lambda: self.listeners.remove(callback)

    def request_stream(self, message_id: int, rate_hz: float) -> bool:
        self.requests.append((message_id, rate_hz))
        return self.takes_requests

    def send(self, message: Any) -> None:
        self.sent.append(message)

    def demand(self, time_usec: int, controls: list[float], group: int = 0) -> None:
        for listener in list(self.listeners):
            listener(mavlink.MAVLink_actuator_control_target_message(time_usec, group, controls))


def test_a_hover_demand_means_eight_equal_setpoints_of_the_standard_table() -> None:
    # thrust scale is 1 when all entries are alike: setpoint s on each of eight rotors of 73.06 N
    scale = DemandScale(X8, StandardCoefficients(73.06, 1.9))
    assert scale.wrench([0, 0, 0, 0.4]) == pytest.approx([8 * 73.06 * 0.4, 0, 0, 0], abs=1e-3)


def test_a_roll_demand_follows_px4s_scale_by_hand() -> None:
    # every rotor at +-0.1807 m: entries e = +-1/(8 * 73.06 * 0.1807), scale sqrt(8 e^2 / 4) = sqrt(2) e
    scale = DemandScale(X8, StandardCoefficients(73.06, 1.9))
    by_hand = 8 * 73.06 * 0.1807 / math.sqrt(2.0)
    assert scale.wrench([0.1, 0, 0, 0]) == pytest.approx([0, 0.1 * by_hand, 0, 0], abs=1e-3)
    assert scale.wrench([0, 0, 0.1, 0]) == pytest.approx([0, 0, 0, 0.1 * 8 * 1.9], abs=1e-3)


def test_a_demand_becomes_the_wrench_it_means_on_the_rotor_model() -> None:
    c = core()
    out = c.step(1000, 0, [0.02, -0.03, 0.05, 0.3, 0, 0, 0, 0])
    assert out is not None
    assert len(out) == 8
    thrust, torque = X8.loads(CRM, out)
    assert X8.wrench(thrust, torque) == pytest.approx(c.wrench, abs=1e-6)
    assert c.wrench[0] > 100
    assert c.wrench[1] > 0 > c.wrench[2]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("axis", [0, 1, 2, 3])
def test_what_is_not_finite_gets_no_answer(bad: float, axis: int) -> None:
    c = core()
    assert c.step(1000, 0, HOVER) is not None
    demand = list(HOVER)
    demand[axis] = bad
    assert c.step(2000, 0, demand) is None
    assert c.counters.not_finite == 1
    assert c.step(3000, 0, HOVER) is not None


def test_old_and_repeated_demands_get_no_answer_but_a_rebooted_clock_does() -> None:
    c = core()
    assert c.step(5_000_000, 0, HOVER) is not None
    assert c.step(5_000_000, 0, HOVER) is None
    assert c.step(4_996_000, 0, HOVER) is None
    assert c.counters.late == 2
    assert c.step(10_000, 0, HOVER) is not None


def test_other_groups_are_not_ours() -> None:
    c = core()
    assert c.step(1000, 1, HOVER) is None
    assert c.counters.other_group == 1


def test_absurd_demands_are_held_to_the_messages_range_and_outputs_to_theirs() -> None:
    rng = np.random.default_rng(5)
    for law in ("standard", "reduced", "coaxial", "coaxial-printed"):
        c = core(law)
        for k in range(60):
            out = c.step(1000 * k, 0, list(rng.uniform(-1, 1, 8) * 10.0 ** rng.uniform(-2, 30)))
            assert out is not None
            assert all(0.0 <= u <= 1.0 for u in out)
        assert c.counters.clamped > 0


def test_a_law_that_gives_rubbish_is_not_passed_on() -> None:
    for rubbish in (math.nan, 1.2, -0.1):
        law = SimpleNamespace(name="mad", speeds=lambda w, x=rubbish: np.full(8, x), dropped=())
        c = MixCore(X8, law, CRM)
        assert c.step(1000, 0, HOVER) is None
        assert c.counters.refused_outputs == 1


def test_the_loop_answers_each_demand_once_and_with_its_stamp() -> None:
    session = ScriptedSession()
    with LiveMixer(session, X8, make_law("coaxial", X8, CRM), CRM) as mixer:  # type: ignore[arg-type]
        assert session.requests == [(140, 250.0)]
        for k in range(20):
            session.demand(4000 * (k + 1), HOVER)
    session.demand(999_999, HOVER)  # after stop: silence
    assert [m.time_usec for m in session.sent] == [4000 * (k + 1) for k in range(20)]
    assert all(m.get_type() == "SET_ACTUATOR_CONTROL_TARGET" and m.group_mlx == 0 for m in session.sent)
    summary = mixer.summary()
    assert summary["cycles"] == 20
    assert max(summary["allocation_error"]["max"]) < 1e-6
    assert 0 < summary["latency_us"]["p50"] <= summary["latency_us"]["p99"]


def test_a_failing_law_falls_silent_instead_of_failing_at_every_demand() -> None:
    def broken(wrench: object) -> None:
        raise RuntimeError("no")

    session = ScriptedSession()
    law = SimpleNamespace(name="broken", speeds=broken, dropped=())
    mixer = LiveMixer(session, X8, law, CRM)  # type: ignore[arg-type]
    mixer.start()
    session.demand(1000, HOVER)
    assert mixer.failed.is_set()
    assert str(mixer.error) == "no"
    session.demand(2000, HOVER)
    assert session.sent == []
    assert mixer.summary()["unanswered"]["failures"] == 1


@pytest.mark.parametrize(
    ("autopilot", "version", "says"),
    [
        (mavlink.MAV_AUTOPILOT_PX4, (1, 16, 1), r"PX4 1\.16\.1 ignores"),
        (mavlink.MAV_AUTOPILOT_PX4, (1, 14, 0), r"PX4 1\.14\.0 ignores"),
        (mavlink.MAV_AUTOPILOT_PX4, None, "unknown version"),
        (mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, (4, 5, 0), "Lua"),
        (mavlink.MAV_AUTOPILOT_GENERIC, (1, 0, 0), "no way is known"),
    ],
)
def test_an_autopilot_that_ignores_the_stream_is_refused_with_the_reason(
    autopilot: int, version: tuple[int, ...] | None, says: str
) -> None:
    with pytest.raises(SafetyRefusal, match=says):
        require_path(autopilot, version)
    session = ScriptedSession(version or (1, 99), autopilot)
    with pytest.raises(SafetyRefusal):
        LiveMixer(session, X8, make_law("reduced", X8, CRM), CRM).start()  # type: ignore[arg-type]
    assert session.listeners == []
    assert session.requests == []


def test_an_autopilot_that_will_not_send_its_demand_is_refused_and_left_alone() -> None:
    session = ScriptedSession()
    session.takes_requests = False
    with pytest.raises(SafetyRefusal, match="will not send"):
        LiveMixer(session, X8, make_law("reduced", X8, CRM), CRM).start()  # type: ignore[arg-type]
    assert session.listeners == []


def test_older_px4_is_accepted() -> None:
    for version in ((1, 13, 3), (1, 13), (1, 12, 3)):
        require_path(mavlink.MAV_AUTOPILOT_PX4, version)


def test_more_motors_than_the_message_carries_are_refused() -> None:
    nine = SimpleNamespace(rotors=[None] * 9, source=None, name="nine")
    with pytest.raises(InputError, match="8 motors at most"):
        MixCore(nine, SimpleNamespace(), CRM)  # type: ignore[arg-type]
