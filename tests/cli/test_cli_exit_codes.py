"""Every no of upload, restore and verify as a user meets it: exit code, one line, the board as it was.

The rows are the table "Exit codes" of docs/tables.md. Faults that need a file system on board, or a restart,
are in tests/uploading (test_uploading_fork.py, test_uploading_standins.py); those of the line and of what a
user gives in test_cli_wrong_line.py.
"""

import json
import re
import resource
from pathlib import Path

import pytest
from case_table import case_table
from cli_board import VERBS, backup, boarded, held, no, run
from px4_board import params_text
from pymavlink.dialects.v20 import common as m
from scripted_autopilot import INT32

pytestmark = pytest.mark.usefixtures("here")


def _sets(**attributes):
    def prepare(board):
        for name, value in attributes.items():
            setattr(board, name, value)

    return prepare


def _holds(**params):
    def prepare(board):
        for name, value in params.items():
            board.params[name] = (value, INT32)

    return prepare


def _table(**options):
    return lambda board: Path("t/x8.params").write_text(params_text(**options))


def _on_wide(prepare):
    """On a board that has the wide vehicle's places already."""

    def both(board):
        prepare(board)
        for name, value in WIDE.items():
            board.params[name] = (value, 9)

    return both


def _contended(board):
    """Another station that puts its own value back whenever ours arrives."""
    original = board._set

    def contend(message):
        original(message)
        if message.param_id == "CA_ROTOR3_CT" and message.param_value > 10.0:
            board.params["CA_ROTOR3_CT"] = (9.0, 9)
            board._send_value("CA_ROTOR3_CT")

    board._set = contend


ARMS = ((1, 1), (1, -1), (-1, -1), (-1, 1), (1, -1), (1, 1), (-1, 1), (-1, -1))
WIDE = {f"CA_ROTOR{n}_P{k}": 1.4 * s for n, arm in enumerate(ARMS) for k, s in zip("XY", arm, strict=True)}
REFUSED = {
    "armed": (_sets(armed=True), "the vehicle is armed: disarm it first"),
    "another kind of vehicle": (_sets(vehicle_type=m.MAV_TYPE_FIXED_WING), "of type fixed_wing, not a multi"),
    "a type with other rotors": (_sets(vehicle_type=m.MAV_TYPE_HEXAROTOR), "the table is for 8 rotors"),
    "a table of other rotors": (_table(count=6), "another vehicle: the table is for 6 rotors"),
    "a board set up for others": (_holds(CA_ROTOR_COUNT=4), "the board is set up for 4"),
    "rotors in other places": (_table(CA_ROTOR0_PX=-0.18), "rotor 1 changes front or rear"),
    "a longer arm": (_table(CA_ROTOR0_PX=0.19), "rotor 1 moves by 0.0093 m"),
    "another spin": (_table(CA_ROTOR1_KM=0.05), "rotor 2 changes spin"),
    "another firmware": (_sets(px4=False), "is for PX4, the vehicle runs ArduPilot"),
    "too old a firmware": (_sets(version=(1, 12, 3)), "PX4 1.12.3 reads no CA_ROTOR table"),
    "allocation switched off": (_sets(version=(1, 13, 3)), "ignores the table while SYS_CTRL_ALLOC is 0"),
    "out of range": (_table(CA_ROTOR0_CT=150), "CA_ROTOR0_CT = 150 is outside 0..100"),
    "NaN": (_table(CA_ROTOR0_CT="nan"), "CA_ROTOR0_CT is nan"),
    "infinite": (_table(MPC_THR_HOVER="inf"), "MPC_THR_HOVER is inf"),
    "an axis PX4 would drop": (_table(ct_upper=0.9, ct_lower=1.2), "px4.weak-axis: PX4 drops yaw"),
    "axes PX4 would zero": (_on_wide(_table(ct_upper=100, ct_lower=100, **WIDE)), "px4.small-mix"),
    "a name the board lacks": (_table(CA_UNHEARD_OF=1.0), "has no parameter CA_UNHEARD_OF"),
}


def test_upload_refuses_before_it_writes(capsys, tmp_path):
    with case_table() as case:
        for name, (prepare, text) in REFUSED.items():
            with case(name), boarded(tmp_path / name) as board:
                board.params["SYS_CTRL_ALLOC"] = (0, INT32)
                prepare(board)
                before = held(board)
                code, _, err = run(capsys, "upload", "t", "--connect", board.url, "--yes", "--json", "u.json")
                assert code == 4
                no(err, text)
                assert json.loads(Path("u.json").read_text())["result"] == "refused"
                assert board.sets == [] and held(board) == before and not Path("backups").exists()


