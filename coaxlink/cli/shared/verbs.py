"""The verbs in the groups that --help shows them in; the module of one is loaded when it is called."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Iterator, Mapping
from typing import Any

import typer
from typer.core import TyperGroup

from coaxlink.cli.shared.outputs import look_before

GROUPS = {
    "Measure": {
        "init": "Make a vehicle file from a board, a log or a template.",
        "airframe": "Draw a vehicle and say what looks wrong.",
        "identify": "Identify a rotor model from stand logs, or from flights.",
    },
    "Table": {
        "table": "Write a mixer table and say what the firmware makes of it.",
        "compare": "Say what a table is worth to a pilot; weigh all laws.",
    },
    "Board": {
        "upload": "Write a table to the autopilot, with backup and read-back.",
        "verify": "Compare the table on the board with a file, bit for bit.",
        "restore": "Undo an upload from its backup.",
        "motors": "Turn each motor on the bench; say what to change.",
        "bridge": "Write what runs on the autopilot: a PX4 module or a Lua script.",
    },
    "Fly": {
        "mix": "Mix live: answer every demand of the autopilot.",
        "fly": "Fly a plan within limits of its own.",
        "monitor": "Show thrust and split of every arm, live or replayed.",
    },
    "Logs": {
        "refine": "Find what the model lacks in measured data, and add it.",
        "health": "Judge every rotor over one flight or many.",
        "report": "Draw a flight log, or two, as one page.",
    },
    "Study": {
        "demo": "Identify, make tables, upload and fly them side by side.",
        "sim": "Fly a simulated autopilot, or measure a simulated stand.",
        "loop": "Fly, refine, make a new table, fly again.",
        "campaign": "Fly a campaign of simulated flights; stopped, it goes on.",
        "allocate": "Allocate one wrench: speeds, thrusts, torques, and the error.",
        "reproduce": "Recompute what the paper prints.",
        "examples": "List the shipped files, or copy them here.",
    },
}
REPORTED = {verb: words for verbs in GROUPS.values() for verb, words in verbs.items()}


@functools.cache
def load(verb: str) -> Any:
    """A verb as click has it: the function of its module's name. Raises ImportError in a light install."""
    function = getattr(importlib.import_module(f"coaxlink.cli.{verb}"), verb)
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    alone.command(verb, short_help=REPORTED[verb])(function)
    command = typer.main.get_command(alone)
    look_before(command)
    return command


class Loaded(Mapping[str, Any]):
    """Every verb by its name, loaded when it is asked for."""

    def __getitem__(self, verb: str) -> Any:
        if verb not in REPORTED:
            raise KeyError(verb)
        return load(verb)

    def __iter__(self) -> Iterator[str]:
        return iter(REPORTED)

    def __len__(self) -> int:
        return len(REPORTED)

    def __contains__(self, verb: object) -> bool:
        return verb in REPORTED


class Verbs(TyperGroup):
    """The command line: all verbs, none of them loaded."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.commands = Loaded()  # type: ignore[assignment]  # none is added to it

    def list_commands(self, ctx: Any) -> list[str]:
        return list(REPORTED)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        width = max(map(len, REPORTED))
        for group, verbs in GROUPS.items():
            with formatter.section(group):
                formatter.write_dl([(verb.ljust(width), words) for verb, words in verbs.items()])
