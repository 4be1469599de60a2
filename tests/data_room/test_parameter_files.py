"""Parameters of a board from whatever is at hand: one table of forms, read by the one reader of all verbs."""

import struct

import pytest
from case_table import case_table
from pymavlink.dialects.v20 import common

from coaxlink.data.logs.board_parameters import read_board_parameters
from coaxlink.errors import InputError

AP = {"FRAME_CLASS": 4.0, "FRAME_TYPE": 1.0, "MOT_SPIN_MIN": 0.15, "SERVO1_FUNCTION": 33.0}
PX4 = {"CA_AIRFRAME": 0, "CA_ROTOR_COUNT": 8, "CA_ROTOR0_PX": 0.25, "CA_ROTOR0_KM": -0.05}


def lines(row, params=None):
    return "".join(
        row.format(n=n, v=v, i=int(v) if v == int(v) else v) + "\n" for n, v in (params or AP).items()
    )


def qgc(params, types, mark="\t", stack="PX4 Pro"):
    head = f"# Onboard parameters for Vehicle 1\n#\n# Stack: {stack}\n# Name Value Type\n"
    return head + "".join(
        f"1{mark}1{mark}{n}{mark}{v}{mark}{t}\n" for (n, v), t in zip(params.items(), types, strict=True)
    )


def decimal(params):
    return {n: f"{v:.18f}" for n, v in params.items()}


def as_bits(params):
    return {
        n: struct.unpack("<f", struct.pack("<i", v))[0] if isinstance(v, int) else v
        for n, v in params.items()
    }


SHELL = """\
nsh> param show CA_*
Symbols: x = used, + = saved, * = unsaved
x   CA_AIRFRAME [45,98] : 0
x + CA_ROTOR_COUNT [46,101] : 8
x * CA_ROTOR0_PX [47,110] : 0.2500
x + CA_ROTOR0_KM [48,111] : -0.0500

 4/1862 parameters used.
nsh>
"""
AIRFRAME = """\
#!/bin/sh
#
# @name Coaxial X8
# @type Octorotor Coaxial
#
. ${R}etc/init.d/rc.mc_defaults

param set-default CA_AIRFRAME 0
param set-default CA_ROTOR_COUNT 8   # all of them
param set-default CA_ROTOR0_PX 0.5
if param compare SYS_HITL 1
then
\tparam set-default CA_ROTOR0_KM 0.9
fi
param set CA_ROTOR0_PX 0.25
param set-default CA_ROTOR0_KM -0.05
set PWM_OUT 12345678
"""
CHANGES = """\
CA_AIRFRAME,0
timestamp,0
CA_ROTOR_COUNT,6,8
timestamp,0,4296175
CA_ROTOR0_PX,0.25
timestamp,0
CA_ROTOR0_KM,0.05,0.06,-0.05
timestamp,0,4296175,9296175
"""
CONSOLE = "STABILIZE> param show *\nAP: EKF3 IMU0 is using GPS\n" + lines("STABILIZE> {n:<16} {v:f}   # x{i}")

