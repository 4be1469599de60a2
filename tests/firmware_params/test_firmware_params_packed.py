"""ArduPilot's packed parameter file, from bytes written out by hand."""

import struct

import pytest

from firmware_params.ardupilot import packed
from firmware_params.errors import TableError

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


@pytest.mark.parametrize("cut", [3, 20, len(BY_HAND) - 2])
def test_a_cut_file_is_refused(cut):
    with pytest.raises(TableError):
        packed.unpack(BY_HAND[:cut])


def test_another_file_is_refused():
    with pytest.raises(TableError, match="magic"):
        packed.unpack(b"not packed at all")
