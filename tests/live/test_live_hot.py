"""The compiled live loop: its bytes held against pymavlink's, its checks, and a real socket end to end."""

from __future__ import annotations

import itertools
import math
import socket
import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.airframe import load_airframe
from coaxlink.live import kernel as k
from coaxlink.live.compiled import packed_address
from coaxlink.live.guard import Timing
from coaxlink.live.mixer import LiveMixer
from coaxlink.live.state import plain_state
from coaxlink.mavlink.address import parse_address
from coaxlink.mavlink.session import Session
from coaxlink.mavlink.transport import Udp
from coaxlink.mixer import make_law
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = load_airframe(EXAMPLES / "x8_paper.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
bytes_of = st.integers(0, 255)
floats = st.floats(width=32, allow_nan=True, allow_infinity=True)
shares = st.one_of(st.sampled_from([0.0, 1.0, 0.5]), st.floats(0, 1, width=32))


def frame_of(message: Any, sequence: int = 0, system: int = 1, component: int = 1) -> bytes:
    packer = mavlink.MAVLink(None, system, component)
    packer.seq = sequence
    return bytes(message.pack(packer))


def demand(stamp: int, controls: list[float], group: int = 0, **who: int) -> bytes:
    return frame_of(mavlink.MAVLink_actuator_control_target_message(stamp, group, controls), **who)


@given(st.integers(0, 2**64 - 1), st.lists(floats, min_size=8, max_size=8), bytes_of, bytes_of)
def test_a_demand_is_read_as_pymavlink_wrote_it(
    stamp: int, controls: list[float], group: int, seq: int
) -> None:
    data, body = demand(stamp, controls, group, sequence=seq), bytearray(48)
    assert k.alone(data, len(data), 1, 1)
    k.unpack(data, body)
    assert k.stamp_of(body) == (stamp if stamp < 2**62 else -1)
    assert struct.pack("<8f", *controls) == bytes(body[8:40]) or any(map(math.isnan, controls))
    assert body[40] == group


@given(
    st.integers(0, 2**62), st.lists(shares, min_size=8, max_size=8),
    bytes_of, bytes_of, bytes_of, bytes_of, bytes_of,
)  # fmt: skip
def test_an_answer_is_byte_for_byte_pymavlinks(
    stamp: int,
    commands: list[float],
    sequence: int,
    own: int,
    own_component: int,
    system: int,
    component: int,
) -> None:
    body, out = bytearray(struct.pack("<Q8f", stamp, *commands) + bytes(8)), bytearray(64)
    size = k.pack(out, body, sequence, own, own_component, system, component)
    message = mavlink.MAVLink_set_actuator_control_target_message(stamp, 0, system, component, commands)
    assert bytes(out[:size]) == frame_of(message, sequence, own, own_component)


HOVER = [0.01, -0.02, 0.03, 0.4, 0.0, 0.0, 0.0, 0.0]
BEAT = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)
RIVAL = mavlink.MAVLink_set_actuator_control_target_message(1, 0, 1, 1, [0.5] * 8)


def test_only_a_demand_alone_in_its_datagram_is_taken() -> None:
    mine, beat = demand(5000, HOVER), frame_of(BEAT)

    def alone(data: bytes) -> bool:
        return bool(k.alone(data, len(data), 1, 1))

    assert alone(mine)
    for other in (beat, beat + mine, mine + beat, mine + mine, frame_of(RIVAL), mine[:-1], b"", b"\0" + mine):
        assert not alone(other)
    assert not alone(demand(5000, HOVER, system=2))
    assert not alone(demand(5000, HOVER, component=2))
    # a newer dialect's longer demand, checksum and all: the loop in Python cuts it, the log has no place
    longer = struct.pack("<BBBBBBBHB", 0xFD, 200, 0, 0, 0, 1, 1, 140, 0) + bytes(199) + b"\1"
    assert not alone(longer + struct.pack("<H", k.checksum(longer, 1, len(longer), 181)))
    for index in range(len(mine)):
        damaged = bytearray(mine)
        damaged[index] ^= 0x41
        assert not alone(bytes(damaged))


@pytest.mark.parametrize(
    ("stamp", "group", "held", "answer"),
    [
        (2000, 0, HOVER, True),
        (1000, 0, HOVER, False),
        (999, 0, HOVER, False),
        (1000 + k.JUMP_US, 0, HOVER, False),
        (-1, 0, HOVER, False),
        (2000, 1, HOVER, False),
        (2000, 0, [math.nan, 0, 0, 0.4], False),
        (2000, 0, [0, 0, math.inf, 0.4], False),
        (2000, 0, [0, 0, 0, math.nan], False),
        (2000, 0, [0, 1.0001, 0, 0.4], False),
        (2000, 0, [0, 0, 0, -0.0001], False),
        (2000, 0, [1.0, -1.0, 1.0, 1.0], True),
    ],
)
def test_only_a_demand_beyond_doubt_is_answered_here(
    stamp: int, group: int, held: list[float], answer: bool
) -> None:
    assert k.acceptable(stamp, 1000, group, held) is answer


