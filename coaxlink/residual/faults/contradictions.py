"""Columns of a flight that the rest of the log contradicts, whatever the rotors do.

Kinematics alone: a height that stands still while the vertical velocity climbs, or goes the other way, or in
feet; a
velocity whose sign the accelerometers deny, or an accelerometer whose sign the velocity denies; a mean
specific force that the velocity would have run away with; and a supply of more volts than any vehicle has.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.data.logs.flight import MOTOR
from coaxlink.data.samples import Samples
from coaxlink.frames import GRAVITY_NED, Array
from coaxlink.residual.faults.repeated_readings import Finding, flying_rows, held_rows, windows
from coaxlink.residual.faults.states import Mask, runs_of

# of an accelerometer that was never calibrated a data sheet has 3 % of scale (MPU-6000), and 2 % for its zero
ACCEL_SHARE = 0.05
ACCEL_S, PIECES, SIGMAS = 2.0, 8, 4.0  # windows; parts of the flight left out in turn, as for a gyro's scale
CLIMB_M, CLIMB_M_S = 1.0, 0.3  # judgement: a height's own wander; what a vertical velocity is off by
UNITS = (
    0.1,
    2.0,
)  # judgement: a foot is 0.3 m, a centimetre 0.01; uneven ground and a slow barometer change less
BEND_M = 3.0  # judgement: what is left of that once its steady part is taken out
WORKS = 0.5  # of the least mean command of the rotors, and of their rise: judgement; unused outputs rest
LINEAR, STEP = 0.5, 1e-3  # of a command's variance: judgement; 1 us of PWM's 1000
# judgement: correlation with what it should be of what has a wrong sign, where both move by so much (m/s, m)
REVERSED, MOVES = -0.7, 0.3
MOST_V = 1500.0  # judgement: packs of multirotors have 60 V, of air taxis 800 V


def contradicted(log: Samples) -> list[Finding]:
    """(column, (rows,) mask, why) of what cannot be: see the module."""
    reversed_axes = _signs(log)
    flagged = {column for column, _, _ in reversed_axes}
    climb = [] if "vel_d_m_s" in flagged else _climb(log)
    return [*reversed_axes, *climb, *_height(log), *_specific_force(log), *_voltage(log)]


def motors_too_many(log: Samples, rotors: set[int]) -> list[Finding]:
    """Motors that work as the others do, of other numbers than the airframe's rotors."""
    numbers = sorted(int(found[1]) for n in log.columns if (found := MOTOR.fullmatch(n)))
    flown = flying_rows(log)
    commands = {n: np.clip(np.nan_to_num(log[f"motor{n}"][flown]), 0.0, 1.0) for n in numbers}
    known = [commands[n] for n in numbers if n in rotors]
    least = min((float(u.sum()) for u in known), default=0.0)
    more = [
        n
        for n in numbers
        if n not in rotors and float(commands[n].sum()) > WORKS * least > 0.0 and _mixed(commands[n], known)
    ]
    if not more:
        return []
    names = ", ".join(f"motor{n}" for n in more)
    why = f"the airframe has {len(rotors)} rotors, and these work as theirs do: it is another vehicle's file"
    return [(names, np.ones(log.rows, bool), why)]


def _mixed(command: Array, known: list[Array]) -> bool:
    """Whether a command (rows,) is of the same mixer: linear in the known motors', and rises where all do.

    Four demands move them all, and thrust moves all alike. A gripper or a landing gear rests where it was
    put; a gimbal goes along with tilt, and not with thrust.
    """
    free = len(command) - len(known) - 1
    spread = float(np.var(command))
    if free <= 0 or spread <= STEP**2:
        return False
    columns = np.stack([np.ones(len(command)), *known], axis=1)
    slopes = np.linalg.lstsq(columns, command, rcond=None)[0]
    left = command - columns @ slopes
    return float(left @ left) < (1.0 - LINEAR) * free * spread and float(slopes[1:].sum()) > WORKS


