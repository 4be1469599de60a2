"""A table explained: what the law asks of every rotor, what the firmware will do, and what that is worth.

"Asked" is the law's own A+ (u^2 per N and per N m); "done" is the firmware's mix, each axis scaled back to
physical units by the one factor that fits it best. Where the two differ, the firmware cannot do what the law
asks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.errors import InputError
from coaxlink.link.ap_tables import ApReport, report_ap
from coaxlink.link.asked import nearest, wanted_mix, worst_relative
from coaxlink.link.behaviour import TURNS, Behaviour, behaviour
from coaxlink.link.tables import TableReport, px4_speeds, report_px4
from coaxlink.rotor import RotorModel
from firmware_params import px4
from firmware_params.errors import TableError

AXES = ("roll", "pitch", "yaw", "thrust")


@dataclass(frozen=True)
class Explanation:
    """Asked against done, and this table against another on the same rotors."""

    asked: NDArray[np.float64]  # (N, 4) u^2 per N m (roll, pitch, yaw) and per N (thrust)
    done: NDArray[np.float64]  # (N, 4) the same, as the firmware mixes
    flown: Behaviour
    reference: Behaviour
    reference_name: str
    changed: tuple[tuple[str, float, float], ...] = ()  # parameters that the board has otherwise

    @property
    def worst(self) -> dict[str, float]:
        """Largest difference of done from asked on each axis, relative to the axis's largest entry."""
        return dict(zip(AXES, worst_relative(self.asked, self.done), strict=True))

    def to_json(self) -> dict[str, Any]:
        """The `explain` part of the JSON of `table`."""
        hint = self.flown.gain_hint(self.reference)
        return {
            "axes": list(AXES),
            "asked": self.asked.tolist(),
            "done": self.done.tolist(),
            "worst_relative": self.worst,
            "against": self.reference_name,
            "gain_Nm": {"this": list(self.flown.gain_Nm), "reference": list(self.reference.gain_Nm)},
            "authority_Nm": {
                "this": list(self.flown.authority_Nm),
                "reference": list(self.reference.authority_Nm),
            },
            "ceiling_N": {"this": self.flown.ceiling_N, "reference": self.reference.ceiling_N},
            "gain_scale": {a: h if np.isfinite(h) else None for a, h in zip(TURNS, hint, strict=True)},
            "changed": [{"name": n, "board": a, "new": b} for n, a, b in self.changed],
        }

    def show(self, out: Any, gains: tuple[str, str, str]) -> None:
        """Print it to a rich console."""
        from rich.table import Table

        out.print("asked -> done, 1e-3 u^2 per N m of roll, pitch and yaw, per N of thrust:")
        rows = Table("rotor", *AXES, box=None)
        for n in range(len(self.asked)):
            cells = [
                f"{1e3 * a:+.2f} -> {1e3 * d:+.2f}" for a, d in zip(self.asked[n], self.done[n], strict=True)
            ]
            rows.add_row(str(n + 1), *cells)
        out.print(rows)
        worst = max(self.worst.items(), key=lambda item: item[1])
        out.print(f"largest difference: {worst[1]:.2%} of the largest entry, on {worst[0]}")
        self._show_worth(out, gains)
        for name, board, new in self.changed:
            out.print(f"{name}: {board:.6g} on board, {new:.6g} in this table")

    def _show_worth(self, out: Any, gains: tuple[str, str, str]) -> None:
        from rich.table import Table

        this, other = self.flown, self.reference
        rows = Table("on the rotor model, in hover", "this table", self.reference_name, box=None)
        for n, axis in enumerate(TURNS):
            rows.add_row(f"{axis}: N m per unit demand", f"{this.gain_Nm[n]:.3f}", f"{other.gain_Nm[n]:.3f}")
        for n, axis in enumerate(TURNS):
            rows.add_row(
                f"{axis}: authority, N m", f"{this.authority_Nm[n]:.3f}", f"{other.authority_Nm[n]:.3f}"
            )
        rows.add_row("ceiling, N", f"{this.ceiling_N:.1f}", f"{other.ceiling_N:.1f}")
        rows.add_row("hover demand", _shown(this.hover), _shown(other.hover))
        out.print(rows)
        hints = zip(gains, this.gain_hint(other), strict=True)
        # no gain mends an axis that turns the wrong way
        usable = [f"{gain} x {scale:.3f}" for gain, scale in hints if 0.0 < scale < float("inf")]
        if usable:
            out.print("to keep the loop as it was: " + ", ".join(usable))


def explain_px4(
    airframe: Airframe, model: RotorModel, report: TableReport, board: dict[str, float | int] | None = None
) -> Explanation:
    """Explain a PX4 table against the board's present one, else against the standard law.

    Raises InputError when the board holds no table of this vehicle.
    """
    mixed = np.stack([*report.mix.mix.T[:3], -report.mix.mix[:, 5]], axis=-1)
    asked = wanted_mix(report.table)
    changed: tuple[tuple[str, float, float], ...] = ()
    if board is None:
        reference, name = report_px4(airframe, model, "standard").behaviour, "standard law"
    else:
        try:
            present = px4.realise(board)
        except (TableError, ValueError) as error:
            raise InputError("--connect", "", f"the board holds no multirotor table: {error}") from error
        if len(present.mix) != len(airframe.rotors):
            raise InputError(
                "--connect", "", f"the board has {len(present.mix)} rotors, {airframe.name} another number"
            )
        reference, name = behaviour(airframe, model, px4_speeds(present)), "on board"
        differing = ((n, float(board[n]), float(v)) for n, v in report.params.items() if n in board)
        changed = tuple(row for row in differing if row[1] != row[2])
    return Explanation(asked, nearest(mixed, asked), report.behaviour, reference, name, changed)


def explain_ap(airframe: Airframe, model: RotorModel, report: ApReport) -> Explanation:
    """Explain an ArduPilot table against the standard law on the same frame class."""
    asked = wanted_mix(report.columns)
    standard = report_ap(
        airframe,
        model,
        "standard",
        frame_class=report.table.frame_class,
        spin_min=report.table.parameters.spin_min,
    )
    done = nearest(report.mix.factors, asked)
    return Explanation(asked, done, report.behaviour, standard.behaviour, "standard law")


def present_table(url: str) -> dict[str, float | int]:
    """The table parameters of the board at `url`. Raises LinkError."""
    from coaxlink.link.opening import connect
    from coaxlink.link.parameters import Parameters

    with connect(url) as session:
        found = Parameters(session).read_all().values
    return {name: value.value for name, value in found.items() if name in px4.PARAMETERS}


def _shown(value: float | None) -> str:
    return "none" if value is None else f"{value:.3f}"
