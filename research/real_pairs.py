"""Real pairs, from their stand map to a flight: the figures of README's table, held against the raw rows.

    python research/real_pairs.py [FOLDER] [--only mn4014] [--no-flight] [--json FILE] [--small]

FOLDER holds the coaxial maps of the shared data (default: ../shared/data/coax beside the repository). Of each
map: `identify`, `init` of an X8 that hovers at 45 % of the most thrust at equal commands, `compare`, tables
for PX4 and ArduPilot, a hover in a world that interpolates the raw rows under the standard, the fitted and
the exact law, `refine` and `health` of each. Beside it stands what the map itself says, by three surfaces
through its rows that share nothing with coaxlink's models: their median, and how far they are apart.

`--small` takes seconds: one map that is made here, of blades (momentum and blade-element theory), a bent
drive and a supply that sags.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
GRAVITY, G_TO_N, RAD_S = 9.80665, 9.80665e-3, math.pi / 30.0
SIDES = ("Left", "Right")  # upper, lower
POINT = 0.01
HOVER = 0.45  # of the most thrust at equal commands
WANDER_S, SMALL_S = 60.0, 30.0  # of the flights that refine and health see
STEMS = ("mn4014_16in", "propdrive_11in", "u5_16in")
INCHES = {"mn4014_16in": 16.2, "propdrive_11in": 11.0, "u5_16in": 16.2, "made": 16.2}
Array = NDArray[np.float64]
Surface = Callable[[Array], Array]  # of rows (n, 2)


@dataclass
class Row:
    """One map. W in hover; savings are shares of the standard table's, of shaft and of battery watts."""

    name: str
    weight_N: float = math.nan
    map_W: tuple[float, float] = (math.nan, math.nan)  # at equal commands, by the raw rows
    standard_W: tuple[float, float] = (math.nan, math.nan)  # as `compare` has it
    best: tuple[float, float] = (math.nan, math.nan)  # saving of the best split, by the raw rows
    apart: tuple[float, float] = (math.nan, math.nan)  # of that, by three surfaces
    fitted: tuple[float, float] = (math.nan, math.nan)  # as `compare` has it
    exact: tuple[float, float] = (math.nan, math.nan)
    ceiling: dict[str, float] = field(default_factory=dict)  # times the weight
    yaw_Nm: dict[str, float] = field(default_factory=dict)
    flown: dict[str, tuple[float, float]] = field(default_factory=dict)  # law: saving in flight
    verdicts: dict[str, str] = field(default_factory=dict)  # of refine and health, a law each
    weak: str = ""  # what refine names in a flight with rotor 1 at 90 % of its loads
    seconds: dict[str, float] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


