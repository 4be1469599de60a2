"""What firmware_params raises on purpose; a verb turns these into coaxlink's own errors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from firmware_params.plain import plain


class FirmwareParamsError(Exception):
    """Base; the text is one plain line, whatever a file put into it."""

    def __init__(self, text: str) -> None:
        super().__init__(plain(text))


class TableError(FirmwareParamsError):
    """A table that this firmware cannot hold; the text names the parameter, its value and its limit."""


class ParamsFileError(FirmwareParamsError):
    """A parameter or script file that cannot be read; `line` counts from 1, 0 is the file as a whole."""

    def __init__(self, path: Path | str, line: int, problem: str) -> None:
        self.path, self.line, self.problem = str(path), line, problem
        super().__init__(f"{path}: line {line}: {problem}" if line else f"{path}: {problem}")


@dataclass(frozen=True)
class Finding:
    """Something the firmware will do with a table that its author may not expect."""

    id: str  # stable, e.g. "px4.weak-axis"
    severity: str  # "error": the vehicle must not fly with it; "warning"
    text: str
    evidence: str = ""  # the numbers it rests on

    def __str__(self) -> str:
        return f"{self.id}: {self.text}" + (f" ({self.evidence})" if self.evidence else "")
