"""`fly --plan split` flown on stand-ins, in worlds of raw stand maps: what it finds, and what is true there.

    python research/split_flown.py [FOLDER] [--only mn4014_16in_zD055] [--ways px4 module ardupilot]
        [--seeds 1] [--reach 0.12] [--felt 3] [--on-board 0.51] [--flat] [--keep DIR] [--small]

FOLDER holds the coaxial maps of the shared data (default: ../shared/data/coax beside the repository). Of
each map: `identify` and `init` as a user runs them, then an X8 of four such pairs whose world interpolates
the raw rows, with gusts of 1 m/s around a wind of 2 m/s, windings that warm, a pack that sags, and a power
module that reads 6 % and 0.7 A too much, late, with 0.4 A of noise in steps of 0.1 A. It hovers twice six
minutes, the second time with a fresh pack and `--after`, by the verb `fly`, on the stand-in PX4 1.13, on PX4
1.16 with the module, on ArduCopter with the script; everything in memory on one virtual clock. The logs of
the second flight go through `identify`, `refine` and `health`.

Gusts push that vehicle and do not change what its rotors lift, unless `--felt` says by how much
(`axial_inflow` of the simulator; 3 is 2 % of thrust for half a metre a second up).

What is true is the world's own: watts of the pair over the share at the hover's thrust, by its tables; the
share that a level really gives is the plant's, as it was flown. `--flat` puts another map in the place of
each: its loads, and watts that are least where both motors have the same command, by a law that no model of
coaxlink has. `--small` takes a minute: one hover of 4.2 minutes on a map that is made here.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import re
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from real_pairs import GRAVITY, coaxlink, made_map, run, vehicle_file, verdicts

from coaxlink.cli.sim import coax_firmware
from coaxlink.live.onboard.ardupilot import SCRIPT_NAME, bridge_script
from coaxlink.live.onboard.description import board_law
from coaxlink.live.onboard.px4 import module_files
from coaxlink.mixer.split import table_of
from coaxlink.tables.ardupilot import report_ap
from coaxlink.vehicle import load_vehicle

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "tests" / "helpers"))
from live_flight import Flight  # noqa: E402
from memory_net import plugged  # noqa: E402

from sim.simulation import Simulation as SimWorld  # noqa: E402
from sim.simulation import build_plant  # noqa: E402
from sim.truth import Truth  # noqa: E402
from sim.vehicle import LOWER  # noqa: E402

MAPS = ["mn4014_16in_zD055", "propdrive_11in_zD07", "u5_16in_zD03"]  # one of each motor
MINUTES = 6.0  # of each of two flights
WARM_ROWS, WARM_S = (
    41,
    8.0,
)  # shares at which windings are looked at, in turn: they stay as warm as on average
EVERY = 25  # ticks between two looks at the plant
TRUTH = """
[[effects]]
name = "wind"
size = 2.0
gust_m_s = 1.0
direction_deg = 60.0

[[effects]]
name = "motor_heating"
size = 0.02

