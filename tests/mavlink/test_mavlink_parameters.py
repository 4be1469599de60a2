"""The parameter protocol, PX4's and ArduPilot's way, on good and bad lines."""

import random

import pytest
from case_table import case_table
from memory_net import Net, meet
from pymavlink.dialects.v20 import common as m
from scripted_autopilot import FLOAT, INT32, ScriptedAutopilot

from coaxlink.errors import CheckFailed, InputError, LinkError
from coaxlink.mavlink.parameters import Parameters
from coaxlink.mavlink.values import ParamSet, decode, encode, is_bytewise

MANY = {f"P{i}": ((i, INT32) if i % 3 == 0 else (i + 0.1, FLOAT)) for i in range(100)}


@pytest.fixture
def vehicle():
    with ScriptedAutopilot(MANY, net=Net()) as scripted:
        yield scripted


def test_int32_travels_bytewise_on_px4_and_as_a_float_on_ardupilot():
    for px4 in (True, False):
        with ScriptedAutopilot({"N": (1, INT32)}, net=Net(), px4=px4) as vehicle, meet(vehicle) as session:
            parameters = Parameters(session)
            assert parameters.bytewise is px4
            assert parameters.read("N").value == 1
            assert parameters.write("N", -5, INT32).value == -5
            assert vehicle.params["N"] == (-5, INT32)


def test_an_int32_that_looks_like_a_signalling_nan_arrives_whole():
    with ScriptedAutopilot({"N": (0, INT32)}, net=Net()) as vehicle, meet(vehicle) as session:
        for value in (0x7F800001, -8388607, 2**31 - 1, -(2**31)):
            assert Parameters(session).write("N", value, INT32).value == value
            assert vehicle.params["N"][0] == value
            assert Parameters(session).read("N").value == value


def test_all_with_gaps_read_again(vehicle):
    vehicle.skip_in_list = {0, 17, 99}
    with meet(vehicle) as session:
        parameters = Parameters(session)
        snapshot = parameters.read_all()
    assert list(snapshot.values) == list(MANY)
    assert all(snapshot.values[n].value == pytest.approx(v, rel=1e-6) for n, (v, _) in MANY.items())
    assert snapshot.hash == 0x12345678
    assert parameters.retries == 3


def test_everything_arrives_over_a_bad_line(vehicle):
    with meet(vehicle) as session:
        vehicle.loss = 0.3
        parameters = Parameters(session)
        assert len(parameters.read_all().values) == 100
        found = parameters.read_many(list(MANY)[:40])
        assert [v.value for v in found.values()] == pytest.approx([v for v, _ in MANY.values()][:40])
        assert parameters.write("P1", 7.25, FLOAT).value == 7.25
        assert parameters.retries > 0


def test_an_unknown_name_is_one_clear_error(vehicle):
    with meet(vehicle) as session:
        with pytest.raises(
            InputError, match=r"NOT_THERE: the vehicle has no such parameter .*not in its list"
        ):
            Parameters(session, timeout_s=0.05).read("NOT_THERE")
        vehicle.param_errors = True
        with pytest.raises(InputError, match="does not exist"):
            Parameters(session).read("NOT_THERE")
        assert list(Parameters(session).read_many(["P1", "NOPE"], missing_ok=True)) == ["P1"]


def test_a_lost_link_is_not_an_unknown_name(vehicle):
    with meet(vehicle) as session:
        vehicle.deaf = True
        session.clock.sleep(10.0)
        with pytest.raises(LinkError, match="no heartbeat"):
            Parameters(session, timeout_s=0.05).read("P1")
        with pytest.raises(LinkError, match="no answer to the request"):
            Parameters(session, timeout_s=0.05).read_all()


def test_a_value_the_vehicle_does_not_keep_is_found(vehicle):
    vehicle.keeps["P1"] = 3.0
    vehicle.refuses.add("P2")
    with meet(vehicle) as session:
        parameters = Parameters(session, timeout_s=0.05)
        with pytest.raises(CheckFailed, match=r"P1: 7.0 was sent, the vehicle holds 3.0"):
            parameters.write("P1", 7.0, FLOAT)
        with pytest.raises(CheckFailed, match=r"P2: the vehicle refused it .read only"):
            parameters.write("P2", 7.0, FLOAT)


def test_what_a_type_cannot_hold_is_never_sent(vehicle):
    with meet(vehicle) as session:
        for value, kind in ((float("nan"), FLOAT), (1.5, INT32), (2**31, INT32), (300, 2)):
            with pytest.raises(InputError):
                Parameters(session).write("P1", value, kind)
    assert vehicle.sets == []


