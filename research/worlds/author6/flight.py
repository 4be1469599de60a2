"""Flights: a vehicle of pairs under its own controller in gusts, what is hidden in it."""

from collections import defaultdict
from types import SimpleNamespace

import numpy as np
from pair import colour, crm, draw_pair, pair_loads, resize, sizes, verdict, weigh, whiten
from scipy.ndimage import gaussian_filter1d

FLIGHT = sizes("""battery_voltage .4 1, ground_effect .8 2.5, rotor_drag .05 .4, axial_inflow .5 1.5,
rotor_lag .02 .08, rotor_inertia_torque 4e-4 4e-3, degraded_rotor .05 .3, cg_offset .01 .05, wind .05 .4,
mass_change .05 .25""")
TOURS = {"low": (3, 0.6, 2.5), "climbs": (2, 3, 12), "dashes": (12, 4, 6), "hover": (0.3, 3, 3.2)}  # m
HEADINGS = """accel_x_m_s2 accel_y_m_s2 accel_z_m_s2 gyro_x_rad_s gyro_y_rad_s gyro_z_rad_s roll_rad pitch_rad
yaw_rad vel_n_m_s vel_e_m_s vel_d_m_s height_m voltage_V"""


def draw_frame(p, rng):
    """An X8, a Y6 or a coaxial quad in plus; upper rotors first, front right round by the way they turn."""
    style = str(rng.choice(["x8", "y6", "plus"]))
    angle = {"x8": [45, -45, -135, 135], "y6": [60, -60, 180], "plus": [0, 90, 180, -90]}[style]
    m, arm = len(angle), p.radius * rng.uniform(1.6, 2.0)
    c = SimpleNamespace(m=m, arm=arm, style=style, lag=rng.uniform(0.015, 0.04), pair=p)
    around = np.tile(np.radians(angle), 2)
    level = np.repeat([-0.5, 0.5], m) * p.gap
    c.place = np.column_stack([arm * np.cos(around), arm * np.sin(around), level]).round(4)
    c.spin = np.tile([1.0, -1.0], m)[:m]
    c.spin = np.concatenate([c.spin, -c.spin])
    c.full = pair_loads(p, *np.full((2, 1), 0.6 * p.top))[:, 0] / 0.36
    c.mass = round(m * (c.full[0] + c.full[2]) * rng.uniform(0.28, 0.42) / 9.81, 3)
    c.inertia = (c.mass * arm**2 * np.array([0.2, 0.22, 0.38])).round(5)
    lift, drag = np.repeat(c.full[[0, 2]], m), np.repeat(c.full[[1, 3]], m) * c.spin
    c.mix = np.linalg.pinv(np.stack([lift, -lift * c.place[:, 1], lift * c.place[:, 0], drag]))
    c.text = f'name = "{style}"\nmass_kg = {c.mass}\ninertia_kg_m2 = {c.inertia.tolist()}\n'
    c.text += f'motor_lag_s = {c.lag:.4f}\nrotor_model = "rotor_model_file"\n'
    for k in range(2 * m):
        c.text += f"\n[[rotors]]\nnumber = {k + 1}\nposition_m = {c.place[k].tolist()}\n"
        c.text += f'spin = "{"ccw" if c.spin[k] > 0 else "cw"}"\nlevel = "{"lower" if k >= m else "upper"}"\n'
        c.text += f"pair = {(k + m) % (2 * m) + 1}\n"
    return c


