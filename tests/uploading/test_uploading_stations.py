"""Others on the line during an upload: one who writes on, one who says "armed", one of another kind."""

import pytest
from memory_net import meet
from pymavlink.dialects.v20 import common as m

from coaxlink.uploading.worker import Uploader

NAME = "CA_ROTOR2_CT"


def _every(board, seconds, what, until_s=1e9):
    clock = board.net.clock
    end = clock.monotonic() + until_s

    def again():
        if clock.monotonic() < end:
            what()
            clock.later(seconds, again)

    again()


def _as(board, system, component, *messages):
    """What a router behind the board's own address brings of somebody else."""
    packer = m.MAVLink(None, system, component)
    for message in messages:
        board.net.send(message.pack(packer), board.address, board._peer)


def _written_over(board, system=255, routed=True, until_s=1e9):
    def write():
        board.params[NAME] = (11.0, 9)
        if routed:
            _as(board, system, 190, m.MAVLink_param_set_message(1, 1, NAME.encode(), 11.0, 9))

    board.after_set[3] = lambda: _every(board, 0.03, write, until_s)


@pytest.mark.parametrize("routed", [True, False])
def test_rolled_back_is_not_said_while_another_station_writes_on(board, plan_of, tmp_path, routed):
    _written_over(board, routed=routed)
    with meet(board) as session:
        outcome = Uploader(session, backup_folder=tmp_path, patience_s=20.0).upload(plan_of())
    assert outcome.result == "failed" and "could not be put back" in outcome.reason
    who = "system 255 component 190" if routed else "another station may write, none is heard here"
    assert who in outcome.reason and board.params[NAME][0] == 11.0


def test_once_it_has_ended_the_old_table_is_back_and_the_station_named(board, plan_of, tmp_path):
    before = board.params[NAME]
    _written_over(board, until_s=9.0)
    with meet(board) as session:
        outcome = Uploader(session, backup_folder=tmp_path, patience_s=60.0).upload(plan_of())
    assert outcome.result == "rolled_back" and "system 255 component 190 at" in outcome.reason
    assert board.params[NAME] == before


def test_forged_armed_heartbeats_stop_the_write(board, plan_of, tmp_path):
    """Whoever says it: between two of them the vehicle's own beat says disarmed."""
    armed = m.MAVLink_heartbeat_message(board.vehicle_type, 12, 128, 0, 4, 3)
    board.after_set[3] = lambda: _every(board, 0.004, lambda: _as(board, 1, 1, armed))
    with meet(board) as session:
        outcome = Uploader(session, backup_folder=tmp_path).upload(plan_of())
    assert outcome.result == "failed" and outcome.error.exit_code == 4
    assert "the vehicle armed while it was written: nothing more was written" in outcome.reason


def test_heartbeats_of_another_kind_are_said(board):
    quad = m.MAVLink_heartbeat_message(m.MAV_TYPE_QUADROTOR, 12, 0, 0, 4, 3)
    with meet(board) as session:
        assert session.bound.news() == []
        _every(board, 0.004, lambda: _as(board, 1, 1, quad))
        session.clock.sleep(3.0)
        (reported,) = session.bound.news()
        assert "two kinds" in reported and "quadrotor and octorotor" in reported and "a second" in reported