def _height(log: Samples) -> list[Finding]:
    if not log.has("height_m"):
        return []
    time, velocity = log["time_s"], log["vel_d_m_s"]
    step_s = float(np.nanmedian(np.diff(time))) if log.rows > 2 else 1.0
    held = held_rows(log["height_m"], flying_rows(log), step_s)
    rows = np.zeros(log.rows, bool)
    most = 0.0
    for first, end in runs_of(held):
        steps = np.diff(time[first:end])
        speed = np.where(steps < 1.0, velocity[first : end - 1], 0.0)  # what happened in a gap is not known
        path = np.nancumsum(speed * steps)
        lasted = float(time[end - 1] - time[first])
        if not (lasted > 0.0 and np.isfinite(path).all()):
            continue
        after = time[first + 1 : end] - np.mean(time[first + 1 : end])
        detrended = path - after * float(after @ path / max(float(after @ after), 1e-12))
        if np.ptp(path) > CLIMB_M + CLIMB_M_S * lasted or np.ptp(detrended) > BEND_M:
            rows[first:end] = True
            most = max(most, float(np.ptp(path)))
    if not rows.any():
        return []
    return [
        ("height_m", rows, f"it stands still while the vertical velocity moves the vehicle by {most:.0f} m")
    ]


def _climb(log: Samples) -> list[Finding]:
    """A height that falls where the vertical velocity climbs."""
    if not log.has("height_m"):
        return []
    first, last, size = windows(log, ACCEL_S)
    rows = first[:, None] + np.arange(size)
    flown = flying_rows(log)[rows].all(axis=1)
    lasted = log["time_s"][last] - log["time_s"][first]
    with np.errstate(invalid="ignore"):  # what is not finite is left out below
        path = -log["vel_d_m_s"][rows].mean(axis=1) * lasted
        rise = log["height_m"][last] - log["height_m"][first]
    every = np.ones(log.rows, bool)
    if _against(rise, path, flown):
        return [("height_m", every, "it falls where the vertical velocity climbs: its sign is wrong")]
    use = flown & np.isfinite(rise) & np.isfinite(path)
    if use.sum() < 2 * PIECES or np.std(path[use]) < MOVES:
        return []
    factor, reach = _left_out((rise * path)[use], (path**2)[use])
    if factor - reach <= UNITS[1] and factor + reach >= UNITS[0]:
        return []
    why = f"it climbs {factor:.3g} times what the vertical velocity does: another unit than metres"
    return [("height_m", every, why)]


def _left_out(measured: Array, allowed: Array) -> tuple[float, float]:
    """The ratio of two sums over windows, and SIGMAS of it, pieces of the flight left out in turn."""

    def ratio(use: Mask) -> float:
        total = float(np.sum(allowed[use]))
        return float(np.sum(measured[use])) / (total if abs(total) > 1e-9 else 1e-9)

    piece = np.arange(len(measured)) * PIECES // len(measured)
    parts = np.array([ratio(piece != k) for k in range(PIECES)])
    reach = SIGMAS * float(np.sqrt((PIECES - 1) / PIECES * np.sum((parts - parts.mean()) ** 2)))
    return ratio(piece >= 0), reach


