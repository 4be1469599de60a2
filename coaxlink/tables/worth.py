"""What PX4's tables of one vehicle are worth, side by side: defaults, laws, and the exact law mixed live."""

from __future__ import annotations

from dataclasses import dataclass

from coaxlink.airframe import Airframe
from coaxlink.errors import InputError
from coaxlink.mixer.demands import Commands, law_commands
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.exact.compiled import is_kept
from coaxlink.mixer.fitted import FittedTable, px4_columns
from coaxlink.mixer.worth import HEAVY, LIGHT, Worth, weigh
from coaxlink.tables.default_law import choose_law
from coaxlink.tables.px4 import px4_commands, px4_table, report_px4
from coaxlink.vehicle import Vehicle
from firmware_params import px4
from firmware_params.errors import TableError

DEFAULTS, CURVED, LIVE = "PX4 defaults", "curved", "exact, live"
ON_BOARD = "on board"
DEFAULT_KM = 0.05  # CA_ROTORn_KM as PX4 has it


@dataclass(frozen=True)
class Worths:
    """One vehicle's tables, weighed."""

    rows: tuple[Worth, ...]
    left_out: dict[str, str]  # table: why it cannot be made
    own_curve: float | None  # THR_MDL_FAC of the curved table
    chosen: str = "standard"  # the row that `coaxlink table` writes where no law is named
    fit: FittedTable | None = None  # of the row `fitted`

    def named(self, name: str) -> Worth | None:
        """A row, None where it could not be made."""
        return next((row for row in self.rows if row.name == name), None)

    @property
    def used(self) -> str:
        """The row in use: the board's own where it was read, else what `coaxlink table` writes."""
        return ON_BOARD if self.named(ON_BOARD) else self.chosen

    def serving(self) -> tuple[Worth, ...]:
        """The three that serve: the board's or the standard table, what `table` writes, the exact law."""
        first = ON_BOARD if self.named(ON_BOARD) else "standard"
        second = self.chosen if self.chosen != "standard" else "fitted"
        return tuple(row for row in self.rows if row.name in (first, second, LIVE))


def px4_worths(
    vehicle: Vehicle, *, light: float = LIGHT, heavy: float = HEAVY, board: Commands | None = None
) -> Worths:
    """Every table that PX4 could hold for this vehicle, and the exact law as a companion would mix it.

    `light` and `heavy` are shares of the vehicle's mass, `board` what the board flies now. What cannot be
    made is named, not raised.
    """
    airframe = vehicle.airframe
    tables: dict[str, px4.Px4Table] = {DEFAULTS: default_table(airframe)}
    left_out: dict[str, str] = {}
    chosen, fit = "standard", None
    for law in ("standard", CURVED, "reduced"):
        try:
            tables[law] = px4_table(vehicle, law)
        except InputError as error:
            left_out[law] = str(error)
    try:
        best = choose_law(vehicle, lambda law, fit: px4_commands(report_px4(vehicle, law, fit=fit).mix))
        chosen, fit = best.law, best.fitted
        if best.fit is not None:
            tables[chosen] = px4_columns(airframe, best.fit)
        tables["fitted"] = px4_columns(airframe, fit)
    except InputError as error:
        left_out["fitted"] = str(error)
    commands: dict[str, Commands] = {} if board is None else {ON_BOARD: board}
    for name, table in tables.items():
        try:
            commands[name] = px4_commands(px4.realise(table))
        except (TableError, ValueError) as error:
            left_out[name] = str(error)
    full = float(airframe.wrench(*airframe.loads(vehicle.model, vehicle.full))[0])
    commands[LIVE] = law_commands(ExactLaw(vehicle, compiled=is_kept()), vehicle, full)
    rows = tuple(weigh(vehicle, flown, name, light=light, heavy=heavy) for name, flown in commands.items())
    curved = tables.get(CURVED)
    return Worths(rows, left_out, None if curved is None else curved.thr_mdl_fac, chosen, fit)


def default_table(airframe: Airframe) -> px4.Px4Table:
    """What PX4 flies before it was given a thrust model: places and spins, equal rotors, a straight curve."""
    ct = px4.PARAMETERS["CA_ROTOR0_CT"].default
    rotors = tuple(px4.RotorEntry(r.position_m, r.axis, ct, DEFAULT_KM * r.yaw_sign) for r in airframe.rotors)
    return px4.Px4Table(rotors, px4.PARAMETERS["THR_MDL_FAC"].default)
