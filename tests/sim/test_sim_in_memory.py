"""A stand-in without sockets and sleep: parameters, a reboot, two clients, faults, a flight."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as m

from sim.in_memory import InMemory
from sim.simulation import Simulation

FRAME = Path(__file__).parents[2] / "examples" / "x8_demo.toml"


class Client:
    """One who talks to a board on a clock of its own."""

    def __init__(self, board: InMemory, number: int = 0) -> None:
        self.board, self.number, self.now = board, number, 100.0
        self.mav, self.reader = m.MAVLink(None, 255, 190), m.MAVLink(None)
        self.reader.robust_parsing = True
        board.exchange(b"", self.now, number)

    def say(self, *messages: m.MAVLink_message, seconds: float = 0.0) -> list[m.MAVLink_message]:
        """What comes back by then."""
        data = b"".join(message.pack(self.mav) for message in messages)
        self.now += seconds
        answer = self.board.exchange(data, self.now, self.number)
        return self.reader.parse_buffer(answer) or []


def named(messages: list[m.MAVLink_message], kind: str) -> list[m.MAVLink_message]:
    return [message for message in messages if message.get_type() == kind]


def command(number: int, *params: float) -> m.MAVLink_message:
    return m.MAVLink_command_long_message(1, 1, number, 0, *params, *[0.0] * (7 - len(params)))


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_parameters_come_and_go(firmware: str) -> None:
    client = Client(InMemory(Simulation(FRAME, firmware=firmware)))
    client.say(seconds=3.0)
    values = named(client.say(m.MAVLink_param_request_list_message(1, 1), seconds=2.0), "PARAM_VALUE")
    names = {v.param_id for v in values} - {"_HASH_CHECK"}
    assert names == set(client.board.autopilot.store.names)
    name = "MPC_Z_P" if firmware == "px4" else "PSC_POSZ_P"
    answers = client.say(m.MAVLink_param_set_message(1, 1, name.encode(), 1.25, 9))  # at once
    assert [v.param_value for v in named(answers, "PARAM_VALUE") if v.param_id == name][:1] == [1.25]
    assert client.board.autopilot.store[name] == 1.25


@pytest.mark.slow
def test_time_passes_as_told_and_never_back() -> None:
    client = Client(InMemory(Simulation(FRAME)))
    assert len(named(client.say(seconds=9.5), "HEARTBEAT")) == 10
    assert client.say(seconds=-5.0) == []
    assert named(client.say(seconds=5.0 + 1.0), "HEARTBEAT")


def test_a_reboot_is_silence() -> None:
    client = Client(InMemory(Simulation(FRAME)))
    answers = client.say(command(246, 1))
    assert named(answers, "COMMAND_ACK")
    assert not client.say(seconds=1.4)
    assert named(client.say(seconds=1.4), "HEARTBEAT")


def test_clients_hear_their_own_answers() -> None:
    board = InMemory(Simulation(FRAME))
    one, two = Client(board), Client(board, 1)
    assert named(one.say(command(520)), "AUTOPILOT_VERSION")
    assert not named(two.say(), "AUTOPILOT_VERSION")


def test_faults_are_on_the_callers_clock() -> None:
    client = Client(InMemory(Simulation(FRAME, wire="dead=1:3")))
    assert client.say(seconds=0.9)
    client.say(seconds=0.2)
    assert not client.say(seconds=1.8)
    assert client.say(seconds=0.2)
