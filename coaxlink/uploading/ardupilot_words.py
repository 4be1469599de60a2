"""What an ArduPilot board itself says of its table: its scripts' words, its pre-arm checks, other scripts.

Bytes that were written and read back do not fly by themselves: ArduPilot takes the matrix of the first script
that sets one (AP_MotorsMatrix_Scripting_Dynamic, AP_MotorsMatrix::init), and refuses to arm after a script's
error (AP_Scripting::arming_checks). Only the board can say which it is.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import CheckFailed
from coaxlink.mavlink.session import Session
from coaxlink.mavlink.telemetry import Telemetry
from coaxlink.uploading.board import LOSSY
from firmware_params.ardupilot import scripts

RUN_PREARM_CHECKS = 401  # MAV_CMD: it says each reason not to arm as a text, and answers ACCEPTED
_ROUND_S = 0.7  # for the texts of one run to arrive
_AGAIN_S = 1.0
_ROUNDS, _ROUNDS_LOSSY = 2, 4  # runs without a complaint; a lossy line may swallow a text
_OF_MATRIX = re.compile(r"\b(?:MotorsMatrix|Motors_dynamic|Motors_6DoF)\b")
_NOT_CODE = re.compile(
    r"""--\[(=*)\[.*?\]\1\]|--[^\n]*|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*'|\[(=*)\[.*?\]\2\]""", re.DOTALL
)
_REQUIRED = re.compile(r"""\brequire\s*\(?\s*["']([^"']+)["']""")
_MATRIX_WORD = re.compile(r"^coaxlink: (?:matrix|table) of (\d+) motors\b")
_ERRORS = ("Lua:", "coaxlink:", "Scripting:")  # texts that begin so and are severe are a script's failure
_OF_TABLE = ("Scripting", "Motors:")  # pre-arm reasons that are about the matrix


def matrix_line(text: str) -> tuple[int, str] | None:
    """(line, binding) where a Lua script sets the motors' matrix; comments and strings do not count."""
    code = _NOT_CODE.sub(lambda m: re.sub(r"[^\n]", " ", m[0]), text)
    found = _OF_MATRIX.search(code)
    return None if found is None else (code.count("\n", 0, found.start()) + 1, found[0])


def required_modules(text: str) -> list[str]:
    """Names of the modules that a script takes in, as paths below `modules`."""
    return [name.replace(".", "/") for name in _REQUIRED.findall(text)]


class Words:
    """The texts of one board since its last start, as far as they were heard."""

    def __init__(self, session: Session) -> None:
        self._session, self._heard = session, Telemetry(session.clock.monotonic)
        session.subscribe(self._heard.hear)

    def forget(self) -> None:
        """The board starts anew."""
        self._heard.clear()

    def failure(self) -> str:
        """A script's own word that it failed, "" where none was heard."""
        severe = (t.text for t in self._heard.texts if t.severity <= mavlink.MAV_SEVERITY_ERROR)
        return next((text for text in severe if text.startswith(_ERRORS)), "")

    def motors(self) -> int | None:
        """How many motors our script reported that it set, None where it was not heard."""
        found = [m for t in self._heard.texts if (m := _MATRIX_WORD.match(t.text))]
        return int(found[-1][1]) if found else None

    def prearm(self) -> list[str] | None:
        """Why it would not arm, by its own checks; None where it does not run them on request."""
        asked_s = self._session.clock.monotonic()
        result = self._session.command(RUN_PREARM_CHECKS, timeout_s=_ROUND_S, tries=8)
        self._session.clock.sleep(_ROUND_S)
        if result not in (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED):
            return None
        since = (t.text for t in self._heard.texts if t.received_s >= asked_s)
        return [text for text in since if text.startswith("PreArm:")]

    def table_complaint(self, motors: int | None, wait_s: float) -> str:
        """Why the board does not fly the table, in its own words; "" once it is sure that it does.

        A board that has just started has no matrix until its scripts ran: it has `wait_s` for that. Raises
        CheckFailed where the board says nothing either way, LinkError.
        """
        clock, clean = self._session.clock, 0
        end = clock.monotonic() + wait_s
        while True:
            if failure := self.failure():
                return failure
            reported = self.motors()
            if reported is not None and motors is not None and reported != motors:
                return f"its script set {reported} motors, the table has {motors}"
            reasons = self.prearm()
            if reasons is None:
                if reported is not None:
                    return ""
                if clock.monotonic() > end:
                    raise CheckFailed("the board does not say whether it flies the table: see its messages")
                clock.sleep(_AGAIN_S)
                continue
            about = [r for r in reasons if any(word in r for word in _OF_TABLE)]
            clean = 0 if about else clean + 1
            wanted = _ROUNDS_LOSSY if self._session.loss > LOSSY else _ROUNDS
            if clean >= wanted or (clean and reported is not None):
                return self.failure()
            if about and clock.monotonic() > end:
                return about[0]
            clock.sleep(_AGAIN_S if about else 0.0)


def matrix_scripts(texts: Mapping[str, bytes | None]) -> list[str]:
    """Paths of the scripts other than ours that set the matrix, by themselves or by a module they take in."""
    read = {p: d.decode("utf-8", "replace") for p, d in texts.items() if d is not None}
    modules = {
        p.partition("/modules/")[2].removesuffix(".lua")
        for p, t in read.items()
        if "/modules/" in p and matrix_line(t)
    }
    own = (scripts.MATRIX_NAME, scripts.LOADER_NAME)
    return [
        p
        for p, t in sorted(read.items())
        if "/modules/" not in p
        and p.rpartition("/")[2] not in own
        and (matrix_line(t) or modules & set(required_modules(t)))
    ]


def foreign_matrix(texts: Mapping[str, bytes | None]) -> str:
    """Where another script than ours sets the matrix too, in words; "" where none does.

    `texts` are the scripts of a card by path, modules among them.
    """
    own = (scripts.MATRIX_NAME, scripts.LOADER_NAME)
    read = {p: d.decode("utf-8", "replace") for p, d in texts.items() if d is not None}
    wanted = {name for p, t in read.items() if "/modules/" not in p for name in required_modules(t)}
    for path, text in sorted(read.items()):
        name = path.rpartition("/")[2]
        module = path.partition("/modules/")[2].removesuffix(".lua")
        if name in own or (module and module not in wanted):
            continue
        if (found := matrix_line(text)) is not None:
            return (
                f"{path} sets the motors' matrix too (line {found[0]}: {found[1]}), and ArduPilot takes the "
                "first one that runs: take it off the card, or rename it to end otherwise than in .lua"
            )
    return ""