ARDUPILOT_FORMS = {
    "Mission Planner": "#NOTE: 1/2/2026 Copter V4.5.7\n" + lines("{n},{i}"),
    "Mission Planner, comma and blank": lines("{n}, {v}"),
    "Mission Planner, blanks": lines("{n} {v}"),
    "Mission Planner, tabs": lines("{n}\t{v}"),
    "Mission Planner, CRLF": lines("{n},{v}").replace("\n", "\r\n"),
    "CR alone": lines("{n},{v}").replace("\n", "\r"),
    "no last line end": lines("{n},{v}").rstrip(),
    "decimal commas behind commas": lines("{n},{i}").replace("0.15", "0,15"),
    "decimal commas behind tabs": lines("{n}\t{v}").replace(".", ","),
    "decimal commas behind semicolons": lines("{n};{v}").replace(".", ","),
    "semicolons": lines("{n};{v}"),
    "equals signs": lines("{n} = {v}"),
    "MAVProxy .parm": lines("{n:<16} {v:f}"),
    "MAVProxy, comments behind": lines("{n:<16} {v:f}  # default 1.5, was 0.1"),
    "param show of MAVProxy": CONSOLE,
    "comments //": lines("{n},{v} // mine"),
    "words behind": lines("{n},{v},degrees and more"),
    "marked read-only": lines("{n} {v} @READONLY"),
    "included defaults": "@include base.parm\n" + lines("{n} {v}"),
    "spreadsheet": '"Name","Value"\n' + lines('"{n}","{v}"'),
    "spreadsheet with units, ranges and words": "Command,Value,Units,Options,Desc\n"
    + lines("{n},{v},,0:Undefined 1:Quad 4:OctaQuad,The frame. 2 of them")
    + "MOT_SPIN_MAX,0.95,,0.9 1.0,none\n",
    "written twice alike": lines("{n},{v}") + "FRAME_CLASS,4\n",
    "QGroundControl, integers": qgc({n: f"{v:g}" for n, v in AP.items()}, (2, 2, 9, 4), stack="ArduPilot"),
    "QGroundControl, all decimals": qgc(decimal(AP), (9, 9, 9, 9), stack="ArduPilot"),
    "QGroundControl, gimbal beside": qgc(AP, (9, 9, 9, 9)) + "1\t154\tMNT_RC\t3\t6\n",
    "UTF-8 with a mark": lines("{n},{v}").encode("utf-8-sig"),
    "UTF-16 of Windows": ("# Höhe\r\n" + lines("{n},{v}")).encode("utf-16"),
    "UTF-16, big end first, no mark": lines("{n},{v}").encode("utf-16-be"),
    "Latin-1": ("# Kürbis\n" + lines("{n},{v}")).encode("latin-1"),
}
PX4_FORMS = {
    "QGroundControl": qgc(PX4, (6, 6, 9, 9)),
    "QGroundControl, all decimals": qgc(decimal(PX4), (9, 9, 9, 9)),
    "QGroundControl, blanks of a forum": qgc(PX4, (6, 6, 9, 9), mark=" "),
    "QGroundControl, integers as float bits": qgc(as_bits(PX4), (6, 6, 9, 9)),
    "ulog_params": lines("{n},{v}", PX4),
    "ulog_params with changes": CHANGES,
    "ulog_params with changes, no stamps": "\n".join(CHANGES.split("\n")[::2]) + "\n",
    "ulog_params, semicolons": CHANGES.replace(",", ";"),
    "param show of the shell": SHELL,
    "param show in colours": SHELL.replace("nsh> ", "\x1b[Knsh> ").replace(" : ", " : \x1b[32m"),
    "airframe file": AIRFRAME,
    "MAVProxy .parm": lines("{n:<16} {v:f}", PX4),
    "pymavlink, integers as float bits": lines("{n} {v}", as_bits(PX4)),
    "Mission Planner": lines("{n},{v}", PX4),
}  # fmt: skip


def packed_by_hand(params):
    body = b"".join(
        bytes([4, (len(n) - 1) << 4]) + n.encode() + struct.pack("<f", v) for n, v in params.items()
    )
    return struct.pack("<HHH", 0x671B, len(params), len(params)) + body


def dataflash_by_hand(params):
    def form(number, size, name, types, columns):
        return struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 128, number, size, name, types, columns)

    parm = b"".join(struct.pack("<BBBQ16sf", 0xA3, 0x95, 64, 1000, n.encode(), v) for n, v in params.items())
    formats = form(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    return formats + form(64, 31, b"PARM", b"QNf", b"TimeUS,Name,Value") + parm


def ulog_by_hand(params):
    def message(kind, data):
        return struct.pack("<HB", len(data), ord(kind)) + data

    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000) + message("B", bytes(40))
    for n, v in params.items():
        key = (("int32_t " if isinstance(v, int) else "float ") + n).encode()
        out += message("P", bytes([len(key)]) + key + struct.pack("<i" if isinstance(v, int) else "<f", v))
    return out


def tlog_by_hand(params, autopilot, bytewise):
    mav = common.MAVLink(None, 1, 1)
    out = [mav.heartbeat_encode(13, autopilot, 81, 0, 3, 3)]
    for k, (n, v) in enumerate(params.items()):
        whole = isinstance(v, int)
        sent = struct.unpack("<f", struct.pack("<i", v))[0] if whole and bytewise else float(v)
        out.append(mav.param_value_encode(n.encode(), sent, 6 if whole else 9, len(params), k))
    return b"".join(struct.pack(">Q", 1_700_000_000_000_000 + k) + m.pack(mav) for k, m in enumerate(out))


BINARY = {
    "param.pck": (packed_by_hand(AP), AP),
    "log.bin": (dataflash_by_hand(AP), AP),
    "log.ulg": (ulog_by_hand(PX4), PX4),
    "copter.tlog": (tlog_by_hand(AP, 3, False), AP),
    "px4.tlog": (tlog_by_hand(PX4, 12, True), PX4),
}


