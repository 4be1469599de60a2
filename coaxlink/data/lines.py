"""A text file as numbered lines: encoding by its bytes, read a piece at a time, quoted cells never split."""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Callable, Iterator
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

    A quoted cell that runs over several lines is one line. Raises InputError: unreadable, or not text.
    """
    quotes = _Quotes(path)
    try:
        with path.open("rb") as stream:
            size = max(path.stat().st_size, 1)
            piece = stream.read(PIECE)
            encoding, done = _encoding(path, piece, complete=size <= len(piece))
            piece = piece[done:]
            decoder = io.IncrementalNewlineDecoder(
                codecs.getincrementaldecoder(encoding)(), translate=True
            )  # \r\n and \r are \n
            rest, number = "", 1
            while True:
                text = rest + _decoded(path, decoder, piece, encoding, done)
                done += len(piece)
                lines = text.split("\n")
                rest = lines.pop() if piece else ""
                yield quotes.joined(list(enumerate(lines, number)), last=not piece)
                number += len(lines)
                if len(rest) > LONGEST_LINE:
                    problem = f"a line of at most {LONGEST_LINE >> 20} MB is expected"
                    raise InputError(path, f"line {number}", problem)
                if progress is not None:
                    progress(min(done / size, 1.0))
                if not piece:
                    return
                piece = stream.read(PIECE)
    except OSError as error:
        raise InputError(path, "", f"cannot be read ({error.strerror})") from error


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


def _decoded(
    path: Path, decoder: io.IncrementalNewlineDecoder, piece: bytes, encoding: str, done: int
) -> str:
    try:
        text = decoder.decode(piece, final=not piece)
    except UnicodeDecodeError as error:
        problem = f"not text ({encoding.upper()} expected)"
        raise InputError(path, f"byte {done + error.start}", problem) from error
    odd = _CONTROL.search(text)
    if odd is not None:
        problem = f"not text (found the control code {ord(odd[0]):#04x})"
        raise InputError(path, f"byte {done + odd.start()}", problem)
    return text


class _Quotes:
    """Joins the lines of quoted cells, over the ends of pieces as well."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._held: list[str] = []
        self._start = 0

    def joined(self, lines: list[Line], *, last: bool) -> list[Line]:
        """The lines that are complete. Raises InputError when a quote never ends."""
        if not self._held and not any('"' in line for _, line in lines):
            return lines
        out = []
        for number, line in lines:
            if not self._held and not (line.count('"') % 2 == 1 and _OPENING.search(line)):
                out.append((number, line))
                continue
            self._start = self._start if self._held else number
            self._held.append(line)
            if sum(part.count('"') for part in self._held) % 2 == 0:
                out.append((self._start, " ".join(self._held)))
                self._held = []
            elif len(self._held) > LONGEST_QUOTE:
                break
        if self._held and (last or len(self._held) > LONGEST_QUOTE):
            raise InputError(self.path, f"line {self._start}", "a quote opens that never closes")
        return out
