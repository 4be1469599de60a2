"""A flying X8 for testing `refine`: its own physics, in other forms than the effects modules, many flights
at once.

Nothing here comes from coaxlink: rotors are written out from eq. 17 of the paper, the airframe from its
table, and the hidden effects follow other laws of the same physics than those that are fitted.
"""

from __future__ import annotations

import numpy as np

ARM = 0.1807
PLACE = np.array(
    [
        [ARM, ARM, -0.075], [ARM, -ARM, -0.075], [-ARM, -ARM, -0.075], [-ARM, ARM, -0.075],
        [ARM, -ARM, 0.075], [ARM, ARM, 0.075], [-ARM, ARM, 0.075], [-ARM, -ARM, 0.075],
    ]
)  # fmt: skip
TURN = np.array([1, -1, 1, -1, 1, -1, 1, -1.0])  # +1: pushes the nose right
ABOVE = np.array([5, 4, 7, 6]), np.array([0, 1, 2, 3])  # lower rotor under each upper one
MASS, INERTIA = 20.0, np.array([0.92, 0.95, 1.60])
SUPPLY = 25.0
G = 9.80665
RATE = 250.0
STIFFNESS, DAMPING = (k * INERTIA * np.array([1, 1, 0.35]) for k in (-45.0, 11.0))  # of the attitude loop
TURNING = np.zeros((3, 9))  # w @ TURNING, as (3, 3): the matrix of w x
TURNING[2, 1], TURNING[1, 2], TURNING[2, 3] = -1.0, 1.0, 1.0
TURNING[0, 5], TURNING[1, 6], TURNING[0, 7] = -1.0, -1.0, 1.0


def turning(w):
    """(..., 3, 3) matrices of w x."""
    return (w @ TURNING).reshape(*w.shape, 3)


def product(matrices, vectors):
    """(B, 3) of (B, 3, 3) and (B, 3)."""
    return (matrices @ vectors[..., None])[..., 0]


def clipped(x, low, high):
    """As np.clip, without its overhead."""
    return np.minimum(np.maximum(x, low), high)


def length(x):
    """(B,) of (B, k)."""
    return np.sqrt((x * x).sum(axis=1))


def rotor_loads(u):
    """Thrust and torque (B, 8) at speeds (B, 8), eq. 17."""
    lower, upper = ABOVE
    a, b = u[:, upper], u[:, lower]
    thrust, torque = np.empty_like(u), np.empty_like(u)
    thrust[:, upper] = a * (55.9517 * a + 22.4464)
    torque[:, upper] = a * (1.2437 * a + 0.7155)
    thrust[:, lower] = (
        2.755 * (a * b) ** 2 + 64.721 * b**2 - 2.547 * a * b + 12.402 * b - 37.502 * a**2 + 0.801
    )
    torque[:, lower] = 0.307 * a * b**2 + 1.466 * b**2 + 0.573 * b - 0.695 * a**2
    return thrust, torque


def _path(t):
    """Position (3,) NED and heading wanted at t: hover, circles, climbs, a turn, low hover."""
    ease = lambda x: 0.5 - 0.5 * np.cos(np.pi * np.clip(x, 0, 1))  # noqa: E731
    p, yaw = np.array([0.0, 0.0, -3.0]), 0.0
    if t > 5:
        p = p + np.array([2.0, 0, -1.5]) * ease((t - 5) / 3)
    if 8 < t <= 32:
        x = t - 8
        phase = 2 * np.pi * (x / 6 if x < 12 else 2 + (x - 12) / 4)
        p = p + np.array([2 * np.cos(phase) - 2, 2 * np.sin(phase), 0])
    if t > 34:
        p = p + np.array([0, 0, -4.0]) * ease((t - 34) / 3.5)
    if t > 38:
        p = p + np.array([-2.0, 0, 5.5]) * ease((t - 38) / 4.5)
    if t > 43:
        yaw = 1.9 * ease((t - 43) / 2.5) - 1.9 * ease((t - 46) / 2.5)
    if t > 50:
        p = p + np.array([0, 0, 2.5]) * ease((t - 50) / 3) + np.array([0, 0, -2.5]) * ease((t - 58) / 3)
    return p, yaw


def _smooth_path(seconds):
    """Grid of times and wanted (x, y, z, yaw), the corners rounded over half a second."""
    t = np.arange(-3.0, seconds + 3.0, 1 / RATE)
    raw = np.array([(*_path(max(x, 0.0))[0], _path(max(x, 0.0))[1]) for x in t])
    kernel = np.exp(-0.5 * (np.arange(-400, 401) / RATE / 0.4) ** 2)
    smooth = np.stack([np.convolve(c, kernel / kernel.sum(), mode="same") for c in raw.T], axis=1)
    return t, smooth