def _signs(log: Samples) -> list[Finding]:
    """Velocities and accelerometers of the wrong sign: each must be what the others make of it.

    Over a window the velocity gains what the specific force and gravity give it, whatever the rotors do.
    """
    first, last, size = windows(log, ACCEL_S)
    if len(first) < 2 * PIECES:
        return []
    rows = first[:, None] + np.arange(size)
    angles = np.stack([log[f"{n}_rad"] for n in ("yaw", "pitch", "roll")], axis=1)
    force = np.stack([log[f"accel_{axis}_m_s2"] for axis in "xyz"], axis=1)
    velocity = np.stack([log[f"vel_{axis}_m_s"] for axis in "ned"], axis=1)
    known: Mask = np.all(np.isfinite(np.hstack([angles, force])), axis=1)
    use: Mask = np.all((flying_rows(log) & known)[rows], axis=1)
    turned = Rotation.from_euler("ZYX", np.where(known[:, None], angles, 0.0))
    lasted = (log["time_s"][last] - log["time_s"][first])[:, None]
    with np.errstate(invalid="ignore"):  # what is not finite is left out below
        mean_gain = (velocity[last] - velocity[first]) / lasted
    given = turned.apply(np.where(known[:, None], force, 0.0))[rows].mean(axis=1) + GRAVITY_NED
    finite: Mask = np.all(np.isfinite(mean_gain), axis=1)
    wanted = np.where(finite[:, None], mean_gain, 0.0) - GRAVITY_NED
    every = np.zeros((log.rows, 3))
    every[rows.ravel()] = np.repeat(wanted, size, axis=0)
    due = turned.apply(every, inverse=True)[rows].mean(axis=1)
    with np.errstate(invalid="ignore"):
        read = force[rows].mean(axis=1)
    pairs = [
        (f"vel_{axis}_m_s", mean_gain[:, k], given[:, k], "accelerometers tell")
        for k, axis in enumerate("ned")
    ]
    pairs += [(f"accel_{axis}_m_s2", read[:, k], due[:, k], "velocity tells") for k, axis in enumerate("xy")]
    everywhere = np.ones(log.rows, bool)
    return [
        (column, everywhere, f"it goes against what the {other}: its sign is wrong")
        for column, mine, others, other in pairs
        if _against(mine * ACCEL_S, others * ACCEL_S, use & finite)
    ]


def _against(mine: Array, others: Array, use: Mask) -> bool:
    """Whether two things (windows,) that are one move, and move against one another."""
    use = use & np.isfinite(mine) & np.isfinite(others)
    if use.sum() < 2 * PIECES or min(np.std(mine[use]), np.std(others[use])) < MOVES:
        return False
    return float(np.corrcoef(mine[use], others[use])[0, 1]) < REVERSED


def _specific_force(log: Samples) -> list[Finding]:
    """The vertical accelerometer, against what keeps the logged velocity from running away."""
    measured, allowed = _downwards(log)
    if len(measured) < 2 * PIECES:
        return []
    factor, reach = _left_out(measured, allowed)
    if not abs(factor - 1.0) - reach > ACCEL_SHARE:
        return []
    why = f"it reads {factor:.2f} times what the logged velocity allows: its scale or its zero is wrong"
    return [("accel_z_m_s2", np.ones(log.rows, bool), why)]


def _downwards(log: Samples) -> tuple[Array, Array]:
    """(windows,) the z axis's part of the downward specific force, as read and as the velocity allows."""
    first, last, size = windows(log, ACCEL_S)
    rows = first[:, None] + np.arange(size)
    flown = flying_rows(log)[rows].all(axis=1)
    with np.errstate(invalid="ignore"):  # what is not finite is left out below
        roll, pitch = log["roll_rad"], log["pitch_rad"]
        x, y, z = (log[f"accel_{axis}_m_s2"] for axis in "xyz")
        level = y * np.sin(roll) * np.cos(pitch) - x * np.sin(pitch)
        down = z * np.cos(roll) * np.cos(pitch)
        lasted = log["time_s"][last] - log["time_s"][first]
        gained = (log["vel_d_m_s"][last] - log["vel_d_m_s"][first]) / lasted
        measured, allowed = down[rows].mean(axis=1), gained - GRAVITY_M_S2 - level[rows].mean(axis=1)
    use = flown & np.isfinite(measured) & np.isfinite(allowed)
    return measured[use], allowed[use]


def _voltage(log: Samples) -> list[Finding]:
    if not log.has("voltage_V"):
        return []
    measured = log["voltage_V"][np.isfinite(log["voltage_V"])]
    usual = float(np.median(measured)) if len(measured) else 0.0
    if not usual > MOST_V:
        return []
    why = f"{usual:.0f} V is no supply of a vehicle: millivolts would be {usual / 1000.0:.1f} V"
    return [("voltage_V", np.ones(log.rows, bool), why)]