def test_a_message_is_decoded_alike_off_the_wire_and_before_it():
    """Every type both ways; the bits of an int32 in the float field are a denormal, or a signalling NaN."""
    for kind, value in ((1, 200), (2, -5), (3, 60000), (4, -300), (5, 3_000_000_000), (6, -7), (9, 0.1)):
        for bytewise in (True, False):
            held = encode("P", value, kind, bytewise)
            frame = ParamSet(1, 1, held).pack(m.MAVLink(None))
            (there,) = m.MAVLink(None).parse_buffer(frame)
            back = decode(there, bytewise)
            assert (back.value, back.type) == (held.value, kind)
            assert bytewise or back.same(held)
    reported = m.MAVLink_param_value_message(b"P", 0.5, 9, 1, 0)  # never sent
    assert decode(reported, True).value == 0.5
    assert is_bytewise(m.MAV_AUTOPILOT_PX4) and not is_bytewise(m.MAV_AUTOPILOT_ARDUPILOTMEGA)
    assert is_bytewise(m.MAV_AUTOPILOT_PX4, 0) and not is_bytewise(m.MAV_AUTOPILOT_PX4, 2)


def test_who_is_heard_and_answers_nothing_is_a_lost_link_and_not_a_board_with_nothing_on_it():
    with ScriptedAutopilot({"A": (1.0, FLOAT)}, net=Net()) as vehicle, meet(vehicle) as session:
        vehicle._handle = lambda message: None
        with pytest.raises(LinkError, match=r"answers nothing .*signing_key"):
            Parameters(session, timeout_s=0.05).read_many(["A"], missing_ok=True)


def stopped_now_and_then(vehicle, seed):
    """As beside a load of 20: it runs for a while, then for seconds it does not; what came meanwhile is
    answered in order after that. Heartbeats come as ever, as from another thread."""
    hear, clock, draw = vehicle._hear, vehicle.net.clock, random.Random(seed)
    until = [0.0, 0.0]  # when it runs again, when it stops next

    def later(data, source):
        now = clock.monotonic()
        while now >= until[1]:
            until[0] = max(until[1], now) + draw.uniform(0.5, 4.0)
            until[1] = until[0] + draw.uniform(0.05, 1.0)
        clock.later(max(until[0] - now, 0.001), lambda: hear(data, source))

    vehicle.net.bind(vehicle.address, later)


def test_silence_of_a_slow_board_is_not_absence():
    """Every name that is there is found, every other is absent by the board's own word."""
    there = list(MANY)[:20]
    with case_table() as case:
        for says_no in (True, False):
            few = dict(list(MANY.items())[:40])
            with ScriptedAutopilot(few, net=Net()) as vehicle, case(f"PARAM_ERROR {says_no}"):
                vehicle.param_errors = says_no
                with meet(vehicle) as session:
                    stopped_now_and_then(vehicle, says_no)
                    for _ in range(12):
                        found = Parameters(session).read_many([*there, "NOPE"], missing_ok=True)
                        assert list(found) == there


def test_a_hidden_name_answers_and_one_that_falls_silent_is_called_silent():
    """Hidden from the list: what ArduPilot has while scripting is off, and PX4's unused ones."""
    with ScriptedAutopilot(MANY, net=Net()) as vehicle, meet(vehicle) as session:
        parameters = Parameters(session)
        vehicle.params["HIDDEN"] = (1.0, FLOAT)
        listed, handle = list(MANY), vehicle._handle

        def answer(message):
            if message.get_type() == "PARAM_REQUEST_LIST":
                for index, name in enumerate(listed):
                    value, kind = MANY[name]
                    vehicle.send(
                        m.MAVLink_param_value_message(name.encode(), float(value), kind, len(listed), index)
                    )
            elif getattr(message, "param_id", "") != "P7":
                handle(message)

        vehicle._handle = answer
        assert list(parameters.read_many(["HIDDEN", "NOPE", "P1"], missing_ok=True)) == ["HIDDEN", "P1"]
        with pytest.raises(LinkError, match="no answer for P7, which the vehicle has"):
            parameters.read_many(["P7", "P1"], missing_ok=True)
        assert list(parameters.answering(["P7", "P1"])) == ["P1"]


def test_a_board_that_claims_more_parameters_than_it_has_is_told_in_seconds():
    with ScriptedAutopilot(MANY, net=Net()) as vehicle, meet(vehicle) as session:
        send = vehicle._send_raw

        def claiming(name, bits, kind, index):
            vehicle.params, real = dict.fromkeys(range(65535)), vehicle.params
            send(name, bits, kind, index)
            vehicle.params = real

        vehicle._send_raw = claiming
        began = session.clock.monotonic()
        with pytest.raises(LinkError, match="of the 65535 parameters that it says it has 100 came"):
            Parameters(session).read_all()
        assert session.clock.monotonic() - began < 30.0
