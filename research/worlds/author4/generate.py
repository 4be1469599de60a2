"""Worlds of a fourth author; the README says how to call it."""

import argparse
import json
import tempfile
import zlib
from pathlib import Path

import flight
import numpy as np
import stand

CASES = {"stand": stand.CASES, "flight": flight.CASES}


def build(case, seed):
    """One world: `columns` of the log, `truth`, and texts `rotor`, `airframe` (or None)."""
    rng = np.random.default_rng([seed, zlib.crc32(case.encode())])
    return (flight if case in flight.CASES else stand).build(case, rng)


def write(case, seed, out):
    world, truth = build(case, seed), {}
    files = [("log", ".csv", None), ("rotor", ".toml", world["rotor"])]
    files += [("airframe", "_x8.toml", world["airframe"])]
    for key, end, text in files:
        truth[key] = None
        if key == "log" or text:
            truth[key] = f"{key}s/{case}{end}"
            (out / f"{key}s").mkdir(parents=True, exist_ok=True)
        if text:
            (out / truth[key]).write_text(text.replace("rotor_model_file", f"../rotors/{case}.toml"))
    columns = world["columns"]
    table = np.column_stack(list(columns.values()))
    np.savetxt(out / truth["log"], table, "%.7g", ",", header=",".join(columns), comments="")
    return truth | world["truth"]


def small():
    """Checks itself: same seed same log, finite columns, truth with its keys, a third of the set clean."""
    for kind, case in [
        ("stand", "battery_voltage"),
        ("stand", "fault_swap"),
        ("flight", "flight_mass_change"),
    ]:
        one, two = build(case, 3), build(case, 3)
        assert all(np.array_equal(v, two["columns"][k]) for k, v in one["columns"].items()), case
        assert np.all(np.isfinite(list(one["columns"].values()))), case
        assert {"kind", "effects", "accept", "noise", "rows"} <= set(one["truth"]), case
        assert 3 * sum(c.startswith("clean") for c in CASES[kind]) >= len(CASES[kind])
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(write("sensor_drift", 1, Path(folder))))


def main():
    parse = argparse.ArgumentParser(description=__doc__)
    parse.add_argument("--kind", choices=["stand", "flight"], default="stand")
    parse.add_argument("--seed", type=int, default=1)
    parse.add_argument("--out", type=Path)
    parse.add_argument("--case", nargs="*")
    parse.add_argument("--small", action="store_true")
    args = parse.parse_args()
    if args.small or not args.out:
        return small() if args.small else parse.error("--out DIR is needed")
    args.out.mkdir(parents=True, exist_ok=True)
    truth = {}
    for case in args.case or CASES[args.kind]:
        truth[case] = write(case, args.seed, args.out)
        (args.out / "truth.json").write_text(json.dumps(truth, indent=1))
    return print(f"{len(truth)} worlds in {args.out}")


if __name__ == "__main__":
    main()
