"""Stand logs of one pair, as people run them, with something hidden in them."""

# fmt: off
from pathlib import Path
from typing import Any

import numpy as np
from pair import AIR, GRID, LOADS, Array, Effects, G, Pair, Rng, noise, terms, write_csv, write_rotor

FORMS: dict[str, tuple[float, float, tuple[str, ...]]] = {  # least and largest amount, forms
    "battery_voltage": (0.6, 1.2, ("motor", "governed until full duty", "exponent 0.6 in speed")),
    "motor_heating": (0.4, 1.8, ("resistance", "cut back above 45 K", "winding ahead of its case")),
    "rotor_lag": (0.012, 0.6, ("first order", "two stages", "slower down", "pure delay", "limited rate")),
    "dead_band": (0.015, 0.14, ("stretched", "cut off", "soft knee")),
    "air_density": (1.0, 1.0, ("ideal gas", "with Reynolds number")),
    "sensor_drift": (0.005, 0.15, ("warm-up of the zero", "linear zero", "span")),
    "lower_on_upper_interference": (0.05, 0.8, ("induced", "saturating in the ratio", "exponent 1.3")),
    "blade_speed_law": (0.03, 0.4, ("exponent above 2", "compressible", "stall near the top")),
    "hysteresis": (0.006, 0.12, ("narrow play", "wide play", "play growing with load")),
    "rotor_spacing": (1.0, 1.0, ("wake",))}
COLUMN = {"battery_voltage": "volts", "motor_heating": "warm", "air_density": "rho",
          "rotor_spacing": "spacing"}
DRIVEN = {"battery_voltage", "motor_heating", "rotor_lag", "dead_band"}  # shown by throttle alone
ODD = ("resonance", "beat of equal speeds", "room fan", "unlogged events", "wake jump over the speed ratio")
FAULTS = ("tachometer halves", "cell at its stop", "frozen torque", "kgf for N", "exchanged cells",
          "sign of torque")
TWO = (("battery_voltage", "motor_heating"), ("rotor_lag", "dead_band"), ("air_density", "rotor_spacing"),
       ("sensor_drift", "lower_on_upper_interference"), ("hysteresis", "sensor_drift"),
       ("blade_speed_law", "air_density"), ("battery_voltage", "rotor_lag"), ("rotor_spacing", "hysteresis"))
RIVALS = (("battery_voltage", "motor_heating"), ("motor_heating", "battery_voltage"),  # hidden, as good
          ("air_density", "battery_voltage"), ("rotor_lag", "hysteresis"))


def lagged(x: Array, t: Array, tau: float, form: str) -> Array:
    """Speeds (2, N) behind x, which is a ramp between rows."""
    if form == "pure delay":
        return np.array([np.interp(t - tau, t, row) for row in x])
    stages = 2 if form == "two stages" else 1
    for _ in range(stages):
        y = x.copy()
        for k in range(1, t.size):
            gap, dt = y[:, k - 1] - x[:, k], t[k] - t[k - 1]
            late = tau / stages * np.where((gap > 0) & (form == "slower down"), 2.2, 1.0)
            ramp = late * (x[:, k] - x[:, k - 1]) / dt
            y[:, k] = x[:, k] - ramp + (y[:, k - 1] - x[:, k - 1] + ramp) * np.exp(-dt / late)
            if form == "limited rate":
                y[:, k] = y[:, k - 1] - np.clip(gap, -0.12 * dt / tau, 0.12 * dt / tau)
        x = y
    return x


def behind(x: Array, reach: float) -> Array:
    """How far a play operator is behind x (2, N), over its reach."""
    y = x.copy()
    for k in range(1, x.shape[1]):
        y[:, k] = np.clip(y[:, k - 1], x[:, k] - reach, x[:, k] + reach)
    return (y - x) / reach


