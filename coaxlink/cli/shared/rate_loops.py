"""What an upload does to the rate loops, said first: the table against the board's, on the same rotors."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from coaxlink import files
from coaxlink.cli.shared.shell import PIPE_WIDTH, console, say
from coaxlink.errors import CoaxlinkError, InputError
from firmware_params.keys import unknown_key

if TYPE_CHECKING:
    from coaxlink.mixer.demands import Commands
    from coaxlink.uploading.plan import Plan
    from coaxlink.vehicle import Vehicle

# gain margins of rate loops are 6 dB or more (a factor of 2, MIL-DTL-9490E), of which tuning leaves a part
ASKED = 0.2
FOLDER = "vehicle"  # of a table's folder: what it was made from
_AIRFRAME, _ROTORS, _CONDITIONS = "airframe.toml", "rotor.toml", "conditions.toml"
Present = Callable[[Mapping[str, float | int], Mapping[str, bytes | None]], None]


def vehicle_files(vehicle: Vehicle, rotor_file: Path) -> dict[str, bytes]:
    """What a table was made from, by its name in the table's folder; empty where no file holds it."""
    if vehicle.declared.source is None:
        return {}
    copies = {_AIRFRAME: vehicle.declared.source.read_bytes(), _ROTORS: rotor_file.read_bytes()}
    stated = {name: value for name, value in vars(vehicle.conditions).items() if value is not None}
    if stated:
        copies[_CONDITIONS] = files.toml_text(stated).encode()
    return {f"{FOLDER}/{name}": data for name, data in copies.items()}


def kept_airframe(source: Path) -> Path | None:
    """The airframe file that a table's folder keeps, None where it keeps none."""
    path = (source if source.is_dir() else source.parent) / FOLDER / _AIRFRAME
    return path if path.is_file() else None


def forget_vehicle(out: Path, kept: Container[str]) -> None:
    """Take away what an earlier table was made from, but for the files `kept`: it is not this one's."""
    for name in (_AIRFRAME, _ROTORS, _CONDITIONS):
        if f"{FOLDER}/{name}" not in kept:
            (out / FOLDER / name).unlink(missing_ok=True)


def reported_first(source: Path, plan: Plan, doubts: list[str], *, spin_from_table: bool = False) -> Present:
    """What `Talk.present` does for a table's folder: its price beside the table on board, in three lines, and
    one on the rate loops. What is to be asked about goes into `doubts`."""
    airframe = kept_airframe(source)

    def present(board: Mapping[str, float | int], on_board: Mapping[str, bytes | None]) -> None:
        from coaxlink.mixer.worth import weigh
        from coaxlink.report.worth import price
        from coaxlink.tables.behaviour import behaviour
        from coaxlink.tables.rate_gains import preserved_gains

        if airframe is None:
            return
        try:
            vehicle = _vehicle(airframe.parent)
            mixes = _mixes(plan, board, on_board, spin_from_table)
            old, new = (behaviour(vehicle, speeds) for speeds in mixes)
            before, after = (weigh(vehicle, speeds) for speeds in mixes)
        except CoaxlinkError as error:
            say(f"what this costs and does to the rate loops is not known: {error}")
            return
        gains = preserved_gains(plan.firmware, new, old, board, "on board", write=False)
        in_table = any(name in plan.params for gain in gains.axes for name in gain.names)
        line = gains.line.partition(";")[0] if in_table else gains.line
        out = console()
        for text in price(after, before, "on board"):
            out.print(text, soft_wrap=out.width >= PIPE_WIDTH)
        kept = "; gains that keep the loops are in the table" if in_table else ""
        out.print(line + kept, soft_wrap=out.width >= PIPE_WIDTH)
        yaw = gains.axes[2]
        if not in_table and (not yaw.usable or abs(1.0 / yaw.scale - 1.0) > ASKED):
            times = f"{1.0 / yaw.scale:.2f} times" if yaw.usable else "none, or the opposite, of"
            doubts.append("yaw")
            keep = "tune it anew, or keep it by coaxlink table --keep-gains"
            say(f"a demand of yaw will give {times} the moment that it gives now: {keep}")

    return present


def _vehicle(folder: Path) -> Vehicle:
    from coaxlink.vehicle import Conditions, load_vehicle

    stated = folder / _CONDITIONS
    read = files.read_toml(stated) if stated.is_file() else {}
    if odd := unknown_key(read, Conditions.__dataclass_fields__):
        raise InputError(stated, odd[0], odd[1])
    known = {k: float(v) for k, v in read.items()}
    return load_vehicle(folder / _AIRFRAME, folder / _ROTORS, Conditions(**known))


def _mixes(
    plan: Plan,
    board: Mapping[str, float | int],
    on_board: Mapping[str, bytes | None],
    spin_from_table: bool,
) -> list[Commands]:
    """The board's table and the plan's, as it will fly there. Raises CheckFailed where one is not known."""
    from coaxlink.errors import CheckFailed
    from coaxlink.tables.ardupilot import ap_commands
    from coaxlink.tables.px4 import px4_commands
    from coaxlink.uploading.ardupilot_table import planned_table, present_table
    from coaxlink.uploading.owners_numbers import for_board
    from firmware_params import ardupilot, px4
    from firmware_params.ardupilot import scripts
    from firmware_params.errors import FirmwareParamsError

    try:
        if plan.firmware == "px4":
            tables = [px4.realise(params) for params in (board, {**board, **plan.params})]
            _refuse_other_count(*(len(table.mix) for table in tables))
            return [px4_commands(table) for table in tables]
        held = next((d for p, d in on_board.items() if p.endswith(scripts.MATRIX_NAME)), None)
        made = for_board(plan.params, board, spin_from_table=spin_from_table).params
        old, new = present_table(board, lambda: held), planned_table({**board, **made}, plan.scripts)
        if old is None or new is None:
            frame = board.get("FRAME_CLASS", 0)
            raise CheckFailed(
                f"the board flies a matrix that is not known to coaxlink (FRAME_CLASS {frame:g})"
            )
        mixes = [ardupilot.realise(table) for table in (old, new)]
        _refuse_other_count(*(len(mix.factors) for mix in mixes))
        return [ap_commands(mix) for mix in mixes]
    except (FirmwareParamsError, ValueError, IndexError) as error:
        raise CheckFailed(str(error)) from error


def _refuse_other_count(now: int, new: int) -> None:
    from coaxlink.errors import CheckFailed

    if now != new:
        raise CheckFailed(f"the board flies {now} rotors now, the table has {new}")
