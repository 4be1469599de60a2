"""A fleet of simulated vehicles over weeks, some rotors of which weaken: what `refine FOLDER` finds of it.

    python research/fleet.py [--vehicles 10] [--weeks 20] [--folder F] [--json F]

Every vehicle flies once a week, 40 s, by a plan of its own. Rotor 3 of vehicle 2 loses 0.8 % of its thrust a
week from week 4 on (counted from 0), the lower rotor 6 of vehicle 7 1.5 % from week 10 on; the others have
nothing.
"""

from __future__ import annotations

import argparse
import datetime
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from sim.effects import HiddenEffect
from sim.flights import write_flight
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[1] / "examples"
START = datetime.date(2026, 1, 5)
AILING = {2: (3, 4, 0.008), 7: (6, 10, 0.015)}  # vehicle: rotor, first week, share of its thrust a week
LOG_EVERY = 4  # of 400 Hz: rows at 100 Hz


def weak(vehicle: int, week: int) -> float:
    """Share of thrust that the vehicle's ailing rotor has lost."""
    _, first, rate = AILING.get(vehicle, (0, 0, 0.0))
    return rate * max(week - first + 1, 0)


def make(folder: Path, vehicles: int, weeks: int) -> None:
    """Write FOLDER/vehicle-N/DATE.csv."""
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--vehicles", type=int, default=10)
    parser.add_argument("--weeks", type=int, default=20)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "coaxlink-fleet")
    parser.add_argument("--report", type=Path)
    parser.add_argument("--json", type=Path)
    o = parser.parse_args()
    start = time.monotonic()
    make(o.folder, o.vehicles, o.weeks)
    print(f"{o.vehicles * o.weeks} logs flown and written: {time.monotonic() - start:.0f} s")
    answer = o.json or o.folder.with_suffix(".json")
    command = [
        sys.executable,
        "-m",
        "coaxlink",
        "refine",
        str(o.folder),
        "--airframe",
        str(EXAMPLES / "x8_demo.toml"),
    ]
    command += ["--json", str(answer)] + (["--report", str(o.report)] if o.report else [])
    start = time.monotonic()
    subprocess.run(command, check=True)
    print(f"looked through: {time.monotonic() - start:.0f} s")
    result = json.loads(answer.read_text())
    truth = {(f"vehicle-{v:02d}", f"rotor {r}") for v, (r, _, _) in AILING.items() if v <= o.vehicles}
    found = {(f["vehicle"], f["part"]) for f in result["findings"] if f["believed"]}
    print(f"ailing: {sorted(truth)}; found: {sorted(found)}")
    sys.exit(0 if truth == found else 1)


if __name__ == "__main__":
    main()
