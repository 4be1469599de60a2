"""`coaxlink identify` of logs whose cell reads both rotors together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from coaxlink.cli.shared.shell import console, say
from coaxlink.errors import CheckFailed

if TYPE_CHECKING:
    from coaxlink.data import Samples
    from coaxlink.rotor.stand_data import Speeds


def answer_of_sums(
    logs: Sequence[Samples], speed_max_rpm: float | None, out: Path | None, json: Path | None
) -> None:
    """Print the model of each sum, what it leaves open and the run that tells it.

    Raises CheckFailed where a rotor file is wanted of them.
    """
    from coaxlink import files
    from coaxlink.rotor.identification import CORRELATED
    from coaxlink.rotor.pair_sum import OPEN, pair_sum
    from coaxlink.rotor.stand_data import unit_of

    found = [pair_sum(log, speed_max_rpm) for log in logs]
    for one in found:
        say(f"{one.samples.source}: {one.samples.rows} rows, both rotors on one cell")
        table = Table("sum", "term", "value", "95 % interval", "held-out RMSE", title="both rotors together")
        for name, fit in one.fits.items():
            error = one.errors[name]
            said = f"{error.rmse:.3g} {unit_of(name)}, {100 * error.nrmse:.2g} % of the range"
            for term, value in fit.polynomial.terms().items():
                low, high = fit.intervals.bounds.get(term, (float("nan"),) * 2)
                table.add_row(name, term, f"{value:.4g}", f"{low:.4g} .. {high:.4g}", said)
                name = said = ""
        console().print(table)
        notes = [_full_speed(one.speeds), *one.samples.notes]
        if abs(one.speeds.correlation()) > CORRELATED:
            notes.insert(0, "both speeds go together: the sum is known along that line alone")
        for note in notes:
            say(f"- {note}")
    if json:
        answers = [one.as_json() for one in found]
        files.write_json(json, answers[0] if len(answers) == 1 else {"logs": answers})
    for line in OPEN:
        say(line)
    if out:
        raise CheckFailed(f"{out} is not written: a rotor file holds the loads of each rotor")


def _full_speed(speeds: Speeds) -> str:
    """What u = 1 is."""
    full = "full throttle" if speeds.from_throttle else f"{speeds.speed_max_rpm:.0f} rpm"
    return f"u = 1 is {full} ({speeds.source})"
