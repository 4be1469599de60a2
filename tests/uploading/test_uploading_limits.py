"""A board's own parameter list, as ground stations fetch it by MAVFTP."""

import json
import lzma

from memory_net import meet, standin
from px4_board import params_text

from coaxlink.mavlink.ftp import Files
from coaxlink.uploading.limits import PATH, Limits, board_limits, parse_limits
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.worker import Uploader

LIST = {
    "version": 1,
    "parameters": [
        {"name": "CA_ROTOR0_CT", "type": "Float", "min": 0.0, "max": 60.0, "default": 6.5},
        {"name": "CA_ROTOR5_CT", "type": "Float", "min": 0.0, "max": 60.0},
        {"name": "CA_AIRFRAME", "type": "Int32"},
        *({"name": f"FILLER_{n}", "type": "Float", "max": n * 1.7} for n in range(400)),
    ],
}


def test_limits_of_a_list():
    found = parse_limits(json.dumps(LIST))
    assert found["CA_ROTOR0_CT"] == Limits(0.0, 60.0)
    assert found["CA_AIRFRAME"] == Limits(None, None) and found["FILLER_3"].minimum is None


def test_a_value_that_the_board_s_own_list_forbids_is_refused(tmp_path):
    table = tmp_path / "x8.params"
    table.write_text(params_text())  # CT 46.98 above, 69.89 below: within ours, beyond this board's
    with standin() as board, meet(board) as session:
        files = board.autopilot.files
        files.folders |= {"etc", "etc/extras"}
        files.files[PATH.strip("/")] = lzma.compress(json.dumps(LIST).encode())
        outcome = Uploader(session, backup_folder=tmp_path / "b").upload(load_plan(table))
        assert outcome.result == "refused" and outcome.error.exit_code == 4
        assert "CA_ROTOR5_CT = 69.89 is outside 0..60, the limits of this PX4" in outcome.reason
        assert not (tmp_path / "b").exists()


def test_a_damaged_list_is_no_list(tmp_path):
    with standin() as board, meet(board) as session:
        files = board.autopilot.files
        files.folders |= {"etc", "etc/extras"}
        files.files[PATH.strip("/")] = b"not xz at all"
        assert board_limits(Files(session), session.identity) is None
