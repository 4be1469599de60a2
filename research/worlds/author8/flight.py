"""Flights of coaxial multirotors with something hidden in them: rigid body, cascaded controller, gusts."""

# fmt: off
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pair import GRID, Array, Effects, G, Pair, Rng, noise, write_csv, write_rotor
from scipy.signal import lfilter

STEP = 0.01  # s
FORMS: dict[str, tuple[float, float, tuple[str, ...]]] = {  # least and largest amount, forms
    "battery_voltage": (0.5, 1.1, ("speed as voltage", "exponent 0.7")),
    "ground_effect": (0.15, 1.6, ("Cheeseman-Bennett", "exponential")),
    "rotor_drag": (0.004, 0.06, ("linear", "power 1.5", "saturating")),
    "axial_inflow": (0.5, 1.3, ("momentum", "climbing only")),
    "rotor_lag": (1.25, 3.0, ("first order", "slower down")),
    "rotor_inertia_torque": (0.5, 3.0, ("rotor's own",)),
    "degraded_rotor": (0.03, 0.2, ("from the start", "sets in", "torque rises")),
    "cg_offset": (0.002, 0.04, ("fixed", "slides once")),
    "mass_change": (0.035, 0.15, ("payload", "dropped", "tank runs dry")),
    "wind": (1.0, 8.0, ("square of the air speed", "power 1.5"))}
ODD = ("swinging load", "tether over height", "pump strokes")
FAULTS = ("frozen gyro", "exchanged motors", "accelerometer at half scale")
TWO = (("battery_voltage", "cg_offset"), ("mass_change", "rotor_drag"), ("ground_effect", "degraded_rotor"),
       ("axial_inflow", "rotor_drag"), ("rotor_lag", "cg_offset"), ("wind", "battery_voltage"))
RIVALS = (("mass_change", "ground_effect"), ("ground_effect", "mass_change"),
          ("battery_voltage", "mass_change"))


@dataclass
class State:
    """Times, commands (2A, ...) uppers first, attitude, rates, velocity NED (3, ...), height, volts."""
    t: Any
    u: Array
    attitude: Array
    rate: Array
    velocity: Array
    height: Any
    volts: Any


