"""A mixing law as PX4's table, and what PX4 will make of it in the vehicle's own units.

PX4's table is one column a rotor: CT * axis and CT * (position x axis) - CT * KM * axis. The reduced coaxial
mixer (Berra, Trujillo and Heredia 2024, eq. 7 and 15) fits it exactly: an upper rotor's CT is p~_u = p_0u +
p_1l, its KM the torque of both rotors of the pair per u_u^2 over that thrust.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.mixer import reduced_coefficients, standard_coefficients
from coaxlink.mixer.demands import ENVELOPE, Commands
from coaxlink.mixer.fitted import FittedTable, fit_table, px4_columns
from coaxlink.mixer.worth import solve
from coaxlink.tables import TABLE_LAWS
from coaxlink.tables.behaviour import TURNS, Behaviour, behaviour
from coaxlink.tables.default_law import BALANCED, balanced_fit
from coaxlink.vehicle import Vehicle, refuse_live
from firmware_params import px4
from firmware_params.errors import Finding, TableError

ROTOR_MODEL = "rotor model"  # source of an error that its numbers are the cause of
_AXES = (*TURNS, "thrust")
_LEAN_SHARE = 0.02  # of the largest entry of an axis: less of an error is not named
DEFAULT_CT = px4.PARAMETERS["CA_ROTOR0_CT"].default  # of every PX4 on whose rotors nobody set any
# of what a flight shows, judgement: motors, packs and propellers of one kind are far nearer
LEAST_CT, MOST_CT = 0.4, 2.5
_LEVEL = np.linspace(*ENVELOPE, 12)  # of the weight: the envelope's thrusts


@dataclass(frozen=True)
class PairSplit:
    """How a coaxial pair shares the work in pure thrust."""

    upper: int  # rotor numbers of the airframe
    lower: int
    squared_ratio: float  # lower / upper u^2, before the thrust curve bends it: that of the setpoints
    hover: tuple[float, float]  # normalised speeds in hover


@dataclass(frozen=True)
class TableReport:
    """A table, its parameters, and what PX4 and the rotors make of them."""

    law: str
    table: px4.Px4Table
    params: dict[str, float | int]  # the table and MPC_THR_HOVER
    mix: px4.Px4Mix
    splits: tuple[PairSplit, ...]
    behaviour: Behaviour  # on the rotor model
    hover_thrust_table: float  # thrust setpoint of hover if the rotors were what the table says
    ceiling_N: float  # thrust by the table's own numbers at thrust setpoint 1
    full_N: float  # thrust by the table's numbers with every rotor at 1
    findings: tuple[Finding, ...]

    @property
    def blocking(self) -> tuple[Finding, ...]:
        """Findings that forbid flying with this table."""
        return tuple(f for f in self.findings if f.severity == "error")


def px4_table(vehicle: Vehicle, law: str) -> px4.Px4Table:
    """The table of a law, rotors in the airframe's numbering (motor n is CA_ROTOR n-1).

    Raises InputError on an unknown law and on an airframe that PX4 cannot hold.
    """
    refuse_live(vehicle)
    airframe, model = vehicle.airframe, vehicle.model
    if law not in TABLE_LAWS:
        raise InputError("`law`", law, f"no table holds this law; expected one of {', '.join(TABLE_LAWS)}")
    if law == "fitted":
        return px4_columns(airframe, fit_table(vehicle))
    if law == BALANCED:
        fit = balanced_fit(vehicle, lambda law, fit: px4_commands(report_px4(vehicle, law, fit=fit).mix))
        return px4_columns(airframe, fit)
    if law == "curved":
        plain = px4_table(vehicle, "standard")
        return dataclasses.replace(plain, thr_mdl_fac=own_curve(vehicle, plain))
    count = len(airframe.rotors)
    ct, torque = np.zeros(count), np.zeros(count)  # N and N m along the axis, per unit setpoint
    spin = np.array([rotor.yaw_sign for rotor in airframe.rotors], float)
    f, q = airframe.gains
    if law == "standard":
        alone = standard_coefficients(model, of_commands=True)
        ct[:], torque[:] = alone.p * f, alone.q * q * spin
    else:
        c = reduced_coefficients(model, of_commands=True)
        for upper, lower in airframe.pairs:
            ct[upper], ct[lower] = c.p_0u * f[upper] + c.p_1l * f[lower], c.p_0l * f[lower]
            torque[upper] = spin[upper] * c.q_0u * q[upper] + spin[lower] * c.q_1l * q[lower]
            torque[lower] = spin[lower] * c.q_0l * q[lower]
        for single in airframe.singles:
            ct[single], torque[single] = c.p_0u * f[single], spin[single] * c.q_0u * q[single]
    if (ct <= 0).any():
        worst = int(np.argmin(ct))
        problem = (
            f"the {law} law gives rotor {worst + 1} {ct[worst]:.4g} N per u^2: a positive thrust is expected"
        )
        raise InputError(ROTOR_MODEL, "", problem)
    rotors = tuple(
        px4.RotorEntry(rotor.position_m, rotor.axis, float(ct[n]), float(torque[n] / ct[n]))
        for n, rotor in enumerate(airframe.rotors)
    )
    return px4.Px4Table(rotors, 1.0)


def own_curve(vehicle: Vehicle, table: px4.Px4Table) -> float:
    """The THR_MDL_FAC that makes a table's level thrust most nearly proportional to the demand, 0..1.

    Over the envelope's thrusts; the table's columns stay as they are.
    """
    from scipy.optimize import minimize_scalar  # scipy takes a third of a second to load

    airframe, model = vehicle.airframe, vehicle.model
    share = -px4.realise(table).mix[:, 5]
    level = _LEVEL * airframe.mass_kg * GRAVITY_M_S2
    demand = np.linspace(0.02, 1.0 / max(float(share.max()), 1e-6), 80)

    def misfit(curve: float) -> float:
        mix = px4.realise(dataclasses.replace(table, thr_mdl_fac=curve))
        u = np.clip(mix.throttle(demand[:, None] * share), 0.0, 1.0)
        lift = airframe.wrench(*airframe.loads(model, vehicle.turned(u)))[..., 0]
        if lift[-1] < level[0]:
            return float("inf")
        wanted = np.clip(level, lift[0], lift[-1])
        at = np.interp(wanted, lift, demand)
        gain = float(wanted @ at) / float(at @ at)
        return float(np.mean((wanted - gain * at) ** 2))

    found = minimize_scalar(misfit, bounds=(0.01, 1.0), method="bounded", options={"xatol": 1e-3})
    return round(float(found.x), 2)


def report_px4(vehicle: Vehicle, law: str, *, fit: FittedTable | None = None) -> TableReport:
    """The table of a law with all that is known about its flight. Raises InputError.

    `fit` is a fitted table made already (`TableFit.with_margins`).
    """
    refuse_live(vehicle)
    table = px4_columns(vehicle.airframe, fit) if fit else px4_table(vehicle, law)
    return assess_px4(vehicle, law, table)


def assess_px4(vehicle: Vehicle, law: str, table: px4.Px4Table) -> TableReport:
    """What PX4 makes of `table` on this vehicle. Raises InputError."""
    refuse_live(vehicle)
    airframe = vehicle.airframe
    source = airframe.source or airframe.name
    try:
        params = px4.table_to_params(table)
        mix = px4.realise(table)
    except (TableError, ValueError) as error:
        raise InputError(source, "rotors", f"PX4 cannot hold this table: {error}") from error
    weight = airframe.mass_kg * GRAVITY_M_S2
    ct = np.array([rotor.ct for rotor in px4.params_to_table(params).rotors])
    up = -np.array([rotor.axis[2] for rotor in airframe.rotors])
    findings = list(mix.warnings)
    flown = behaviour(vehicle, px4_commands(mix))
    by_table = solve(lambda t: float(ct * up @ mix.setpoints(_thrust(t))), weight)
    findings += _hover_findings(flown, weight)
    findings += _lean_findings(table, mix, law)
    findings += _reversed_findings(flown, law)
    limits = px4.PARAMETERS["MPC_THR_HOVER"]
    hover = limits.maximum if flown.hover is None else flown.hover
    params["MPC_THR_HOVER"] = px4.as_stored(
        "MPC_THR_HOVER", round(min(max(hover, limits.minimum), limits.maximum), 3)
    )
    speeds = flown.hover_speeds
    share = -mix.mix[:, 5]
    splits = tuple(
        PairSplit(
            u + 1, w + 1, float(share[w] / share[u]) if share[u] else float("inf"), (speeds[u], speeds[w])
        )
        for u, w in airframe.pairs
    )
    return TableReport(
        law,
        table,
        params,
        mix,
        splits,
        flown,
        1.0 if by_table is None else by_table,
        float(ct * up @ mix.setpoints(_thrust(1.0))),
        float(ct @ up),
        tuple(findings),
    )


def refuse_traps(report: TableReport) -> None:
    """Raise SafetyRefusal when a finding forbids flying with the table."""
    if report.blocking:
        raise SafetyRefusal(str(report.blocking[0]))


def px4_commands(mix: px4.Px4Mix) -> Commands:
    """Motor commands under a PX4 mix: setpoints, then the thrust curve."""

    def commands(roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        return mix.throttle(mix.setpoints([roll, pitch, yaw, 0.0, 0.0, -thrust]))

    return commands


def not_in_newtons(parameters: Mapping[str, float], meant_N: float, thrust_N: float) -> str:
    """Why the CA_ROTORn_CT on board are no newtons, where a flight shows it; "" where they may be.

    A table means `meant_N` by the commands of a vehicle that makes `thrust_N`; no specimen of the rotors that
    were measured makes 2.5 times, nor 0.4 times, what was measured.
    """
    given = [v for n, v in parameters.items() if re.fullmatch(r"CA_ROTOR\d+_CT", n)]
    if given and all(ct == DEFAULT_CT for ct in given):
        return f"the CT on board are not in newtons: PX4's default, {DEFAULT_CT:g}"
    if thrust_N > 1.0 and not LEAST_CT < meant_N / thrust_N < MOST_CT:
        return f"the CT on board are not in newtons ({meant_N:.0f} N for {thrust_N:.0f} N)"
    return ""


def _hover_findings(flown: Behaviour, weight_N: float) -> list[Finding]:
    limits = px4.PARAMETERS["MPC_THR_HOVER"]
    if flown.hover is None:
        text = f"no hover: {flown.ceiling_N:.1f} N at full thrust setpoint, {weight_N:.1f} N are needed"
        return [Finding("px4.no-hover", "error", text)]
    if not limits.minimum <= flown.hover <= limits.maximum:
        text = (
            f"hover needs thrust setpoint {flown.hover:.3f}, PX4 takes {limits.minimum:g}..{limits.maximum:g}"
        )
        return [Finding("px4.hover-range", "warning", text)]
    return []


def _lean_findings(table: px4.Px4Table, mix: px4.Px4Mix, law: str) -> list[Finding]:
    """PX4's pseudo-inverse holds six axes: where rotors lean, it also forbids every sideways force."""
    mixed = np.stack([*mix.mix.T[:3], -mix.mix[:, 5]], axis=-1)
    demanded = wanted_mix(table)
    worst = worst_relative(demanded, nearest(mixed, demanded))
    if max(worst) <= _LEAN_SHARE or not np.abs(mix.effectiveness[3:5]).any():
        return []
    text = "the table's rotors lean, and PX4 spends them on holding the sideways force at zero as well"
    if law != "fitted":
        text += "; `law` fitted makes a table for that"
    shares = ", ".join(f"{axis} {share:.0%}" for axis, share in zip(_AXES, worst, strict=True))
    return [Finding("px4.leaning-axes", "warning", text, f"off what the law demands by {shares}")]


