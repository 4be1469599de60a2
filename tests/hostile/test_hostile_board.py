"""A board that means harm: listings and files without an end, short answers, names that are none."""

import lzma
import struct
from pathlib import Path

import pytest
from hostile_names import NAMES
from memory_net import Net, meet, plugged
from pymavlink.dialects.v20 import common as m
from scripted_autopilot import FLOAT, ScriptedAutopilot

from coaxlink.cli import main
from coaxlink.errors import CheckFailed, LinkError
from coaxlink.mavlink import ftp
from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.parameters import Parameters
from coaxlink.uploading.limits import board_limits

ACK, NAK, EOF = 128, 129, 6
LIST, OPEN, READ, CRC, TERMINATE = 3, 4, 5, 14, 1


class Board(ScriptedAutopilot):
    """Answers file requests by `serve(code, offset, data)`: None is silence, bytes the body, int an error."""

    serve = staticmethod(lambda code, offset, data: 10)
    requests = 0

    def _handle(self, message):
        if message.get_type() != "FILE_TRANSFER_PROTOCOL":
            super()._handle(message)
            return
        self.requests += 1
        number, session, code, size, _, _, _, offset = struct.unpack_from("<HBBBBBBI", bytes(message.payload))
        answer = self.serve(code, offset, bytes(message.payload)[12 : 12 + size])
        if answer is None:
            return
        ok, body = (NAK, bytes([answer])) if isinstance(answer, int) else (ACK, answer)
        head = struct.pack("<HBBBBBBI", (number + 1) % 65536, session, ok, len(body), code, 0, 0, offset)
        payload = list((head + body[:239]).ljust(251, b"\0"))
        self.send(m.MAVLink_file_transfer_protocol_message(0, 255, 0, payload))


@pytest.fixture(autouse=True)
def state(tmp_path, monkeypatch):
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def board():
    with (
        plugged(Net()) as net,
        Board({"CA_AIRFRAME": (0, 6), "THR_MDL_FAC": (0.5, FLOAT)}, net=net) as made,
    ):
        yield made


def refused(ask, says):
    with pytest.raises((CheckFailed, LinkError)) as error:
        ask()
    assert says in str(error.value) and str(error.value).isprintable()


def entries(*names):
    return b"".join(b"F" + name + b"\t10\0" for name in names)


def test_a_listing_that_repeats_itself_ends(board):
    for block in (entries(b"a.lua"), entries(b"a.lua", b"b.lua"), b"Dup\0", b"S\0" * 100):
        board.serve, board.requests = lambda code, offset, data, block=block: block, 0
        with meet(board) as session:
            refused(lambda: Files(session).listing("/APM/scripts"), "listing has no end")
        assert board.requests < 100


def test_a_listing_that_goes_on_ends(board, monkeypatch):
    monkeypatch.setattr(ftp, "MOST_NAMES", 100)
    board.serve = lambda code, offset, data: entries(b"%09d.lua" % offset, b"%09d.txt" % offset)
    with meet(board) as session:
        refused(lambda: Files(session).listing("/APM/scripts"), "listing has no end (102 names so far)")


def test_a_sound_listing_of_a_full_folder_is_read(board):
    names = [b"script_%04d.lua" % n for n in range(300)]
    board.serve = lambda code, offset, data: entries(*names[offset : offset + 8]) if offset < 300 else EOF
    with meet(board) as session:
        assert Files(session).listing("/APM/scripts") == [name.decode() for name in names]


def test_names_of_files_that_are_none_are_refused(board):
    with meet(board) as session:
        files = Files(session)
        for name in NAMES.values():
            raw = name.encode("utf-8", "surrogatepass")[:200]
            if not name.strip() or "\0" in name or "\t" in name:
                continue
            board.serve = lambda code, offset, data, raw=raw: EOF if offset else entries(raw)
            shown = raw.decode(errors="replace")
            if shown in ("..", ".") or "/" in shown or not shown.isprintable():
                refused(lambda: files.listing("scripts"), "which is no name of a file")
            else:
                assert files.listing("scripts") == [shown]