def fly(c, plan, gust, variants, dt):
    """The first variant's states (rows, ...); every variant's wrench (rows, variants, 6) without gusts."""
    m, p, n, place = c.m, c.pair, len(gust), c.place
    q = defaultdict(lambda: np.zeros(len(variants)))
    q |= {key: np.array([v.get(key, 0.0) for v in variants]) for key in set().union(*variants)}
    loss = np.column_stack([q[f"degraded_rotor.{i}"] for i in range(2 * m)])
    lever = place[None, :, :2] - np.column_stack([q["cg_offset.x"], q["cg_offset.y"]])[:, None]
    wind = np.column_stack([q["wind.n"], q["wind.e"], q["none"]])
    kept = 1 - np.exp(-dt / (c.lag + q["rotor_lag"]))[:, None]
    spun = p.top * c.spin * q["rotor_inertia_torque"][:, None]
    u, turn, w, v, x = np.full((len(variants), 2 * m), 0.55), np.eye(3), np.zeros(3), np.zeros(3), plan[0, :3]
    sway, sums, cells, bob = np.zeros(3), np.zeros(3), 1.0, np.zeros(3)
    rows, wrenches = [], np.empty((n, len(variants), 6))
    for k in range(n):
        off = plan[k, :3] - x
        sums = np.clip(sums + off * dt, -4, 4)
        want = np.clip(1.6 * off + 2.4 * (plan[k, 4:] - v) + 0.4 * sums, -4, 4) - [0, 0, 9.81]
        down = -want / np.linalg.norm(want)
        side = np.cross(down, [np.cos(plan[k, 3]), np.sin(plan[k, 3]), 0])
        side /= np.linalg.norm(side)
        tilt = turn.T @ np.column_stack([np.cross(side, down), side, down])
        twist = np.array([tilt[2, 1] - tilt[1, 2], tilt[0, 2] - tilt[2, 0], tilt[1, 0] - tilt[0, 1]]) / 2
        torque = c.inertia * ([50, 50, 8] * twist - [11, 11, 4] * w)
        command = np.sqrt(np.clip(c.mix @ [-c.mass * want @ turn[:, 2], *torque], 0.02, 1))
        cells += 3 * dt * (1 - 0.1 * k / n - 0.25 * (np.mean(command**3) - 0.15) - cells)
        change = (command * cells ** q["battery_voltage"][:, None] - u) * kept
        u = u + change
        back = turn.T @ v
        climb = -q["axial_inflow"][:, None] * (back + np.cross(w, place[:m]))[:, 2]
        loads = pair_loads(p, u[:, :m] * p.top, u[:, m:] * p.top, climb=climb)
        near = p.radius / 4 / np.maximum(-x[2] - place @ turn[2], 0.6 * p.radius)
        grow = (1 + q["thrust_level"][:, None] + q["ground_effect"][:, None] * near**2) * (1 - loss)
        lift, drag = np.hstack([loads[0], loads[2]]) * grow, np.hstack([loads[1], loads[3]]) * (1 - loss)
        force = wind @ turn - (q["rotor_drag"] + q["wind.k"])[:, None] * back * [1, 1, 0]
        force = c.mass * u.mean(1)[:, None] * force - lift.sum(1)[:, None] * [0, 0, 1]
        moment = np.stack([-(lift * lever[..., 1]).sum(1), (lift * lever[..., 0]).sum(1), drag @ c.spin], 1)
        moment[:, 2] += (spun * change).sum(1) / dt
        moment += (spun * u).sum(1)[:, None] * [w[1], -w[0], 0]
        if c.odd == 0:  # a cable to the ground pulls
            force += q["odd"][:, None] * c.mass * 4 * ((plan[0, :3] - x) @ turn)
        elif c.odd == 1:  # a load swings below
            force += q["odd"][:, None] * c.mass * 30 * sway * [1, 1, 0]
        else:  # an arm twists under its thrust
            force[:, 0] += q["odd"] * lift[:, 0] ** 2 / lift[0, 0]
            moment[:, 2] -= q["odd"] * lift[:, 0] ** 2 / lift[0, 0] * place[0, 1]
        force = force / (1 + q["mass_change"])[:, None]
        push = force[0] / c.mass + gust[k, :3]
        spin_up = (moment[0] + gust[k, 3:] * c.inertia - np.cross(w, c.inertia * w)) / c.inertia
        bob = bob + dt * (-9 * sway - 0.4 * bob - push * [1, 1, 0])
        sway = sway + dt * bob
        roll, pitch = np.arctan2(turn[2, 1], turn[2, 2]), -np.arcsin(np.clip(turn[2, 0], -1, 1))
        angles = [roll, pitch, np.arctan2(turn[1, 0], turn[0, 0])]
        rows.append([*command, *push, *w, *angles, *v, -x[2], cells, u[0].mean()])
        wrenches[k] = np.hstack([force, moment])
        w, v = w + dt * spin_up, v + dt * (turn @ push + [0, 0, 9.81])
        x, step = x + dt * v, np.cross(np.eye(3), dt * w)
        turn = turn @ (np.eye(3) + step + step @ step / 2)
        turn = turn @ (1.5 * np.eye(3) - 0.5 * turn.T @ turn)
    return np.array(rows), wrenches


