"""The mix that PX4 will make of a table: effectiveness, normalised mix, desaturation, thrust curve.

Learnt from PX4's control allocation (v1.16.1 and main of 2026-03) and held to golden vectors of that code.
Controls and rows are [roll, pitch, yaw, thrust x, thrust y, thrust z], FRD; hover is thrust z about -0.4.

1. Effectiveness from the table; an axis whose entries are all within +-0.05 is dropped (the first trap).
2. Mix = pseudo-inverse; roll and pitch are divided by one scale, yaw by its largest entry, thrust by its mean
   magnitude; what is below 1e-3 then becomes 0. Roll and pitch only have a scale if an entry exceeds 1e-3
   before normalising, so a strong, wide vehicle loses both (the second trap).
3. Sequential desaturation without airmode: thrust is lowered, then roll and pitch are given up, then yaw is
   added with 15 % room above full throttle and given up, and thrust is lowered for what remains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_params.errors import Finding, TableError
from firmware_params.px4.parameters import out_of_range
from firmware_params.px4.pseudo_inverse import pseudo_inverse
from firmware_params.px4.table import Px4Table, params_to_table, table_to_params

AXES = ("roll", "pitch", "yaw", "thrust_x", "thrust_y", "thrust_z")
ROLL, PITCH, YAW, THRUST_Z = 0, 1, 2, 5
WEAK_AXIS = 0.05
SMALL_MIX = 1e-3
WEAK_ACTUATOR = 0.2  # an entry below this is not used to get out of saturation
YAW_MARGIN = 0.15
FLT_EPSILON = float(np.finfo(np.float32).eps)

_Floats = NDArray[np.float32]
_Pull = tuple[_Floats, tuple[tuple[int, float], ...]]  # a mix column; its entries strong enough to use


@dataclass(frozen=True)
class Px4Mix:
    """What PX4 makes of a table. `setpoints` and `throttle` are pure and count in float32, as PX4 does."""

    effectiveness: NDArray[np.float64]  # (6, N) after dropping weak axes
    mix: NDArray[np.float64]  # (N, 6) normalised
    scale: NDArray[np.float64]  # (6,) what each column of the pseudo-inverse was divided by
    thr_mdl_fac: float
    method: int
    airmode: int
    warnings: tuple[Finding, ...]
    _columns: _Floats = field(init=False, repr=False, compare=False)  # (6, N)
    _pulls: tuple[_Pull, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        columns = np.ascontiguousarray(self.mix.T, np.float32)
        pulls = []
        for column in columns:
            strong = [(i, c) for i, c in enumerate(column.tolist()) if abs(c) >= WEAK_ACTUATOR]
            pulls.append((column, tuple(strong)))
        object.__setattr__(self, "_columns", columns)
        object.__setattr__(self, "_pulls", tuple(pulls))

    def setpoints(self, control: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Motor setpoints (N,) in 0..1 for a control (6,): mixing, desaturation, clipping."""
        parts = self._columns * np.asarray(control, np.float32)[:, None]
        if self.method == 0 or self.airmode == 2:
            sp = parts[0] + parts[1] + parts[2] + parts[3] + parts[4] + parts[5]
            if self.method != 0:
                _desaturate(sp, self._pulls[THRUST_Z])
                _desaturate(sp, self._pulls[YAW])
        else:
            sp = parts[0] + parts[1] + parts[3] + parts[4] + parts[5]
            self._desaturate_without_yaw(sp)
            sp += parts[2]
            _desaturate(sp, self._pulls[YAW], ceiling=1.0 + YAW_MARGIN)
            _desaturate(sp, self._pulls[THRUST_Z], reduce_only=True)
        return np.minimum(np.maximum(sp, 0.0), 1.0).astype(np.float64)

    def throttle(self, setpoints: ArrayLike) -> NDArray[np.float64]:
        """Motor commands (..., N) after the thrust curve: the u with fac u^2 + (1 - fac) u = setpoint."""
        sp = np.asarray(setpoints, float)
        if not 0.0 < self.thr_mdl_fac <= 1.0:
            return sp.copy()
        half = (1.0 - self.thr_mdl_fac) / (2.0 * self.thr_mdl_fac)
        curved = np.sqrt(half * half + np.maximum(sp, 0.0) / self.thr_mdl_fac) - half
        return np.where(sp > FLT_EPSILON, curved, sp)

    def wrench(self, motor: ArrayLike) -> NDArray[np.float64]:
        """Wrench (..., 4), thrust up N, roll, pitch, yaw N m, that the table means by commands (..., N).

        PX4 takes rotor thrust as CT times its set-point s = fac u^2 + (1 - fac) u.
        """
        u, factor = np.asarray(motor, float), self.thr_mdl_fac
        rows = self.effectiveness @ np.moveaxis(factor * u**2 + (1.0 - factor) * u, -1, 0)
        return np.moveaxis(np.stack([-rows[THRUST_Z], rows[ROLL], rows[PITCH], rows[YAW]]), 0, -1)

    def _desaturate_without_yaw(self, sp: _Floats) -> None:
        if self.airmode == 1:
            _desaturate(sp, self._pulls[THRUST_Z])
        else:
            _desaturate(sp, self._pulls[THRUST_Z], reduce_only=True)
            _desaturate(sp, self._pulls[ROLL])
            _desaturate(sp, self._pulls[PITCH])


