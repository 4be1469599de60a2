"""Where the results of a verb may go: looked at when its line is understood, before anything is computed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from coaxlink import files
from coaxlink.errors import InputError

# options that name what is written, in whichever verb; one is an argument, that of "init"
WRITTEN = {
    "--json", "--out", "out", "--report", "--markdown", "--picture", "--plot", "--next", "--record",
    "--log", "--stand", "--tlog", "--truth-log", "--truth-out",
}  # fmt: skip


def look_before(verb: Any) -> None:
    """Make a verb look at its outputs before it begins."""
    begin = verb.invoke

    def invoke(context: Any) -> Any:
        files.note_reads()
        _refuse(verb.params, context.params)
        return begin(context)

    verb.invoke = invoke


def _refuse(parameters: list[Any], values: dict[str, Any]) -> None:
    """Raises InputError for an output that is no place for a file, is read too, or is named twice."""
    outputs: dict[str, Path] = {}
    inputs: list[Path] = []
    for parameter in parameters:
        value = values.get(parameter.name)
        if not WRITTEN.isdisjoint(parameter.opts):
            if isinstance(value, Path):
                _refuse_output(value, folder=parameter.metavar in ("DIR", "FOLDER"), others=outputs)
        else:
            inputs += _paths(value)
    for path in outputs.values():
        files.refuse_unwritable(path, inputs)


def _refuse_output(path: Path, *, folder: bool, others: dict[str, Path]) -> None:
    if folder:
        if path.exists() and not path.is_dir():
            raise InputError(path, "", "cannot be written (a folder is expected, something else is there)")
        return
    place = os.path.realpath(path)
    if place in others:
        raise InputError(path, "", "two results would go there: name two files")
    others[place] = path


def _paths(value: Any) -> Iterator[Path]:
    """The files that an argument names."""
    if isinstance(value, (list, tuple)):
        for one in value:
            yield from _paths(one)
    elif isinstance(value, (str, Path)) and "\0" not in str(value):
        yield Path(value)