def _reversed_findings(flown: Behaviour, law: str) -> list[Finding]:
    """A loop closed over a gain of the wrong sign falls over."""
    found = []
    for axis, gain in zip(TURNS, flown.gain_Nm, strict=True):
        if gain <= 0.0:
            text = f"a {axis} demand turns the vehicle the other way, or not at all"
            if law != "fitted":
                text += "; try `law` fitted"
            evidence = f"{gain:+.3f} N m per unit demand in hover, on the rotor model"
            found.append(Finding("px4.reversed-axis", "error", text, evidence))
    return found


def _thrust(setpoint: float) -> list[float]:
    return [0.0, 0.0, 0.0, 0.0, 0.0, -setpoint]


def wanted_mix(table: px4.Px4Table) -> NDArray[np.float64]:
    """(N, 4) A+ of a table: u^2 per N m of roll, pitch and yaw and per N of thrust."""
    columns = px4.effectiveness(table)
    matrix = np.stack([columns[0], columns[1], columns[2], -columns[5]])
    return np.asarray(np.linalg.pinv(matrix), np.float64)


def nearest(mixed: NDArray[np.float64], demanded: NDArray[np.float64]) -> NDArray[np.float64]:
    """Each column of `mixed` times the one number that brings it nearest to `demanded`."""
    power = (mixed**2).sum(axis=0)
    scale = np.divide((mixed * demanded).sum(axis=0), power, out=np.zeros(mixed.shape[1]), where=power > 0)
    return mixed * scale


def worst_relative(demanded: NDArray[np.float64], done: NDArray[np.float64]) -> tuple[float, ...]:
    """Largest difference of `done` from `demanded` on each axis, relative to the axis's largest entry."""
    scale = np.abs(demanded).max(axis=0)
    error = np.abs(done - demanded).max(axis=0)
    return tuple(float(e / s) if s else float(e) for e, s in zip(error, scale, strict=True))
