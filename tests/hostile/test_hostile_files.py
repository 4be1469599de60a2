"""Directed files over the real verbs: one line on stderr, the documented exit code, within seconds."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table
from sound_files import EXAMPLES, MAKERS, flight_rows, px4_params, sheet_rows, stand_rows
from verb import run

from coaxlink.data import read_flight_log
from coaxlink.data.logs.streams import TimeSeries, possible
from coaxlink.data.samples import DAMAGED

NOBODY = "udpout:127.0.0.1:9"  # whoever opens it has read the file already
X8 = str(EXAMPLES / "x8_paper.toml")


def text_of(name):
    return (EXAMPLES / name).read_text()


def airframe(old, new):
    text = text_of("x8_paper.toml")
    assert old in text
    return text.replace(old, new, 1)


def rotor(more):
    return text_of("rotor_paper.toml") + more


def params(name, value, kind=9):
    rows = [f"1\t1\t{n}\t{v}\t{6 if isinstance(v, int) else 9}" for n, v in px4_params().items() if n != name]
    return "\n".join([f"# X8\n1\t1\t{name}\t{value}\t{kind}", *rows]) + "\n"


def sound(kind):
    """A sound file of that kind, as bytes."""

    def make(folder):
        sound_folder = folder / "sound"
        sound_folder.mkdir()
        return MAKERS[kind](sound_folder).read_bytes()

    return make


def backup(value, kind):
    """A backup whose checksum is not asked for, with one value altered."""

    def make(folder):
        lines = sound("backup PX4")(folder).decode().splitlines()
        rest = [line for line in lines if not line.startswith("# Sum")]
        name = "CA_ROTOR_COUNT" if kind == 6 else "CA_ROTOR0_CT"
        at = next(i for i, line in enumerate(rest) if f"\t{name}\t" in line)
        rest[at] = f"1\t1\t{name}\t{value}\t{kind}"
        return "\n".join(rest) + "\n"

    return make


def with_cell(cell, row=5):
    lines = stand_rows().splitlines()
    cells = lines[row].split(",")
    lines[row] = ",".join([*cells[:3], cell, *cells[4:]])
    return "\n".join(lines) + "\n"


TABLE = ("table", "FILE", "--firmware", "px4", "--law", "standard")
ROTOR = ("table", X8, "--rotor", "FILE", "--firmware", "px4", "--law", "standard")
UPLOAD = ("upload", "FILE", "--connect", NOBODY)
RESTORE = ("restore", "FILE", "--connect", NOBODY)
IDENTIFY = ("identify", "FILE")
REFINE = ("refine", "FILE")
COLUMNS = ("identify", str(EXAMPLES / "stand_eq17.csv"), "--columns", "FILE")
TRUTH = ("loop", "--truth", "FILE", "--out", "loop")
STAND = ("sim", "--stand", "out.csv", "--schedule", "FILE")
DEEP = "x = " + "[" * 500 + "]" * 500 + "\n"

# what: (verb, name of the file, what stands in it, what the line says)
FILES = {
    "a name of two lines": (
        TABLE, "a.toml", airframe('"paper-x8"', '"X8\\nB,0"'), "name: one line of printable",
    ),
    "a name that turns around": (TABLE, "a.toml", airframe('"paper-x8"', '"X8\\u202eB"'), "name: one line"),
    "a name of 10 kB": (
        TABLE, "a.toml", airframe('"paper-x8"', f'"{"X" * 10_000}"'), "at most 4096 characters",
    ),
    "a name of 81": (TABLE, "a.toml", airframe('"paper-x8"', f'"{"X" * 81}"'), "at most 80 characters"),
    "TOML 500 deep": (TABLE, "a.toml", airframe("mass_kg", DEEP + "mass_kg"), "nested deeper"),
    "TOML of inline tables": (TABLE, "a.toml", "y = " + "{a=" * 400 + "1" + "}" * 400, "nested deeper"),
    "TOML 40 deep": (
        TABLE, "a.toml", airframe("mass_kg", "x = " + "[" * 40 + "]" * 40 + "\nmass_kg"), "deeper",
    ),
    "a TOML key of 5000 parts": (TABLE, "a.toml", "a." * 5000 + "b = 1\n", "more than 16 parts"),
    "a TOML key of 100 kB": (TABLE, "a.toml", "k" * 100_000 + " = 1\n", "at most 512 characters"),
    "a TOML key of two lines": (TABLE, "a.toml", '"a\\nb" = 1\n', "one line of printable text"),
    "a mass of 5000 digits": (TABLE, "a.toml", airframe("20.0", "7" * 5000), "digits"),
    "a mass of 400 digits": (
        TABLE, "a.toml", airframe("20.0", "7" * 400), "mass_kg: an integer of at most 64 bits",
    ),
    "a mass of 1e400": (TABLE, "a.toml", airframe("20.0", "1e400"), "mass_kg"),
    "a date for a mass": (TABLE, "a.toml", airframe("20.0", "1979-05-27"), "mass_kg"),
    "a day that is none": (TABLE, "a.toml", airframe("20.0", "1979-02-31"), "not TOML"),
    "TOML of 2 MB": (TABLE, "a.toml", "# " + "x" * 2_000_000, "more than the 1 MB"),
    "NUL in TOML": (TABLE, "a.toml", airframe("mass_kg", "\0mass_kg"), "not TOML"),
    "UTF-16": (TABLE, "a.toml", text_of("x8_paper.toml").encode("utf-16"), "not text (UTF-8 expected)"),
    "half a surrogate": (TABLE, "a.toml", b'name = "\xed\xa0\x80"\n', "not text (UTF-8 expected)"),
    "escape half a surrogate": (TABLE, "a.toml", 'name = "\\ud800"\n', "not TOML"),
    "a form in red": (
        ROTOR, "r.toml", rotor("").replace('form = "crm"', 'form = "\\u001b[31m"'), "form: one line",
    ),
    "a rotor with hidden text": (
        ROTOR, "r.toml", rotor('\n[identified]\nfile = "a\\u2028b"\n'), "identified.file",
    ),
    "a power of 5000 digits": (ROTOR, "r.toml", rotor("").replace("u_u^2", f"u_u^{'9' * 5000}", 1), "upper"),
    "a term of 400 digits": (ROTOR, "r.toml", rotor("").replace("55.9517", "9" * 400), "64 bits"),
    "an int of 1e30 in a table": (UPLOAD, "t.params", params("CA_ROTOR_COUNT", 10**30, 6), "an integer"),
    "1e39 in a table": (UPLOAD, "t.params", params("CA_ROTOR0_CT", "1e39"), "a float32 is expected"),
    "5000 digits in a table": (
        UPLOAD, "t.params", params("CA_ROTOR0_CT", "7" * 5000), "a number is expected",
    ),
    "an address of 5000 digits": (UPLOAD, "t.params", f"{'7' * 5000}\t1\tA\t1\t6\n", "must be integers"),
    "a system of -1": (UPLOAD, "t.params", "-1\t1\tA\t1\t6\n", "0..255"),
    "a name that is none": (UPLOAD, "t.params", "1\t1\tA B\t1\t6\n", "is not a parameter name"),
    "a line inside a line": (
        UPLOAD, "t.params", "# X8\u2028\n1\t1\tA\u2028B\t1\t6\n", "is not a parameter name",
    ),
    "1e39 for ArduPilot": (UPLOAD, "t.param", "FRAME_CLASS,1e39\n", "a float32 is expected"),
    "1_0 for ArduPilot": (UPLOAD, "t.param", "FRAME_CLASS,1_0\n", "a number is expected"),
    "ESC for ArduPilot": (UPLOAD, "t.param", "FRAME\x1b[2J,15\n", "NAME,VALUE is expected"),
    "1e39 in a backup": (RESTORE, "b.params", backup("1e39", 9), "a float32 is expected"),
    "an int of 1e30 in a backup": (RESTORE, "b.params", backup(10**30, 6), "an integer is expected"),
    "an int of 2^31 in a backup": (RESTORE, "b.params", backup(2**31, 6), "2147483647 is expected"),
    "a cut backup": (RESTORE, "b.params", lambda f: sound("backup PX4")(f)[:-300], "b.params"),
    "a line break in a cell": (IDENTIFY, "s.csv", with_cell('"0.5\n"'), None),
    "two cells in quotes": (IDENTIFY, "s.csv", with_cell('"0.5\n0.6"'), "line 6"),
    "a quote without an end": (IDENTIFY, "s.csv", with_cell('"0.5'), "s.csv"),
    "5000 digits in a cell": (IDENTIFY, "s.csv", with_cell("7" * 5000), "line 6"),
    "1e999 in a cell": (IDENTIFY, "s.csv", with_cell("1e999"), "line 6"),
    "a cell of 1 MB": (IDENTIFY, "s.csv", with_cell("x" * 1_000_000), "line 6"),
    "a quoted cell of 1 MB": (IDENTIFY, "s.csv", with_cell('"' + "x" * 1_000_000 + '"'), "s.csv"),
    "100,000 columns": (
        IDENTIFY, "s.csv", ",".join(f"c{i}" for i in range(100_000)) + "\n" + "1," * 100_000, "2000",
    ),
    "100,000 equal headings": (IDENTIFY, "s.csv", "a," * 100_000 + "\n" + "1," * 100_000, "2000 columns"),
    "a heading of 1 MB": (IDENTIFY, "s.csv", "x" * 1_000_000 + ",b\n1,2\n", "s.csv"),
    "a heading in red": (
        IDENTIFY, "s.csv", stand_rows().replace("upper_rpm", "\x1b[31mupper_rpm", 1), "s.csv",
    ),
    "a line of 24 MB": (IDENTIFY, "s.csv", lambda f: "1," * 12_000_000, "a line of at most 4 MB"),
    "NUL in a CSV": (IDENTIFY, "s.csv", with_cell("\0"), "s.csv"),
    "100,000 empty lines": (IDENTIFY, "s.csv", "\n" * 100_000, "empty"),
    "a sheet that is a bomb": (IDENTIFY, "s.xlsx", lambda f: sheet_rows(stand_rows())[:700], "s.xlsx"),
    "a map 500 deep": (COLUMNS, "m.toml", DEEP, "nested deeper"),
    "a scale of 400 digits": (
        COLUMNS, "m.toml", f'a = {{ column = "upper_rpm", scale = {"9" * 400} }}\n', "64 bits",
    ),
    "a scale of NaN": (COLUMNS, "m.toml", 'a = { column = "upper_rpm", scale = nan }\n', "a: "),
    "a map of ESC": (COLUMNS, "m.toml", 'a = "\\u001b[2J"\n', "one line of printable text"),
    "a ULog in a circle": (REFINE, "f.ulg", lambda f: ulog_in_a_circle(), "not a readable ULog"),
    "a ULog of one byte more": (REFINE, "f.ulg", b"ULog\x01\x12\x35\x01", "not a readable ULog"),
    "a DataFlash without formats": (REFINE, "f.bin", b"\xa3\x95" * 5000, "f.bin"),
    "a tlog of stamps": (REFINE, "f.tlog", (b"\0" * 8 + b"\xfd\xff\xff") * 3000, "f.tlog"),
    "a motor of 1e999": (REFINE, "f.csv", flight_rows().replace("\n0.02,", "\n1e999,", 1), "line 3"),
    "a truth 500 deep": (TRUTH, "t.toml", DEEP, "nested deeper"),
    "a truth of 1e400": (TRUTH, "t.toml", '[[effects]]\nname = "wind"\nsize = 1e400\n', "size"),
    "effects that are none": (TRUTH, "t.toml", "effects = 5\n", "effects"),
    "a schedule of 1e8 s": (STAND, "s.toml", "[[pieces]]\nseconds = 1e8\nupper=0.5\nlower=0.5\n", "7200"),
    "a schedule of 1e6 pieces": (STAND, "s.toml", "pieces = [" + "{}," * 50_000 + "]\n", "at most 1000"),
    "a schedule that is a table": (STAND, "s.toml", "pieces = {a = 1}\n", "[[pieces]]"),
}  # fmt: skip


def ulog_in_a_circle():
    """A message of definitions, unknown and longer than what is left of the file."""
    from sim.px4.logger import framed, keyed

    head = b"ULog\x01\x12\x35\x01" + bytes(8) + framed("B", bytes(40))
    head += b"".join(keyed("I", "char[3] sys_name", b"PX4") for _ in range(200))
    return head + b"\xff\x7f\x01" + bytes(100)


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)


def refused(capsys, arguments, says, code=2):
    ended, out, err = run(capsys, *arguments)
    assert (ended, out) == (code, ""), (ended, err[:500])
    lines = err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("coaxlink: ") and lines[0].isprintable(), err[:500]
    assert says in lines[0] and "fault of coaxlink" not in err and len(err) < 1200


@pytest.mark.slow
def test_a_file_that_means_harm_is_refused_in_one_line(tmp_path, capsys):
    with case_table() as case:
        for number, (what, (verb, name, content, says)) in enumerate(FILES.items()):
            folder = tmp_path / str(number)
            folder.mkdir()
            (folder / "rotor_paper.toml").write_text(text_of("rotor_paper.toml"))
            content = content(folder) if callable(content) else content
            path = folder / name
            path.write_bytes(content.encode() if isinstance(content, str) else content)
            arguments = [str(path) if word == "FILE" else word for word in verb]
            with case(what):
                if says is None:  # odd, and sound: a spreadsheet breaks lines inside a cell
                    code, _, err = run(capsys, *arguments)
                    assert code == 0 and "fault" not in err
                else:
                    refused(capsys, arguments, says)


NOT_FILES = {
    "table": TABLE, "rotor": ROTOR, "upload": UPLOAD, "restore": RESTORE, "identify": IDENTIFY,
    "refine": REFINE, "map": COLUMNS, "truth": TRUTH, "schedule": STAND,
    "key": ("upload", "t.params", "--connect", NOBODY, "--signing-key", "FILE"),
    "init": ("init", "new.toml", "--mass", "20", "--from", "FILE"),
    "memory": ("sim", "--listen", "udpin:127.0.0.1:0", "--memory", "FILE"),
}  # fmt: skip


@pytest.mark.slow
def test_what_is_no_file_is_refused_at_once(tmp_path, capsys):
    (tmp_path / "t.params").write_text(params("CA_AIRFRAME", 0, 6))
    paths = {"zero": Path("/dev/zero"), "folder": tmp_path / "empty"}
    paths |= {what: tmp_path / f"{what}.toml" for what in ("pipe", "loop", "absent")}
    os.mkfifo(paths["pipe"])
    paths["folder"].mkdir()
    paths["loop"].symlink_to(paths["loop"])
    with case_table() as case:
        for what, path in paths.items():
            for verb, words in NOT_FILES.items():
                if what in ("folder", "absent", "loop") and verb not in ("table", "identify"):
                    continue  # looked at in one place for all verbs
                with case(f"{verb} of {what}"):
                    refused(capsys, [str(path) if word == "FILE" else word for word in words], str(path))


def test_a_journal_5000_deep_is_refused(tmp_path):
    from sound_files import PX4

    from coaxlink.errors import InputError
    from coaxlink.uploading.journal import Journal

    for content in (
        "[" * 5000 + "]" * 5000,
        '{"board": ' + "[" * 5000,
        '{"old": 1' + "0" * 5000 + "}",
        "[]",
        "5",
        '"x"',
        "null",
        json.dumps(
            {"board": "b", "old": {"A\nB": {"value": 1, "type": 6, "bits": "00000000"}}, "old_files": {}}
        ),
        json.dumps({"board": ["b"], "old": {}, "old_files": {}, "new": {}, "new_files": {}}),
    ):
        journal = Journal(PX4, tmp_path)
        for path, read in ((journal.path, journal.open_entry), (journal.record_path, journal.last)):
            path.write_text(content)
            with pytest.raises(InputError) as error:
                read()
            assert str(error.value).isprintable() and "damaged" in str(error.value)


def test_a_name_of_a_file_that_no_terminal_shows(tmp_path, capsys):
    """Names of files come from strangers too: a card, an archive, a mail."""
    for name in (b"a\x1b[2J.toml", b"a\nb.toml", "a\u202eb.toml".encode(), b"a\xff.toml", b"[red].toml"):
        path = Path(os.fsdecode(os.path.join(os.fsencode(tmp_path), name)))  # noqa: PTH118
        path.write_bytes(b"x = [\n")
        refused(capsys, ["table", path, "--firmware", "px4"], "not TOML")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc is Linux's")
def test_a_file_without_a_size_is_read_to_its_end(capsys):
    refused(capsys, ["table", "/proc/self/status", "--firmware", "px4"], "not TOML")


def test_a_logger_that_hung_counts_once(tmp_path):
    """One row five hundred times, its stamp too, made a fit singular."""
    from coaxlink.data import read_stand_log

    lines = stand_rows().splitlines()
    (tmp_path / "s.csv").write_text("\n".join([*lines[:20], *[lines[20]] * 500, *lines[20:]]) + "\n")
    (tmp_path / "sound.csv").write_text("\n".join(lines) + "\n")
    hung, sound = read_stand_log(tmp_path / "s.csv"), read_stand_log(tmp_path / "sound.csv")
    assert hung.rows == sound.rows and "500 rows that repeat the row before left out" in hung.notes
    assert hung.columns.keys() == sound.columns.keys()
    assert all((hung[name] == sound[name]).all() for name in sound.columns)


def test_damage_inside_a_log_is_a_premise_and_a_torn_end_is_none(tmp_path):
    with case_table() as case:
        for name in ("ULog", "DataFlash", "tlog"):
            path = MAKERS[name](tmp_path)
            data = path.read_bytes()
            for what, spoiled, premise in (
                ("sound", data, False),
                ("torn", data[: len(data) * 9 // 10], False),
                ("noise", data[: len(data) // 2] + b"\xff" * 500 + data[len(data) // 2 :], True),
            ):
                with case(f"{name} {what}"):
                    path.write_bytes(spoiled)
                    assert (DAMAGED in read_flight_log(path).premises) is premise


def test_a_ulogs_parameter_of_no_known_type_is_damage(tmp_path):
    """Its value would be bytes."""
    path = MAKERS["ULog"](tmp_path)
    whole = read_flight_log(path)
    path.write_bytes(path.read_bytes().replace(b"int32_t SYS_", b"inq32_t SYS_"))
    log = read_flight_log(path)
    assert DAMAGED in log.premises and len(log.parameters) < len(whole.parameters)


def test_what_no_sensor_reads_is_left_out_and_is_damage():
    premises = []
    time = np.arange(40) * 0.1
    spoiled = np.where(np.arange(40) == 7, 4e37, 1.0)
    (left,) = possible([TimeSeries(time, {"accel_x_m_s2": spoiled})], premises)
    assert len(left.time_s) == 39 and premises == [DAMAGED]
