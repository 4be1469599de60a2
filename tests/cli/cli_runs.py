"""The command line in this process: what it prints, and its exit code."""

import contextlib
import io
from dataclasses import dataclass

from coaxlink.cli import main


@dataclass(frozen=True)
class Run:
    """One command line."""

    code: int
    out: str
    err: str


def coaxlink(*arguments):
    """Run `coaxlink ARGUMENTS...`."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main([str(a) for a in arguments])
        except SystemExit as ended:
            return Run(int(ended.code or 0), out.getvalue(), err.getvalue())
    raise AssertionError("main() does not return")