@pytest.mark.parametrize(
    ("prepare", "code", "text"),
    [
        pytest.param(_sets(keeps={"CA_ROTOR0_CT": 6.5}), 1, "rolled back", id="a value it does not keep"),
        pytest.param(_contended, 1, "CA_ROTOR3_CT", id="another station writing"),
    ],
)
@pytest.mark.parametrize("verb", VERBS[:2])
def test_what_goes_wrong_under_way_ends_with_the_old_table(board, capsys, verb, prepare, code, text):
    source, before = "t", held(board)
    if verb == "restore":  # the backup is of the table that is to come back
        assert run(capsys, "upload", "t", "--connect", board.url, "--yes")[0] == 0
        (table,) = Path("backups").glob("*.params")
        assert run(capsys, "restore", table, "--connect", board.url, "--yes")[0] == 0
        source, board.sets = max(Path("backups").glob("*.params"), key=lambda p: p.stat().st_mtime_ns), []
        assert source != table and held(board) == before
    prepare(board)
    got, _, err = run(capsys, verb, source, "--connect", board.url, "--yes", "--json", "u.json")
    assert got == code
    no(err, text)
    assert json.loads(Path("u.json").read_text())["result"] == "rolled_back"
    assert held(board) == before and board.sets != []
    assert not list(Path("state").glob("*.journal.json"))


@pytest.mark.parametrize("verb", VERBS[:2])
def test_arming_under_way_ends_all_writing_and_either_verb_finishes_later(board, capsys, verb):
    """34 values change and 20 go out at a time: the armed heartbeat comes before any answer."""
    before = held(board)
    moved = {
        f"CA_ROTOR{n}_P{k}": 0.2 * s for n, arm in enumerate(ARMS) for k, s in zip("XY", arm, strict=True)
    }
    _table(**moved)(board)
    board.arm_after = 1
    mean = () if verb == "restore" else ("--new-geometry",)
    code, _, err = run(
        capsys, "upload", "t", "--connect", board.url, "--yes", "--new-geometry", "--json", "u.json"
    )
    assert code == 4
    no(err, "armed while it was written: nothing more was written")
    answer = json.loads(Path("u.json").read_text())
    assert answer["result"] == "failed" and board.sets and len(board.sets) <= 20
    changed = {n for n, v in held(board).items() if v != before[n]}
    assert set(answer["standing"]["new"]) == changed == set(board.sets)
    assert set(answer["standing"]["old"]) == {c["name"] for c in answer["changed"]} - changed != set()
    assert list(Path("state").glob("*.journal.json"))
    source = "t" if verb == "upload" else answer["backup"]
    code, _, err = run(capsys, verb, source, "--connect", board.url, *mean)
    assert code == 4 and "disarm it first" in err
    assert len(board.sets) == len(changed)  # armed: not one more
    board.armed = False
    assert run(capsys, verb, source, "--connect", board.url, "--yes", *mean)[0] == 0
    assert not list(Path("state").glob("*.journal.json"))
    if verb == "restore":
        assert held(board) == before
    else:
        assert run(capsys, "verify", "t", "--connect", board.url)[0] == 0


def test_a_vehicle_that_arms_while_the_old_table_goes_back_is_left_alone_too(board, capsys):
    """A refused value starts the way back; the vehicle arms at its first word."""
    moved = {
        f"CA_ROTOR{n}_P{k}": 0.2 * s for n, arm in enumerate(ARMS) for k, s in zip("XY", arm, strict=True)
    }
    _table(**moved)(board)
    board.keeps, board.arm_after = {"CA_ROTOR0_CT": 6.5}, 60
    code, _, err = run(
        capsys, "upload", "t", "--connect", board.url, "--yes", "--new-geometry", "--json", "u.json"
    )
    assert code == 4
    no(err, "armed while it was written")
    assert json.loads(Path("u.json").read_text())["result"] == "failed"
    assert list(Path("state").glob("*.journal.json"))
    written = len(board.sets)
    assert 60 <= written <= 60 + 20


def test_a_link_that_dies_under_way_is_three_and_says_how_to_come_back(board, capsys):
    board.mute_after = 7
    before = held(board)
    code, _, err = run(capsys, "upload", "t", "--connect", board.url, "--yes", "--json", "u.json")
    assert code == 3
    no(err, "coaxlink restore backups/")
    assert json.loads(Path("u.json").read_text())["result"] == "failed" and held(board) != before
    command = re.search(r"coaxlink (restore \S+ --connect \S+)", err)[1].split()
    board.mute_after, board.deaf = None, False
    assert run(capsys, *command, "--yes")[0] == 0
    assert held(board) == before


