"""Damaged logs of every kind: read as far as they go, or refused in one line, without chatter."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from coaxlink.data import read_flight_log, read_stand_log
from coaxlink.errors import InputError

SHARED = Path(__file__).parents[2] / ".." / "shared" / "data"
needs_shared = pytest.mark.skipif(
    not SHARED.is_dir(), reason="the shared real logs are not beside this checkout"
)


def damaged(data: bytes, dice: random.Random) -> bytes:
    """Cut short, with bytes flipped, a piece taken out, or noise put in."""
    out = bytearray(data)
    offset, kind = dice.randrange(len(out)), dice.randrange(4)
    if kind == 0:
        del out[offset:]
    elif kind == 1:
        for _ in range(20):
            out[dice.randrange(len(out))] = dice.randrange(256)
    elif kind == 2:
        del out[offset : offset + dice.randrange(1, 2000)]
    else:
        out[offset:offset] = dice.randbytes(dice.randrange(1, 60))
    return bytes(out)


@needs_shared
@pytest.mark.shared_data
@pytest.mark.parametrize(
    "name, size",
    [
        ("logs/sample_log_small.ulg", None),
        ("flights/px4_null_fitted.ulg", 400_000),
        ("flights/ap_null.bin", 200_000),
        ("coax/mn4014_16in_zD1.csv", None),
        ("single/xNova-SR-steps.csv", 20_000),
    ],
)
def test_damage_is_survived_or_said(tmp_path: Path, capfd, name: str, size: int | None) -> None:
    data, dice = (SHARED / name).read_bytes()[:size], random.Random(5)
    read = read_flight_log if name.endswith((".ulg", ".bin")) else read_stand_log
    path = tmp_path / Path(name).name
    refused = 0
    for _ in range(12):
        path.write_bytes(damaged(data, dice))
        try:
            assert read(path).rows > 0
        except InputError as error:
            refused += 1
            assert str(error).startswith(str(path)) and "\n" not in str(error)
    assert capfd.readouterr() == ("", "")
    assert refused > 0 or not name.endswith(".csv")


@needs_shared
@pytest.mark.shared_data
def test_a_damaged_ulog_says_so(tmp_path: Path) -> None:
    data = bytearray((SHARED / "logs" / "sample_log_small.ulg").read_bytes())
    data[400_000:400_000] = b"\xff" * 500
    (tmp_path / "x.ulg").write_bytes(data)
    assert any("damaged" in note for note in read_flight_log(tmp_path / "x.ulg").notes)


def test_a_number_no_sensor_reads_is_refused_with_its_place(tmp_path):
    log = tmp_path / "huge.csv"
    head = "time_s,upper_rpm,lower_rpm,upper_thrust_N,upper_torque_Nm,lower_thrust_N,lower_torque_Nm"
    rows = [f"{i},{1000 + 100 * i},2000,{i}.5,0.1,{i}.1,0.1" for i in range(20)]
    rows[4] = "4,1400,2000,1e300,0.1,4.1,0.1"
    log.write_text("\n".join([head, *rows]) + "\n")
    with pytest.raises(InputError, match=r"line 6, column 'upper_thrust_N': no sensor reads 1e300"):
        read_stand_log(log)