def _mixer():
    """Linear table and thrust curve by which this autopilot flies (its own, roughly right)."""
    lower, upper = ABOVE
    size = np.zeros(8)
    size[upper], size[lower] = 43.0, 78.0
    drag = np.zeros(8)
    drag[upper], drag[lower] = 1.1, 1.9
    effect = np.stack([size, -PLACE[:, 1] * size, PLACE[:, 0] * size, TURN * drag])
    return np.linalg.pinv(effect)


def fly(effects, seconds=64.0, log_rate=50.0, seed=0, lag=0.02, noise=1.0):
    """Fly len(effects) vehicles at once; `effects[i]` is a dict of hidden effects of flight i.

    Returns a list of dicts of contract columns.
    """
    rng = np.random.default_rng(seed)
    B = len(effects)

    def get(name, default=0.0):
        return np.array([e.get(name, default) for e in effects], float)

    mass = MASS * (1 + get("mass"))
    sag, ground, drag, inflow = get("battery"), get("ground"), get("drag"), get("inflow")
    tau = lag + get("lag")
    spin_inertia = get("inertia")
    sick = np.ones((B, 8))
    for i, e in enumerate(effects):
        if "weak" in e:
            sick[i, e["weak"][0] - 1] -= e["weak"][1]
    slow, onset, dropped = np.ones((B, 8)), get("onset"), get("dropped")  # dropped: share of the mass
    over = get("over")  # seconds that what begins takes to come; 0: at once
    for i, e in enumerate(effects):
        if "slow" in e:
            slow[i, e["slow"][0] - 1] -= e["slow"][1]
    shift = np.array([e.get("cg", (0.0, 0.0)) for e in effects], float)
    shift = np.concatenate([shift, np.zeros((B, 1))], axis=1)
    wind = np.array([(*e.get("wind", (0.0, 0.0)), 0.0) for e in effects], float)
    gust = np.zeros((B, 3))
    dt, steps, every = 1 / RATE, int(seconds * RATE), round(RATE / log_rate)
    mix = _mixer()
    path = _smooth_path(seconds)[1]
    now = np.arange(steps) + round(3.0 * RATE)
    ahead, behind, step = path[now + 12, :3], path[now - 12, :3], 12 / RATE
    wants, want_vs = path[now, :3], (ahead - behind) / (2 * step)
    want_as = clipped((ahead - 2 * wants + behind) / step**2, -4, 4) - np.array([0, 0, G])
    noses = turning(np.stack([-np.sin(path[now, 3]), np.cos(path[now, 3]), np.zeros(steps)], axis=1))
    times = np.arange(steps)[:, None] / RATE
    eased = 0.5 - 0.5 * np.cos(np.pi * np.clip((times - onset) / np.maximum(over, 1e-9), 0.0, 1.0))
    begun_by = np.where(over > 0.0, eased, times >= onset)  # (steps, B)
    tau, identity = np.maximum(tau, dt)[:, None], np.eye(3)
    windy = bool(np.any(wind))
    p = np.tile(_path(0)[0], (B, 1))
    v, w = np.zeros((B, 3)), np.zeros((B, 3))
    R = np.tile(np.eye(3), (B, 1, 1))  # body to world
    u = np.full((B, 8), 0.55)
    command = u.copy()
    integral, integral_torque = np.zeros((B, 3)), np.zeros((B, 3))
    omega_max = 5400 * 2 * np.pi / 60
    log = {k: [] for k in ("t", "u", "a", "g", "att", "v", "h", "V")}
    momentum_before = None
    volts = np.full(B, SUPPLY)
    for k in range(steps):
        t = k * dt
        # world
        volts_now = SUPPLY * (1 - sag * (0.15 + 0.85 * t / seconds)) - sag * 0.02 * u.sum(axis=1)
        volts += (volts_now - volts) * dt / 0.05
        target = command * (1 - 0.92 * (1 - volts / SUPPLY))[:, None]
        begun = begun_by[k][:, None]
        target = target * (1.0 + begun * (slow - 1.0))
        mass_now = mass * (1.0 - begun[:, 0] * dropped)
        u = u + (target - u) * (dt / tau)
        thrust, torque = rotor_loads(u)
        thrust = thrust * (1.0 + begun * (sick - 1.0))
        torque = torque * (1.0 + 0.4 * begun * (sick - 1.0))
        W, back = turning(w), R.transpose(0, 2, 1)
        air = product(back, v - wind - gust)
        arm = PLACE - (begun * shift)[:, None, :]
        hub = air[:, None, :] + arm @ W.transpose(0, 2, 1)
        thrust = thrust * (1 / (1 - inflow[:, None] * hub[:, :, 2] / 4.0))
        height = np.maximum(-p[:, 2], 0.05)
        thrust = thrust * (1 + ground / (1 + (height / 0.45) ** 2.5))[:, None]
        force = np.zeros((B, 3))
        force[:, 2] = -thrust.sum(axis=1)
        speed = length(air[:, :2])
        pull = drag * np.sqrt(thrust.sum(axis=1) / (MASS * G)) * (1 + 0.06 * speed) * MASS * G / 3.0
        force[:, :2] -= pull[:, None] * air[:, :2]
        moment = np.empty((B, 3))
        moment[:, 0], moment[:, 1] = -(arm[:, :, 1] * thrust).sum(1), (arm[:, :, 0] * thrust).sum(1)
        moment[:, 2] = torque @ TURN
        momentum = -(u * TURN).sum(axis=1) * omega_max * spin_inertia  # along z (down)
        if momentum_before is not None:
            moment[:, 2] -= (momentum - momentum_before) / dt
        momentum_before = momentum
        spin = INERTIA * w
        spin[:, 2] += momentum
        dw = (moment - product(W, spin)) / INERTIA
        specific = force / mass_now[:, None]
        acceleration = product(R, specific)
        acceleration[:, 2] += G
        v = v + acceleration * dt
        p = p + v * dt
        w = w + dw * dt
        rot = w * dt
        angle = length(rot)[:, None, None] + 1e-12
        K = turning(rot)
        R = R @ (identity + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * K @ K)
        if windy:
            gust += -gust * dt / 3.0 + 0.15 * (wind != 0) * np.sqrt(dt) * rng.standard_normal((B, 3))
        if k % every == 0:
            log["t"].append(t)
            log["u"].append(command.copy())
            log["a"].append(specific + noise * 0.05 * rng.standard_normal((B, 3)))
            log["g"].append(w + noise * 0.002 * rng.standard_normal((B, 3)))
            roll = np.arctan2(R[:, 2, 1], R[:, 2, 2])
            pitch = -np.arcsin(np.clip(R[:, 2, 0], -1, 1))
            log["att"].append(np.stack([roll, pitch, np.arctan2(R[:, 1, 0], R[:, 0, 0])], axis=1))
            log["v"].append(v + noise * 0.02 * rng.standard_normal((B, 3)))
            log["h"].append(-p[:, 2] + noise * 0.01 * rng.standard_normal(B))
            log["V"].append(np.round(volts + noise * 0.02 * rng.standard_normal(B), 3))
        # autopilot
        error = p - wants[k]
        integral = clipped(integral + error * dt, -2, 2)
        a_sp = want_as[k] - 4.0 * error - 3.2 * (v - want_vs[k]) - 1.0 * integral
        lift = (R[:, :, 2] * a_sp).sum(axis=1)
        z = -a_sp / length(a_sp)[:, None]
        x = z @ noses[k].T
        x /= length(x)[:, None]
        D = np.empty((B, 3, 3))
        D[:, :, 0], D[:, :, 1], D[:, :, 2] = x, product(turning(z), x), z
        M = D.transpose(0, 2, 1) @ R
        E = M - M.transpose(0, 2, 1)
        tilt = 0.5 * E[:, (2, 0, 1), (1, 2, 0)]
        integral_torque = clipped(integral_torque + tilt * dt, -3, 3)
        demand = STIFFNESS * tilt - DAMPING * w - 12 * integral_torque
        wrench = np.empty((B, 4))
        wrench[:, 0], wrench[:, 1:] = np.abs(lift) * MASS, clipped(demand, -9, 9)
        s = clipped(wrench @ mix.T, 0.0, 1.0)
        command = clipped((-0.275 + np.sqrt(0.275**2 + 4 * 0.725 * s)) / (2 * 0.725), 0.02, 1.0)
    out = []
    arrays = {k: np.array(x) for k, x in log.items()}
    for i in range(B):
        c = {"time_s": arrays["t"]}
        for m in range(8):
            c[f"motor{m + 1}"] = arrays["u"][:, i, m]
        for j, a in enumerate("xyz"):
            c[f"accel_{a}_m_s2"] = arrays["a"][:, i, j]
            c[f"gyro_{a}_rad_s"] = arrays["g"][:, i, j]
        for j, a in enumerate(("roll", "pitch", "yaw")):
            c[f"{a}_rad"] = arrays["att"][:, i, j]
        for j, a in enumerate("ned"):
            c[f"vel_{a}_m_s"] = arrays["v"][:, i, j]
        c["height_m"] = arrays["h"][:, i]
        c["voltage_V"] = arrays["V"][:, i]
        out.append(c)
    return out
