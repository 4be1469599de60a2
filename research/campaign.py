"""What campaigns cost: two workers against one, the engine's own cost, memory; what a fleet's logs say.

    python research/campaign.py [--small] [--flights 10000] [--scale 600] [--json F]
    python research/campaign.py --fleet [--vehicles 10] [--weeks 20] [--folder F]

Flights are 60 s, plant at 1 ms, loops at 400 Hz, four laws on the paper's X8 in drawn winds with drawn weak
rotors. The engine's cost is processor time, its own and the workers', beyond what the cells themselves take;
it does not count who else uses the machine. Wall-clock ratios do: the load average stands beside them.
Fleet: every vehicle flies once a week, 40 s, by a plan of its own. Rotor 3 of vehicle 2 loses 0.8 % of its
thrust a week from week 4 on (counted from 0), the lower rotor 6 of vehicle 7 1.5 % from week 10 on; the
others have nothing.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

CAMPAIGN = """
flights = {flights}
laws = ["standard", "reduced", "fitted", "exact"]
airframe = "x8_demo.toml"
[effects.wind]
size = {{ low = 0.0, high = 8.0 }}
direction_deg = {{ low = 0.0, high = 360.0 }}
law = "dryden"
[effects.degraded_rotor]
chance = 0.5
size = {{ low = 0.0, high = 0.3 }}
rotor = "any"
"""
CELL_S, CELLS = 0.05, 800
EXAMPLES = Path(__file__).parents[1] / "examples"
START = datetime.date(2026, 1, 5)
AILING = {2: (3, 4, 0.008), 7: (6, 10, 0.015)}  # vehicle: rotor, first week, share of its thrust a week
LOG_EVERY = 4  # of 400 Hz: rows at 100 Hz
COAXLINK = [sys.executable, "-m", "coaxlink", "campaign"]


def burn(payload: object, cells: Sequence[int]) -> list[dict[str, object]]:
    """Cells of 50 ms of processor time each, with rows as wide as a flight's."""
    for _ in cells:
        until = time.thread_time() + CELL_S
        while time.thread_time() < until:
            pass
    return [{"cell": c} | {f"figure{k}": 0.1 * c + k for k in range(40)} for c in cells]


def engine_cost(cells: int) -> float:
    """Processor seconds of this process and its workers for so many cells, the work itself left out."""
    from coaxlink.studies.campaign.rows import Dataset
    from coaxlink.studies.engine import Machine, run

    def spent() -> float:
        both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        return sum(u.ru_utime + u.ru_stime for u in both)

    columns = {"cell": "int64"} | {f"figure{k}": "float64" for k in range(40)}
    before = spent()
    with tempfile.TemporaryDirectory() as folder, Dataset(Path(folder), columns, cells, {}) as rows:
        for done in run(burn, None, rows.missing(), Machine(2), 16):
            rows.add(done)
    return spent() - before - cells * CELL_S


def fly(folder: Path, flights: int, workers: int) -> tuple[float, float, float]:
    """(wall s, processor s, MB of the largest process) of a campaign as a user starts it."""
    folder.mkdir(parents=True, exist_ok=True)
    spec = folder / "bench.toml"
    spec.write_text(CAMPAIGN.format(flights=flights))
    command = [*COAXLINK, str(spec), "--out", str(folder / "out"), "--workers", str(workers)]
    start = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, "the campaign failed"
    return time.monotonic() - start, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0


def weak(vehicle: int, week: int) -> float:
    """Share of thrust that the vehicle's ailing rotor has lost."""
    _, first, rate = AILING.get(vehicle, (0, 0, 0.0))
    return rate * max(week - first + 1, 0)


