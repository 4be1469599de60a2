"""Parameter files of QGroundControl and ArduPilot, text and packed, read and written."""

import struct

import numpy as np
import pytest

from firmware_params import ardupilot as ap
from firmware_params import px4
from firmware_params.ardupilot import packed
from firmware_params.errors import ParamsFileError, TableError
from firmware_params.reading import read_params

GOOD = "# Vehicle-Id 1\n#\n1\t1\tCA_ROTOR_COUNT\t8\t6\n1\t1\tCA_ROTOR0_CT\t46.979999542236328125\t9\n"


def test_reads_what_qgc_writes(tmp_path):
    path = tmp_path / "a.params"
    path.write_text(GOOD)
    read = read_params(path)
    assert read.params == {"CA_ROTOR_COUNT": 8, "CA_ROTOR0_CT": 46.979999542236328125}
    assert read.types == {"CA_ROTOR_COUNT": 6, "CA_ROTOR0_CT": 9}
    assert read.header[0] == "Vehicle-Id 1"


def test_every_float32_comes_back_bit_for_bit(tmp_path):
    rng = np.random.default_rng(5)
    bits = rng.integers(0, 2**32, 3000, dtype=np.uint32).view(np.float32)
    values = [float(v) for v in bits if np.isfinite(v)] + [0.0, -0.0, 1e-45, 6.5, 0.1]
    params = {f"P{i}": v for i, v in enumerate(values)}
    path = tmp_path / "b.params"
    px4.write_params_file(path, params)
    read = read_params(path).params
    got = np.array([read[name] for name in params], np.float32)
    assert (got.view(np.uint32) == np.array(values, np.float32).view(np.uint32)).all()


def test_param_files(tmp_path):
    path = tmp_path / "a.param"
    params = {"MOT_THST_EXPO": 1.0, "SCR_LD_CHECKSUM": 8388607.0, "MOT_SPIN_MIN": 0.05, "X": -0.0}
    ap.write_param_file(path, params, header=["one", "two"])
    read = read_params(path)
    assert read.params == {
        n: float(np.float32(v)) if n != "MOT_SPIN_MIN" else 0.05 for n, v in params.items()
    }
    assert read.header == ("one", "two")
    path.write_text("MOT_THST_EXPO 1.0\nSERVO1_FUNCTION=33 # motor\n\nFRAME_CLASS\t15 @READONLY\n")
    assert read_params(path).params == {
        "MOT_THST_EXPO": 1.0,
        "SERVO1_FUNCTION": 33.0,
        "FRAME_CLASS": 15.0,
    }


def test_a_bad_line_is_named(tmp_path):
    px4_lines = {
        "1\t1\tCA_ROTOR0_CT\tnan\t9": "line 2: CA_ROTOR0_CT: a finite number",
        "1\t1\tCA_ROTOR0_CT\tx\t9": "line 2: CA_ROTOR0_CT: a number is expected, found 'x'",
        "1\t1\tCA_ROTOR_COUNT\t8.5\t6": "line 2: CA_ROTOR_COUNT: an integer",
        "1\t1\tA\t1\t6\n1\t1\tB\t1": "line 3: 5 tab-separated fields",
        "1\t1\tA\t1\t6\n1\t1\tA\t2\t6": "line 3: A stands twice",
        "1\t1\tA\t1\t6\n2\t1\tB\t1\t6": "line 3: 2/1 beside",
        "1\t300\tA\t1\t6": "0..255 are expected",
        "1\t1\tn-m\t1\t6": "not a parameter name",
        "1\t1\tA\t1\t77": "type 77 is unknown",
        "1\t1\tA\t300\t1": "0..255 is expected",
        "": "no parameters",
    }
    ardupilot_lines = {
        "MOT_THST_EXPO,x": "line 2: MOT_THST_EXPO: a number",
        "A,1\nA,2": "line 3: A stands twice",
        "lower,1": "line 2: NAME,VALUE",
        "A,nan": "line 2: A: a finite",
        "": "no parameters",
    }
    path, wrong = tmp_path / "c.params", {}
    for lines in (px4_lines, ardupilot_lines):
        for line, says in lines.items():
            path.write_text(f"# head\n{line}\n")
            with pytest.raises(ParamsFileError) as caught:
                read_params(path)
            if says not in str(caught.value):
                wrong[line] = str(caught.value)
    assert not wrong