def test_a_file_without_an_end_ends(board, monkeypatch):
    monkeypatch.setattr(ftp, "MOST_BYTES", 100_000)
    board.serve = lambda code, offset, data: bytes(239) if code == READ else struct.pack("<I", 5)
    with meet(board) as session:
        refused(lambda: Files(session).read("/etc/x"), "the board's file has no end")
    assert board.requests < 1000


def test_a_checksum_of_too_few_bytes_is_refused(board):
    with meet(board) as session:
        for body in (b"", b"\1", b"\1\2\3"):
            board.serve = lambda code, offset, data, body=body: body
            reported = f"checksum has {len(body)} bytes, 4 are expected"
            refused(lambda: Files(session).crc("/APM/scripts/a.lua"), reported)


def test_any_error_code_is_one_line(board):
    with meet(board) as session:
        files = Files(session)
        for code in (0, 1, 2, 5, 7, 9, 77, 255):
            board.serve = lambda request, offset, data, code=code: code
            refused(lambda: files.read("a\x1b[2J"), "")
            refused(lambda: files.listing("a\nb"), "")


def lists():
    return {
        "a bomb": lzma.compress(bytes(50_000_000)),
        "5000 deep": lzma.compress(b"[" * 5000),
        "5000 digits": lzma.compress(b'{"parameters":[{"name":"A","min":1' + b"0" * 5000 + b"}]}"),
        "no list": lzma.compress(b'{"parameters":5}'),
        "no rows": lzma.compress(b'{"parameters":[5]}'),
        "no numbers": lzma.compress(b'{"parameters":[{"name":"A","min":[]}]}'),
        "cut": lzma.compress(b'{"parameters":[]}')[:30],
        "noise": bytes(range(256)),
        "a dictionary of 4 GB": lzma.compress(b"x", lzma.FORMAT_RAW, filters=[{"id": lzma.FILTER_LZMA2}]),
    }


def test_a_list_of_limits_that_means_harm_is_none(board):
    with meet(board) as session:
        identity = session.identity.__class__(**{**vars(session.identity), "capabilities": 32})
        for what, held in lists().items():

            def serve(code, offset, data, held=held):
                if code == READ:
                    return held[offset : offset + 239] or EOF
                return struct.pack("<I", len(held)) if code == OPEN else b""

            board.serve = serve
            assert board_limits(Files(session), identity) is None, what


def test_a_parameter_whose_name_is_none_is_refused(board):
    with meet(board) as session:
        for key, name in NAMES.items():
            if key in ("nothing", "NUL", "10 kB"):
                continue
            raw = name.encode("utf-8", "surrogatepass")[:16].decode("ascii", "replace")
            board.params = {"CA_AIRFRAME": (0, 6), raw.encode("ascii", "replace").decode(): (0.5, FLOAT)}
            refused(lambda: Parameters(session).read_all(), "which is no name")


def test_an_upload_to_such_a_board_writes_no_file_and_no_parameter(board, capsys):
    board.params["X\nARMING_CHECK,0"] = (0.5, FLOAT)
    Path("t.params").write_text("1\t1\tTHR_MDL_FAC\t0.7\t9\n")
    with pytest.raises(SystemExit) as ended:
        main(["upload", "t.params", "--connect", board.url, "--yes"])
    err = capsys.readouterr().err
    assert ended.value.code == 1 and "which is no name" in err
    assert board.sets == [] and not list(Path().glob("backups/*"))


def test_an_upload_where_the_folder_of_scripts_has_no_end_writes_nothing(board, capsys):
    from sound_files import COPTER_PARAMS, MAKERS

    table = MAKERS[".param table"](Path())
    board.px4 = False
    board.params = {name: (value, FLOAT) for name, value in COPTER_PARAMS.items()}
    board.params |= {"SCR_LD_CHECKSUM": (-1.0, FLOAT), "SCR_HEAP_SIZE": (100000.0, FLOAT)}
    board.serve = lambda code, offset, data: entries(b"a.lua") if code == LIST else 10
    with pytest.raises(SystemExit) as ended:
        main(["upload", str(table), "--connect", board.url, "--yes"])
    err = capsys.readouterr().err
    assert ended.value.code == 1 and "listing has no end" in err, err
    assert err.count("coaxlink: ") == 1 and board.sets == []
