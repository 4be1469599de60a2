"""A mixing law as ArduPilot's factors, and what ArduPilot will make of them in the vehicle's own units.

ArduPilot's factors are mixing columns: those of A+, u^2 = A+ mu (Berra, Trujillo and Heredia 2024, eq. 7 and
15), each axis scaled to a largest entry of 0.5 and throttle to 1. The scale of an axis is lost on board and
belongs in the rate gains (ATC_RAT_*).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError
from coaxlink.mixer.demands import Commands
from coaxlink.mixer.fitted import FittedTable, fit_table, px4_columns
from coaxlink.tables.behaviour import Behaviour, behaviour
from coaxlink.tables.default_law import BALANCED, balanced_fit
from coaxlink.tables.px4 import px4_table
from coaxlink.vehicle import Vehicle, refuse_live
from firmware_params import ardupilot as ap
from firmware_params import px4
from firmware_params.ardupilot import scripts
from firmware_params.ardupilot.table import DYNAMIC_MATRIX, SCRIPTING_MATRIX, Factors, expo_for
from firmware_params.errors import Finding, TableError

SPIN_MIN = 0.05  # motors that stop in flight restart badly; 0 would keep every ratio exact
HOVER = (0.125, 0.6875)  # MOT_THST_HOVER: AP_MOTORS_THST_HOVER_MIN and _MAX of AP_MotorsMulticopter.h


@dataclass(frozen=True)
class ApReport:
    """A table, its files, and what ArduPilot and the rotors make of them."""

    law: str
    table: ap.ApTable
    params: dict[str, float]
    scripts: dict[str, str]  # file name -> text
    mix: ap.ApMix
    behaviour: Behaviour
    squared_ratio: tuple[float, ...]  # lower / upper u^2 in hover, one a pair
    columns: px4.Px4Table  # what the factors are the mix of
    findings: tuple[Finding, ...]

    @property
    def blocking(self) -> tuple[Finding, ...]:
        """Findings that forbid flying with this table."""
        return tuple(f for f in self.findings if f.severity == "error")


def ap_factors(vehicle: Vehicle, law: str, table: px4.Px4Table | None = None) -> tuple[Factors, ...]:
    """Factors (N,) of roll, pitch, yaw and throttle, motor n being rotor n. Raises InputError."""
    columns = px4.effectiveness(table or px4_table(vehicle, law))
    matrix = np.stack([columns[0], columns[1], columns[2], -columns[5]])  # per unit u^2
    mixing: NDArray[np.float64] = np.linalg.pinv(matrix)  # (N, 4)
    for axis, largest in ((0, 0.5), (1, 0.5), (2, 0.5), (3, 1.0)):
        top = np.abs(mixing[:, axis]).max()
        if top > 0:
            mixing[:, axis] *= largest / top
    if (mixing[:, 3] <= 0).any():
        problem = (
            f"rotor {int(np.argmin(mixing[:, 3])) + 1} would have to push down: no throttle factor holds that"
        )
        raise InputError(vehicle.airframe.source or vehicle.airframe.name, "rotors", problem)
    return tuple(
        (float(r), float(p), float(y), float(t)) for r, p, y, t in np.where(np.abs(mixing) < 1e-9, 0, mixing)
    )


def report_ap(
    vehicle: Vehicle,
    law: str,
    *,
    frame_class: int = SCRIPTING_MATRIX,
    spin_min: float = SPIN_MIN,
    spin_max: float = 1.0,
    spin_arm: float | None = None,
    expo: float | None = None,
    fit: FittedTable | None = None,
) -> ApReport:
    """The table of a law for ArduPilot with all that is known about its flight. Raises InputError.

    `expo` is MOT_THST_EXPO; without it the one that keeps the law's thrust curve over this spin range.
    `fit` is a fitted table made already for this spin range; `spin_arm` is a little below it if not given.
    """
    refuse_live(vehicle)
    airframe = vehicle.airframe
    source = airframe.source or airframe.name
    if frame_class not in (SCRIPTING_MATRIX, DYNAMIC_MATRIX):
        raise InputError("`frame_class`", str(frame_class), "expected 15 (scripting matrix) or 17 (dynamic)")
    if law == BALANCED and fit is None:

        def speeds_of(law: str, fit: FittedTable | None) -> Commands:
            return ap_commands(report_ap(vehicle, law, spin_min=spin_min, spin_max=spin_max, fit=fit).mix)

        fit = balanced_fit(vehicle, speeds_of, spin_min=spin_min, spin_max=spin_max)
    if law in ("fitted", BALANCED):
        fit = fit or fit_table(vehicle, spin_min=spin_min, spin_max=spin_max)
        columns, expo = px4_columns(airframe, fit), round(fit.curve, 6)
    else:
        columns = px4_table(vehicle, law)
        expo = round(expo_for(columns.thr_mdl_fac, spin_min, spin_max), 4) if expo is None else expo
    factors = ap_factors(vehicle, law, columns)
    arm = max(0.0, round(spin_min - 0.02, 3)) if spin_arm is None else spin_arm
    motor = ap.MotorParameters(thst_expo=expo, spin_min=spin_min, spin_max=spin_max, spin_arm=arm)
    table = ap.ApTable(frame_class, factors, motor, 0)
    try:
        mix = ap.realise(table)
        loaded = scripts.loader_params(factors) if frame_class == DYNAMIC_MATRIX else {}
        title = f"{airframe.name}, {law} law"
        if frame_class == DYNAMIC_MATRIX:
            texts = {scripts.LOADER_NAME: scripts.loader_script()}
        else:
            texts = {scripts.MATRIX_NAME: scripts.matrix_script(factors, title=title)}
    except TableError as error:
        raise InputError(source, "rotors", f"no table for ArduPilot: {error}") from error
    flown = behaviour(vehicle, ap_commands(mix))
    findings = [*mix.warnings, *_hover_findings(flown, airframe.mass_kg * GRAVITY_M_S2)]
    hover = min(max(flown.hover or HOVER[1], HOVER[0]), HOVER[1])
    params = {
        "FRAME_CLASS": float(frame_class),
        "MOT_THST_EXPO": motor.thst_expo,
        "MOT_SPIN_ARM": motor.spin_arm,
        "MOT_SPIN_MIN": motor.spin_min,
        "MOT_SPIN_MAX": motor.spin_max,
        "MOT_THST_HOVER": round(hover, 4),
        "SCR_ENABLE": 1.0,
        "SCR_LD_CHECKSUM": float(scripts.load_checksum(text.encode() for text in texts.values())),
    }
    params |= {f"SERVO{n}_FUNCTION": float(ap.servo_function(n)) for n in range(1, len(factors) + 1)}
    speeds = flown.hover_speeds
    ratios = tuple((speeds[w] / speeds[u]) ** 2 if speeds[u] else float("inf") for u, w in airframe.pairs)
    return ApReport(law, table, params | loaded, texts, mix, flown, ratios, columns, tuple(findings))


def ap_commands(mix: ap.ApMix) -> Commands:
    """Motor commands under an ArduPilot mix: PWM over its calibrated range."""

    def commands(roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        return mix.output(ap.Demand(roll, pitch, yaw, thrust)).actuator

    return commands


def _hover_findings(flown: Behaviour, weight_N: float) -> list[Finding]:
    if flown.hover is None:
        text = (
            f"the vehicle cannot hover: {flown.ceiling_N:.1f} N at full throttle, {weight_N:.1f} N are needed"
        )
        return [Finding("ap.no-hover", "error", text)]
    if not HOVER[0] <= flown.hover <= HOVER[1]:
        text = f"hover needs throttle {flown.hover:.3f}, ArduPilot learns {HOVER[0]}..{HOVER[1]}"
        return [Finding("ap.hover-range", "warning", text)]
    return []