class RawMap:
    """The rows of a map: loads and watts over both speeds, speeds over both PWM values, by surfaces."""

    def __init__(self, path: Path, surface: Callable[[Array, Array], Surface]) -> None:
        with path.open(newline="") as lines:
            head, *rows = list(csv.reader(lines))
        column = {name.strip(): np.array([float(r[i]) for r in rows]) for i, name in enumerate(head)}
        turning = column["PWM Left"] > 1001
        column = {name: values[turning] for name, values in column.items()}
        pwm = np.stack([column[f"PWM {side}"] for side in SIDES], axis=1)
        rpm = np.stack([column[f"Speed {side} [rpm]"] for side in SIDES], axis=1)
        self.low, self.high = float(pwm.min()), float(pwm.max())
        self._rpm = [surface(pwm, values) for values in rpm.T]
        self._surfaces: dict[str, list[Surface]] = {"thrust": [], "shaft": [], "battery": []}
        shaft, drawn = np.zeros_like(rpm), np.zeros_like(rpm)
        for k, (side, speed) in enumerate(zip(SIDES, rpm.T, strict=True)):
            torque = column[f"Torque {side} [Nm]"]
            torque = torque * np.sign(np.median(torque[np.abs(torque) > 0.1 * np.abs(torque).max()]))
            shaft[:, k] = torque * speed * RAD_S
            drawn[:, k] = column[f"Voltage {side} [V]"] * column[f"Current {side} [A]"]
        self.crosstalk = crosstalk(pwm, shaft, drawn)
        for k, side in enumerate(SIDES):
            other, own = drawn[:, 1 - k], shaft[:, k]
            true = (drawn[:, k] + self.crosstalk[k] * other) / (1.0 - math.prod(self.crosstalk))
            known = (other < 5.0 * own) & (own > 0.05 * own.max())  # elsewhere a reading may end at nothing
            true = np.where(known, true, np.maximum(own, 0.0) * np.median(true[known] / own[known]))
            loads = column[f"Thrust {side} [g]"] * G_TO_N, own, true
            for kind, values in zip(self._surfaces, loads, strict=True):
                self._surfaces[kind].append(surface(rpm, values))

    def at(self, kind: str, rpm: Array) -> Array:
        """Both sides' thrust (N), shaft or battery (W) together at speeds (rows, 2)."""
        return np.asarray(sum(surface(rpm) for surface in self._surfaces[kind]))

    def upper_thrust(self, rpm: Array) -> Array:
        """The upper rotor's thrust (N) at speeds (rows, 2)."""
        return self._surfaces["thrust"][0](rpm)

    def speeds(self, pwm: Array) -> Array:
        """(rows, 2) speeds at PWM values (rows, 2)."""
        return np.stack([surface(pwm) for surface in self._rpm], axis=1)

    def equal(self) -> tuple[float, float, float]:
        """(thrust of the pair in hover, shaft and battery watts of the pair) at equal commands."""
        pwm = np.repeat(np.linspace(self.low, self.high, 801)[:, None], 2, axis=1)
        rpm = self.speeds(pwm)
        thrust = self.at("thrust", rpm)
        wanted = HOVER * float(thrust.max())
        share = np.interp(wanted, thrust, np.arange(801.0))
        at = np.array([[np.interp(share, np.arange(801.0), speed) for speed in rpm.T]])
        return wanted, float(self.at("shaft", at)[0]), float(self.at("battery", at)[0])

    def least(self, thrust_N: float, kind: str) -> float:
        """The least watts of the pair for a thrust, over all splits of the map's range."""
        ends = [surface(np.full((1, 2), self.high))[0] for surface in self._rpm]
        upper, lower = (np.linspace(0.25 * end, end, 241) for end in ends)
        grid = np.stack(np.meshgrid(upper, lower, indexing="ij"), axis=-1)
        thrust = self.at("thrust", grid.reshape(-1, 2)).reshape(241, 241)
        points = []
        for i, row in enumerate(thrust):
            for j in np.flatnonzero((row[:-1] < thrust_N) & (row[1:] >= thrust_N)):
                share = (thrust_N - row[j]) / (row[j + 1] - row[j])
                points.append((upper[i], lower[j] + share * (lower[j + 1] - lower[j])))
        return float(self.at(kind, np.array(points)).min())


def crosstalk(pwm: Array, shaft: Array, drawn: Array) -> tuple[float, float]:
    """Of each side, watts that its reading lacks for each watt of the other's: at one command what it draws
    goes with its own shaft, and with nothing else. Rows (n, 2).
    """
    found = []
    for own, other in ((0, 1), (1, 0)):
        rows = (shaft[:, own] > 0.05 * shaft[:, own].max()) & (drawn[:, other] < 5.0 * shaft[:, own])
        parts = [rows & (pwm[:, own] == level) for level in np.unique(pwm[rows, own])]
        means = [np.stack([shaft[p, own], drawn[p, other], drawn[p, own]], axis=1) for p in parts]
        x = np.concatenate([m - m.mean(axis=0) for m in means])
        slope = np.linalg.lstsq(x[:, :2], x[:, 2], rcond=None)[0]
        found.append(float(-slope[1]))
    return found[0], found[1]


