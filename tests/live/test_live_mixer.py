"""Live mixing: every demand gets one bounded answer or none, and only from an autopilot that takes it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.live.guard import Timing
from coaxlink.live.mixer import DemandScale, LiveMixer, MixCore, require_path
from coaxlink.mixer import StandardCoefficients, make_law
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = load_airframe(EXAMPLES / "x8_paper.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
HOVER = [0.0, 0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0]


def core(law: str = "coaxial") -> MixCore:
    return MixCore(Vehicle(X8, CRM), law)


class ScriptedSession:
    """A peer that says what the test wants, byte for byte by pymavlink, and keeps what it is sent."""

    fileno, loss = -1, 0.0
    bound = SimpleNamespace(strangers=SimpleNamespace(datagrams=0))

    def __init__(
        self,
        version: tuple[int, ...] = (1, 13, 3),
        autopilot: int = mavlink.MAV_AUTOPILOT_PX4,
        signed: bool = False,
    ) -> None:
        self.identity = SimpleNamespace(system=1, component=1, autopilot=autopilot, version=version)
        self.takes_requests = True
        self.signed = signed
        self.armed = True
        self.tap: Any = None
        self.sent: list[Any] = []
        self.requests: list[tuple[int, float]] = []
        self.listeners: list[Callable[[Any], None]] = []
        self.landed_state = 2
        self._packer = mavlink.MAVLink(None, 1, 1)
        self._parser = mavlink.MAVLink(None)

    def subscribe(self, callback: Callable[[Any], None]) -> Callable[[], None]:
        self.listeners.append(callback)
        return lambda: self.listeners.remove(callback)

    def request_stream(self, message_id: int, rate_hz: float) -> bool:
        self.requests.append((message_id, rate_hz))
        return self.takes_requests

    def wait(self, names: Any, timeout_s: float) -> None:
        return None

    def latest(self, name: str) -> Any:
        return SimpleNamespace(landed_state=self.landed_state)

    def send(self, message: Any) -> None:
        if message.get_type() != "TIMESYNC":
            self.sent.append(message)

    def send_frame(self, pack: Callable[[int, int, int], bytes], seed: bytes) -> None:
        self.sent += self._parser.parse_buffer(pack(len(self.sent) % 256, 245, 191)) or []

    def hear(self, message: Any, system: int = 1, component: int = 1) -> None:
        packer = self._packer
        packer.srcSystem, packer.srcComponent = system, component
        data = bytes(message.pack(packer))
        packer.seq = (packer.seq + 1) % 256
        if self.tap is not None:
            self.tap.take(data)
        for listener in list(self.listeners):
            listener(message)

    def demand(self, time_usec: int, controls: list[float], group: int = 0) -> None:
        self.hear(mavlink.MAVLink_actuator_control_target_message(time_usec, group, controls))


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
    assert c.step(10_000, 0, HOVER) is None  # one stray stamp is not a new clock, two in a row are
    assert c.step(14_000, 0, HOVER) is not None
    assert c.counters.clock_jumps == 1


def test_a_single_stamp_from_elsewhere_does_not_lock_the_right_ones_out() -> None:
    c = core()
    assert c.step(5_000_000, 0, HOVER) is not None
    assert c.step(2**63, 0, HOVER) is None
    assert c.step(5_004_000, 0, HOVER) is not None
    assert c.step(0, 0, HOVER) is None
    assert c.step(5_008_000, 0, HOVER) is not None


def test_other_groups_are_not_ours() -> None:
    c = core()
    assert c.step(1000, 1, HOVER) is None
    assert c.counters.other_group == 1


def test_absurd_demands_get_no_answer_and_outputs_keep_their_range() -> None:
    rng = np.random.default_rng(5)
    for law in ("standard", "reduced", "coaxial", "coaxial-printed"):
        c, answered = core(law), 0
        for k in range(120):
            demand = list(rng.uniform(-1, 1, 8) * 10.0 ** rng.uniform(-2, 3))
            out = c.step(1000 * (k + 1), 0, demand)
            absurd = max(abs(v) for v in demand[:3]) > 1.5 or not -0.5 <= demand[3] <= 1.5
            assert (out is None) == absurd
            if out is not None:
                answered += 1
                assert all(0.0 <= u <= 1.0 for u in out)
        assert answered > 10
        assert c.counters.absurd == 120 - answered
    assert c.counters.clamped > 0


def test_a_law_that_gives_rubbish_is_not_passed_on() -> None:
    for rubbish in (math.nan, 1.2, -0.1):
        law = SimpleNamespace(name="mad", speeds=lambda w, x=rubbish: np.full(8, x), dropped=())
        c = MixCore(Vehicle(X8, CRM), law)
        assert c.step(1000, 0, HOVER) is None
        assert c.counters.refused_outputs == 1


# a slow machine's pauses between demands are none of the vehicle's
QUICK = Timing(settle=1, fade_s=0.0, hold_after_s=30.0, ramp_after_s=60.0)


def mixer_on(session: ScriptedSession, law: Any = None, **options: Any) -> LiveMixer:
    law = law or make_law("coaxial", Vehicle(X8, CRM))
    return LiveMixer(session, Vehicle(X8, CRM), law, **{"timing": QUICK, **options})  # type: ignore[arg-type]


@pytest.mark.parametrize("signed", [False, True])
def test_the_loop_answers_each_demand_once_and_with_its_stamp(signed: bool) -> None:
    session = ScriptedSession(signed=signed)
    with mixer_on(session) as mixer:
        assert session.requests[0] == (140, 250.0)
        for k in range(20):
            session.demand(4000 * (k + 1), HOVER)
        session.demand(4000 * 10, HOVER)
    answered = len(session.sent)
    session.demand(999_999, HOVER)  # after stop: silence
    assert len(session.sent) == answered
    assert [m.time_usec for m in session.sent[:20]] == [4000 * (k + 1) for k in range(20)]
    assert all(m.get_type() == "SET_ACTUATOR_CONTROL_TARGET" and m.group_mlx == 0 for m in session.sent)
    assert all((m.target_system, m.target_component) == (1, 1) for m in session.sent)
    summary = mixer.summary()
    assert summary["cycles"] == 20
    assert summary["unanswered"]["late"] == 1
    assert max(summary["allocation_error"]["max"]) < 1e-6
    assert 0 < summary["latency_us"]["p50"] <= summary["latency_us"]["p99"]


def test_what_goes_out_is_what_the_law_says() -> None:
    session = ScriptedSession()
    with mixer_on(session):
        session.demand(1000, HOVER)
        session.demand(2000, [0.02, -0.03, 0.05, 0.35, 0, 0, 0, 0])
    c = core()
    for message, demand in zip(session.sent, (HOVER, [0.02, -0.03, 0.05, 0.35, 0, 0, 0, 0]), strict=False):
        float32 = np.array(demand, np.float32).astype(float)
        assert list(message.controls) == pytest.approx(c.step(message.time_usec, 0, list(float32)), abs=1e-6)


def test_a_dry_run_computes_and_sends_nothing() -> None:
    session = ScriptedSession()
    with mixer_on(session, dry_run=True) as mixer:
        for k in range(20):
            session.demand(4000 * (k + 1), HOVER)
    assert session.sent == []
    assert mixer.summary()["cycles"] == 20
    assert max(mixer.core.sent) > 0.3


def test_it_takes_over_from_the_autopilots_own_mixer_without_a_step() -> None:
    session = ScriptedSession()
    with mixer_on(session, timing=Timing(settle=4, fade_s=1e9)):
        for k in range(8):
            session.demand(4000 * (k + 1), [0.05, 0.0, 0.1, 0.4, 0, 0, 0, 0])
        sent = list(session.sent)
    assert [m.time_usec for m in sent] == [4000 * k for k in range(4, 9)]
    # setpoints of the geometry mixer: thrust 0.4 on all, roll +-, yaw by spin, each entry +-1 of the axis
    first = np.array(sent[0].controls)
    assert first.mean() == pytest.approx(0.4, abs=1e-6)
    assert np.unique(np.abs(first - 0.4).round(4)).size == 2  # |0.05 e + 0.1| and |0.05 e - 0.1|


def test_of_demands_that_wait_only_the_newest_is_answered() -> None:
    session = ScriptedSession()
    with mixer_on(session):
        packer = mavlink.MAVLink(None, 1, 1)
        burst = b"".join(
            bytes(mavlink.MAVLink_actuator_control_target_message(1000 * k, 0, HOVER).pack(packer))
            for k in range(1, 30)
        )
        session.tap.take(burst)
        summary = session.tap.summary()
        assert [m.time_usec for m in session.sent] == [29_000]
    assert summary["unanswered"]["superseded"] == 28


def test_a_demand_of_someone_else_is_not_answered() -> None:
    session = ScriptedSession()
    with mixer_on(session) as mixer:
        message = mavlink.MAVLink_actuator_control_target_message(1000, 0, HOVER)
        session.hear(message, system=1, component=50)
        session.hear(message, system=9)
    assert session.sent == []
    assert mixer.summary()["unanswered"]["foreign"] == 2


def test_another_companions_commands_on_the_line_end_it() -> None:
    session = ScriptedSession()
    mixer = mixer_on(session)
    mixer.start()
    session.demand(1000, HOVER)
    assert len(session.sent) == 1
    session.hear(session.sent[0], 245, 191)  # our own words, handed back by a router
    assert not mixer.failed.is_set()
    rival = mavlink.MAVLink_set_actuator_control_target_message(1500, 0, 1, 1, [0.3] * 8)
    session.hear(rival, 246, 191)
    session.demand(2000, HOVER)
    assert isinstance(mixer.error, SafetyRefusal)
    assert "another companion" in str(mixer.error)
    assert len(session.sent) == 1


def test_a_failing_law_falls_silent_instead_of_failing_at_every_demand() -> None:
    def broken(wrench: object) -> None:
        raise RuntimeError("no")

    session = ScriptedSession()
    mixer = mixer_on(session, SimpleNamespace(name="broken", speeds=broken, dropped=()))
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
        LiveMixer(session, Vehicle(X8, CRM), "reduced").start()  # type: ignore[arg-type]
    assert session.tap is None
    assert session.requests == []


def test_an_autopilot_that_will_not_send_its_demand_is_refused_and_left_alone() -> None:
    session = ScriptedSession()
    session.takes_requests = False
    with pytest.raises(SafetyRefusal, match="will not send"):
        LiveMixer(session, Vehicle(X8, CRM), "reduced").start()  # type: ignore[arg-type]
    assert session.tap is None


def test_older_px4_is_accepted() -> None:
    for version in ((1, 13, 3), (1, 13), (1, 12, 3)):
        require_path(mavlink.MAV_AUTOPILOT_PX4, version)


def test_more_motors_than_the_message_carries_are_refused() -> None:
    nine = replace(X8, rotors=(*X8.rotors, replace(X8.rotors[0], number=9, level="single", pair=None)))
    with pytest.raises(InputError, match="8 rotors at most"):
        MixCore(Vehicle(nine, CRM), SimpleNamespace())  # type: ignore[arg-type]
