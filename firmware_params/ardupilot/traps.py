"""What ArduPilot will do with a table that its author may not expect."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from firmware_params.ardupilot.table import SCRIPTING_MATRIX, ApTable, expo_for
from firmware_params.errors import Finding

_BALANCE = (
    1.0 / 3.0
)  # the thrust-balance check trips in hover where one motor has a third of another's thrust


def findings(table: ApTable, factors: NDArray[np.float64]) -> tuple[Finding, ...]:
    """Findings for a table with its used factors (N, 4)."""
    found = []
    for axis, name in enumerate(("roll", "pitch", "yaw", "throttle")):
        if not np.abs(factors[:, axis]).any():
            found.append(Finding("ap.no-authority", "error", f"no rotor acts on {name}"))
    throttle = factors[:, 3]
    if throttle.max() > 0 and throttle.min() <= _BALANCE * throttle.max():
        text = "the thrust-balance check trips in hover: a throttle factor is a third of the largest or less"
        found.append(Finding("ap.thrust-balance", "warning", text, f"{throttle.min() / throttle.max():.3f}"))
    p = table.parameters
    fair = expo_for(1.0, p.spin_min, p.spin_max)
    if np.ptp(throttle) > 1e-6 and p.thst_expo > fair + 1e-3:
        text = (
            f"MOT_SPIN_MIN bends the ratio between rotors: MOT_THST_EXPO {fair:.3f} keeps it for u^2 rotors"
        )
        evidence = f"MOT_SPIN_MIN = {p.spin_min:g}, MOT_THST_EXPO = {p.thst_expo:g}"
        found.append(Finding("ap.spin-min", "warning", text, evidence))
    if np.ptp(throttle) > 1e-6:
        text = "saturation ignores throttle factors: rotors below 1 can clip on yaw without a limit flag"
        found.append(Finding("ap.silent-clip", "warning", text, f"smallest factor {throttle.min():.3f}"))
    for name, value, low, high in (
        ("MOT_THST_EXPO", p.thst_expo, -1.0, 1.0),
        ("MOT_SPIN_MIN", p.spin_min, 0.0, 0.3),
        ("MOT_SPIN_MAX", p.spin_max, 0.9, 1.0),
        ("MOT_SPIN_ARM", p.spin_arm, 0.0, 1.0),
    ):
        if not low <= value <= high:
            text = f"{name} = {value:g} is outside {low:g}..{high:g}"
            found.append(Finding("ap.out-of-range", "error", text, "ArduPilot stores it unchecked"))
    if table.frame_class == SCRIPTING_MATRIX and np.abs(np.array(table.factors)[:, 3]).max() == 0.0:
        found.append(Finding("ap.no-throttle", "error", "every throttle factor is 0"))
    return tuple(found)
