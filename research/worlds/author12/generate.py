"""`generate.py --kind stand|flight --seed N --out FOLDER`: thirty stands or 24 flights, with truth."""

# fmt: off
import argparse
import json
import math
from pathlib import Path
from typing import Any

import flight
import numpy as np
import stand
from pair import Rng, nats

KINDS = ("effect", "two", "odd", "fault", "ambiguous", "clean")
GOALS = {"effect": (3.4, 7.0), "faint": (1.0, 2.4), "two": (3.8, 7.0), "odd": (3.8, 7.0),
         "ambiguous": (3.2, 4.0)}


def plan(room: Any, rng: Rng) -> list[tuple[str, tuple[str, ...]]]:
    """Kind and what is hidden, world by world."""
    known = [n for n in room.FORMS if n not in room.ODD]
    singles = [[(n,) for n in names] for names in (known, room.ODD, room.FAULTS)]
    drawn = zip(KINDS, (singles[0], room.TWO, *singles[1:], room.RIVALS, [()]), room.COUNTS, strict=True)
    return [(kind, pool[k]) for kind, pool, n in drawn for k in np.resize(rng.permutation(len(pool)), n)]


def world(room: Any, rng: Rng, kind: str, hidden: tuple[str, ...], path: Path) -> dict[str, Any]:
    """Write one world, or nothing where its amounts cannot be had or a rival is not as its kind says."""
    scene, on, evidence, goal, rival = room.Scene(rng, kind, hidden), {}, {}, {}, None
    for n in hidden[:1] if kind == "ambiguous" else hidden if kind != "fault" else ():
        on[n] = math.sqrt(math.prod(room.FORMS[n][:2])), str(rng.choice(scene.forms(n)))
        goal[n] = math.exp(rng.uniform(*GOALS["faint" if kind == "effect" and rng.random() < 0.25 else kind]))
    for again in range(3):
        if not scene.prepare(on):
            return {}
        for _ in range(1 if again == 2 else 4):  # other amounts at the states flown, then once more for good
            for n in on:
                less = scene.seen({k: v for k, v in on.items() if k != n})
                evidence[n] = nats(scene, scene.seen(on) - less)
            wrong = [n for n in on if not 0.6 < evidence[n] / goal[n] < 1.7]
            for n in wrong if again < 2 else ():
                step = math.sqrt(goal[n] / (evidence[n] + 1e-3))
                on[n] = float(np.clip(on[n][0] * step, *room.FORMS[n][:2])), on[n][1]
        if not on or on == getattr(scene, "on", None):
            break
    if any(not (2 if kind == "effect" else 20) < evidence[n] < room.MOST for n in on):
        return {}
    made, told, lie = scene.write(on, path)
    if kind == "fault":
        evidence = {told: nats(scene, lie)}
    elif len(on) == 1:
        ask = [n for n in room.FORMS if n not in on and scene.shows(n)]
        others = {n: min(nats(scene, lie, p) for p in scene.sets(n)) for n in ask}
        rival = min(others.items(), key=lambda o: o[1])
        alike = others[hidden[1]] > 3 if kind == "ambiguous" else min(evidence.values()) > 40 and rival[1] < 8
        if alike:
            return {}
    return {**made, "kind": kind, "effects": [] if kind in ("odd", "fault") else [*hidden], "accept": [],
            "llr_null": round(min(evidence.values(), default=0.0), 1), "llr_each": evidence,
            "llr_rival": rival, "suspect": told,
            "form": {n: [round(a, 4), f] for n, (a, f) in on.items()} or [*hidden]}


def main() -> None:
    """Each world anew, from its own seed, until its kind holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kind", choices=("flight", "stand"), required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    room, truth = {"stand": stand, "flight": flight}[args.kind], {}
    for number, (kind, hidden) in enumerate(plan(room, np.random.default_rng([12, args.seed]))):
        name = f"{args.kind}{number + 1:02d}_{kind}"
        seeds = ([12, args.seed, number, k] for k in range(60))
        tries = (world(room, np.random.default_rng(s), kind, hidden, args.out / name) for s in seeds)
        truth[name] = next(filter(None, tries))
        print(name, truth[name]["form"], truth[name]["llr_each"], truth[name]["llr_rival"], flush=True)
    (args.out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


if __name__ == "__main__":
    main()
