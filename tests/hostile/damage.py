"""Ways to spoil a file, drawn from a seed: the same number always spoils it the same way."""

from __future__ import annotations

import random
import re

NUMBERS = (
    b"1e39", b"-1e39", b"1e308", b"1e999", b"-1e999", b"nan", b"inf", b"-inf", b"0", b"-0.0", b"1e-320",
    b"1_000", b"1" + b"0" * 30, b"-" + b"9" * 400, b"7" * 5000, b"0x1p5000", b"2147483648", b"-129",
    b"65536", b"4294967296", b"9223372036854775808", b"1e", b"--1", b"0.1.2", b"true",
    b"1979-05-27T07:32:00Z", "１２".encode(), b"3" * 20_000,
)  # fmt: skip
TOKENS = (
    b"\n", b"\r", b"\r\n", b"\0", b"\x1b[2J", b"\x1b]0;x\x07", b"\xff", b"\xed\xa0\x80", "\u2028".encode(),
    "\u202e".encode(), b"\xef\xbb\xbf", b"\xff\xfe", b'"', b"'", b'"""', b"'''", b"\\", b"\\u0000",
    b"\\ud800", b"#", b",", b";", b"\t", b"=", b"[", b"]", b"[[", b"]]", b"{", b"}", b"[/red]", b"--[[",
    b"<script>", b"%n", b"$(x)", b"../../x", b"null", b'"a\nb"', b"@READONLY", b'{"a":1}', b"[1,2]",
    "é".encode("latin-1"), "🚁".encode(),
)  # fmt: skip
DEEP = (
    b"[" * 500, b"[" * 5000, b"{" * 5000, b'{"a":' * 3000, b"x = " + b"[" * 600 + b"]" * 600 + b"\n",
    b"a." * 5000 + b"b = 1\n", b"[" + b"a." * 3000 + b"b]\n",
    b"y = " + b"{a=" * 700 + b"1" + b"}" * 700 + b"\n", b"[" * 200_000, b'"k' + b"k" * 5000 + b'" = 1\n',
    b"(" * 2000, b"z = [" + b"1," * 30_000 + b"]\n",
)  # fmt: skip
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][A-Za-z0-9_.]*")


def damaged(data: bytes, seed: str, others: list[bytes]) -> bytes:
    """The file spoiled once to three times; `others` are sound files of which pieces are put in."""
    dice = random.Random(seed)
    for _ in range(dice.choice((1, 1, 1, 2, 3))):
        data = dice.choice(WAYS)(data, dice, others)
    return data


def _offset(data: bytes, dice: random.Random) -> int:
    return dice.randrange(len(data) + 1)


def _cut(data, dice, others):
    return data[: _offset(data, dice)]


def _flip(data, dice, others):
    out = bytearray(data)
    for _ in range(dice.choice((1, 3, 20)) if out else 0):
        out[dice.randrange(len(out))] = dice.randrange(256)
    return bytes(out)


def _bit(data, dice, others):
    out = bytearray(data)
    if out:
        out[dice.randrange(len(out))] ^= 1 << dice.randrange(8)
    return bytes(out)


def _remove(data, dice, others):
    at = _offset(data, dice)
    return data[:at] + data[at + dice.randrange(1, 400) :]


def _noise(data, dice, others):
    at = _offset(data, dice)
    return data[:at] + dice.randbytes(dice.randrange(1, 100)) + data[at:]


def _double(data, dice, others):
    first, second = sorted((_offset(data, dice), _offset(data, dice)))
    return data[:second] + data[first:second] * dice.choice((1, 1, 2, 50)) + data[second:]


def _foreign(data, dice, others):
    other = dice.choice(others)
    at, start = _offset(data, dice), _offset(other, dice)
    return data[:at] + other[start : start + dice.randrange(1, 5000)] + data[at:]


def _token(data, dice, others):
    for _ in range(dice.choice((1, 1, 4))):
        at = _offset(data, dice)
        data = data[:at] + dice.choice(TOKENS) + data[at:]
    return data


def _number(data, dice, others):
    found = list(_NUMBER.finditer(data))
    if not found:
        return _token(data, dice, others)
    m = dice.choice(found)
    return data[: m.start()] + dice.choice(NUMBERS) + data[m.end() :]


def _word(data, dice, others):
    found = list(_WORD.finditer(data))
    if not found:
        return _token(data, dice, others)
    m = dice.choice(found)
    return data[: m.start()] + dice.choice((*TOKENS, *NUMBERS, b"", m[0] * 1000)) + data[m.end() :]


def _deep(data, dice, others):
    at = dice.choice((0, len(data), _offset(data, dice)))
    return data[:at] + dice.choice(DEEP) + data[at:]


def _lines(data, dice, others):
    lines = data.split(b"\n")
    kind, at = dice.randrange(4), dice.randrange(len(lines))
    if kind == 0:
        dice.shuffle(lines)
    elif kind == 1:
        lines[at:at] = [lines[at]] * dice.choice((1, 2, 500))
    elif kind == 2:
        lines[at] = lines[at] * dice.choice((2, 1000))
    else:
        del lines[at]
    return b"\n".join(lines)


def _encoding(data, dice, others):
    text = data.decode("utf-8", "replace")
    name = dice.choice(("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-7", "utf-8-sig", "latin-1"))
    return text.encode(name, "replace")


def _ends(data, dice, others):
    return data.replace(b"\n", dice.choice((b"\r", b"\r\n", b"\0", b"", b"\xe2\x80\xa8", b"\x0b", b"\n\n")))


def _bytes(data, dice, others):
    return dice.choice((b"", b"\0", b"\n" * 5000, b"\0" * 100_000, b"\xff" * 1000, dice.randbytes(3000)))


def _fill(data, dice, others):
    """Length fields and counts at their largest, values of all ones."""
    at = _offset(data, dice)
    size = dice.choice((1, 2, 4, 8))
    return data[:at] + dice.choice((b"\xff", b"\x7f", b"\0")) * size + data[at + size :]


WAYS = (
    _cut, _flip, _bit, _remove, _noise, _double, _foreign, _token, _token, _number, _number, _word, _word,
    _deep, _lines, _encoding, _ends, _bytes, _fill,
)  # fmt: skip