def plate(x: Array, y: Array) -> Surface:
    """A thin plate through rows (n, 2), as stiff as rows left out want it."""
    from scipy.interpolate import RBFInterpolator

    scale, part = x.max(axis=0), np.random.default_rng(0).permutation(len(y)) % 10

    def through(rows: NDArray[np.bool_], stiff: float) -> Surface:
        found = RBFInterpolator(
            x[rows] / scale, y[rows], smoothing=stiff, kernel="thin_plate_spline", degree=2
        )
        return lambda at: np.asarray(found(at / scale))

    def missed(stiff: float) -> float:
        every = (part == k for k in range(10))
        return sum(float(np.sum((through(~out, stiff)(x[out]) - y[out]) ** 2)) for out in every)

    return through(part >= 0, min(10.0 ** np.arange(-4.0, 1.5, 0.5), key=missed))


def polynomial(order: int) -> Callable[[Array, Array], Surface]:
    """All powers of both up to a total order, by least squares."""

    def made(x: Array, y: Array) -> Surface:
        scale = x.max(axis=0)

        def powers(at: Array) -> Array:
            u, v = (at / scale).T
            return np.stack([u**a * v**b for a in range(order + 1) for b in range(order + 1 - a)], axis=1)

        found = np.linalg.lstsq(powers(x), y, rcond=None)[0]
        return lambda at: np.asarray(powers(at) @ found)

    return made


def truth(path: Path) -> tuple[float, dict[str, list[float]], dict[str, list[float]]]:
    """Of four pairs: weight in hover (N); watts at equal commands and the best split's saving by surface."""
    weights, watts, savings = [], {"shaft": [], "battery": []}, {"shaft": [], "battery": []}
    for surface in (plate, polynomial(4), polynomial(5)):
        raw = RawMap(path, surface)
        thrust, shaft, battery = raw.equal()
        weights.append(4 * thrust)
        for kind, drawn in (("shaft", shaft), ("battery", battery)):
            watts[kind].append(4 * drawn)
            savings[kind].append(1.0 - raw.least(thrust, kind) / drawn)
    return float(np.median(weights)), watts, savings


def run(*words: Any) -> tuple[int, str, str]:
    """A verb in this process, which has loaded what it needs: its exit code, stdout, stderr."""
    from coaxlink.cli import main as verb

    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            verb([str(word) for word in words])
            code = 0
        except SystemExit as ended:
            code = int(ended.code or 0)
    return code, out.getvalue(), err.getvalue()


def coaxlink(*words: Any) -> str:
    """What a verb says on stdout. Raises RuntimeError with its stderr."""
    code, out, err = run(*words)
    if code not in (0, 1):
        raise RuntimeError(f"{words[0]}: exit {code}: {err.strip()[-300:]}")
    return out


def walk(path: Path, folder: Path, *, wander_s: float) -> Row:
    """The README's way with one map; `wander_s` 0 flies nothing."""
    row = Row(path.stem)
    row.weight_N, watts, savings = truth(path)
    row.map_W = (float(np.median(watts["shaft"])), float(np.median(watts["battery"])))
    row.best = (float(np.median(savings["shaft"])), float(np.median(savings["battery"])))
    row.apart = (float(np.ptp(savings["shaft"])), float(np.ptp(savings["battery"])))
    rotor, frame = folder / "rotor.toml", folder / "x8.toml"
    begun = time.perf_counter()
    coaxlink("identify", path, "--upper", "left", "--out", rotor)
    row.seconds["identify"] = time.perf_counter() - begun
    vehicle_file(path, rotor, frame, row.weight_N)
    begun = time.perf_counter()
    coaxlink("compare", frame, "--all", "--json", folder / "compare.json")
    row.seconds["compare"] = time.perf_counter() - begun
    tables = {t["table"]: t for t in json.loads((folder / "compare.json").read_text())["worth"]["tables"]}
    standard = tables["standard"]
    row.standard_W = _watts(standard)
    for label, name in (("fitted", "fitted"), ("exact", "exact, live")):
        if name in tables and tables[name]["hover_W"]:
            setattr(row, label, _saving(_watts(tables[name]), row.standard_W))
        else:
            row.problems.append(f"{label}: cannot")
    row.ceiling = {name: t["thrust_to_weight"] for name, t in tables.items()}
    row.yaw_Nm = {name: t["limits"][2]["moment_Nm"] for name, t in tables.items()}
    for firmware in ("px4", "ardupilot"):
        coaxlink("table", frame, "--firmware", firmware, "--law", "fitted", "--out", folder / firmware)
    if wander_s:
        fly_all(row, path, frame, rotor, folder, wander_s)
    return row


