"""A test pilot's logs: X8, plus-eight and Y6 under an own cascade, in gusts, 60 to 100 s at 50 Hz."""

# fmt: off
import math
from pathlib import Path
from typing import Any

import numpy as np
from pair import RHO, Array, On, Pair, Rng

COUNTS, STEP, MOST = (10, 3, 3, 2, 2, 4), 0.01, 9000
FORMS: dict[str, tuple[float, float, tuple[str, ...]]] = {
    "battery_voltage": (0.2, 1.3, ("motor", "power")), "cg_offset": (0.003, 0.15, ("x", "y", "diagonal")),
    "ground_effect": (0.2, 3.0, ("Cheeseman and Bennett", "fountain")), "wind": (0.004, 0.5, ("square",)),
    "rotor_drag": (0.1, 3.0, ("induced", "linear")), "axial_inflow": (0.1, 1.2, ("momentum", "gradient")),
    "rotor_lag": (0.008, 0.09, ("first order", "slower down")), "degraded_rotor": (0.01, 0.25, ()),
    "rotor_inertia_torque": (0.1, 5.0, ("rotors",)), "mass_change": (0.01, 0.2, ("dropped", "sprayed")),
    "slosh": (0.005, 0.15, ("tank",)), "fin": (0.002, 1.0, ("weathervane",)),
    "desync": (0.04, 0.6, ("bursts",))}
ODD, FAULTS = ("slosh", "fin", "desync"), ("clipped accel", "frozen gyro", "sign of gyro", "frozen accel")
TWO = (("battery_voltage", "wind"), ("cg_offset", "axial_inflow"), ("degraded_rotor", "ground_effect"),
       ("rotor_drag", "mass_change"), ("rotor_lag", "cg_offset"))
RIVALS = (("cg_offset", "degraded_rotor"),)