[[effects]]
name = "power_module"
size = 0.06
offset_A = 0.7
delay_s = 0.4
noise_A = 0.4
step_A = 0.1
"""
FELT = """
[[effects]]
name = "axial_inflow"
size = {}
"""


class Watched(Flight):
    """A flight whose plant is looked at as it goes: seconds, share from above, W, driven or not."""

    def __init__(self, vehicle: Any, gusts: int, **world: Any) -> None:
        self.vehicle, self.seen = vehicle, []
        self._ticks = 0
        super().__init__(airborne=False, **world)
        self.autopilot.truth = Truth(self.autopilot.truth.effects, gusts)  # other gusts

    def _tick(self) -> None:
        super()._tick()
        self._ticks += 1
        plant = self.autopilot.plant
        if self._ticks % EVERY == 0 and self.autopilot.armed:
            upper = np.asarray(plant.vehicle.level) != LOWER
            share = plant.thrust[upper].sum() / max(plant.thrust.sum(), 1e-9)
            self.seen.append((plant.time_s, share, plant.rotor_watts().sum(), self.driven, plant.height))
        del self.rows[:-1000]


class Module(Watched):
    firmware = "px4:1.16"

    def prepare(self) -> None:
        a, about = self.autopilot, board_law(self.vehicle)
        a.firmware_module = coax_firmware(self.vehicle)
        a.store.write("MPC_THR_HOVER", 9, about.hover)
        a.files.files["etc/extras.txt"] = module_files(about, "research")["etc/extras.txt"].encode()
        a.boot()


class Copter(Watched):
    firmware = "ardupilot"
    table: float | None = None  # share of the table on board

    def prepare(self) -> None:
        a, texts = self.autopilot, {SCRIPT_NAME: bridge_script(8)}
        a.scripts_start_s = 0.0
        a.store.write("SCR_ENABLE", 1.0)
        if self.table is not None:
            report = report_ap(self.vehicle, "fitted", fit=table_of(self.vehicle, self.table))
            texts |= report.scripts
            for name, value in report.params.items():
                if name != "SCR_LD_CHECKSUM":  # of these scripts alone
                    a.store.write(name, value)
        a.boot()
        a.files.folders.add("scripts")
        a.files.files.update({f"scripts/{name}": text.encode() for name, text in texts.items()})
        a.boot()

    @property
    def driven(self) -> bool:
        return bool(self.autopilot.bridged)


WAYS = {"px4": Watched, "module": Module, "ardupilot": Copter}


class Simulation:
    """Watts of the pack over the upper rotors' share of the weight: the world's own tables, and what warm
    windings take beside them."""

    def __init__(self, path: Path, frame: Path, truth: Path) -> None:
        plant, true = build_plant(SimWorld(frame, rotor=path, truth=truth))
        true.act(plant)
        weight_N, pair, axis = GRAVITY * plant.vehicle.mass_kg, plant.pair, np.linspace(0.15, 1.15, 401)
        found = []
        for upper in axis:
            loads, drawn = pair.loads(upper, axis), pair.watts(upper, axis)
            total = 4.0 * (loads[0] + loads[2])
            if total[0] < weight_N < total[-1]:
                row = [float(np.interp(weight_N, total, row)) for row in (loads[0], drawn.sum(axis=0), axis)]
                found.append((4.0 * row[0] / weight_N, 4.0 * row[1], upper, row[2]))
        self.share, static, *speeds = np.array(sorted(found)).T
        rows = np.linspace(0, len(static) - 1, WARM_ROWS).round().astype(int)
        rows = rows[(self.share[rows] > 0.3) & (self.share[rows] < 0.9)]
        more = [_pack_over_rotors(plant, *(float(u[k]) for u in speeds)) for k in (rows[0], *rows)][1:]
        self.drawn = static * np.interp(self.share, self.share[rows], more)

    def watts(self, share: Any) -> Any:
        return np.interp(share, self.share, self.drawn)

    def least(self, low: float, high: float) -> float:
        grid = np.linspace(low, high, 2001)
        return float(grid[np.argmin(self.watts(grid))])


def _pack_over_rotors(plant: Any, upper: float, lower: float) -> float:
    """What the pack gives over what the rotors draw by the map, at these speeds for WARM_S, held in place."""
    wanted = np.where(np.asarray(plant.vehicle.level) == LOWER, lower, upper)
    start, command, found = plant.state[:13].copy(), wanted.copy(), []
    for _ in range(round(WARM_S / 0.05)):
        plant.advance(np.clip(command, 0.0, 1.0), 50)
        plant.state[:13] = start
        plant.state[2] = -4.0  # clear of the ground
        command *= 1.0 + 0.5 * (wanted / np.maximum(plant.speeds, 0.05) - 1.0)
        found.append(plant.voltage * plant.current / plant.rotor_watts().sum())
    return float(np.mean(found[-20:]))


@dataclass
class Found:
    """One way of one map; fractions."""

    name: str
    on_board: float = math.nan  # share, as the plant had it
    best: float = math.nan  # of least watts within what was flown, as the plant has it
    saving: float = math.nan  # there
    share: float = math.nan  # the answer's level, as the plant had it
    off: float = math.nan  # the answer's share by the rotor model, from it
    reported: float = math.nan  # saving
    holds: tuple[bool, bool] = (False, False)  # the intervals of share and saving
    real: float = math.nan  # saving of the level that was found
    beyond: float = math.nan  # saving of the map's own best, whatever was flown
    edge: bool = False
    logs: dict[str, str] = field(default_factory=dict)
    problem: str = ""
    escs: str = ""  # what their amps say


def flown(
    way: str, map_file: Path, frame: Path, folder: Path, seed: int, determined: str, *more: Any
) -> dict[str, Any]:
    """One flight of the verb in a world of which `told` is true; its log lies in `folder` as the card has it.

    Raises RuntimeError.
    """
    folder.mkdir(parents=True)
    truth = folder / "truth.toml"
    truth.write_text(determined)
    flight = WAYS[way](load_vehicle(frame), seed, airframe=frame, rotor=map_file, truth=truth, seed=seed)
    words: list[Any] = ["fly", "--plan", "split", "--connect", flight.url(), "--airframe", frame, *more]
    words += ["--battery", 0.1, "--no-log", "--yes", "--out", folder, "--json", folder / "fly.json"]
    with plugged(flight.net):
        code, out, err = run(*words)
    (folder / "said.txt").write_text(out + err)
    if code:
        raise RuntimeError(f"exit {code}: {err.strip()[-300:]}")
    card = flight.autopilot.files.files
    for name in [name for name in card if name.lower().endswith((".ulg", ".bin"))][-1:]:
        (folder / f"card{Path(name).suffix.lower()}").write_bytes(bytes(card[name]))
    found = json.loads((folder / "fly.json").read_text())
    seen = np.array(flight.seen)
    begun = seen[np.argmax(seen[:, 3] > 0), 0]  # the first answer flown
    found["true_share"] = [
        [share, float(seen[np.abs(seen[:, 0] - begun - middle) < 3.0, 1].mean())]
        for middle, _, share, *_ in found["split"]["dwell_rows"]
    ]
    return found


def judged(found: Found, answer: dict[str, Any], levels: Any, world: Simulation) -> None:
    """The answer beside what is true."""
    asked, true = levels.T
    plant = np.polynomial.Polynomial.fit(asked, true, 2)  # the share by the model to the plant's
    low, high = float(plant(asked.min())), float(plant(asked.max()))
    found.on_board, found.share = float(plant(answer["on_board"])), float(plant(answer["share"]))
    found.off = answer["share"] - found.share
    found.best = world.least(low, high)
    board = world.watts(found.on_board)
    found.saving = float(1.0 - world.watts(found.best) / board)
    found.real = float(1.0 - world.watts(found.share) / board)
    found.beyond = float(1.0 - world.drawn.min() / board)
    found.reported, found.edge = answer["saving"], answer["at_edge"]
    share_ci, saving_ci = ([float(v) for v in answer[key]] for key in ("share_ci", "saving_ci"))
    found.holds = (
        bool(plant(share_ci[0]) - 2e-3 <= found.best <= plant(share_ci[1]) + 2e-3),
        bool(saving_ci[0] - 1e-6 <= found.saving <= saving_ci[1] + 1e-6),
    )


def of_escs(reported: dict[str, Any]) -> str:
    """Their amps over the battery monitor's, and the split by them alone."""
    if "ratio" not in reported:
        return str(reported["why"])
    alone = reported["by_escs"] or {}
    share, saving = (alone.get(key, math.nan) for key in ("share", "saving"))
    return f"{reported['ratio']:.3f} of the monitor's; by them alone {share:.3f} saves {100 * saving:.2f} %"