def make_fleet(folder: Path, vehicles: int, weeks: int) -> None:
    """Write FOLDER/vehicle-N/DATE.csv."""
    from sim.effects import HiddenEffect
    from sim.flights import write_flight
    from sim.physics.rotors import read_pair
    from sim.quick.flight import FlightWorld, fly_quick, make_design
    from sim.vehicle import read_vehicle

    airframe = EXAMPLES / "x8_demo.toml"
    from coaxlink.tables.px4 import px4_table
    from coaxlink.vehicle import load_vehicle
    from firmware_params import px4

    table = px4.table_to_params(px4_table(load_vehicle(airframe), "fitted"))
    design = make_design(read_vehicle(airframe), read_pair(EXAMPLES / "rotor_paper.toml"), table)
    for vehicle in range(1, vehicles + 1):
        vehicle_folder = folder / f"vehicle-{vehicle:02d}"
        vehicle_folder.mkdir(parents=True, exist_ok=True)
        for week in range(weeks):
            lost = weak(vehicle, week)
            rotor = float(AILING.get(vehicle, (1,))[0])
            effects = (HiddenEffect("degraded_rotor", lost, 0.0, {"rotor": rotor}),) if lost else ()
            world = FlightWorld(effects, 1000 * vehicle + week, "wander", 40.0)
            date = START + datetime.timedelta(days=7 * week + vehicle % 5)
            log = vehicle_folder / f"{date.isoformat()}.csv"
            if not log.exists():
                write_flight(log, fly_quick(design, world, LOG_EVERY)[1])


def fleet(o: argparse.Namespace) -> None:
    """Fly a fleet's logs and look through them; the ailing rotors and no others have to be found."""
    make_fleet(o.folder, o.vehicles, o.weeks)
    answer = o.folder.with_suffix(".json")
    command = [sys.executable, "-m", "coaxlink", "refine", str(o.folder)]
    command += ["--airframe", str(EXAMPLES / "x8_demo.toml"), "--json", str(answer)]
    start = time.monotonic()
    subprocess.run(command, check=True)
    print(f"{o.vehicles * o.weeks} logs looked through: {time.monotonic() - start:.0f} s")
    findings = json.loads(answer.read_text())["findings"]
    truth = {(f"vehicle-{v:02d}", f"rotor {r}") for v, (r, _, _) in AILING.items() if v <= o.vehicles}
    found = {(f["vehicle"], f["part"]) for f in findings if f["believed"]}
    print(f"ailing: {sorted(truth)}; found: {sorted(found)}")
    assert truth == found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--small", action="store_true", help="8 flights, for CI")
    parser.add_argument("--flights", type=int, default=10_000)
    parser.add_argument("--scale", type=int, default=600, help="flights of the comparison of 1 and 2 workers")
    parser.add_argument("--fleet", action="store_true")
    parser.add_argument("--vehicles", type=int, default=10)
    parser.add_argument("--weeks", type=int, default=20)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "coaxlink-fleet")
    parser.add_argument("--json", type=Path)
    o = parser.parse_args()
    if o.fleet:
        fleet(o)
        return
    if o.small:
        o.flights = 8
    results: dict[str, float] = {}

    def tell(name: str, value: float, text: str) -> None:
        results[name] = value
        print(f"{text}   (load {os.getloadavg()[0]:.1f})", flush=True)

    start_up = min(engine_cost(2) for _ in range(2))  # the second time what this process needs is imported
    cells = 10 if o.small else CELLS
    own = (engine_cost(cells) - start_up) / (cells * CELL_S)
    tell(
        "engine_share",
        own,
        f"engine: {100 * own:.2f} % of the work at cells of 50 ms; start {start_up:.1f} s",
    )
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        if not o.small:
            fly(folder / "warm", 8, 2)  # compiles what is not yet compiled
            one, two = (fly(folder / f"by-{w}", o.scale, w) for w in (1, 2))
            ratio = one[0] / two[0]
            text = f"{o.scale} flights: 1 worker {one[0]:.1f} s, 2 {two[0]:.1f} s, ratio {ratio:.2f}"
            tell("ratio", ratio, f"{text}; processor {one[1]:.0f} and {two[1]:.0f} s")
        wall, processor, mb = fly(folder / "big", o.flights, 2)
        each = f"{wall:.0f} s, {processor / o.flights:.3f} s of processor each, largest process {mb:.0f} MB"
        tell("wall_s", wall, f"{o.flights} flights of 60 s: {each}")
    if o.json:
        o.json.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
