"""Worlds of a sixth author; the README says how to call it."""

import argparse
import json
import zlib
from pathlib import Path

import flight
import numpy as np
import stand


def cases(kind, seed):
    """{case: (what is drawn, names)}; which effects stand in pairs and in a flight turns with the seed."""
    rng, names = np.random.default_rng(seed), list(stand.STAND if kind == "stand" else flight.FLIGHT)
    turn = [names[(k + 6 * seed) % 10] for k in range(10)]
    pairs = [rng.choice(names, 2, replace=False).tolist() for _ in range(3)]
    if kind == "stand":
        weak = [["rotor_lag"], [("battery_voltage", "motor_heating")[seed % 2]]]
        drawn = [("effect", [n]) for n in (*turn, turn[0])] + [("two", p) for p in pairs]
        drawn += [("odd", ["odd"])] * 2 + [("fault", [])] * 2 + [("ambiguous", n) for n in weak]
        drawn += [("clean", [])] * 4
    else:
        drawn = [("effect", [n]) for n in turn[:6]] + [("two", p) for p in pairs[:2]] + [("odd", ["odd"])]
        drawn += [("fault", [])] * 2 + [("ambiguous", [("mass_change", "ground_effect")[seed % 2]])]
        drawn += [("clean", [])] * 2
    return {f"{kind[0]}{k:02d}_{'+'.join(n) or d}": (d, n) for k, (d, n) in enumerate(drawn)}


def build(case, kind, seed):
    """One world: columns of the log, truth, and texts of rotor model and airframe, or None."""
    rng = np.random.default_rng([seed, zlib.crc32(case.encode())])
    make = stand.build_stand if kind == "stand" else flight.build_flight
    return make(*cases(kind, seed)[case], rng)


def main():
    parse = argparse.ArgumentParser(description=__doc__)
    parse.add_argument("--kind", choices=["stand", "flight"], default="stand")
    parse.add_argument("--seed", type=int, default=1)
    parse.add_argument("--out", type=Path, required=True)
    parse.add_argument("--case", nargs="*")
    args, truths = parse.parse_args(), {}
    for case in args.case or cases(args.kind, args.seed):
        columns, truth, *texts = build(case, args.kind, args.seed)
        files = {
            "log": f"logs/{case}.csv",
            "rotor": f"rotors/{case}.toml",
            "airframe": f"airframes/{case}.toml",
        }
        for folder in files.values():
            (args.out / folder).parent.mkdir(parents=True, exist_ok=True)
        rows = np.column_stack(list(columns.values()))
        np.savetxt(args.out / files["log"], rows, "%.7g", ",", header=",".join(columns), comments="")
        for key, text in zip(("rotor", "airframe"), texts, strict=True):
            files[key] = files[key] if text else None
            if text:
                (args.out / files[key]).write_text(text.replace("rotor_model_file", f"../rotors/{case}.toml"))
        truths[case] = files | truth
        (args.out / "truth.json").write_text(json.dumps(truths, indent=1))
    print(f"{len(truths)} worlds in {args.out}")


if __name__ == "__main__":
    main()