@settings(max_examples=30)
@given(st.lists(floats, min_size=8, max_size=8), st.floats(0.3, 1.3), st.sampled_from([0.0, 0.02, 0.1]))
def test_no_speeds_whatever_make_a_command_out_of_bounds(
    speeds: list[float], factor: float, lag: float
) -> None:
    state = plain_state()
    state.count, state.factor, state.lag_s, state.quick_s = 8, factor, lag, 0.002
    state.motors, state.commands = [0.4] * 8, [0.4] * 8
    for _ in range(3):
        if k.command(state, 0.004, speeds, range(8)):
            assert all(0.0 <= u <= 1.0 for u in state.commands)
        else:
            assert not all(0.0 <= u <= 1.0 for u in speeds)
            assert state.commands == [0.4] * 8


def test_with_the_lead_a_lagging_motor_turns_as_asked_within_bounds() -> None:
    # its own motor: 20 ms of first order, stepped finely
    state, speed, plain = plain_state(), 0.0, 0.0
    state.count, state.lag_s = 8, 0.02
    commands = state.commands
    misses, late, wanted = [], [], 0.0
    for step in range(200):
        wanted = 0.5 + 0.02 * math.sin(step / 5)
        assert k.command(state, 0.004, [wanted] * 8, range(8))
        for _ in range(400):
            speed += (commands[0] - speed) * 1e-5 / 0.02
            plain += (wanted - plain) * 1e-5 / 0.02
        misses.append(abs(speed - wanted))
        late.append(abs(plain - wanted))
    assert max(misses[20:]) < 2e-5
    assert max(late[20:]) > 2e-3
    assert commands[0] <= 1.0


@pytest.mark.parametrize(("host", "family"), [("127.0.0.1", socket.AF_INET), ("::1", socket.AF_INET6)])
def test_addresses_are_packed_as_the_system_has_them(host: str, family: socket.AddressFamily) -> None:
    import ctypes

    libc = ctypes.CDLL(None, use_errno=True)
    with socket.socket(family, socket.SOCK_DGRAM) as one:
        one.bind((host, 0))
        raw, size = ctypes.create_string_buffer(32), ctypes.c_uint32(32)
        assert libc.getsockname(one.fileno(), raw, ctypes.byref(size)) == 0
        assert raw.raw[: size.value] == packed_address(one.getsockname())


@pytest.fixture(scope="module")
def native() -> Any:
    from coaxlink.live import compiled

    if not compiled.available():
        pytest.skip("the compiled loop runs on 64-bit Linux")
    return compiled.load()


class Rig:
    """An autopilot by hand on a real socket, and a live mixer on the other end."""

    def __init__(self, native: Any, lead_s: tuple[float, float] = (0.0, 0.0)) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(1.0)
        address = f"udpout:127.0.0.1:{self.socket.getsockname()[1]}"
        line = Udp(parse_address(address))
        line.write(b"\0")
        _, self.peer = self.socket.recvfrom(100)
        self.session = Session(line, address, 245, 191)
        self.session._ask_version = lambda: None  # type: ignore[method-assign]
        self.say(frame_of(BEAT))
        self.session.start(3.0)
        self.session.bound.identity = self.session.identity.__class__(1, 1, 12, 2, (1, 13, 3))
        self.session.request_stream = lambda *_: True  # type: ignore[method-assign]
        timing = Timing(settle=1, fade_s=0.0, hold_after_s=1.0, ramp_after_s=2.0)
        law = make_law("exact", Vehicle(X8, CRM))
        self.live = LiveMixer(
            self.session, Vehicle(X8, CRM), law, timing=timing, witness=False, native=native, lead_s=lead_s
        )
        self.live.start()
        time.sleep(0.1)  # the read that was under way does not know of it yet
        self._parser = mavlink.MAVLink(None)

    @property
    def hot_answers(self) -> int:
        """How many answers the compiled loop gave."""
        return self.live.exchange.answers if self.live.exchange else 0

    def say(self, data: bytes) -> None:
        self.socket.sendto(data, self.peer)

    def hear(self) -> Any:
        while True:
            for message in self._parser.parse_buffer(self.socket.recv(2048)) or []:
                if message.get_type() == "SET_ACTUATOR_CONTROL_TARGET":
                    return message

    def silent(self) -> bool:
        self.socket.settimeout(0.08)
        try:
            self.hear()
        except TimeoutError:
            return True
        finally:
            self.socket.settimeout(1.0)
        return False

    def close(self) -> None:
        self.session.tap = None
        self.session.close()
        self.socket.close()


