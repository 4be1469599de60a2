"""Every fault of the wire, alone and all at once: the board holds one table whole, and gives it back."""

from pathlib import Path

import numpy as np
import pytest
from memory_net import meet, standin

from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.parameters import Parameters
from coaxlink.uploading.backup import read_backup
from coaxlink.uploading.journal import Journal
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.verify import verify
from coaxlink.uploading.worker import Uploader
from firmware_params.ardupilot import scripts

pytestmark = pytest.mark.slow
FAULTS = {  # as `coaxlink sim --wire` has them
    "loss": "loss=0.1",
    "much loss": "loss=0.3",
    "copies": "copies=0.2",
    "disorder": "disorder=0.3",
    "corruption": "corruption=0.05",
    "delay": "delay=0.15",
    "dead for a while": "dead=0.7:4",
    "reboot while it writes": "reboot=4",
    "all": "loss=0.05,copies=0.03,disorder=0.05,corruption=0.005,delay=0.003",
}


@pytest.mark.parametrize(("firmware", "table"), [("px4", "px4"), ("ardupilot", "loader")])
def test_uploads_and_restores_under_faults(tables, tmp_path, monkeypatch, firmware, table):
    plan, wrong = load_plan(tables[table]), []
    for n, (name, wire) in enumerate(FAULTS.items()):
        monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / name))
        with standin(firmware, wire=wire, seed=n) as board, meet(board) as session:
            held = board.autopilot.store.memory
            before = {k: v for k, v in held().items() if k in plan.params}
            outcome = Uploader(session, backup_folder=tmp_path / name).upload(plan)
            journal = Journal(session.identity, address=session.address)
            if outcome.result not in ("verified", "rolled_back") or journal.open_entry() is not None:
                wrong.append((name, outcome.result, outcome.reason))
                continue
            if outcome.result == "verified":
                if not verify(session, plan).holds:
                    wrong.append((name, "verified and yet not there"))
                saved = read_backup(Path(outcome.backup))
                back = Uploader(session, backup_folder=tmp_path / name).restore(saved)
                if back.result != "verified":
                    wrong.append((name, "restore", back.result, back.reason))
            after = {k: held()[k] for k in before}  # a loader's own parameters come with its script
            if after != before or journal.open_entry() is not None:
                wrong.append((name, outcome.result, {k for k in before if before[k] != after.get(k)}))
    assert not wrong


def test_files_over_a_bad_line():
    data = np.random.default_rng(3).integers(0, 256, 1500, dtype=np.uint8).tobytes()
    wire = "loss=0.1,copies=0.05,disorder=0.05,corruption=0.01"
    with standin("ardupilot", wire=wire) as board, meet(board) as session:
        files, path = Files(session, timeout_s=0.15), "/APM/scripts/a.lua"
        files.make_folder("/APM/scripts")
        files.write(path, data)
        assert files.read(path) == data and files.crc(path) == scripts.file_crc(data)
        assert files.listing("/APM/scripts") == ["a.lua"] and files.listing("/APM/none") is None
        assert files.read("/APM/scripts/none") is None and files.crc("/APM/none") is None
        assert files.remove(path) and files.retries > 0


def test_the_list_of_a_vehicle_over_a_bad_line_is_whole():
    with standin("px4", wire="loss=0.3") as board, meet(board) as session:
        found = Parameters(session).read_all().values
        assert {n: v.value for n, v in found.items()} == pytest.approx(
            board.autopilot.store.memory(), rel=1e-6
        )
