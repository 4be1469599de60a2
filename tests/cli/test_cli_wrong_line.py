"""Exit codes of upload, restore and verify where the line, the vehicle or what a user gives is not right."""

import re
import socket
from pathlib import Path

import pytest
from cli_board import KEY, VERBS, backup, no, run, verbs
from px4_board import params_text, x8
from scripted_autopilot import ScriptedAutopilot

pytestmark = pytest.mark.usefixtures("here")


WRONG = {  # options, exit code, what is said
    "unsigned": (["--signing-key", "key"], 4, "does not sign with this key"),
    "a key that all can read": (["--signing-key", "open"], 4, "chmod 600"),
    "no key": (["--signing-key", "none"], 2, "the signing key cannot be read"),
    "an empty key": (["--signing-key", "empty"], 2, "an empty signing key"),
    "another system id": (["--system", "7"], 3, "no system 7 heard"),
    "a file in place of a folder": (["--json", "file/out.json"], 2, "file/out.json: cannot be written"),
    "no time": (["--timeout", "nan"], 2, "--timeout: seconds above 0 are expected"),
    "no system id": (["--system", "300"], 2, "--system: a system id from 1 to 255 is expected"),
    "a typing error": (["--sytem", "1"], 2, "No such option"),
}


@pytest.mark.parametrize("verb", VERBS)
def test_wrong_options_and_another_vehicle_than_the_one_meant(board, capsys, verb):
    Path("b.params").write_text(backup(board, capsys).read_text())
    for name, content, mode in (("open", KEY, 0o644), ("empty", b"", 0o600), ("file", b"", 0o600)):
        Path(name).write_bytes(content)
        Path(name).chmod(mode)
    board.sets = []
    for case, (options, code, text) in WRONG.items():
        board.heard = []
        got, _, err = run(capsys, *verbs(board.url)[verb], *options)
        assert got == code, case
        no(err, text)
        assert board.sets == [] and (code != 2 or board.heard == []), case


@pytest.mark.parametrize("verb", VERBS)
def test_a_second_vehicle_of_the_same_ids_is_four_and_both_places_are_named(board, capsys, verb):
    Path("b.params").write_text(backup(board, capsys).read_text())
    net = board.net
    here = net.address()
    with (
        ScriptedAutopilot(x8(7.0, 8.0), net=net, towards=here) as one,
        ScriptedAutopilot(x8(), net=net, towards=here) as two,
    ):
        code, _, err = run(capsys, *verbs(f"udpin:{here[0]}:{here[1]}")[verb])
        assert code == 4
        no(err, "two vehicles answer as system 1")
        for vehicle in (one, two):
            assert f"{here[0]}:{vehicle.address[1]}" in err and vehicle.sets == []


@pytest.mark.parametrize("verb", VERBS)
def test_a_vehicle_that_signs_is_four_without_its_key(board, capsys, verb):
    Path("b.params").write_text(backup(board, capsys).read_text())
    with ScriptedAutopilot(x8(), net=board.net, key=KEY) as signing:
        code, _, err = run(capsys, *verbs(signing.url)[verb])
        assert code == 4 and signing.sets == []
        no(err, "--signing-key")


@pytest.mark.parametrize("verb", VERBS)
def test_a_damaged_journal_is_two_and_says_what_to_do(board, capsys, verb):
    Path("b.params").write_text(backup(board, capsys).read_text())
    journal = Path("state") / f"{0xC0A1:016x}.journal.json"
    board.sets = []
    for text in ("", '{"board": 3', "[1]", '{"board": "x", "old": 3}'):
        journal.write_text(text)
        code, _, err = run(capsys, *verbs(board.url)[verb])
        assert code == 2 and board.sets == []
        no(err, "delete it, then restore the newest backup")
    journal.unlink()
    assert run(capsys, *verbs(board.url)[verb])[0] == 0


@pytest.mark.parametrize("verb", VERBS)
def test_nobody_there_is_three_and_no_address_is_two(board, capsys, verb):
    Path("b.params").write_text(backup(board, capsys).read_text())
    board.close()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        dead = f"tcp:127.0.0.1:{free.getsockname()[1]}"
        for address, code, text in (
            (board.url, 3, "no autopilot heard within 0.3 s"),
            (dead, 3, "refused"),
            ("/dev/ttyNONE9,57600", 3, "No such file"),
            ("udpin:127.0.0.1:0", 2, "a port between 1 and 65535"),
            ("elsewhere", 2, "not a connection"),
        ):
            got, _, err = run(capsys, *verbs(address)[verb], "--timeout", "0.3")
            assert got == code, (address, err)
            no(err, text)
            assert len(err.splitlines()) == 1


TABLES = {
    "no number": (params_text(CA_ROTOR0_CT="x"), r"t/x8.params: line \d+: .*a number is expected"),
    "empty": ("# only a header\n", r"t/x8.params: "),
    "twice": (params_text() + "1\t1\tCA_ROTOR0_CT\t6.5\t9\n", r"t/x8.params: line \d+: .*twice"),
    "type": (params_text().replace("\t9\n", "\t4\n"), r"t/x8.params: line \d+: "),
    "no table": (None, r"t: no .params or .param file in it"),
}


def test_a_bad_table_is_two_and_names_its_line(capsys):
    for case, (text, reported) in TABLES.items():
        Path("t/x8.params").unlink(missing_ok=True)
        if text is not None:
            Path("t/x8.params").write_text(text)
        for verb in ("upload", "verify"):
            code, _, err = run(capsys, *verbs("udpout:127.0.0.1:9")[verb])
            assert code == 2 and len(err.splitlines()) == 1 and re.search(reported, err), (case, err)
