"""Damaged logs of every kind: read as far as they go, or refused in one line, without chatter."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from case_table import case_table

from coaxlink.data import read_flight_log, read_stand_log
from coaxlink.errors import InputError

SHARED = Path(__file__).parents[2] / ".." / "shared" / "data"
needs_shared = pytest.mark.skipif(
    not SHARED.is_dir(), reason="the shared real logs are not beside this checkout"
)


FILES = {  # bytes taken
    "logs/sample_log_small.ulg": None,
    "flights/px4_null_fitted.ulg": 400_000,
    "flights/ap_null.bin": 200_000,
    "coax/mn4014_16in_zD1.csv": None,
    "single/xNova-SR-steps.csv": 20_000,
}


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


@pytest.mark.slow
@needs_shared
@pytest.mark.shared_data
def test_damage_is_survived_or_said(tmp_path: Path, capfd) -> None:
    dice = random.Random(5)
    with case_table() as case:
        for name, size in FILES.items():
            data, path = (SHARED / name).read_bytes()[:size], tmp_path / Path(name).name
            read = read_flight_log if name.endswith((".ulg", ".bin")) else read_stand_log
            for _ in range(6):
                path.write_bytes(damaged(data, dice))
                with case(name):
                    try:
                        assert read(path).rows > 0
                    except InputError as error:
                        assert str(error).startswith(str(path)) and "\n" not in str(error)
    assert capfd.readouterr() == ("", "")