def logs(folder: Path, frame: Path) -> dict[str, str]:
    """What refine, health and identify say of the logs of a flight."""
    reported = {}
    for path in sorted([*folder.glob("card.*"), *folder.glob("flight.*")]):
        kind, answer = path.suffix[1:], folder / "answer.json"
        reported[kind] = " / ".join(verdicts(path, frame, frame.parent / "rotor.toml", folder))
        answer.unlink(missing_ok=True)
        code, _, err = run(
            "identify", path, "--airframe", frame, "--rotor", frame.parent / "rotor.toml", "--json", answer
        )
        reported[kind] += f" / identify {code}" + (f": {err.strip()[-200:]}" if code else "")
    return reported


def flat_map(path: Path, out: Path) -> Path:
    """The same loads; watts by total thrust alone but for a term that grows from equal commands, bent."""
    with path.open(newline="") as lines:
        head, *rows = list(csv.reader(lines))
    at = {name.strip(): n for n, name in enumerate(head)}
    kept = []
    for row in rows:
        value = {name: float(row[n]) for name, n in at.items()}
        pwm = [value[f"PWM {side}"] for side in ("Left", "Right")]
        if min(pwm) <= 1001:
            continue
        thrust = max(value["Thrust Left [g]"] + value["Thrust Right [g]"], 10.0) * 9.80665e-3
        uneven = abs(pwm[0] - pwm[1]) / (sum(pwm) - 2000.0)
        watts = 6.0 * thrust**1.35 * (1.0 + 0.5 * uneven**1.7)
        part = [max(p - 1000.0, 1.0) ** 2.5 for p in pwm]
        for side, share in zip(("Left", "Right"), part, strict=True):
            volts = value[f"Voltage {side} [V]"]
            row[at[f"Current {side} [A]"]] = f"{watts * share / sum(part) / volts:.4f}"
        kept.append(row)
    with out.open("w", newline="") as file:
        csv.writer(file).writerows([head, *kept])
    return out