class Scene:
    """A vehicle, its pilot's plan and the gusts, drawn once."""

    def __init__(self, rng: Rng, kind: str, hidden: tuple[str, ...]) -> None:
        self.rng, self.kind, self.hidden = rng, kind, hidden
        p = self.pair = Pair(rng, rng.uniform(0.15, 0.28))
        arms = [[45, -45, -135, 135], [0, 90, 180, -90], [60, -60, 180]][rng.integers(3)]
        n = self.n = len(arms)
        self.arm = p.radius * (rng.uniform(1.55, 1.9) if n == 4 else rng.uniform(1.3, 1.6))
        at = np.radians(arms)
        xyz = np.stack([np.cos(at) * self.arm, np.sin(at) * self.arm, np.full(n, p.gap / 2)], 1)
        self.r = np.concatenate([xyz * [1, 1, -1], xyz])
        spin = np.array([1, -1, 1, -1.0]) if n == 4 else np.ones(3)
        self.s = np.concatenate([spin, -spin])  # 1: counter-clockwise, its torque turns the nose right
        full, self.hover = p.loads(1.0, 1.0), rng.uniform(0.55, 0.66)
        self.m = n * (full[0] + full[2]) * self.hover**2 / 9.81
        self.inertia = self.m * self.arm**2 * rng.uniform([0.2, 0.2, 0.35], [0.3, 0.3, 0.5])
        self.lag, self.count = rng.uniform(0.025, 0.06), int(rng.uniform(60, 100) / STEP) // 2 * 2
        k, q = np.full(2 * n, full[[0, 2]].mean()), np.full(2 * n, full[[1, 3]].mean())
        self.mix = np.linalg.pinv(np.stack([k, -self.r[:, 1] * k, self.r[:, 0] * k, self.s * q]))
        self.yaw_limit = 0.12 * q.sum() * self.hover**2
        self.rpm = not {*hidden} & {"battery_voltage", "rotor_lag", "desync"} and rng.random() < 0.4
        a, speed = rng.uniform((0, 2), (2 * math.pi, 7))
        self.wind = speed * np.array([math.cos(a), math.sin(a), 0])
        self.who, self.j = int(rng.integers(2 * n)), 0.09 * p.radius**4.5
        self.tank = rng.uniform((3, 0.04), (7, 0.15))
        self.end, self.v0, self.use = self.count * STEP, rng.choice([22.2, 25.2, 50.4]), rng.uniform(0.1, 0.2)
        self.bursts, self.drop = np.sort(rng.uniform(4, self.end - 2, 12)), rng.uniform(0.35, 0.7) * self.end
        self.fly_plan()
        size = self.m * 9.81 * rng.uniform(0.003, 0.014, 6)
        size[3:] *= self.arm * rng.uniform(0.1, 0.4)
        tau = np.repeat([rng.uniform(0.5, 2), rng.uniform(0.08, 0.4)], 3)
        a, self.gust = np.exp(-STEP / tau), rng.normal(size=(self.count, 6)) * size
        for i in range(1, self.count):
            self.gust[i] = a * self.gust[i - 1] + np.sqrt(1 - a * a) * self.gust[i]
        self.acc, self.gyr = rng.uniform((0.08, 0.0015), (0.3, 0.005))
        f, a = np.arange(self.count // 4 + 1) / (self.count // 2), (a * a)[:, None]
        self.psd = size[:, None] ** 2 * (1 - a * a) / np.abs(1 - a * np.exp(-2j * math.pi * f)) ** 2
        self.psd[:3] += (self.m * self.acc) ** 2
        self.psd[3:] += (self.inertia[:, None] * self.gyr * 2 * np.sin(math.pi * f) / 0.02) ** 2
        self.noise = {"accel_m_s2": self.acc, "gyro_rad_s": self.gyr, "gust": [*size]}
        self.noise["gust_tau_s"] = [*tau[2:4]]

    def fly_plan(self) -> None:
        """Set-points of the pilot: speed north and east, height, yaw rate."""
        rng, n, low = self.rng, self.count, "ground_effect" in self.hidden
        t, h, self.sp = 0, 1.5 if low else 8.0, np.zeros((n, 4))
        pieces = ["step", "circle", "climb", "hover", "yaw", *(["low"] * 2 if low else ["step", "climb"])]
        while t < n:
            for piece in rng.permutation(pieces):
                rows = slice(t, t := min(n, t + int(rng.uniform(4, 8) / STEP)))
                i, v, a = np.arange(rows.stop - rows.start), rng.uniform(3, 8), rng.uniform(0, 2 * math.pi)
                sign, h = rng.choice([-1, 1]), max(h, self.pair.radius * 5)
                if piece == "step":
                    flip = np.where(i < len(i) // 2, v, -v)
                    self.sp[rows, :2] = flip[:, None] * [math.cos(a), math.sin(a)]
                elif piece == "circle":
                    a = a + sign * rng.uniform(0.8, 1.4) * i * STEP
                    self.sp[rows, :2] = 0.7 * v * np.stack([np.cos(a), np.sin(a)], 1)
                elif piece == "climb":
                    h = rng.uniform(1.5, 12) if low else float(np.clip(h + sign * rng.uniform(4, 9), 5, 25))
                elif piece == "yaw":
                    self.sp[rows, 3] = sign * rng.uniform(0.5, 1.0)
                elif piece == "low":
                    h = self.pair.gap + self.pair.radius * rng.uniform(1.3, 2.4)
                    self.sp[rows, 0] = sign * v / 2
                self.sp[rows, 2] = h
        for i in range(1, n):  # a thumb, not a switch
            self.sp[i] = self.sp[i - 1] + 0.03 * (self.sp[i] - self.sp[i - 1])

    def forms(self, name: str) -> list[str]:
        """Forms of a name: of a degraded rotor, each rotor."""
        if name == "degraded_rotor":
            return [f"rotor {k + 1}" for k in range(2 * self.n)]
        return ["diagonal"] if self.kind == "ambiguous" and name == "cg_offset" else [*FORMS[name][2]]

    def goal(self, c: Array, t: Any, volt: Any, on: On) -> Array:
        """Speeds at which the motors aim."""
        a, form = on.get("battery_voltage", (0.0, ""))
        x = np.asarray(volt / self.v0)[..., None]
        if form:  # the motor: speed and its losses out of what the pack gives
            motor = (np.sqrt(1 + 0.8 * (c + 0.2 * c * c) * (1 + a * (x - 1))) - 1) / 0.4
            c = c * x**a if form == "power" else motor
        past, c = np.asarray(t)[..., None] - self.bursts, c.copy()
        c[..., self.who] *= 1 - on.get("desync", (0.0,))[0] * ((past > 0) & (past < 0.3)).any(-1)
        return c

    def follow(self, u: Array, goal: Array, on: On) -> Array:
        """Speeds a step later."""
        a, form = on.get("rotor_lag", (0.0, ""))
        slow = np.where((goal < u) & (form[:1] == "s"), 1.6, 1.0)
        return goal + (u - goal) * np.exp(-STEP / (self.lag + a * slow))

    def wrench(self, s: dict[str, Any], u: Array, rate: Array, on: On) -> Array:
        """Force and torque at states, as the vehicle file's mass would have them."""
        p, n, r, v, w = self.pair, self.n, self.r, s["v"], s["w"]
        climb, form = on.get("axial_inflow", (0.0, ""))
        into = -climb * (v[:, 2:] + w[:, :1] * r[:, 1] - w[:, 1:2] * r[:, 0])
        y = p.loads(u[:, :n], u[:, n:], into=(0.0, 0.0) if form == "gradient" else (into[:, :n], into[:, n:]))
        f, q = (np.concatenate([y[..., k], y[..., k + 2]], 1) for k in (0, 1))
        if form == "gradient":
            f = f - into * u * RHO * math.pi * p.radius**3 * p.omega * p.solidity * 5.7 / 8
        if "degraded_rotor" in on:
            a, k = on["degraded_rotor"][0], int(on["degraded_rotor"][1].split()[1]) - 1
            f[:, k], q[:, k] = f[:, k] * (1 - a), q[:, k] * (1 + 0.3 * a)
        if "ground_effect" in on:
            a, form = on["ground_effect"]
            z = np.maximum(s["h"][:, None] - r[:, 2], 0.45 * p.radius) / p.radius
            fade = 1 / (1 + (v[:, :1] ** 2 + v[:, 1:2] ** 2) / (0.1 * p.omega * p.radius) ** 2)
            near = a / (4 * z) ** 2 if form[0] == "C" else 0.05 * a * np.exp(1 - z / 1.4)
            f /= 1 - np.minimum(near, 0.3) * fade
        force = np.stack([np.zeros(len(u)), np.zeros(len(u)), -f.sum(1)], 1)
        torque = np.stack([-f @ r[:, 1], f @ r[:, 0], q @ self.s], 1)
        if "rotor_drag" in on:
            a, form = on["rotor_drag"]
            share = f / u if form == "induced" else 1.7 * self.m * 9.81 / (2 * n) * u
            k = -a / (p.omega * p.radius) * share
            x, y = k * (v[:, :1] + w[:, 1:2] * r[:, 2]), k * (v[:, 1:2] - w[:, :1] * r[:, 2])
            force[:, :2] += np.stack([x.sum(1), y.sum(1)], 1)
            torque += np.stack([-(y @ r[:, 2]), x @ r[:, 2], y @ r[:, 0] - x @ r[:, 1]], 1)
        if "rotor_inertia_torque" in on:
            j = on["rotor_inertia_torque"][0] * self.j * p.omega
            spin = -j * (u @ self.s)
            torque += np.stack([-w[:, 1] * spin, w[:, 0] * spin, j * (rate @ self.s)], 1)
        if "wind" in on:
            air = v - s["air"]
            drag = -0.5 * RHO * on["wind"][0] * np.linalg.norm(air, axis=1)[:, None] * air
            force, torque = force + drag, torque + np.cross([0.0, 0.0, -0.01], drag)
        torque[:, 2] += 0.06 * on.get("fin", (0.0,))[0] * v[:, 1] * np.abs(v[:, 1])
        pull = on.get("slosh", (0.0,))[0] * self.m * self.tank[0] ** 2 * s["tank"]
        force[:, :2] += pull
        torque[:, :2] += 0.06 * np.stack([-pull[:, 1], pull[:, 0]], 1)
        if "cg_offset" in on:
            a, form = on["cg_offset"]
            away = {"x": [self.arm, 0, 0], "y": [0, self.arm, 0]}.get(form, self.r[0] * [1, 1, 0])
            torque -= np.cross(a * np.array(away), force)
        if "mass_change" in on:
            a, form = on["mass_change"]
            gone = s["t"] / self.end if form == "sprayed" else s["t"] > self.drop
            force /= (1 + a * (0.5 - gone))[:, None]
        return np.concatenate([force, torque], 1)

    def prepare(self, on: On) -> bool:
        """Fly; False where the vehicle leaves what pilots fly."""
        count, n = self.count, 2 * self.n
        size = {"c": n, "u": n, "rate": n, "tank": 2}
        size |= dict.fromkeys(("v", "w", "air", "force", "vel", "rpy"), 3)
        log: dict[str, Any] = {k: np.empty((count, m)) for k, m in size.items()}
        log |= {"h": np.empty(count), "volt": np.empty(count), "t": np.arange(count) * STEP}
        rot, h, spent, yaw, (u, c) = np.eye(3), float(self.sp[0, 2]), 0.0, 0.0, np.full((2, n), self.hover)
        (vel, w, rest, turn), (tank, tank_v) = np.zeros((4, 3)), np.zeros((2, 2))
        hum = np.random.default_rng(count).normal(size=(count, 3)) * self.gyr
        for i in range(count):
            load = float((u**3).mean()) / self.hover**3
            volt, spent = self.v0 * (1 - self.use * (spent + 0.35 * load)), spent + load / count
            goal = self.goal(c, log["t"][i], volt, on)
            s = {"v": (rot.T @ vel)[None], "w": w[None], "air": (rot.T @ self.wind)[None], "h": np.array([h]),
                 "tank": tank[None], "t": log["t"][i : i + 1]}
            rate = (goal - u) / (self.lag + on.get("rotor_lag", (0.0, ""))[0])
            act = self.wrench(s, u[None], rate[None], on)[0] + self.gust[i]
            rpy = math.atan2(rot[2, 1], rot[2, 2]), -math.asin(rot[2, 0]), math.atan2(rot[1, 0], rot[0, 0])
            s |= {"c": c, "u": u, "rate": rate, "force": act[:3], "vel": vel, "rpy": rpy, "volt": volt}
            for k, x in s.items():
                log[k][i : i + 1] = x
            u, flat = self.follow(u, goal, on), act[:3] / self.m
            if i % 2:  # the controller publishes half-way between two rows
                yaw += self.sp[i, 3] * 2 * STEP
                err = np.array([*self.sp[i, :2], np.clip(1.5 * (h - self.sp[i, 2]), -3, 2.5)]) - vel
                rest = np.clip(rest + err * 1.2 * STEP, -4, 4)
                acc = 1.8 * err + rest
                acc[:2] *= min(1.0, 6.0 / (math.hypot(*acc[:2]) + 1e-9))
                up = np.array([0, 0, 9.81]) - acc
                z = up / np.linalg.norm(up)
                x = np.cross([-math.sin(yaw), math.cos(yaw), 0], z)
                x /= np.linalg.norm(x)
                e = rot.T @ np.stack([x, np.cross(z, x), z], 1)
                e = 0.5 * np.array([5, 5, 2.5]) * (e - e.T)[[2, 0, 1], [1, 2, 0]] - (w + hum[i])
                turn = np.clip(turn + e * 2 * STEP, -1.5, 1.5)
                tau = self.inertia * np.array([11, 11, 6]) * (e + 0.8 * turn)
                tau[2] = np.clip(tau[2], -self.yaw_limit, self.yaw_limit)
                c = np.sqrt(np.clip(self.mix @ [self.m * (up @ rot[:, 2]), *tau], 0.15**2, 0.99))
            swing, damp = self.tank
            tank_v = tank_v - STEP * (swing**2 * tank + 2 * damp * swing * tank_v + flat[:2])
            tank = tank + STEP * tank_v
            w = w + STEP * (act[3:] - np.cross(w, self.inertia * w)) / self.inertia
            k = STEP * np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
            rot = rot @ (np.eye(3) + k + k @ k / 2 + k @ k @ k / 6)
            vel = vel + STEP * (rot @ flat + [0, 0, 9.81])
            h -= STEP * vel[2]
            if not (0.1 < h < 60 and np.abs(w).max() < 6 and rot[2, 2] > 0.3):
                return False
        self.log, self.on = log, dict(on)
        self.base = self.model({})
        return True

    def model(self, on: On) -> Array:
        """Force and torque of the rows with these effects, at the states and commands flown."""
        log, rows = self.log, slice(0, None, 2)
        u, at = log["u"].copy(), log["u"][0]
        if not self.rpm:
            for i, g in enumerate(self.goal(log["c"], log["t"], log["volt"], on)):
                u[i], at = at, self.follow(at, g, on)
        slope = np.gradient(u, STEP, axis=0)[rows]
        return self.wrench({k: x[rows] for k, x in log.items()}, u[rows], slope, on)

    def white(self, x: Array, c: int) -> Array:
        """Spectrum of rows in units of the noise's (Whittle)."""
        z = np.fft.rfft(x - x.mean()) * np.sqrt(2 / (len(x) * self.psd[c]))
        return np.concatenate([z.real, z.imag])

    def seen(self, on: On) -> Array:
        """Signal of what is hidden."""
        return self.model(on) - self.base

    def shows(self, name: str) -> bool:
        """Whether the log holds what the name needs."""
        return name not in ODD and not (self.rpm and name in ("battery_voltage", "rotor_lag"))

    def sets(self, name: str) -> list[list[Array]]:
        """What a rival could put in the place."""
        tried = [self.seen({name: (math.sqrt(math.prod(FORMS[name][:2])), f)}) for f in self.forms(name)]
        return [tried] if name == "cg_offset" else [[t] for t in tried]

    def write(self, on: On, path: Path) -> tuple[dict[str, Any], str, Array]:
        """The log, the vehicle, the rotor model; what is wrong in the log, and the signal."""
        rng, rows, lie, told = self.rng, self.count // 2, self.seen(on), ""
        d, noisy = {k: x[::2] for k, x in self.log.items()}, lambda x, s: x + rng.normal(0, s, x.shape)
        read = {"accel": noisy(d["force"] / self.m, self.acc) + rng.normal(0, 0.02, 3),
                "gyro": noisy(d["w"], self.gyr) + rng.normal(0, 0.001, 3)}
        if self.kind == "fault":
            how, _, which = self.hidden[0].rpartition(" ")
            k, a = 2 if how == "clipped" else int(rng.integers(3)), int(rows * rng.uniform(0.2, 0.5))
            wrong, b = read[which].copy(), a + int(rows * rng.uniform(0.15, 0.3))
            wrong[a:b, k] = wrong[a, k] if how == "frozen" else wrong[a:b, k]
            wrong[:, k] = {"frozen": wrong[:, k], "sign of": -wrong[:, k]}.get(
                how, np.maximum(wrong[:, k], np.quantile(wrong[:, k], 0.25)))
            off, read[which] = wrong - read[which], wrong
            told = f"{which}_{'xyz'[k]}_{'m_s2' if which == 'accel' else 'rad_s'}"
            lie[:, :3] += off * self.m * (which == "accel")
            lie[:, 3:] += np.gradient(off * self.inertia, 0.02, axis=0) * (which == "gyro")
        names = [f"motor{k + 1}" for k in range(2 * self.n)]
        names += [f"{s}_{x}_{y}" for s, y in (("accel", "m_s2"), ("gyro", "rad_s")) for x in "xyz"]
        names += ["roll_rad", "pitch_rad", "yaw_rad", "vel_n_m_s", "vel_e_m_s", "vel_d_m_s", "height_m"]
        table = [d["t"][:, None], d["c"], *read.values(), noisy(d["rpy"], 0.002), noisy(d["vel"], 0.03),
                 noisy(d["h"][:, None], 0.02)]
        if "battery_voltage" in self.hidden or rng.random() < 0.5:
            names, table = [*names, "voltage_V"], [*table, noisy(d["volt"][:, None], 0.02)]
        if self.rpm:
            names += [f"rpm{k + 1}" for k in range(2 * self.n)]
            table.append(np.round(noisy(d["u"] * self.pair.rpm, 0.001 * self.pair.rpm)))
        made: dict[str, Any] = {k: f"{path.name}{e}" for k, e in (
            ("log", ".csv"), ("rotor", "_rotor.toml"), ("airframe", "_airframe.toml"))}
        head = ",".join(["time_s", *names])
        np.savetxt(path.with_name(made["log"]), np.hstack(table), "%.7g", ",", header=head, comments="")
        self.pair.write(path.with_name(made["rotor"]))
        text = [f'name = "{path.name}"', f"mass_kg = {self.m * rng.normal(1, 0.003):.4f}",
                f'rotor_model = "{made["rotor"]}"', f"motor_lag_s = {self.lag:.4f}",
                f"inertia_kg_m2 = {[round(float(x), 6) for x in self.inertia * rng.normal(1, 0.015, 3)]}"]
        for k, place in enumerate(self.r):
            text += ["", "[[rotors]]", f"number = {k + 1}", f"pair = {(k + self.n) % (2 * self.n) + 1}",
                     f'level = "{"upper" if k < self.n else "lower"}"',
                     f'spin = "{"ccw" if self.s[k] > 0 else "cw"}"',
                     f"position_m = {[round(float(x), 5) for x in place]}"]
        path.with_name(made["airframe"]).write_text("\n".join(text) + "\n")
        return {**made, "noise": self.noise}, told, lie
