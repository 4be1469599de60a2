"""`generate.py --kind stand|flight --seed N --out FOLDER`: thirty stands or twenty flights, with truth."""

# fmt: off
import argparse
import json
from pathlib import Path
from typing import Any

import flight
import numpy as np
import stand
from pair import Rng, nats

COUNTS = {"stand": (11, 5, 4, 3, 3, 4), "flight": (9, 3, 2, 2, 1, 3)}


def plan(room: Any, counts: tuple[int, ...], rng: Rng) -> list[tuple[str, tuple[str, ...]]]:
    """Kind and what is hidden, world by world."""
    singles = [[(n,) for n in names] for names in (room.FORMS, room.ODD, room.FAULTS)]
    pools = {"effect": singles[0], "two": room.TWO, "odd": singles[1], "fault": singles[2],
             "ambiguous": room.RIVALS, "clean": [()]}
    drawn = zip(pools.items(), counts, strict=True)
    return [(kind, pool[k]) for (kind, pool), n in drawn for k in np.resize(rng.permutation(len(pool)), n)]


def world(room: Any, rng: Rng, kind: str, hidden: tuple[str, ...], path: Path) -> dict[str, Any]:
    """Write one world; nothing where what is hidden is too small, too large or not as its kind says."""
    names = hidden if kind in ("effect", "two") else hidden[:1] if kind == "ambiguous" else ()
    rival = hidden[1] if kind == "ambiguous" else ""
    drawn = {n: (np.log(room.FORMS[n][:2]), room.FORMS[n][2][: 1 if rival else None]) for n in names}
    on = {n: (float(np.exp(rng.uniform(*a))), str(rng.choice(forms))) for n, (a, forms) in drawn.items()}
    scene, evidence, goal = room.Scene(rng, kind, hidden), {}, (3.4, 4.1) if rival else (3.6, 8.1)
    for _ in range(4):  # again with another amount where the log would say too little or too much
        if not scene.run(on):
            return {}
        for n in on:
            less = scene.seen(on) - scene.seen({k: v for k, v in on.items() if k != n})
            evidence[n] = nats(less, scene.factors, scene.free, [])
        wrong = [n for n in on if not 28 < evidence[n] < (900 if rival else 6000)]
        if not wrong:
            break
        for n in wrong:
            step = np.sqrt(np.exp(rng.uniform(*goal)) / (evidence[n] + 1e-3))
            on[n] = float(np.clip(on[n][0] * step, *room.FORMS[n][:2])), on[n][1]
    else:
        return {}
    truth = scene.seen(on) - scene.seen({})
    ask = [n for n in room.FORMS if n not in on and kind in ("effect", "ambiguous") and scene.shows(n)]
    others = {n: min(nats(truth, scene.factors, scene.free, p) for p in scene.probes(n)) for n in ask}
    if (kind == "effect" and min(others.values()) < 8) or (rival and others[rival] > 3):
        return {}
    made, lie, told = scene.write(on, path)
    if kind in ("odd", "fault"):
        evidence = {told or hidden[0]: nats(lie, scene.factors, scene.free, [])}
        if kind == "odd" and not 28 < evidence[hidden[0]] < 20000:
            return {}
    return {**made, "kind": kind, "effects": [*hidden] if rival else [*names], "accept": [],
            "llr_null": round(min(evidence.values(), default=0.0), 1), "llr_each": evidence,
            "llr_rival": min(others.items(), key=lambda o: o[1], default=None), "suspect": told,
            "form": {n: [round(a, 4), f] for n, (a, f) in on.items()} or [*hidden]}


def main() -> None:
    """Each world anew, from its own seed, until its kind holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kind", choices=sorted(COUNTS), required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    room, truth = {"stand": stand, "flight": flight}[args.kind], {}
    worlds = plan(room, COUNTS[args.kind], np.random.default_rng([8, args.seed]))
    for number, (kind, hidden) in enumerate(worlds):
        name = f"{args.kind}{number + 1:02d}_{kind}"
        tries = (world(room, np.random.default_rng([8, args.seed, number, k]), kind, hidden, args.out / name)
                 for k in range(60))
        truth[name] = next(filter(None, tries))
        print(name, truth[name]["form"], round(truth[name]["llr_null"]), truth[name]["llr_rival"], flush=True)
    (args.out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


if __name__ == "__main__":
    main()