def build_flight(drawn, names, rng):
    p, hz, every = draw_pair(rng), int(rng.choice([100, 125, 200])), int(rng.choice([1, 2]))
    c, n, dt = draw_frame(p, rng), 48 * hz, 1 / hz
    tour = {"ground_effect": "low", "axial_inflow": "climbs", "rotor_drag": "dashes", "wind": "dashes"}
    style = tour.get(names[0] if names else "", str(rng.choice(["low", "climbs", "dashes"])))
    style = "hover" if drawn == "ambiguous" else style
    reach, low, high = TOURS[style]
    stops = rng.uniform([-reach, -reach, -high, -3], [reach, reach, -low, 3], (15, 4))
    stops[:, 3] *= style != "hover"
    plan = gaussian_filter1d(np.repeat(stops, n // 15, 0), 0.6 * hz, axis=0, mode="nearest")
    plan = np.hstack([plan, np.gradient(plan[:, :3], dt, axis=0)])
    f, rate = np.fft.rfftfreq(n, dt), hz / every
    size = np.array([*rng.uniform(0.02, 0.12, 3), *rng.uniform(0.05, 0.4, 3)])
    corner = rng.uniform(0.2, 1)

    def gusty(f):
        psd = 1 / (1 + (f / corner) ** (5 / 3)) ** 1.5
        return psd / psd.mean()

    gust = np.column_stack([g * colour(gusty(f), n, rng) for g in size])
    blow, way, bad = rng.uniform(-7, 7, 2), rng.uniform(0, 6.3), int(rng.integers(2 * c.m))
    unit = {"wind": {"wind.k": 1, "wind.n": blow[0], "wind.e": blow[1]}}
    unit |= {"degraded_rotor": {f"degraded_rotor.{bad}": 1}}
    unit |= {"cg_offset": {"cg_offset.x": np.cos(way), "cg_offset.y": np.sin(way)}}
    single = [k for k in FLIGHT if k not in unit] + ["thrust_level"]
    tangents = [*single, "wind.k", "wind.n", "wind.e", "cg_offset.x", "cg_offset.y"]
    tangents += [f"degraded_rotor.{i}" for i in range(2 * c.m)]
    scale = {k: 0.3 * FLIGHT.get(k.split(".")[0], (0.03,))[0] for k in tangents}
    shaky, still = rng.uniform([0.05, 0.001, 0.2], [0.3, 0.004, 1.2]), rng.normal(0, 0.03, 3)

    def judge(e, fault=None):
        flat = {a: {k: v * e[a] for k, v in unit.get(a, {a: 1}).items()} for a in e}
        some = [e.keys(), *(e.keys() - {a} for a in e), ()]
        cases = [{k: v for a in names for k, v in flat[a].items()} for names in some]
        rows, wrench = fly(c, plan, gust, [*cases, *({k: v} for k, v in scale.items())], dt)
        rows, wrench = rows[::every], np.moveaxis(wrench[::every], 0, -1)
        f = np.fft.rfftfreq(wrench.shape[-1], 1 / rate)
        psd = (size**2)[:, None] * gusty(f)
        psd[:3] += shaky[0] ** 2 + shaky[2] ** 2 / 2
        psd[3:] += (shaky[1] * 2 * rate * np.sin(np.pi * f / rate)) ** 2
        psd *= np.array([*[c.mass] * 3, *c.inertia])[:, None] ** 2
        signs = {a: whiten(wrench[0] - wrench[1 + k], psd) for k, a in enumerate(e)}
        signs = signs if fault is None else {"fault": whiten(fault, psd)}
        rivals = {a: [] for a in [*FLIGHT, "thrust_level"]}
        for k, key in enumerate(scale, len(cases)):
            rivals[key.split(".")[0]].append(whiten(wrench[k] - wrench[len(cases) - 1], psd))
        unit_c = np.eye(6)[:, :, None] * np.ones(f.size * 2 - 2)
        nuisance = [whiten(0.03 * c.mass * x, psd) for x in unit_c[:3]]
        return rows, weigh(signs, [*nuisance, whiten(0.01 * wrench[0] * unit_c[2], psd)], rivals)

    e = {a: FLIGHT.get(a, (0.05,))[0] for a in names}
    wants = {a: np.exp(rng.uniform(2.6, 7.8)) for a in e}
    c.odd = int(rng.integers(3))
    for _ in range(2 if drawn == "ambiguous" else bool(e)):
        weighed = judge(e)[1]
        e = {a: resize(s, weighed[a], wants[a], drawn, FLIGHT.get(a, (0, 0.2))[1]) for a, s in e.items()}
    rows, weighed = judge(e)
    if not np.all(np.isfinite(rows)) or np.abs(rows[:, -9:-7]).max() > 1.3 or rows[:, -3].min() < 0.3:
        return build_flight(drawn, names, rng)  # a vehicle that was lost
    m, t = 2 * c.m, np.arange(len(rows)) / rate
    spread = np.repeat([0, *shaky[:2], 0.002, 0.03, 0.02, 0.001, 0], [m, 3, 3, 3, 3, 1, 1, 1])
    read = rows + spread * rng.standard_normal(rows.shape)
    turns = np.cumsum(rows[:, -1]) * p.top / rate
    read[:, m : m + 3] += still + shaky[2] * np.sin(turns[:, None] * [1, 1, 2] + rng.uniform(0, 6, 3))
    read[:, m + 3 : m + 6] += rng.normal(0, 0.002, 3)
    suspect, keys = [], [f"motor{k + 1}" for k in range(m)] + HEADINGS.split()
    if drawn == "fault":
        at, c_bad = int(len(t) * rng.uniform(0.3, 0.6)), int(rng.integers(6))
        was, how = read[:, m + c_bad].copy(), int(rng.integers(3))
        if how == 0:  # a step of the bias
            read[at:, m + c_bad] += (0.8, 0.1)[c_bad > 2]
        elif how == 1:  # the gain falls
            read[at:, m + c_bad] *= 0.8
        else:  # stuck
            read[at : at + len(t) // 5, m + c_bad] = read[at, m + c_bad]
        wrong = read[:, m + c_bad] - was
        wrong = c.mass * wrong if c_bad < 3 else c.inertia[c_bad - 3] * np.gradient(wrong, 1 / rate)
        suspect, weighed = [keys[m + c_bad]], judge({}, np.outer(np.arange(6) == c_bad, wrong))[1]
    read[:, -2] *= rng.uniform(22, 50)
    columns = {"time_s": t} | dict(zip(keys, read[:, : len(keys)].T, strict=True))
    if "battery_voltage" not in names and rng.random() < 0.5:
        del columns["voltage_V"]
    truth = verdict(drawn, weighed) | {"size": e, "suspect": suspect, "rows": len(t)}
    truth["form"] = f"{c.style} {style} {rate:g} Hz" + (
        f" rotor {bad + 1}" if "degraded_rotor" in names else ""
    )
    u = 0.2 + 0.8 * rng.random((2, 140))
    return columns, truth, crm(p, pair_loads(p, *(u * p.top)), u, rng), c.text
