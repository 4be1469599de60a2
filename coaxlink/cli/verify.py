"""`coaxlink verify`: is the table still on board, bit for bit?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli.shared.line import address_of, typed_again, vehicle_at
from coaxlink.cli.shared.next import after_verify
from coaxlink.cli.shared.shell import JsonOption, console, say
from coaxlink.cli.upload import SigningOption, SystemOption, TimeoutOption, VehicleConnectOption
from coaxlink.errors import CheckFailed


def verify(
    connect: VehicleConnectOption = None,
    source: Annotated[
        Path | None, typer.Argument(metavar="[DIR]", help="The table; without it, what was uploaded last.")
    ] = None,
    json_file: JsonOption = None,
    timeout: TimeoutOption = 10.0,
    system: SystemOption = None,
    signing_key: SigningOption = None,
) -> None:
    """Read the table back from the board and compare it bit for bit; exit 1 when it differs."""
    from coaxlink import files
    from coaxlink.cli.shared.rate_loops import kept_airframe
    from coaxlink.uploading.outcome import value_text
    from coaxlink.uploading.plan import load_plan
    from coaxlink.uploading.verify import verify as check

    files.refuse_unwritable(json_file)
    connect = address_of(connect, kept_airframe(source) if source else None)
    plan = load_plan(source) if source else None
    for note in plan.notes if plan else ():
        say(f"note: {note}")
    with vehicle_at(
        connect, timeout_s=timeout, system=system, signing_key=signing_key, station=True
    ) as session:
        result = check(session, plan)
    if json_file:
        files.write_json(json_file, result.to_json())
    out, again = console(), typed_again(connect, system)
    for wrong in result.mismatches:
        found, wanted = (value_text(wrong["name"], wrong[k]) for k in ("found", "wanted"))
        since = f" (written by the upload or restore of {wrong['written']})" if wrong.get("written") else ""
        out.print(f"{wrong['name']}: {wanted} expected, {found} on board{since}")
    for kept in result.kept:
        say(kept)
    for row in result.learned:
        out.print(f"{row['name']}: learned in flight: {row['wanted']:.4g} -> {row['found']:.4g}")
    if result.hash_then and result.hash != result.hash_then:
        out.print(
            f"hash {result.hash:08x}, {result.hash_then:08x} at the upload: since then some other "
            "parameter changed, or others are in use (a restart alone can do that)"
        )
    if result.interrupted:
        raise CheckFailed(
            f"the upload of {result.interrupted} did not end: upload again, or restore its backup"
        )
    if result.mismatches:
        say(after_verify(False, source, again))
        raise CheckFailed(f"{result.counts()} differ from {result.source}")
    if result.unflown:
        say(after_verify(False, source, again))
        raise CheckFailed(f"the table is written, but the board does not fly it: {result.unflown}")
    out.print(f"verified: {result.checked} values as in {result.source}")
    say(after_verify(True, source, again))
