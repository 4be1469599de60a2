"""What an ArduPilot board does with a table, beyond holding its bytes; and what of its owner's it keeps."""

import struct
from pathlib import Path

import pytest
from case_table import case_table
from memory_net import meet, standin

from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.identity import Identity
from coaxlink.mavlink.parameters import Parameters, Snapshot, Value
from coaxlink.mavlink.reboot import reboot
from coaxlink.setup import ardupilot_layout
from coaxlink.uploading.ardupilot_scripts import matrix_script
from coaxlink.uploading.ardupilot_words import foreign_matrix
from coaxlink.uploading.backup import read_backup, write_backup
from coaxlink.uploading.owners_numbers import for_board
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.verify import verify
from coaxlink.uploading.worker import Uploader
from firmware_params.ardupilot.table import expo_for

OWN_MATRIX = (
    b"for i = 0, 7 do MotorsMatrix:add_motor_raw(i, 0.5, 0.5, 0.5, i + 1) end\nassert(MotorsMatrix:init(8))"
)


def _ap(session, folder):
    return Uploader(session, backup_folder=folder, reboot_s=0.4, script_s=6.0)


def _put(session, name, text):
    files = Files(session)
    files.make_folder("/APM/scripts")
    files.write(f"/APM/scripts/{name}", text)


def test_a_script_that_sets_the_matrix_is_known_by_its_code():
    with case_table() as case:
        for text, says in (
            (OWN_MATRIX, "line 1"),
            (b"--[[ old ]]\nlocal m = MotorsMatrix\nm:init(8)", "line 2"),
            (b"Motors_6DoF:add_motor(0, 0, 0, 1, 0, 0, 0, false, 1)", "Motors_6DoF"),
            (b"-- MotorsMatrix:init(8)\ngcs:send_text(6, 'MotorsMatrix is coaxlinks')", ""),
            (b"--[==[\nMotorsMatrix:init(8)\n]==]\nlocal a = [[MotorsMatrix]]", ""),
        ):
            with case(f"{text}, {says}"):
                found = foreign_matrix(
                    {"/APM/scripts/own.lua": text, "/APM/scripts/coaxlink_matrix.lua": OWN_MATRIX}
                )
                assert says in found and bool(found) == bool(says)


def test_a_module_counts_when_a_script_takes_it_in():
    module = {"/APM/scripts/modules/mine/matrix.lua": OWN_MATRIX}
    assert not foreign_matrix(module)
    taken_in = module | {"/APM/scripts/a.lua": b"require('mine.matrix')"}
    assert "modules/mine/matrix.lua" in foreign_matrix(taken_in)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "result", "code", "says"),
    [
        (OWN_MATRIX, "refused", 4, "own.lua sets the motors' matrix too"),
        (b"error('no sensor')", "rolled_back", 1, "no sensor"),
        (b"gcs:send_text(6, 'hello')", "verified", 0, ""),
    ],
)
def test_another_script_on_the_card(tables, tmp_path, text, result, code, says):
    with standin("ardupilot") as board, meet(board) as session:
        _put(session, "own.lua", text)
        outcome = _ap(session, tmp_path).upload(load_plan(tables["matrix"]))
        assert outcome.result == result and says in outcome.reason
        assert (outcome.error.exit_code if outcome.error else 0) == code
        if result != "verified":
            assert Parameters(session).read("FRAME_CLASS").value == 4


@pytest.mark.slow
def test_an_owners_matrix_is_taken_over_and_put_back(tables, tmp_path):
    """Read by `init` from the card, removed by the upload, whole again after the restore."""
    rows = [
        (-1, 1, 1),
        (1, 1, -1),
        (1, -1, 1),
        (-1, -1, -1),
        (1, 1, 1),
        (-1, 1, -1),
        (-1, -1, 1),
        (1, -1, -1),
    ]
    calls = "".join(
        f"MotorsMatrix:add_motor_raw({n}, {r}, {p}, {y}, {n + 1})\n" for n, (r, p, y) in enumerate(rows)
    )
    owners = f"{calls}assert(MotorsMatrix:init(8))\n".encode()
    with standin("ardupilot") as board, meet(board) as session:
        _put(session, "own.lua", owners)
        parameters = Parameters(session)
        parameters.write_many(
            [parameters.encode("SCR_ENABLE", 1, 2), parameters.encode("FRAME_CLASS", 15, 2)]
        )
        reboot(session, 0.4)
        read = ardupilot_layout({"FRAME_CLASS": 15}, "board", lambda: matrix_script(Files(session)))
        assert [m.spin for m in read.mounts] == ["ccw", "cw"] * 4
        worker, plan = _ap(session, tmp_path), load_plan(tables["matrix"])
        assert "`take_over` removes it" in worker.upload(plan).reason
        done = worker.upload(plan, take_over=True)
        assert done.result == "verified", done.reason
        assert Files(session).read("/APM/scripts/own.lua") is None
        assert verify(session, plan).holds
        back = worker.restore(read_backup(Path(done.backup)))
        assert back.result == "verified", back.reason
        assert Files(session).read("/APM/scripts/own.lua") == owners
        assert Files(session).read("/APM/scripts/coaxlink_matrix.lua") is None