def prepared(path: Path, folder: Path) -> Path:
    """The file of an X8 of four such pairs, hovering at 45 %: `identify` and `init`, unless it is there."""
    rotor, frame = folder / "rotor.toml", folder / "x8.toml"
    if not frame.exists():
        coaxlink("identify", path, "--upper", "left", "--out", rotor)
        text = vehicle_file(path, rotor, frame).read_text()
        for key in ("mass_kg", "inertia_kg_m2", "motor_lag_s"):  # the world's are this file's
            text = re.sub(rf'{key} = "[a-z]+"', f'{key} = "measured"', text)
        frame.write_text(text)
    return frame


def walk(
    path: Path, folder: Path, way: str, seed: int, determined: str, options: list[Any], once: bool
) -> Found:
    """Two flights of one map by one way, or with `once` one."""
    found = Found(f"{path.stem} {way} {seed}")
    frame = prepared(path, folder)
    try:
        first, second = folder / f"{way}_{seed}_1", folder / f"{way}_{seed}_2"
        first_flown = last = flown(way, path, frame, first, 2 * seed, determined, *options)
        if not once:
            again = (*options, "--after", first / "fly.json")
            last = flown(way, path, frame, second, 2 * seed + 1, determined, *again)
        levels, answer = first_flown["true_share"] + last["true_share"], last["split"]
        if "share" not in answer:
            raise RuntimeError(answer["why"])
        found.escs = of_escs(answer["escs"])
        judged(found, answer, np.array(levels), Simulation(path, frame, first / "truth.toml"))
        found.logs = {} if once else logs(second, frame)
    except RuntimeError as error:
        found.problem = str(error)
    return found


def show(f: Found) -> None:
    """A line, and one for each log."""
    if f.problem:
        print(f"{f.name}: PROBLEM {f.problem}", flush=True)
        return
    share, saving = ("holds" if one else "does NOT hold" for one in f.holds)
    print(
        f"{f.name}: on board {f.on_board:.3f}, best {f.best:.3f} saves {100 * f.saving:.2f} % (whole map "
        f"{100 * f.beyond:.2f}); found {f.share:.3f} (by the rotor model {f.off:+.3f}), "
        f"said {100 * f.reported:.2f}, really {100 * f.real:.2f} %; intervals: share {share}, saving {saving}"
        f"{'; at the edge' if f.edge else ''}; ESCs' amps: {f.escs}",
        flush=True,
    )
    for kind, reported in f.logs.items():
        print(f"    {kind}: {reported}", flush=True)


def main() -> int:
    """As the module says; 1 where the small form has no answer, or an interval without the truth."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path, default=HERE.parents[1] / "shared" / "data" / "coax")
    parser.add_argument("--only", nargs="+", default=MAPS)
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=["px4", "ardupilot"])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--reach", type=float, default=0.12, help="of shares, to both sides of the board's")
    parser.add_argument("--felt", type=float, default=0.0, help="axial_inflow: rotors feel the gusts")
    parser.add_argument("--on-board", type=float, help="ardupilot: a table of this share, as found before")
    parser.add_argument("--flat", action="store_true")
    parser.add_argument("--keep", type=Path, help="a new folder for all logs")
    parser.add_argument("--small", action="store_true")
    given = parser.parse_args()
    Copter.table = given.on_board
    with tempfile.TemporaryDirectory() as scratch:
        place = given.keep or Path(scratch)
        place.mkdir(parents=True, exist_ok=True)
        paths = [given.folder / f"{name}.csv" for name in given.only]
        minutes, ways = MINUTES, given.ways
        if given.small:
            paths, minutes, ways = [made_map(place / "made_zD07.csv")], 4.2, ["px4"]
        options = ["--minutes", minutes, "--split-reach", given.reach]
        determined = TRUTH + (FELT.format(given.felt) if given.felt else "")
        if given.flat:
            paths = [flat_map(path, place / f"{path.stem}_flat.csv") for path in paths]
        sound = True
        for path in paths:
            folder = place / path.stem
            folder.mkdir()
            for way in ways:
                for seed in range(given.seeds):
                    found = walk(path, folder, way, seed, determined, options, given.small)
                    sound = sound and not found.problem and all(found.holds)
                    show(found)
    return int(given.small and not sound)


if __name__ == "__main__":
    sys.exit(main())