def vehicle_file(path: Path, rotor: Path, frame: Path, weight_N: float = math.nan) -> Path:
    """Write an X8 of four such pairs that hovers at `HOVER`, its arm by the size of the propellers."""
    if math.isnan(weight_N):
        weight_N = 4 * RawMap(path, polynomial(4)).equal()[0]
    stem = next((s for s in INCHES if path.stem.startswith(s)), "made")
    words = (
        "init", frame, "--template", "x8", "--mass", f"{weight_N / GRAVITY:.3f}", "--arm",
        f"{0.0254 * INCHES[stem] * 1.1:.3f}", "--spacing", "0.2", "--lag", "0.03", "--rotor", rotor,
    )  # fmt: skip
    coaxlink(*words)
    inertia = tomllib.loads(frame.read_text())["inertia_kg_m2"]  # the world's own: its owner has measured it
    coaxlink(*words, "--inertia", ",".join(map(str, inertia)), "--force")
    return frame


def fly_all(row: Row, path: Path, frame: Path, rotor: Path, folder: Path, wander_s: float) -> None:
    """A hover in the raw map's world under each law, then a wandering flight through refine and health."""
    from coaxlink.mixer.exact.native import NativeExact
    from coaxlink.tables.px4 import report_px4
    from coaxlink.vehicle import load_vehicle
    from sim.effects import HiddenEffect
    from sim.flights import write_flight
    from sim.physics.rotors import read_pair
    from sim.quick.flight import FlightWorld, fly_quick, make_design
    from sim.vehicle import read_vehicle

    vehicle, pair = load_vehicle(frame, rotor), read_pair(path)
    mixers: dict[str, Any] = {law: report_px4(vehicle, law).params for law in ("standard", "fitted")}
    mixers["exact"] = NativeExact(vehicle)
    watts = {}
    for law, mixer in mixers.items():
        design = make_design(read_vehicle(frame), pair, mixer)
        hover, _ = fly_quick(design, FlightWorld(plan="hover", seconds=30.0))
        if hover.failsafe:
            row.problems.append(f"{law}: {hover.failsafe} in hover")
        watts[law] = (hover.shaft_W, hover.pack_W)
        flown, columns = fly_quick(design, FlightWorld(plan="wander", seconds=wander_s, seed=3), 4)
        if flown.failsafe:
            row.problems.append(f"{law}: {flown.failsafe} in flight")
            continue
        log = folder / f"{law}.csv"
        write_flight(log, columns)
        row.verdicts[law] = " / ".join(verdicts(log, frame, rotor, folder))
    worn = HiddenEffect("degraded_rotor", 0.1, 0.0, {"rotor": 1.0})
    design = make_design(read_vehicle(frame), pair, mixers["fitted"])
    _, columns = fly_quick(design, FlightWorld((worn,), plan="wander", seconds=wander_s, seed=3), 4)
    log = folder / "weak.csv"
    write_flight(log, columns)
    row.weak = next(verdicts(log, frame, rotor, folder))
    row.flown = {law: _saving(w, watts["standard"]) for law, w in watts.items() if law != "standard"}


def verdicts(log: Path, frame: Path, rotor: Path, folder: Path) -> Iterator[str]:
    """What `refine` and `health` say of a sound flight."""
    answer = folder / "answer.json"
    try:
        coaxlink("refine", log, "--airframe", frame, "--rotor", rotor, "--json", answer)
        found = json.loads(answer.read_text())
        reported = [
            " ".join([e["name"], *(f"{p['value']:.0f}" for p in e["parameters"] if p["name"] == "rotor")])
            for e in found["effects"]
        ]
        reported += ["|".join(a["names"]) for a in found["ambiguous"]]
        reported += [f"unexplained {u['channel']}" for u in found["unexplained"]]
        yield ", ".join(reported) or "nothing"
    except RuntimeError as error:
        yield str(error)
    try:
        coaxlink("health", log, "--airframe", frame, "--rotor", rotor, "--json", answer)
        yield str(json.loads(answer.read_text()).get("verdict", "?"))
    except RuntimeError as error:
        yield str(error)


