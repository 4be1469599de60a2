"""`coaxlink reproduce`: the paper's tables and figures against what its own numbers give."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli.shared.shell import JsonOption, console, say


def reproduce(
    no_fly: Annotated[bool, typer.Option("--no-fly", help="Leave Table 4's flights out.")] = False,
    pair: Annotated[
        Path | None,
        typer.Option(metavar="LOG", help="A real stand log of a close pair, for contradiction 11."),
    ] = None,
    markdown: Annotated[
        Path | None, typer.Option(metavar="FILE.md", help="Write the ledger as a page.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Recompute what the paper prints, and each place where it disagrees with itself."""
    from coaxlink import files
    from coaxlink.report import paper
    from coaxlink.studies.paper.reproduction import recompute

    for output in (json_file, markdown):
        files.refuse_unwritable(output)
    ledger = recompute(fly_table_4=not no_fly, pair=pair, tell=say)
    for table in paper.tables(ledger):
        console().print(table)
    if markdown:
        files.write_atomic(markdown, paper.markdown(ledger))
    if json_file:
        files.write_json(json_file, ledger.to_json())