# two names that share "MOT_", an int8, a default behind a value, and padding between entries
BY_HAND = (
    struct.pack("<HHH", 0x671B, 4, 4)
    + bytes([1, 0 | (10 << 4)]) + b"FRAME_CLASS" + struct.pack("<b", 15)
    + b"\0\0\0"
    + bytes([4 | (1 << 4), 0 | (11 << 4)]) + b"MOT_SPIN_MIN" + struct.pack("<ff", 0.15, 0.1)
    + bytes([4, 4 | (8 << 4)]) + b"THST_EXPO" + struct.pack("<f", 1.0)
    + bytes([3, 0 | (14 << 4)]) + b"SCR_LD_CHECKSUM" + struct.pack("<i", -1)
)  # fmt: skip


def test_reads_what_the_format_says():
    found = packed.unpack(BY_HAND)
    assert found["FRAME_CLASS"] == (15.0, 2) and found["SCR_LD_CHECKSUM"] == (-1.0, 6)
    assert found["MOT_SPIN_MIN"] == (pytest.approx(0.15), 9) and found["MOT_THST_EXPO"] == (1.0, 9)
    assert len(found) == 4


def test_what_is_packed_comes_back():
    params = {f"CXL_{a}{n}": (n / 8, 9) for a in "RPYT" for n in range(1, 9)} | {"FRAME_CLASS": (17.0, 2)}
    data = packed.pack(params)
    assert packed.unpack(data) == params
    assert struct.unpack_from("<HHH", data) == (0x671B, 33, len(data)) and len(data) < 300


def test_a_cut_file_and_another_file_are_refused():
    for cut in (3, 20, len(BY_HAND) - 2):
        with pytest.raises(TableError):
            packed.unpack(BY_HAND[:cut])
    with pytest.raises(TableError, match="magic"):
        packed.unpack(b"not packed at all")


def test_what_ardupilot_includes_is_read_within_its_folder_and_else_said(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "common.parm").write_text("FRAME_CLASS 4\nFRAME_TYPE 0\n@include deeper.parm\n")
    (tmp_path / "parts" / "deeper.parm").write_text("MOT_SPIN_MIN 0.1\n")
    path = tmp_path / "board.parm"
    path.write_text("@include parts/common.parm  # of all\nFRAME_TYPE 1\n")
    read = read_params(path)
    assert read.params == {"FRAME_CLASS": 4.0, "FRAME_TYPE": 1.0, "MOT_SPIN_MIN": pytest.approx(0.1)}
    assert len(read.notes) == 1 and "parts/common.parm was read too" in read.notes[0]
    path.write_text("FRAME_TYPE 1\n@include parts/common.parm\n")
    assert read_params(path).params["FRAME_TYPE"] == 0.0  # the last line holds
    for name in ("gone.parm", "../outside.parm", str(tmp_path / "parts" / "common.parm.bak"), "/etc/passwd"):
        path.write_text(f"FRAME_CLASS 4\n@INCLUDE {name}\n")
        assert "was not followed (it is not beside this file)" in read_params(path).notes[0]
        path.write_text(f"@include {name}\n")  # and nothing else: why there is nothing
        with pytest.raises(ParamsFileError, match=r"no parameters.*was not followed"):
            read_params(path)
    path.write_text("FRAME_CLASS 4\n@include board.parm\n")
    with pytest.raises(ParamsFileError, match="8 files in one another"):
        read_params(path)