def schedule(rng: Rng, kind: str) -> tuple[Array, Array]:
    """Times (N,) and set-points (2, N), as people run a stand."""
    if kind == "grid":  # every pair of levels, in turn or shuffled, some rows each
        level = np.linspace(rng.uniform(0.06, 0.25), rng.uniform(0.85, 1), rng.integers(6, 9))
        points = np.array([(a, b) for k, a in enumerate(level) for b in level[:: (-1) ** k]])
        points = rng.permutation(points) if rng.random() < 0.5 else points
        demand = np.repeat(points, rng.integers(8, 14), 0).T
        return np.arange(demand.shape[1]) * 0.5, demand
    if kind in ("steps", "endurance"):  # random levels by hand: for seconds, or half minutes
        dt, hold = (0.05, (0.8, 2.5)) if kind == "steps" else (0.7, (12.0, 45.0))
        t = np.arange(1200) * dt
        rows = [np.searchsorted(np.cumsum(rng.uniform(*hold, 999)), t) for _ in "ul"]
        levels = [np.pad(rng.uniform(0.1, 0.97, 999)[r], 6, "edge") for r in rows]
        return t, np.array([np.convolve(level, np.ones(13) / 13, "valid") for level in levels])
    if kind == "creep":  # both up together, slowly, once
        t = np.arange(500) * 0.3
        return t, np.array([[0.4], [0.42]]) + 0.45 * t / t[-1] + rng.normal(0, 2e-4, (2, t.size)).cumsum(1)
    t, ratio = np.arange(1100) * 0.25, rng.permutation(np.resize([0.6, 0.8, 1.0, 1.15], 40))
    lap = t / rng.uniform(16, 30)  # triangles, each with another ratio of the lower rotor
    up = 0.18 + 0.75 * np.abs(lap % 1 * 2 - 1)
    return t, np.array([up, (up * (1.0 if kind == "saw" else ratio[lap.astype(int)])).clip(0.1, 1)])