def test_every_form_gives_the_same_parameters(tmp_path):
    forms = [
        (f"a{k}.{'params' if k % 2 else 'param'}", n, d, AP, "ardupilot")
        for k, (n, d) in enumerate(ARDUPILOT_FORMS.items())
    ]
    forms += [
        (f"p{k}.{'txt' if k % 2 else 'param'}", n, d, PX4, "px4")
        for k, (n, d) in enumerate(PX4_FORMS.items())
    ]
    forms += [(n, n, d, want, "px4" if want is PX4 else "ardupilot") for n, (d, want) in BINARY.items()]
    with case_table() as case:
        for file, name, data, wanted, firmware in forms:
            (tmp_path / file).write_bytes(data if isinstance(data, bytes) else data.encode())
            with case(f"{firmware}: {name}"):
                read = read_board_parameters(tmp_path / file)
                assert read.firmware == firmware
                assert {n: read.params[n] for n in wanted} == pytest.approx(wanted, rel=1e-6)
                assert len(read.params) == len(wanted) + (name.startswith("spreadsheet with"))


def test_a_premise_of_the_reading_is_said(tmp_path):
    notes = {
        "decimal commas": ARDUPILOT_FORMS["decimal commas behind tabs"],
        "changed in the log, the last value is taken: CA_ROTOR_COUNT, CA_ROTOR0_KM": CHANGES,
        "four decimals": SHELL,
        "set on a condition, and left out: CA_ROTOR0_KM": AIRFRAME,
        "left out, of other components: 1/154": ARDUPILOT_FORMS["QGroundControl, gimbal beside"],
    }
    path = tmp_path / "a.txt"
    with case_table() as case:
        for says, text in notes.items():
            path.write_text(text)
            with case(says):
                assert says in " ".join(read_board_parameters(path).notes)


def test_rubbish_is_refused_with_its_line(tmp_path):
    rubbish = {
        "nothing": ("", "no parameters"),
        "comments alone": ("# a\n# b\n", "no parameters"),
        "no value": ("FRAME_CLASS\n", "line 1: NAME,VALUE is expected"),
        "a word for a value": (
            "FRAME_CLASS,4\nFRAME_TYPE,x\n",
            "line 2: FRAME_TYPE: a number is expected, found 'x'",
        ),
        "two values": (
            "FRAME_CLASS,4\nMOT_SPIN_MIN,0.1,0.2\n",
            "line 2: MOT_SPIN_MIN: one value is expected",
        ),
        "both points and commas": (
            "MOT_SPIN_MIN\t0.1\nFRAME_CLASS\t4,0\n",
            "line 2: a decimal comma ('4,0'), with decimal points in line 1",
        ),
        "two firmwares": (
            "FRAME_CLASS,4\nCA_ROTOR_COUNT,8\n",
            "of PX4 (CA_*) and of ArduPilot (FRAME_CLASS)",
        ),
        "nobody's": ("FOO,4\n", "neither FRAME_CLASS (ArduPilot) nor CA_* (PX4)"),
        "twice": ("FRAME_CLASS,4\nFRAME_CLASS,5\n", "line 2: FRAME_CLASS stands twice"),
        "a stand log": ("time_s,upper_rpm\n0,1\n", "line 1: NAME,VALUE is expected"),
        "a page": ("<html>\n", "line 1: NAME,VALUE is expected"),
        "half a count": ("CA_ROTOR_COUNT,8.5\n", "line 1: CA_ROTOR_COUNT: an integer is expected"),
        "two vehicles": (
            qgc(PX4, (6, 6, 9, 9)) + "2\t1\tCA_ROTOR_COUNT\t8\t6\n",
            "line 9: 2/1 beside (1, 1)",
        ),
        "a float as an integer": (qgc(PX4, (6, 6, 9, 6)).replace("-0.05", "5"), "type 9 is expected"),
        "zeros": (bytes(64), "not text"),
        "noise": (bytes(range(128, 256)) + bytes(range(8)), "not text"),
        "a picture": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "not text"),
        "a cut packed file": (packed_by_hand(AP)[:-3], "packed parameters"),
        "a log without": (b"ULog\x01\x12\x35\x01" + bytes(8), "no parameters"),
        "a tlog without": (tlog_by_hand({}, 3, False) * 3, "no parameters (PARAM_VALUE)"),
    }  # fmt: skip
    path = tmp_path / "file.txt"
    with case_table() as case:
        for name, (data, says) in rubbish.items():
            path.write_bytes(data if isinstance(data, bytes) else data.encode())
            with case(name):
                with pytest.raises(InputError) as caught:
                    read_board_parameters(path, telling=True)
                assert says in str(caught.value), str(caught.value)
                assert "\n" not in str(caught.value)