def _gain(sp: _Floats, pull: _Pull, ceiling: float) -> float:
    """How far along a mix column the worst over- and undershoot lie, added."""
    values = sp.tolist()
    if min(values) >= 0.0 and max(values) <= ceiling:
        return 0.0
    low = high = 0.0
    for i, entry in pull[1]:
        s = values[i]
        if s < 0.0:
            k = -s / entry
        elif s > ceiling:
            k = (ceiling - s) / entry
        else:
            continue
        if k < low:
            low = k
        elif k > high:
            high = k
    return float(np.float32(low) + np.float32(high))


def _desaturate(sp: _Floats, pull: _Pull, *, ceiling: float = 1.0, reduce_only: bool = False) -> None:
    """Shift `sp` along a column, a full step and a half one. The thrust column is negative: a positive step
    lowers thrust, which is all that `reduce_only` allows."""
    for share in (1.0, 0.5):
        gain = _gain(sp, pull, ceiling)
        if gain == 0.0 or (share == 1.0 and reduce_only and gain < 0.0):
            return
        sp += np.float32(share * gain) * pull[0]


def realise(source: Mapping[str, float | int] | Px4Table) -> Px4Mix:
    """The mix of a table or of parameters. Raises TableError when PX4 could not fly it at all."""
    table = source if isinstance(source, Px4Table) else params_to_table(source)
    params = table_to_params(table)
    findings = out_of_range(params)
    if any(f.id == "px4.not-finite" for f in findings):
        raise TableError(findings[0].text)
    stored = params_to_table(params)
    full = effectiveness(stored)
    cut = full.copy()
    for n, axis in enumerate(AXES):
        largest = float(np.abs(full[n]).max())
        if largest <= WEAK_AXIS and largest > 0.0:
            cut[n] = 0.0
            findings.append(_weak_axis(axis, largest))
        elif largest == 0.0 and n in (ROLL, PITCH, YAW, THRUST_Z):
            findings.append(Finding("px4.no-authority", "error", f"no rotor acts on {axis}"))
    mix, scale = _normalised(pseudo_inverse(cut.astype(np.float32)))
    findings += _dropped_mix(cut, mix)
    if table.reversible:
        note = "reversible motors (CA_R_REV) are mixed here as one-way ones"
        findings.append(Finding("px4.reversible", "warning", note, f"CA_R_REV = {table.reversible}"))
    return Px4Mix(
        cut,
        mix.astype(np.float64),
        scale.astype(np.float64),
        stored.thr_mdl_fac,
        table.method,
        table.airmode,
        tuple(findings),
    )


def effectiveness(table: Px4Table) -> NDArray[np.float64]:
    """(6, N) moments and forces of each rotor at setpoint 1, before weak axes are dropped."""
    columns = np.zeros((6, len(table.rotors)))
    for n, rotor in enumerate(table.rotors):
        axis, position = np.array(rotor.axis, np.float32), np.array(rotor.position_m, np.float32)
        norm = np.sqrt(axis @ axis)
        ct, km = np.float32(rotor.ct), np.float32(rotor.km)
        if norm <= FLT_EPSILON or abs(ct) < FLT_EPSILON:
            continue  # PX4 leaves such a rotor out
        axis = axis * (np.float32(1.0) / norm)
        columns[:3, n] = ct * np.cross(position, axis) - ct * km * axis
        columns[3:, n] = ct * axis
    return columns


def _normalised(mix: _Floats) -> tuple[_Floats, _Floats]:
    scale = np.ones(6, np.float32)
    rms = []
    for column in (mix[:, ROLL], mix[:, PITCH]):
        counted = int((np.abs(column) > SMALL_MIX).sum())
        rms.append(np.sqrt(_dot(column, column) / np.float32(counted / 2.0)) if counted else np.float32(1.0))
    scale[ROLL] = scale[PITCH] = max(rms)
    scale[YAW] = max(
        mix[:, YAW].max(), np.float32(0.0)
    )  # PX4's column also holds actuators that are not there
    for n in (THRUST_Z, 4, 3):
        size = np.abs(mix[:, n])
        counted = int((size > FLT_EPSILON).sum())
        scale[n] = _dot(size, np.ones_like(size)) / np.float32(counted) if counted else scale[THRUST_Z]
    if scale[YAW] <= FLT_EPSILON:
        scale[YAW] = 1.0
    if scale[3] <= FLT_EPSILON:
        scale[3:] = 1.0
    normalised = mix * (np.float32(1.0) / scale)
    normalised[np.abs(normalised) < SMALL_MIX] = 0.0
    return normalised, scale


def _dot(a: _Floats, b: _Floats) -> np.float32:
    total = np.float32(0.0)
    for product in a * b:
        total = total + product  # one after the other: the order decides the last bits
    return total


def _weak_axis(axis: str, largest: float) -> Finding:
    severity = "error" if axis in ("roll", "pitch", "yaw", "thrust_z") else "warning"
    text = f"PX4 drops {axis}: no rotor's effectiveness on it exceeds {WEAK_AXIS}"
    return Finding("px4.weak-axis", severity, text, f"largest {largest:.4g}; scale every CT up")


def _dropped_mix(cut: NDArray[np.float64], mix: _Floats) -> list[Finding]:
    found = []
    for n in (ROLL, PITCH, YAW, THRUST_Z):
        if cut[n].any() and not mix[:, n].any():
            text = f"PX4 zeroes {AXES[n]}: every entry of its mix is below {SMALL_MIX} before normalising"
            evidence = f"largest effectiveness {np.abs(cut[n]).max():.4g}; scale every CT down"
            found.append(Finding("px4.small-mix", "error", text, evidence))
    return found