class Scene:
    """A pair, what the operator set and what the room did: rows of time N."""

    def __init__(self, rng: Rng, kind: str, hidden: tuple[str, ...]) -> None:
        self.rng, self.pair, self.hidden, self.kind = rng, Pair.draw(rng), hidden, kind
        governed = {*list(FORMS)[6:8], "rotor_spacing", FAULTS[0]} & set(hidden)
        self.throttle = bool(DRIVEN & set(hidden)) or (not governed and rng.random() < 0.25)
        self.rival, lag = kind == "ambiguous", "rotor_lag" in hidden
        way = "sweeps" if "hysteresis" in hidden else str(rng.choice(["grid", "grid", "endurance", "sweeps"]))
        way = ("saw" if lag else "creep") if self.rival else "steps" if lag else way
        t, x = self.t, self.demand = schedule(rng, way)
        load, one = np.mean(x**3, 0), np.ones(t.size)
        used, self.warm = np.cumsum(load) / load.sum(), np.zeros(t.size)
        for k in range(1, t.size):  # one thermal mass
            self.warm[k] = self.warm[k - 1] + 4 * t[1] / t[-1] * (120 * load[k] - self.warm[k - 1])
        sags = "battery_voltage" in hidden or not self.throttle
        sag = 0.18 * rng.uniform(0.4, 1) ** 2 * used + rng.uniform(0.005, 0.05) * load - 0.02
        self.volts, self.rho, self.spacing = one - sags * sag, AIR * one, self.pair.spacing * one
        if "air_density" in hidden:
            door = 1 / (1 + np.exp(8 - 20 * t / t[-1])) if rng.random() < 0.5 else np.sin(5 * t / t[-1])
            self.rho = AIR * 288 / (288 + 25 * rng.uniform(0.3, 1) ** 2 * rng.choice([-1, 1]) * door)
        if self.rival and not lag:  # a big motor in a closed room: all goes with the energy used
            self.volts, self.warm = 1 - rng.uniform(0.04, 0.12) * used, 40 * used
            self.rho = AIR * 288 / (288 + 12 * used) if "air_density" in hidden else self.rho
        if "rotor_spacing" in hidden:
            self.spacing *= rng.permutation([0.6, 1.0, 1.7, 2.6])[np.arange(t.size) * 4 // t.size]
        self.cells = rng.choice([-1, 1], 4) * rng.uniform(0.4, 1, 4) * (rng.random(4) < 0.6)  # how they drift
        self.cells[rng.integers(4)] = 1.0
        self.resistive = rng.uniform(0.08, 0.2)
        flat, own, self.full = np.ones(GRID.shape[1]), self.__dict__.copy(), np.ones(4)
        self.__dict__ |= {"t": flat.cumsum(), "demand": GRID, "volts": flat, "warm": 0 * flat}
        self.map = self.seen({})
        self.__dict__ |= own | {"full": self.map.max(1)}
        white = self.full * rng.uniform([0.003, 0.004] * 2, [0.008, 0.012] * 2) * np.sqrt(0.5 / (t[1] - t[0]))
        drift, ring = rng.uniform(0, [0.5, 0.8]) * rng.integers(0, 2, 2)
        self.noise = [(w, w * drift, rng.uniform(8, 40), w * ring, rng.uniform(0.3, 3)) for w in white]
        self.factors = [noise(t, *n) for n in self.noise]
        needs = {"dead_band", "blade_speed_law"} & set(hidden) or kind in ("odd", "ambiguous")
        self.modelled = bool(needs) or rng.random() < 0.6
        maps = [np.stack([one, *terms(x, 4, lower).values()], 1) for lower in (False, False, True, True)]
        self.free = [np.stack([one, row], 1) for row in self.seen({})] if self.modelled else maps

    def run(self, on: Effects) -> bool:
        """Nothing moves by itself here."""
        return True

    def seen(self, on: Effects) -> Array:
        """(4, N) as the cells feel them, without noise."""
        x, rho = self.demand, self.rho if "air_density" in on else AIR + 0 * self.t
        all_on = {n: on.get(n, (0.0, "")) for n in FORMS}
        amount, form = {n: a for n, (a, _) in all_on.items()}, {n: f for n, (_, f) in all_on.items()}
        b, f = all_on["dead_band"]
        if b:
            soft, cut = x * (1 - np.exp(-((x / (2 * b)) ** 3))), np.where(x < b, 0.02, x)
            x = {"soft knee": soft, "cut off": cut}.get(f, (x - b).clip(0) / (1 - b))
        if self.throttle:  # duty on a motor with a winding: v d = (1 - r) x + r hot dense x^2
            a, f = all_on["motor_heating"]
            v = 1 + amount["battery_voltage"] * (self.volts - 1)
            v = np.minimum(v / x.clip(1e-3), 1) if form["battery_voltage"].startswith("gov") else v
            v = v**0.6 if form["battery_voltage"].startswith("exp") else v
            x = x * (1 - 0.002 * a * (self.warm - 45).clip(0)) if f.startswith("cut") else x
            ahead = 25 * np.gradient(self.warm, self.t) if f.startswith("winding") else 0
            hot = 1 + 0.0039 * a * (self.warm + ahead) * (not f.startswith("cut"))
            lin, square = 1 - self.resistive, self.resistive * hot * rho / AIR
            x = (np.sqrt(lin**2 + 4 * square * v * x) - lin) / (2 * square)
        x = lagged(x, self.t, *on["rotor_lag"]) if "rotor_lag" in on else x
        s, f = all_on["lower_on_upper_interference"]
        y = self.pair.loads(x, rho, self.spacing if "rotor_spacing" in on else 0.0, s * (f == "induced"))
        if form["air_density"].startswith("with"):
            y = y * (rho / AIR) ** np.array([[0.15], [-0.1], [0.15], [-0.1]])
        y[0] *= 1 - 0.3 * s * np.tanh(1.5 * (x[1] / (x[0] + 0.05)) ** 2) * f.startswith("sat")
        y[0] -= 0.25 * s * self.full[0] * x[1] ** 1.3 * x[0] ** 0.7 * f.startswith("exp")
        b, mach, u = amount["blade_speed_law"], x * self.pair.top * self.pair.radius / 340, x + 0.02
        fast, stall = 1 + 12 * b * (mach - 0.3).clip(0) ** 2, 1 - b / (1 + np.exp((0.85 - x) / 0.05))
        law = {"exponent above 2": (u**b, u ** (-0.4 * b)), "compressible": ((1 - mach**2) ** (-2 * b), fast)}
        gain, drag = law.get(form["blade_speed_law"], (stall, 1 + 0 * x))
        y = y * np.array([gain[0], drag[0], gain[1], drag[1]])
        if h := amount["hysteresis"]:
            late = behind(x, 0.25 if form["hysteresis"].startswith("wide") else 0.02)
            grows = form["hysteresis"].endswith("load")
            y = y + h * np.repeat(late, 2, 0) * (1.5 * y if grows else 0.6 * self.full[:, None])
        (d, f), s = all_on["sensor_drift"], self.t / self.t[-1]
        course = 1 - np.exp(-4 * s) if f.startswith("warm") else s
        return y + d * self.cells[:, None] * course * (2 * y if f == "span" else self.full[:, None])

    def shows(self, name: str) -> bool:
        """Could this log show that effect at all?"""
        return (self.throttle or name not in DRIVEN) and bool(np.ptp(getattr(self, COLUMN.get(name, "t"))))

    def probes(self, name: str) -> list[list[Array]]:
        """What the effect would add, of its forms: to each cell by its own amount, or to all loads by one."""
        cells, self.cells = self.cells, np.ones(4)
        adds = [self.seen({name: (FORMS[name][1] / 2, form)}) - self.seen({}) for form in FORMS[name][2]]
        self.cells = cells
        each = name in ("sensor_drift", "hysteresis")
        return [[a * (np.arange(4) == k)[:, None] for a in adds for k in range(4)]] if each else [adds[:1]]

    def odd(self, form: str) -> tuple[Array, dict[str, Array]]:
        """Factor (4, N) of the loads and further columns."""
        rng, x, t, gain = self.rng, self.demand, self.t, np.ones((4, self.t.size))
        size, row = rng.uniform(0.04, 0.12), int(rng.choice([0, 2]))
        if form == "resonance":
            gain[row] += size * np.exp(-(((x[row // 2] - rng.uniform(0.55, 0.8)) / 0.04) ** 2))
        elif form.startswith("beat"):
            gain[2:] -= size * np.exp(-(((x[0] - x[1]) / 0.03) ** 2))
        elif form.startswith("room"):
            fan = rng.permutation(np.resize([0.0, 1.5, 3.0, 4.5], 12))[np.arange(t.size) * 12 // t.size]
            return gain + np.array([[1], [-0.3], [0.6], [-0.1]]) * size * (fan / 4.5) ** 2, {"fan_m_s": fan}
        elif form.startswith("unlogged"):
            for at in rng.uniform(0.05, 0.95, 5) * t[-1]:
                gain[row : row + 2] -= size * (np.abs(t - at) < rng.uniform(0.01, 0.03) * t[-1])
        else:
            gain[2] -= size / (1 + np.exp((1.15 - x[0] / x[1]) / 0.03))
        return gain, {}

    def spoil(self, table: dict[str, Array], form: str) -> str:
        """Make an instrument lie; the column."""
        n, side, other = self.t.size, *self.rng.permutation(["upper", "lower"])
        start = int(self.rng.integers(n // 5, n // 2))
        column = f"{side}_{'rpm' if form == FAULTS[0] else 'torque_Nm' if 'torque' in form else 'thrust_N'}"
        rows = np.arange(n) // (n // self.rng.integers(6, 30)) == 4
        rows = np.arange(n) >= start if form == FAULTS[3] else rows
        old, swap = table[column].copy(), f"{other}_thrust_N"
        stop, stuck = old.clip(None, 0.65 * old.max()), old[rows][0] + 0 * old
        new = dict(zip(FAULTS, (old / 2, stop, stuck, old / G, table[swap], -old), strict=True))[form]
        table[column] = new if form == FAULTS[1] else np.where(rows, new, old)
        table[swap] = np.where(rows, old, table[swap]) if form == FAULTS[4] else table[swap]
        return column

    def write(self, on: Effects, path: Path) -> tuple[dict[str, Any], Array, str]:
        """The log, its rotor file; what is odd or false in the loads (4, N), and the false column."""
        rng, n, calm, fault = self.rng, self.t.size, self.seen(on), ""
        gain, further = self.odd(self.hidden[0]) if self.kind == "odd" else (np.ones((4, 1)), {})
        zero = self.full[:, None] * rng.normal(0, 1e-3, (4, 1))
        read = calm * gain * (1 + rng.normal(0, 0.006, (4, 1))) + zero
        read += np.stack([f @ rng.normal(size=n) for f in self.factors])
        turn = self.pair.top * 30 / np.pi * self.demand * (1 + rng.normal(0, 2e-4, (2, n)))
        what, speed = ("throttle", self.demand) if self.throttle else ("rpm", turn)
        table = {"time_s": self.t, f"upper_{what}": speed[0], f"lower_{what}": speed[1]}
        table |= {**dict(zip(LOADS, read, strict=True)), **further}
        air, moves = 287.05 * 288 * AIR, "air_density" in self.hidden
        table["voltage_V"] = rng.choice([14.8, 22.2, 44.4]) * self.volts + rng.normal(0, 0.02, n)
        if not (self.rival and moves):
            table["motor_temperature_C"] = 20 + self.warm + rng.normal(0, 0.3, n)
        table["air_temperature_C"] = 288 * AIR / self.rho - 273.15 + rng.normal(0, 0.1, n)
        table["air_pressure_Pa"] = air + rng.normal(0, 15, n)
        table |= {"rotor_spacing_m": self.spacing} if "rotor_spacing" in self.hidden else {}
        lie = calm * (gain - 1)
        if self.kind == "fault":
            sound = dict(table)
            fault = self.spoil(table, self.hidden[0])
            lie = np.array([table[c] - sound[c] for c in LOADS])
            if fault.endswith("rpm"):
                self.demand = self.demand * [table[c] / sound[c] for c in ("upper_rpm", "lower_rpm")]
                lie = self.seen(on) - calm
        write_csv(path.with_suffix(".csv"), table)
        if self.modelled:
            write_rotor(path.with_name(path.name + "_rotor.toml"), self.pair.top, self.map)
        keys = ("white", "drift", "drift_tau_s", "ring", "ring_Hz")
        made: dict[str, Any] = {"log": path.name + ".csv"}
        made |= {"rotor": path.name + "_rotor.toml"} if self.modelled else {}
        each = zip(LOADS, self.noise, strict=True)
        made["noise"] = {c: dict(zip(keys, map(float, v), strict=True)) for c, v in each}
        return made, lie, fault