@pytest.mark.slow
def test_verify_says_no_where_a_script_came_after_the_table(tables, tmp_path):
    plan = load_plan(tables["loader"])
    with standin("ardupilot") as board, meet(board) as session:
        assert _ap(session, tmp_path).upload(plan).result == "verified"
        assert verify(session, plan).holds
        _put(session, "z.lua", b"error('no sensor')")
        Parameters(session).write("SCR_LD_CHECKSUM", -1.0, 6)
        reboot(session, 0.4)
        session.clock.sleep(6.0)
        found = verify(session, plan)
        assert not found.holds and "Scripting" in found.unflown
        assert "no sensor" not in found.unflown  # said once, before we listened
        _put(session, "z.lua", OWN_MATRIX)
        assert "z.lua sets the motors' matrix" in verify(session, plan).unflown


SPIN = {"MOT_SPIN_ARM": 0.07, "MOT_SPIN_MIN": 0.12, "MOT_SPIN_MAX": 0.9}
TABLE = {"MOT_SPIN_ARM": 0.03, "MOT_SPIN_MIN": 0.05, "MOT_SPIN_MAX": 1.0, "MOT_THST_HOVER": 0.4}


def test_the_curve_of_a_table_is_made_for_the_boards_spin_range():
    for share in (0.2, 0.7, 1.0):
        table = TABLE | {"MOT_THST_EXPO": expo_for(share, 0.05)}
        made = for_board(table, SPIN)
        assert made.params["MOT_THST_EXPO"] == pytest.approx(expo_for(share, 0.12, 0.9), abs=1e-5)
        assert not set(SPIN) & set(made.params) and "MOT_SPIN_MIN 0.12 (table: 0.05)" in made.kept[0]
        assert for_board(table, SPIN, spin_from_table=True).params == table
        assert for_board(table, TABLE).params == table


def test_the_boards_motor_outputs_stay_where_they_drive_every_motor():
    table = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 9)}
    aux = {f"SERVO{n}_FUNCTION": 0 for n in range(1, 9)}
    aux |= {f"SERVO{n + 8}_FUNCTION": 41 - n for n in range(1, 9)}
    assert for_board(table, aux).params == {} and "SERVO1_FUNCTION 0" in for_board(table, aux).kept[0]
    del aux["SERVO16_FUNCTION"]
    assert for_board(table, aux).params == table


@pytest.mark.slow
def test_the_owners_spin_range_stays_and_verify_agrees(tables, tmp_path):
    plan = load_plan(tables["matrix"])
    with standin("ardupilot") as board, meet(board) as session:
        parameters = Parameters(session)
        for name, value in SPIN.items():
            parameters.write(name, value, 9)
        assert _ap(session, tmp_path).upload(plan).result == "verified"
        held = {n: v.value for n, v in parameters.read_many(SPIN).items()}
        assert held == pytest.approx(SPIN)
        found = verify(session, plan)
        assert found.holds and "MOT_SPIN_MIN" in found.kept[0]


def _snapshot(**values):
    return Snapshot({n: Value(n, v, 9, struct.pack("<f", v)) for n, v in values.items()})


def test_backups_of_one_second_have_names_of_their_own(tmp_path):
    """Boards whose ids differ in zeros alone; the same board twice."""
    boards = [Identity(1, 1, 3, 2, uid=uid) for uid in ("0310", "31", "3100", "31")]
    paths = [write_backup(tmp_path, ".param", b, _snapshot(A=n), {}) for n, b in enumerate(boards)]
    assert len(set(paths)) == 4
    assert [read_backup(path).params["A"] for path in paths] == [0.0, 1.0, 2.0, 3.0]


@pytest.mark.slow
def test_a_backup_without_the_loader_brings_none_of_its_numbers_back(tables, tmp_path):
    """As one taken after a kill, when the loader's numbers were still there and its script was to go."""
    plan = load_plan(tables["loader"])
    with standin("ardupilot") as board, meet(board) as session:
        first = _ap(session, tmp_path).upload(plan)
        saved = read_backup(Path(first.backup))
        assert not [n for n in saved.params if n.startswith("CXL_")]
        late = type(saved)(**vars(saved) | {"params": {**saved.params, "CXL_SUM": 5.0}})
        assert _ap(session, tmp_path).restore(late).result == "verified"
        assert _ap(session, tmp_path).restore(late).result == "verified"
        assert not verify(session, plan).holds and verify(session, None).holds


def test_an_ardupilot_is_asked_for_nothing_that_it_does_not_know():
    """Each such request would be a text to every ground station."""
    with standin("ardupilot") as board, meet(board) as session:
        reported = []
        session.subscribe(lambda m: reported.append(m.text) if m.get_type() == "STATUSTEXT" else None)
        assert not session.request_stream(291, 10.0) and session.request_stream(11030, 10.0)
        session.clock.sleep(0.2)
        assert reported == []


@pytest.mark.parametrize("station", [False, True])
def test_px4_says_its_words_to_ground_stations(station):
    with standin("px4") as board, meet(board, station=station) as session:
        reported = []
        session.subscribe(lambda m: reported.append(m.text) if m.get_type() == "STATUSTEXT" else None)
        session.clock.sleep(1.5)
        assert session.command(400, 1.0) == 0
        session.clock.sleep(0.2)
        assert bool(reported) == station