def _watts(table: dict[str, Any]) -> tuple[float, float]:
    return float(table["hover_W"]), float(table["battery_W"] or math.nan)


def _saving(watts: tuple[float, float], standard: tuple[float, float]) -> tuple[float, float]:
    return 1.0 - watts[0] / standard[0], 1.0 - watts[1] / standard[1]


def made_map(path: Path, seed: int = 1) -> Path:
    """A map of a pair of blades (`sim.physics.bemt`) with drives of our own; as the real ones are written.

    The motor: V t^0.9 = K w + R (Q + friction) / K, its lower one let go by the ESC where the wake turns it;
    amps from the motor's own current; the supply falls by its resistance.
    """
    from sim.physics.rotors import read_pair

    random, pair = np.random.default_rng(seed), read_pair(Path("kde5215_bemt"))
    top = pair.speed_max_rpm * RAD_S
    kv, ohm, friction, supply, source = 22.0 / (1.28 * top), 0.11, 0.004, 22.4, 0.03

    command = np.array([(a, b) for b in np.linspace(0.07, 0.95, 10) for a in np.linspace(0.07, 0.95, 10)]).T
    w, amps = np.full(command.shape, 0.3 * top), np.zeros(command.shape)  # upper, lower
    for _ in range(300):  # until they settle
        torque = pair.loads(w[0] / top, w[1] / top)[[1, 3]]
        current = ((supply - source * amps) * command**0.9 - kv * w) / ohm
        current = np.where(torque < 0.0, np.maximum(current, 0.0), current)  # no braking
        w = np.maximum(w + 0.02 * top * np.clip(kv * current - torque - friction, -1.0, 1.0), 0.0)
        amps = np.maximum(current, 0.0) * command
    names = ("PWM {0}", "Thrust {0} [g]", "Torque {0} [Nm]", "Voltage {0} [V]", "Current {0} [A]")
    names += ("Speed {0} [rpm]",)
    head = [n.format(side) for n in names for side in ("Left", "Right")]

    def noise(size: float) -> Array:
        return size * random.standard_normal(command.shape)

    loads = pair.loads(w[0] / top, w[1] / top)
    columns = (
        1000 + 1000 * command, loads[[0, 2]] / G_TO_N + noise(3.0),
        loads[[1, 3]] * [[-1.0], [1.0]] + noise(5e-4), supply - source * amps + noise(0.01),
        amps + 0.15 + noise(0.02), w / RAD_S + noise(5.0),
    )  # fmt: skip
    rows = np.concatenate([np.stack(column) for column in columns]).T
    text = [",".join(head), *(",".join(f"{x:.6f}" for x in row) for row in rows)]
    path.write_text("\n".join(text) + "\n")
    return path


