"""`coaxlink identify --single`: a first model of a pair from a table of one rotor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.shell import console, say
from coaxlink.cli.shared.stand import Reading

if TYPE_CHECKING:
    from coaxlink.rotor.prior import Propeller

SingleOption = Annotated[
    Path | None,
    typer.Option(metavar="TABLE", help="No stand: a table of one rotor (T-Motor, APC, UIUC, RCbenchmark)."),
]
PitchOption = Annotated[
    float | None, typer.Option(metavar="M", help="Pitch of the propellers, with --single (5.3 in is 0.135).")
]
SpacingOption = Annotated[
    float | None, typer.Option(metavar="M", help="From disc to disc of the pair, with --single.")
]
BladesOption = Annotated[int, typer.Option(min=1, max=8, help="Blades of a propeller, with --single.")]

# metres: the smallest that lifts a vehicle, the largest on a multirotor; what else is typed is in inches or
# mm
DIAMETERS, PITCH_RATIOS, SPACINGS = (0.03, 2.5), (0.15, 1.2), (0.02, 3.0)


@dataclass(frozen=True)
class Sizes:
    """What the options say of the pair."""

    diameter_m: float | None
    pitch_m: float | None
    spacing_m: float | None
    blades: int

    def propeller(self) -> Propeller:
        """The propeller. Raises InputError for what is missing or is no length in metres."""
        from coaxlink.errors import InputError
        from coaxlink.rotor.prior import Propeller

        for option, value in (("--diameter", self.diameter_m), ("--spacing", self.spacing_m)):
            if value is None:
                raise InputError("--single", option, "needed with it, in metres")
        assert self.diameter_m is not None and self.spacing_m is not None
        _within("--diameter", self.diameter_m, *DIAMETERS)
        _within("--spacing", self.spacing_m, *(s * self.diameter_m for s in SPACINGS))
        if self.pitch_m is not None:
            _within("--pitch", self.pitch_m, *(p * self.diameter_m for p in PITCH_RATIOS))
        return Propeller(self.diameter_m, self.spacing_m, self.pitch_m, self.blades)


def _within(option: str, value: float, low: float, high: float) -> None:
    from coaxlink.errors import InputError

    if not low <= value <= high:
        inches = f" ({value:g} in is {value * 0.0254:.3g} m)" if low <= value * 0.0254 <= high else ""
        raise InputError(option, "", f"{low:.3g} to {high:.3g} m are expected, found {value:g}{inches}")


def prior_of_single(
    table: Path,
    logs: Sequence[Path],
    how: Reading,
    sizes: Sizes,
    speed_max_rpm: float | None,
    out: Path | None,
    json: Path | None,
    plot: Path | None,
) -> None:
    """Print the prior with its intervals and all that was guessed; write it."""
    from coaxlink import files
    from coaxlink.cli.shared.next import after_prior
    from coaxlink.data.single import read_single_table
    from coaxlink.errors import InputError
    from coaxlink.report.prior import picture, prior_table, what_it_says
    from coaxlink.rotor.model import save_rotor_model
    from coaxlink.rotor.prior import pair_prior

    if logs:
        raise InputError("--single", "", f"a table in place of stand logs, found also {logs[0]}")
    if speed_max_rpm is not None and not speed_max_rpm > 0:
        raise InputError("--speed-max-rpm", "", f"more than 0 is expected, found {speed_max_rpm:g}")
    propeller = sizes.propeller()
    read = read_single_table(
        table,
        propeller.diameter_m,
        columns_map=how.columns,
        poles=how.poles,
        sheet=how.sheet,
        trust_units=how.trust_units,
    )
    prior = pair_prior(read, propeller, speed_max_rpm=speed_max_rpm)
    say(f"{read.source}: {len(read.rpm)} rows, {read.origin.words}; no coaxial measurement enters")
    console().print(prior_table(prior))
    for line in what_it_says(prior):
        console().print(line)
    for line in (*read.notes, *prior.guessed):
        say(f"- {line}")
    if out:
        save_rotor_model(out, prior.model)
        say(f"wrote {out}")
    if json:
        files.write_json(json, prior.as_json())
    if plot:
        files.write_atomic(plot / "prior.png", picture(prior))
        say(f"wrote prior.png to {plot}")
    say(after_prior(out))