def test_the_compiled_loop_answers_as_the_plain_one_and_keeps_the_same_books(native: Any) -> None:
    rig, plain = Rig(native), make_law("exact", Vehicle(X8, CRM))
    heard: list[str] = []
    rig.session.subscribe(lambda m: heard.append(m.get_type()))
    sequences = []
    try:
        for n in range(300):
            controls = [0.03 * math.sin(n / 9), 0.02 * math.cos(n / 7), 0.05 * math.sin(n / 5), 0.4]
            controls += [0.0] * 4
            stamp = 1_000_000 + 2500 * n
            data = demand(stamp, controls, sequence=n % 256)
            if n == 100:
                data = frame_of(BEAT) + data + frame_of(BEAT)
            if n == 101:
                data = demand(stamp - 1, [0.9] * 8) + data
            rig.say(data)
            answer = rig.hear()
            assert answer.time_usec == stamp
            assert (answer.target_system, answer.target_component) == (1, 1)
            wrench = rig.live.core.scale.wrench(np.float32(controls).astype(float).tolist())
            # two laws from different starts: the same optimum to a quadratic step, the same wrench exactly
            assert answer.controls == pytest.approx(plain.speeds(wrench), abs=2e-5)
            delivered = X8.wrench(*X8.loads(CRM, np.array(answer.controls)))
            assert delivered == pytest.approx(wrench, abs=1e-4)
            sequences.append(answer.get_seq())
        # whatever is strange still gets the plain loop's judgement, in the middle of it all
        for n, bad in enumerate(([math.nan, 0, 0, 0.4], [9.0, 0, 0, 0.4], [0, 0, 0, -7.0])):
            rig.say(demand(2_000_000 + n, bad + [0.0] * 4))
            assert rig.silent()
        rig.say(demand(1_000_000, HOVER))
        assert rig.silent()
        rig.say(demand(2_100_000, HOVER, component=7))
        assert rig.silent()
        rig.say(demand(2_200_000, [0.0, 0.0, 0.0, 1.2, 0.0, 0.0, 0.0, 0.0]))  # held to the range
        assert rig.hear().time_usec == 2_200_000
        rig.say(demand(2_210_000, HOVER))
        assert rig.hear().time_usec == 2_210_000
        time.sleep(0.3)
        s = rig.live.summary()
        assert s["cycles"] == 302
        assert rig.hot_answers > 290
        assert s["unanswered"]["not_finite"] == 1
        assert s["unanswered"]["absurd"] == 2
        assert s["unanswered"]["late"] == 1
        assert s["unanswered"]["foreign"] == 1
        assert s["unanswered"]["superseded"] == 1
        assert s["clamped_demands"] == 1
        assert max(s["allocation_error"]["mean"][1:]) < 1e-5  # full thrust was out of reach
        assert 0 < s["latency_us"]["p50"] < 1e5
        assert heard.count("HEARTBEAT") >= 2  # what rode along with a demand was not lost
        assert heard.count("ACTUATOR_CONTROL_TARGET") < 20  # nearly all were the compiled loop's
        steps = {(b - a) % 256 for a, b in itertools.pairwise(sequences)}
        assert 1 in steps and max(steps) <= 3  # more than 1 where heartbeats of ours went between
    finally:
        rig.close()


def test_motor_commands_of_another_end_it_for_good(native: Any) -> None:
    rig = Rig(native)
    try:
        for n in range(5):
            rig.say(demand(1_000_000 + 2500 * n, HOVER))
            rig.hear()
        rig.say(demand(1_020_000, HOVER) + frame_of(RIVAL, system=3))
        assert rig.live.failed.wait(1.0)
        assert "another companion" in str(rig.live.error)
        while not rig.silent():
            pass
        rig.say(demand(1_030_000, HOVER))
        assert rig.silent()
    finally:
        rig.close()


@pytest.mark.parametrize("compiled", [True, False])
def test_nothing_from_another_address_is_answered_or_stops_it(native: Any, compiled: bool) -> None:
    rig = Rig(native if compiled else None)
    other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    other.bind(("127.0.0.1", 0))
    other.settimeout(0.3)
    junk = [
        frame_of(BEAT),
        demand(1_500_000, HOVER),
        frame_of(RIVAL, system=3),
        frame_of(RIVAL),
        b"\xfd\xff\0",
    ]
    try:
        for n in range(400):
            for k in range(3):
                other.sendto(junk[(n + k) % len(junk)], rig.peer)
            rig.say(demand(1_000_000 + 2500 * n, HOVER))
            assert rig.hear().time_usec == 1_000_000 + 2500 * n
        assert rig.live.error is None
        time.sleep(0.4)  # the compiled loop books when its turn is over
        assert rig.live.core.counters.cycles == 400
        if compiled:
            assert rig.hot_answers > 300
        assert rig.session.bound.strangers.datagrams > 400
        parser, heard = mavlink.MAVLink(None), set()
        while True:
            try:
                heard |= {message.get_type() for message in parser.parse_buffer(other.recv(2048)) or []}
            except TimeoutError:
                break
        assert heard == {"COMMAND_LONG"}  # it was asked who it is, and got no motor command
    finally:
        rig.close()
        other.close()


def test_the_compiled_loop_leads_the_motors_as_the_plain_one(native: Any) -> None:
    rig, other = Rig(native, lead_s=(0.02, 0.004)), Rig(None, lead_s=(0.02, 0.004))
    try:
        for n in range(50):
            data = demand(1_000_000 + 4000 * n, [0.02 * math.sin(n / 3), 0, 0, 0.4, 0, 0, 0, 0])
            rig.say(data)
            other.say(data)
            assert rig.hear().controls == pytest.approx(other.hear().controls, abs=1e-6)
    finally:
        rig.close()
        other.close()