def show(rows: list[Row]) -> None:
    """The table."""
    print("| map | hover N | W map | compare | best split | fitted | exact | flown | verdicts | weak | s |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for r in rows:
        flown = ", ".join(_percents(r.flown[law]) for law in ("fitted", "exact") if law in r.flown)
        off = ", ".join(f"{100 * (a / b - 1):+.1f}" for a, b in zip(r.standard_W, r.map_W, strict=True))
        best = f"{_percents(r.best)} ({_percents(r.apart)})"
        cells = [
            r.name,
            f"{r.weight_N:.0f}",
            f"{r.map_W[0]:.0f}, {r.map_W[1]:.0f}",
            f"{off} %",
            best,
            _percents(r.fitted),
            _percents(r.exact),
            flown,
            "; ".join(r.verdicts.values()),
            r.weak,
            ", ".join(f"{s:.1f}" for s in r.seconds.values()),
        ]
        print(f"| {' | '.join(cells)} |")
        for problem in [*r.problems, *missed(r)]:
            print(f"|   | {problem} |")


def summary(rows: list[Row]) -> None:
    """The table of the README."""
    print("| pair | hover | *fitted* saves | exact saves | best split | ceiling | yaw |")
    print("|---|---|---|---|---|---|---|")
    laws = ("standard", "fitted", "exact, live")
    for r in rows:
        stem, _, spacing = r.name.rpartition("_zD")
        far = f"{spacing[0]}.{spacing[1:]}" if len(spacing) > 1 else spacing
        best = " / ".join(f"{100 * b:.1f} ± {50 * a:.1f}" for b, a in zip(r.best, r.apart, strict=True))
        ceiling, yaw = (
            ", ".join(f"{values.get(law, math.nan):.2f}" for law in laws) for values in (r.ceiling, r.yaw_Nm)
        )
        saved = (" / ".join(f"{100 * s:.1f}" for s in law) for law in (r.fitted, r.exact))
        watts = f"{r.standard_W[1]:.0f} W"
        print(f"| {' | '.join([f'{stem}, z/D {far}', watts, *saved, best, ceiling, yaw])} |")


def missed(r: Row) -> Iterator[str]:
    """What was asked for and is not there, one line each."""
    kinds = (("shaft", 0.03), ("battery", 0.04))
    for k, (kind, most) in enumerate(kinds):
        off = r.standard_W[k] / r.map_W[k] - 1.0
        if abs(off) > most:
            yield f"standard table's {kind} power {100 * off:+.1f} % off the map's"
        for law, printed in (("fitted", r.fitted), ("exact", r.exact)):
            if law in r.flown and abs(r.flown[law][k] - printed[k]) > POINT:
                both = f"{100 * printed[k]:.1f} % printed, {100 * r.flown[law][k]:.1f} flown"
                yield f"{law}: {kind} saving {both}"
    if r.exact[0] < r.fitted[0] - 0.003:
        yield "exact: more shaft power than the fitted table"
    if abs(r.exact[0] - r.best[0]) > POINT + r.apart[0]:
        yield f"exact: shaft saving {100 * r.exact[0]:.1f} %, the map's best split {100 * r.best[0]:.1f}"
    best = max(r.ceiling.values(), default=math.nan)
    if r.ceiling.get("exact, live", math.nan) < 0.98 * best:
        yield f"exact: ceiling {r.ceiling['exact, live']:.2f}, best {best:.2f}"
    for law, verdict in r.verdicts.items():
        if verdict != "nothing / sound":
            yield f"{law}: refine and health of a sound flight: {verdict}"
    if r.weak not in ("", "degraded_rotor 1"):
        yield f"a rotor at 90 %: {r.weak}"


def _percents(pair: tuple[float, float]) -> str:
    return "/".join(f"{100 * p:.1f}" for p in pair)


def main() -> int:
    """1 where the small map misses something, or a figure of another is none."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "folder", nargs="?", type=Path, default=HERE.parent.parent / "shared" / "data" / "coax"
    )
    parser.add_argument("--only", default="")
    parser.add_argument("--no-flight", action="store_true")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--small", action="store_true")
    o = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        if o.small:
            paths = [made_map(Path(scratch) / "made_zD07.csv")]
        else:
            every = sorted(p for s in STEMS for p in o.folder.glob(f"{s}_zD*.csv") if p.stem.count("_") == 2)
            paths = [p for p in every if o.only in p.stem]
        for path in paths:
            folder = Path(scratch) / path.stem
            folder.mkdir()
            wander_s = 0.0 if o.no_flight else SMALL_S if o.small else WANDER_S
            rows.append(walk(path, folder, wander_s=wander_s))
            show(rows[-1:])
    print()
    show(rows)
    print()
    summary(rows)
    if o.json:
        o.json.write_text(json.dumps([asdict(r) for r in rows], indent=1))
    return int(any(r.problems or (o.small and [*missed(r)]) for r in rows))


if __name__ == "__main__":
    sys.exit(main())