def axes(attitude: Array) -> Array:
    """(3, 3, ...) body to NED."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(attitude), np.sin(attitude)
    return np.array([[cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
                     [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy], [-sp, sr * cp, cr * cp]])


def mission(rng: Rng, low: bool, still: bool, n: int, radius: float) -> Array:
    """(4, N) north, east, down, heading as asked for: hover, circles, dashes, climbs, low passes, turns."""
    home = rng.uniform(1.5, 3) if low else rng.uniform(3, 8)
    home, way, k = 0.3 + rng.uniform(1.6, 2.4) * radius if still and low else home, np.zeros((4, n)), 0
    way[2] = home
    while k < n and not still:
        kind = rng.choice(["hover", "circle", "dash", "climb", "turn", "doublets"] + ["low"] * 2 * low)
        s, end = np.arange(min(int(rng.uniform(7, 14) / STEP), n - k)) * STEP, way[:, k].copy()
        leg, side, v = end[:, None] + np.zeros((4, s.size)), rng.choice([-1, 1]), rng.uniform(1.5, 4.5)
        if kind == "circle":
            leg[:2] += (v - 0.5) * np.array([np.sin(0.2 * v * s), side * (1 - np.cos(0.2 * v * s))])
        elif kind == "dash":
            leg[:2] += v * np.outer([np.cos(9 * v), np.sin(9 * v)], 3 - np.abs((s % 6) - 3))
        elif kind == "climb":
            leg[2] += 0.55 * v * (2 - np.abs((s % 4) - 2))
        elif kind == "low":
            leg[2] = 0.15 + rng.uniform(1.2, 3) * radius
        elif kind == "turn":
            leg[3] += side * rng.uniform(0.2, 0.6) * s
        elif kind == "doublets":
            leg[[3, 0]] += np.sign(np.sin(np.outer([2, 1.5], s))) * [[0.5], [0.7]]
        way[:, k : k + s.size], k = leg, k + s.size
        way[:, k:] = leg[:, -1:]
        way[2, k:] = home if kind == "low" else way[2, k:]
    hand = lfilter([1], [1, -0.995], rng.normal(0, 0.05, (3, n)))
    way[:3] += (0.01 if still else 0.15) * hand
    way[2] = -np.maximum(way[2], 0.9 * radius)
    pole = np.exp(-STEP / 0.6)
    for _ in range(2):
        way = lfilter([1 - pole], [1, -pole], way, zi=pole * way[:, :1])[0]
    return np.asarray(way)


class Scene:
    """A vehicle as drawn, what only its builder knows, its mission and its sensors."""

    def __init__(self, rng: Rng, kind: str, hidden: tuple[str, ...]) -> None:
        self.rng, self.kind, self.hidden, still = rng, kind, hidden, kind == "ambiguous"
        pair = self.pair = Pair.draw(rng)
        self.count, n = int(rng.choice([3, 4, 4])), int(rng.uniform(45, 75) / STEP)
        angle = 2 * np.pi * (np.arange(self.count) + 0.5) / self.count
        reach = pair.radius * rng.uniform(1.15, 1.5) / np.sin(np.pi / self.count)
        self.arms = reach * np.array([np.cos(angle), np.sin(angle)])
        self.turn = np.resize([1.0, -1.0], self.count)
        self.kilos = self.count * pair.loads(np.full((2, 1), rng.uniform(0.52, 0.65)))[::2].sum() / G
        self.inertia = self.kilos * reach**2 * np.array([0.2, 0.22, 0.38]) * rng.uniform(0.8, 1.2)
        self.lag, self.hand, self.t = 0.015 + 0.08 * pair.radius, rng.uniform(-1, 1, 6), np.arange(n) * STEP
        self.way = mission(rng, "ground_effect" in hidden, still, n, pair.radius)
        sag = 1.01 - rng.uniform(0.06, 0.15) * (self.t / self.t[-1]) ** 0.9
        self.volts = np.full(n, rng.uniform(0.98, 0.99)) if still else sag
        self.gusts = rng.uniform(0.5, 1.5, 6) * self.kilos * G * np.repeat([0.004, 0.0012 * reach], 3)
        pole, self.blocks = np.exp(-STEP / 1.5), n // 10  # an oracle that reads tenths of a second
        self.gust = lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.normal(size=(6, n))) * self.gusts[:, None]
        self.grain, self.jitter = rng.uniform(0.08, 0.3), rng.uniform(0.002, 0.006)
        self.stride, tenths = int(rng.choice([1, 2])), np.arange(self.blocks) * 0.1
        white = [self.kilos * self.grain] * 3 + [*(self.inertia * self.jitter * np.sqrt(2) / 0.1)]
        white /= np.sqrt(10 // self.stride)
        self.factors = [noise(tenths, white[k], self.gusts[k], 1.5, 0, 1, k > 2) for k in range(6)]
        self.free = [np.empty((self.blocks, 0))] * 6

    def mass(self, on: Effects, t: Any) -> Any:
        """kg at t."""
        a, form = on.get("mass_change", (0.0, ""))
        course = {"dropped": t < 0.5 * self.t[-1], "tank runs dry": 1 - t / self.t[-1]}.get(form, 1.0)
        return self.kilos * (1 + a * np.sign(self.hand[0]) * course)

    def follow(self, on: Effects, goal: Array, before: Array) -> Array:
        """Speeds (2A,) a step after `before`."""
        a, form = on.get("rotor_lag", (1.0, ""))
        slow = np.where((goal < before) & (form == "slower down"), 1.6, 1.0)
        return np.asarray(goal + (before - goal) * np.exp(-STEP / (self.lag * a) / slow))

    def goal(self, on: Effects, s: State) -> Array:
        """The speeds that the motors go for."""
        p, form = on.get("battery_voltage", (0.0, ""))
        return np.asarray(s.u * (1 + p * (s.volts - 1)) ** (0.7 if form.startswith("exp") else 1))

    def wrench(self, on: Effects, s: State, x: Array, dx: Array) -> Array:
        """(6, ...) force N and torque N m in the body, of speeds x (2A, ...) and their change a second."""
        n, frame, one, late = self.count, axes(s.attitude), 0 * s.t + 1, s.t > 0.45 * self.t[-1]
        air, column = np.einsum("ij...,i...->j...", frame, s.velocity), (1,) * (x.ndim - 1)
        a, form = on.get("axial_inflow", (0.0, ""))
        fore, right = self.arms.reshape(2, n, *column)
        climb = -a * (air[2] + s.rate[0] * right - s.rate[1] * fore)
        climb = climb.clip(0 if form.startswith("climb") else -3)
        load = self.pair.loads(x.reshape(2, n, *x.shape[1:]), climb=climb)
        thrust, torque = load[::2].copy(), load[1::2].copy()  # (2, A, ...)
        if "ground_effect" in on:
            a, form = on["ground_effect"]
            z = np.maximum(s.height / self.pair.radius, 0.7)
            near = 0.25 * a * np.exp(-z / 2)
            thrust *= 1 + near if form == "exponential" else 1 / (1 - a * (0.25 / z) ** 2)
        if "degraded_rotor" in on:
            a, form = on["degraded_rotor"]
            k, a = int((self.hand[1] + 1) * n), a * (late if form == "sets in" else one)
            thrust[k // n, k % n] *= 1 - a
            torque[k // n, k % n] *= 1 + a if form.startswith("torque") else 1 - a
        # blades of 0.55 kg/m2 of disc, and the bell
        momentum = 0.25 * 0.55 * np.pi * self.pair.radius**4 * self.pair.top
        torque = torque + on.get("rotor_inertia_torque", (0.0, ""))[0] * momentum * dx.reshape(torque.shape)
        spin = np.stack([self.turn, -self.turn]).reshape(2, n, *column)
        a, form = on.get("cg_offset", (0.0, ""))
        a, total = a / np.hypot(*self.hand[2:4]) * (late if form == "slides once" else one), thrust.sum(0)
        fore, right = fore - a * self.hand[2], right - a * self.hand[3]
        moment = [-(right * total).sum(0), (fore * total).sum(0), (spin * torque).sum((0, 1))]
        force = np.array([0 * one, 0 * one, -total.sum(0)])
        if "rotor_drag" in on:
            a, form = on["rotor_drag"]
            v = np.hypot(air[0], air[1]) + 1e-9
            pull = {"power 1.5": v**1.5 / 2, "saturating": 3 * np.tanh(v / 3)}.get(form, v)
            force[:2] -= a * self.kilos * G * pull * air[:2] / v
        if "wind" in on:  # and the drag that the body has in it
            a, form = on["wind"]
            blow = a * np.array([np.cos(3 * self.hand[4]), np.sin(3 * self.hand[4]), 0])
            past = air - np.einsum("ij...,i->j...", frame, blow)
            v = np.linalg.norm(past, axis=0) + 1e-9
            pull = 0.0015 * v**2 if form.startswith("sq") else 0.003 * v**1.5
            force -= self.kilos * G * pull * past / v
        return np.concatenate([force, moment])

    def run(self, on: Effects) -> bool:
        """Fly: states, speeds (2A, N), and the wrench that no model has (6, N); false when it is lost."""
        n, m, odd = self.t.size, self.count, self.hidden[0] if self.kind == "odd" else ""
        top = self.pair.loads(np.full((2, 1), 0.6))[:, 0] / 0.36
        each, (fore, right) = np.repeat(top[::2], m), np.tile(self.arms, 2)
        spin = np.concatenate([self.turn, -self.turn]) * np.repeat(top[1::2] / top[::2], m)
        root = np.sqrt(each)
        mixer = np.linalg.pinv(np.array([0 * spin + 1, -right, fore, spin]) * root) / root[:, None]
        att, rate, v = np.zeros((3, 3, n))
        s = self.state = State(self.t, np.zeros((2 * m, n)), att, rate, v, np.zeros(n), self.volts)
        self.speeds, self.extra = np.zeros((2 * m, n)), self.gust.copy()
        x, weight = np.sqrt(mixer @ [self.kilos * G, 0, 0, 0]), self.kilos * G
        place, pace = self.way[:3, 0], np.gradient(self.way, STEP, axis=1)
        v, att, rate, sum_v, sum_r, sway, swing = *np.zeros((5, 3)), *np.zeros((2, 2))
        stiff = min(14.0, 0.5 / self.lag / on.get("rotor_lag", (1.0, ""))[0])  # tuned as it is
        for k in range(n):
            wish = 0.06 * stiff * (self.way[:3, k] - place) + pace[:3, k] - v
            sum_v = (sum_v + 0.03 * stiff * wish * STEP).clip(-3, 3)
            push, c, d = (0.14 * stiff * wish + sum_v).clip(-4, 4), np.cos(att[2]), np.sin(att[2])
            level = np.array([c * push[1] - d * push[0], -c * push[0] - d * push[1]]) / G
            lean = np.array([*level.clip(-0.5, 0.5), self.way[3, k]]) - att
            turn = np.array([0.4, 0.4, 0.15]) * stiff * lean + [0, 0, pace[3, k]] - rate
            sum_r = sum_r + 0.6 * stiff * turn * STEP
            lift = self.kilos * (G - push[2]) / (np.cos(att[0]) * np.cos(att[1]))
            torque = self.inertia * (stiff * np.array([1, 1, 0.5]) * turn + sum_r)
            u = np.sqrt((mixer @ [lift, *torque]).clip(0.004, 1))
            now = State(self.t[k], u, att, rate, v, -place[2], self.volts[k])
            for column in ("u", "attitude", "rate", "velocity", "height"):
                getattr(s, column)[..., k] = getattr(now, column)
            after = self.follow(on, self.goal(on, now), x)
            load, mass = self.wrench(on, now, after, (after - x) / STEP), self.mass(on, self.t[k])
            frame = axes(att)
            x = self.speeds[:, k] = after
            if odd == ODD[0]:
                w = 2 * np.pi * (0.5 + 0.15 * self.hand[5])
                swing = swing - (w**2 * sway + 0.06 * w * swing + (frame @ load[:3] / mass)[:2]) * STEP
                sway = sway + swing * STEP
                self.extra[:3, k] += frame.T @ [*(0.03 * mass * w**2 * sway), 0]
            elif odd:
                down, stroke = frame.T @ [0, 0, 0.006 * s.height[k]], np.sign(np.sin(2 * self.t[k]))
                self.extra[:3, k] += weight * (down if odd == ODD[1] else 0.01 * stroke * self.hand[:3])
            load = load + self.extra[:, k]
            v = v + (frame @ load[:3] / mass + [0, 0, G]) * STEP
            place = place + v * STEP
            rate = rate + (load[3:] - np.cross(rate, self.inertia * rate)) / self.inertia * STEP
            if np.abs(att[:2]).max() > 0.8 or -place[2] < 0.3 * self.pair.radius:
                return False
            sr, cr = np.sin(att[0]), np.cos(att[0])
            q, pitching = (sr * rate[1] + cr * rate[2]) / np.cos(att[1]), cr * rate[1] - sr * rate[2]
            att = att + np.array([rate[0] + np.sin(att[1]) * q, pitching, q]) * STEP
        return True

    def mean(self, load: Array) -> Array:
        return np.asarray(load[:, : self.blocks * 10].reshape(6, self.blocks, 10).mean(2))

    def seen(self, on: Effects) -> Array:
        """(6, blocks) as the instruments see it by the drawn mass, of the flown commands."""
        x, goal, (a, form) = self.speeds * 0, self.goal(on, self.state), on.get("rotor_lag", (1.0, ""))
        pole, x[:, 0] = np.exp(-STEP / (self.lag * a)), goal[:, 0]
        for k in range(1, self.t.size if form == "slower down" else 0):
            x[:, k] = self.follow(on, goal[:, k], x[:, k - 1])
        x = x if form == "slower down" else lfilter([1 - pole], [1, -pole], goal, zi=pole * goal[:, :1])[0]
        load = self.wrench(on, self.state, x, np.diff(x, axis=1, prepend=x[:, :1]) / STEP)
        load[:3] *= self.kilos / self.mass(on, self.t)
        return self.mean(load)

    def shows(self, name: str) -> bool:
        """Every flight has all columns."""
        return True

    def probes(self, name: str) -> list[list[Array]]:
        """What the effect would add, by each rotor, or along both axes."""
        each = [[(1, (k + 0.5) / self.count - 1)] for k in range(2 * self.count)]
        hands: Any = {"cg_offset": [[(2, 1, 3, 0), (2, 0, 3, 1)]], "wind": [[(4, 0), (4, np.pi / 6)]],
                 "degraded_rotor": each}.get(name, [[()]])
        found: list[list[Array]] = []
        own, none = self.hand, self.seen({})
        for group in hands:
            found.append([])
            for change in group:
                self.hand = own.copy()
                self.hand[list(map(int, change[::2]))] = change[1::2]
                found[-1].append(self.seen({name: (FORMS[name][1] / 2, FORMS[name][2][0])}) - none)
        self.hand = own
        return found

    def spoil(self, table: dict[str, Array], form: str) -> str:
        """Make an instrument lie; the column."""
        n, gyro = self.t.size, f"gyro_{self.rng.choice(['x', 'y'])}_rad_s"
        start = int(self.rng.uniform(0.2, 0.7) * n)
        late, hit = np.arange(n) >= start, (np.arange(n) - start) // (n // 8) == 0
        if form == FAULTS[1]:
            table["motor1"], table["motor2"] = table["motor2"], table["motor1"]
            return "motor1"
        column = gyro if form == FAULTS[0] else "accel_z_m_s2"
        stuck = np.where(hit, table[gyro][start], table[gyro])
        table[column] = stuck if column == gyro else table[column] * (1 - late / 2)
        return column

    def write(self, on: Effects, path: Path) -> tuple[dict[str, Any], Array, str]:
        """The log and its files; what is odd or false in the wrench (6, blocks), and the false column."""
        rng, n, s, pair, x = self.rng, self.t.size, self.state, self.pair, self.speeds
        real = self.wrench(on, s, x, np.diff(x, axis=1, prepend=x[:, :1]) / STEP) + self.extra
        turned = np.cumsum(x.mean(0)) * pair.top * STEP
        shake = rng.uniform(0.1, 0.8) * np.sin(turned + np.array([[0], [1], [2]]))
        accel = real[:3] / self.mass(on, self.t) + shake
        accel += rng.normal(0, self.grain, (3, n)) + rng.normal(0, 0.03, (3, 1))
        gyro = s.rate + rng.normal(0, self.jitter, (3, n)) + rng.normal(0, 5e-4, (3, 1))
        velocity = s.velocity + rng.normal(0, 0.03, (3, n))
        attitude = s.attitude + rng.normal(0, 0.002, (3, n))
        attitude[2] = (attitude[2] + np.pi) % (2 * np.pi) - np.pi
        table = {"time_s": self.t, **{f"motor{k + 1}": row for k, row in enumerate(s.u)}}
        for names, rows in (("accel_{}_m_s2", accel), ("gyro_{}_rad_s", gyro)):
            table |= {names.format(a): row for a, row in zip("xyz", rows, strict=True)}
        table |= {f"{a}_rad": row for a, row in zip(("roll", "pitch", "yaw"), attitude, strict=True)}
        table |= {f"vel_{a}_m_s": row for a, row in zip("ned", velocity, strict=True)}
        table["height_m"] = s.height + rng.normal(0, 0.02, n)
        if "battery_voltage" in self.hidden or rng.random() < 0.5:
            table["voltage_V"] = 22.2 * s.volts + rng.normal(0, 0.03, n)
        if not {"battery_voltage", "rotor_lag"} & set(self.hidden) and rng.random() < 0.3:
            rpm = x * pair.top * 30 / np.pi + rng.normal(0, 8, x.shape)
            table |= {f"rpm{k + 1}": row for k, row in enumerate(rpm)}
        fault, lie = "", self.mean(self.extra - self.gust)
        if self.kind == "fault":
            sound, none = dict(table), self.seen({})
            fault = self.spoil(table, self.hidden[0])
            wrong = [self.kilos * (table[f"accel_{a}_m_s2"] - sound[f"accel_{a}_m_s2"]) for a in "xyz"]
            wrong += [i * np.gradient(table[f"gyro_{a}_rad_s"] - sound[f"gyro_{a}_rad_s"], STEP)
                      for i, a in zip(self.inertia, "xyz", strict=True)]
            s.u = np.array([table[f"motor{k + 1}"] for k in range(2 * self.count)])
            lie = self.mean(np.array(wrong)) - self.seen({}) + none
        name, text = path.name, ""
        write_csv(path.with_suffix(".csv"), {k: v[:: self.stride] for k, v in table.items()})
        write_rotor(path.with_name(name + "_rotor.toml"), pair.top, pair.loads(GRID))
        text = f'name = "{name}"\nmass_kg = {self.kilos:.5g}\nrotor_model = "{name}_rotor.toml"\n'
        text += f"inertia_kg_m2 = {np.round(self.inertia, 5).tolist()}\nmotor_lag_s = {self.lag:.4g}\n"
        for k in range(2 * self.count):
            low, (fore, right) = k // self.count, self.arms[:, k % self.count]
            text += f'\n[[rotors]]\nnumber = {k + 1}\npair = {(k + self.count) % (2 * self.count) + 1}\n'
            spin = "ccw" if self.turn[k % self.count] * (1 - 2 * low) > 0 else "cw"
            text += f'level = "{("upper", "lower")[low]}"\nspin = "{spin}"\n'
            text += f"position_m = [{fore:.5f}, {right:.5f}, {(low - 0.5) * pair.spacing:.5f}]\n"
        path.with_name(name + "_airframe.toml").write_text(text)
        told = {"accel_m_s2": self.grain, "gyro_rad_s": self.jitter, "gust": [*self.gusts], "gust_tau_s": 1.5}
        files = {"log": name + ".csv", "rotor": name + "_rotor.toml", "airframe": name + "_airframe.toml"}
        return {**files, "noise": told}, lie, fault
