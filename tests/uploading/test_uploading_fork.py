"""`mixer.csv` on the research fork: there and back, whole or not at all."""

import dataclasses
from pathlib import Path

import pytest
from fork_board import BOARD_PATH, EXAMPLES, fork_board
from px4_board import x8
from scripted_autopilot import ScriptedAutopilot

from coaxlink.cli import main
from coaxlink.mavlink import connect
from coaxlink.uploading.backup import read_backup
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.verify import verify
from coaxlink.uploading.worker import Uploader


@pytest.fixture
def table(tmp_path):
    options = ["--firmware", "px4", "--law", "reduced", "--csv", "--out", str(tmp_path / "t")]
    with pytest.raises(SystemExit) as ended:
        main(["table", str(EXAMPLES / "x8_paper.toml"), *options])
    assert ended.value.code == 0
    return tmp_path / "t"


def _upload(session, folder, plan):
    return Uploader(session, backup_folder=folder / "b", reboot_s=2.5).upload(plan)


def test_mixer_csv_goes_on_board_and_its_predecessor_comes_back(table, tmp_path):
    with fork_board() as (url, files, store), connect(url) as session:
        files.folders |= {"etc"}
        files.files[BOARD_PATH] = b"1,2,3,4,5,6\n" * 8
        outcome = _upload(session, tmp_path, load_plan(table))
        assert outcome.result == "verified", outcome.reason
        assert outcome.scripts == ("/fs/microsd/etc/mixer.csv",)
        assert files.files[BOARD_PATH] == (table / "mixer.csv").read_bytes()
        assert store._values["DTRG_MIXER_CSV"] == 1
        assert verify(session, None).holds and verify(session, load_plan(table)).holds
        files.files[BOARD_PATH] = b"0,0,0,0,0,1\n" * 8
        wrong = verify(session, load_plan(table)).mismatches
        assert [row["name"] for row in wrong] == ["/fs/microsd/etc/mixer.csv"]
        saved = read_backup(Path(outcome.backup))
        assert saved.files == {"mixer.csv": b"1,2,3,4,5,6\n" * 8}
        back = Uploader(session, backup_folder=tmp_path / "b", reboot_s=2.5).restore(saved)
        assert back.result == "verified", back.reason
        assert files.files[BOARD_PATH] == b"1,2,3,4,5,6\n" * 8 and store._values["DTRG_MIXER_CSV"] == 0


def test_a_card_that_is_full_keeps_the_old_mixer(table, tmp_path):
    with fork_board("DTRG_CSV_MIXER") as (url, files, store), connect(url) as session:
        files.folders |= {"etc"}
        files.files[BOARD_PATH] = b"1,2,3,4,5,6\n" * 8
        files.files["etc/other"] = bytes(512 * 1024 - 300)
        before = dict(store._values)
        outcome = _upload(session, tmp_path, load_plan(table))
        assert outcome.result == "rolled_back" and outcome.error.exit_code == 1, outcome.reason
        assert files.files[BOARD_PATH] == b"1,2,3,4,5,6\n" * 8 and store._values == before


def test_a_board_that_reads_no_csv_is_not_given_one(table, tmp_path):
    with ScriptedAutopilot(x8()) as vehicle, connect(vehicle.url) as session:
        plan = dataclasses.replace(load_plan(table), params={}, types={})
        outcome = _upload(session, tmp_path, plan)
        assert outcome.result == "refused" and outcome.error.exit_code == 4
        assert "reads no mixer.csv" in outcome.reason and vehicle.sets == []
