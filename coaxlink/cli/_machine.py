"""Options of verbs that share work out: processes here, or a Dask cluster."""

from __future__ import annotations

from typing import Annotated

import typer

WorkersOption = Annotated[
    int, typer.Option("--workers", min=0, help="Processes on this machine; 0: one a processor.")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="A Dask scheduler, as tcp://HOST:8786, instead."),
]
