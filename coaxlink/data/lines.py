"""A text file as numbered lines: encoding by its bytes, read a piece at a time, quotes never split."""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from coaxlink.errors import InputError

PIECE = 8 << 20  # bytes read at once
LONGEST_LINE = 4 << 20  # characters; what goes on longer has no lines
LONGEST_QUOTE = 40  # lines that one quoted cell may run over
_BOMS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x84\x86-\x9f]")  # NEL is white space, tab to return are too
_OPENING = re.compile(r'(?:^|[,;\t|])\s*"')  # a quote inside a word (15" propeller) opens nothing
Line = tuple[int, str]  # number in the file from 1, text without its end
Progress = Callable[[float], None]  # takes the share that is read, 0..1


def read_lines(path: Path, progress: Progress | None = None) -> Iterator[list[Line]]:
    """Pieces of a text file as numbered lines: UTF-8, UTF-16 or, when it is neither, Latin-1.

    Raises InputError: unreadable, or not text.
    """
    try:
        with path.open("rb") as stream:
            size = max(path.stat().st_size, 1)
            head = stream.read(PIECE)
            encoding, skip = _encoding(path, head, complete=size <= len(head))
            decoder = codecs.getincrementaldecoder(encoding)()
            piece, rest, number, done = head[skip:], "", 1, skip
            while True:
                done += len(piece)
                text = rest + _decoded(path, decoder, piece, encoding, done)
                last = not piece
                lines = text.replace("\r\n", "\n").split("\n") if last else _complete_lines(text)
                rest = "" if last else lines.pop()
                lines = [part for line in lines for part in (line.split("\r") if "\r" in line else [line])]
                yield list(zip(range(number, number + len(lines)), lines, strict=True))
                number += len(lines)
                if len(rest) > LONGEST_LINE:
                    problem = f"a line of at most {LONGEST_LINE >> 20} MB is expected"
                    raise InputError(path, f"line {number}", problem)
                if progress is not None:
                    progress(min(done / size, 1.0))
                if last:
                    return
                piece = stream.read(PIECE)
    except OSError as error:
        raise InputError(path, "", f"cannot be read ({error.strerror})") from error


def _complete_lines(text: str) -> list[str]:
    """Lines of a piece; the last one may go on, and a return at its end may be half of a line's end."""
    return text.replace("\r\n", "\n").split("\n")


def _encoding(path: Path, head: bytes, *, complete: bool) -> tuple[str, int]:
    """Name of the encoding and the bytes of its mark."""
    for mark, name in _BOMS:
        if head.startswith(mark):
            found, skip = name, len(mark)
            break
    else:
        pairs = head[:4000]
        zeros = pairs[1::2].count(0), pairs[0::2].count(0)
        found, skip = "utf-8", 0
        if max(zeros) > 0.4 * len(pairs) / 2:  # Latin letters and digits in UTF-16 without a mark
            found = "utf-16-le" if zeros[0] > zeros[1] else "utf-16-be"
    if found == "utf-8":
        try:
            codecs.getincrementaldecoder("utf-8")().decode(head[skip:], final=complete)
        except UnicodeDecodeError:
            found = "latin-1"
    text = head[skip : skip + 4000].decode(found, "ignore")
    if text and sum(c.isascii() for c in text) < 0.5 * len(text):  # numbers are ASCII in every script
        raise InputError(path, "", "not text (UTF-8 expected)")
    return found, skip


def _decoded(path: Path, decoder: codecs.IncrementalDecoder, piece: bytes, encoding: str, done: int) -> str:
    try:
        text = decoder.decode(piece, final=not piece)
    except UnicodeDecodeError as error:
        offset = done - len(piece) + error.start
        raise InputError(path, f"byte {offset}", f"not text ({encoding.upper()} expected)") from error
    odd = _CONTROL.search(text)
    if odd is not None:
        near = done - len(piece) + odd.start()
        raise InputError(path, f"byte {near}", f"not text (found the control code {ord(odd[0]):#04x})")
    return text


def is_open(line: str) -> bool:
    """Whether a quoted cell that begins on this line goes on below it."""
    return line.count('"') % 2 == 1 and _OPENING.search(line) is not None


def joined_quotes(path: Path, lines: Iterable[Line]) -> Iterator[Line]:
    """Lines whose quoted cells run over several are one line. Raises InputError when a quote never ends."""
    held: list[str] = []
    start = 0
    for number, line in lines:
        if not held and not is_open(line):
            yield number, line
            continue
        start = start if held else number
        held.append(line)
        if sum(part.count('"') for part in held) % 2 == 0:
            yield start, " ".join(held)
            held = []
        elif len(held) > LONGEST_QUOTE:
            break
    if held:
        raise InputError(path, f"line {start}", "a quote opens that never closes")