EDITS = {
    "a changed value": (
        lambda t: t.replace("CA_ROTOR0_CT\t6.5", "CA_ROTOR0_CT\t7.5"),
        2,
        "changed since it was",
    ),
    "a changed value, meant": (
        lambda t: re.sub("# Sum.*\n", "", t).replace("CA_ROTOR0_CT\t6.5", "CA_ROTOR0_CT\t750"),
        4,
        "outside 0..100",
    ),
    "a NaN, meant": (
        lambda t: re.sub("# Sum.*\n", "", t).replace("CA_ROTOR0_CT\t6.5", "CA_ROTOR0_CT\tnan"),
        4,
        "CA_ROTOR0_CT is nan",
    ),
    "a word for a number": (lambda t: t.replace("CA_ROTOR0_CT\t6.5", "CA_ROTOR0_CT\tsix"), 2, "line "),
    "cut": (lambda t: "".join(t.splitlines(keepends=True)[:-3]), 2, "it was cut"),
    "nobody's parameters": (lambda t: "FOO,1\n", 2, "whose parameters these are"),
    "another firmware's": (lambda t: "FRAME_CLASS,4\n", 4, "is of ardupilot"),
    "another board's": (lambda t: re.sub("(Board: 0*)c0a1", r"\1beef", t), 4, "is of board"),
    "not text": (lambda t: b"\xff\xfe\x00" + t.encode("utf-16-le"), 2, "UTF-8"),
}


def test_a_backup_that_a_hand_was_in(capsys, tmp_path):
    with case_table() as case:
        for name, (edit, code, text) in EDITS.items():
            with case(name), boarded(tmp_path / name) as board:
                path = backup(board, capsys)
                edited = edit(path.read_text())
                path.write_bytes(edited if isinstance(edited, bytes) else edited.encode())
                board.sets, before = [], held(board)
                got, _, err = run(capsys, "restore", path, "--connect", board.url, "--yes")
                assert got == code
                no(err, text)
                assert board.sets == [] and held(board) == before


def test_an_owners_own_file_goes_back_as_far_as_it_is_of_a_table(board, capsys):
    path = backup(board, capsys)
    before = dict(board.params)
    assert run(capsys, "restore", path, "--connect", board.url, "--yes")[0] == 0
    owners = "".join(f"{name} {value!r}  # saved by hand\n" for name, (value, _) in board.params.items())
    board.params = dict(before)
    path.with_name("mine.parm").write_text(owners)
    got, _, err = run(capsys, "restore", path.with_name("mine.parm"), "--connect", board.url, "--yes")
    assert got == 0 and "does not say of which board it is" in err
    assert board.params["CA_ROTOR0_CT"] != before["CA_ROTOR0_CT"]


def test_a_backup_goes_back_also_when_the_board_held_what_no_table_may(board, capsys):
    board.params["CA_ROTOR0_CT"] = (150.0, 9)
    path = backup(board, capsys)
    assert board.params["CA_ROTOR0_CT"][0] < 100.0
    assert run(capsys, "restore", path, "--connect", board.url, "--yes")[0] == 0
    assert board.params["CA_ROTOR0_CT"][0] == 150.0


def test_a_disk_without_room_for_the_backup_is_two_and_nothing_is_sent(board, capsys):
    before, limit = held(board), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (600, limit[1]))  # Python ignores SIGXFSZ: writes fail
    try:
        code, _, err = run(capsys, "upload", "t", "--connect", board.url, "--yes")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert code == 2
    no(err, "the backup cannot be written")
    assert board.sets == [] and held(board) == before
    assert [p for p in Path().rglob("*") if p.is_file() and "backups" in p.parts] == []


def test_a_place_that_is_no_folder_is_two(board, capsys):
    Path("file").write_text("")
    code, _, err = run(capsys, "upload", "t", "--connect", board.url, "--yes", "--backup-dir", "file")
    assert code == 2 and board.sets == []
    no(err, "file/")


def test_verify_says_no_with_one_and_never_writes(board, capsys):
    address = ["--connect", board.url]
    for arguments, code, text in (
        ([], 2, "nothing was uploaded to this board from here"),
        (["t"], 1, "parameters differ from t/x8.params"),
    ):
        got, _, err = run(capsys, "verify", *arguments, *address)
        assert got == code
        no(err, text)
    board.armed = True  # looking is allowed at any time
    assert run(capsys, "verify", "t", *address)[0] == 1
    board.px4 = False
    got, _, err = run(capsys, "verify", "t", *address)
    assert got == 1
    no(err, "t/x8.params is not for ArduPilot")
    assert board.sets == []


def test_names_in_any_script_and_with_blanks(board, capsys):
    folder = Path("Flügel 機体 №1")
    Path("t").rename(folder)
    (folder / "x8.params").rename(folder / "Tabelle für X8 ✈.params")
    before = held(board)
    code, _, _ = run(
        capsys,
        "upload",
        folder,
        "--connect",
        board.url,
        "--yes",
        "--json",
        "ü.json",
        "--backup-dir",
        "Rück halt",
    )
    assert code == 0 and json.loads(Path("ü.json").read_text())["files"] == [
        f"{folder}/Tabelle für X8 ✈.params"
    ]
    assert run(capsys, "verify", folder, "--connect", board.url)[0] == 0
    (backup,) = Path("Rück halt").iterdir()
    assert run(capsys, "restore", backup, "--connect", board.url, "--yes")[0] == 0
    assert held(board) == before
