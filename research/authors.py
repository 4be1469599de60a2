"""Worlds of other authors through one or two checkouts: right, not there, error over the floor.

    git worktree add ../old COMMIT
    python research/authors.py [../old] . --worlds ../shared/worlds/{stand,flight,real,authors/*} [--out F]
    python research/authors.py [../old] . --data ../shared/data [--out F]
    python research/authors.py --small

Each log goes through `coaxlink refine`, as a user types it, once by each checkout's code, in this
environment; F keeps the answers. `--worlds` are folders with a `truth.json` and the
grader `grade.py` beside them, whose verdict is printed. `--data` has no truth: a row a log, what each says.
`--small`: the first log of the shared data, where that is there. Own blind worlds are `blind.py`'s.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared" / "data"
# stands where the grader looks for coaxlink (`refine LOG ...`), and keeps the answer under the log's name
WRAPPER = """#!/bin/sh
export PYTHONPATH={code}
for a in "$@"; do [ "$was" = --json ] && json=$a; was=$a; done
cd {kept}  # python -m looks where it stands first
{python} -m coaxlink "$@" || exit $?
log=$(basename "$2")
cp "$json" "{kept}/${{log%%.*}}.json"
"""


def answered(code: Path, log: Path, out: Path) -> tuple[dict[str, Any], float]:
    """The answer to a log, or {"error": what was said}, and seconds of wall time."""
    kept = out / f"{log.stem}.json"
    if not kept.exists():
        environment = os.environ | {"PYTHONPATH": str(code)}
        fresh = kept.with_suffix(".new")
        command = [sys.executable, "-m", "coaxlink", "refine", str(log.resolve()), "--json", str(fresh)]
        start = time.perf_counter()
        done = subprocess.run(command, env=environment, cwd=out, capture_output=True, text=True, check=False)
        answer = {"error": (done.stderr.strip().splitlines() or ["?"])[-1]}
        if fresh.exists():
            answer = json.loads(fresh.read_text())
            fresh.unlink()
        kept.write_text(json.dumps({"answer": answer, "seconds": time.perf_counter() - start}))
    found = json.loads(kept.read_text())
    return found["answer"], found["seconds"]


def over_floor(answer: dict[str, Any]) -> float:
    """Largest error over its noise floor, after."""
    channels = answer.get("channels", {}).values()
    return max(
        (c["rmse_after"] / c["noise_floor"] for c in channels if c["noise_floor"] > 0), default=float("nan")
    )


def said(answer: dict[str, Any]) -> str:
    """In few words."""
    if "error" in answer:
        return answer["error"][-90:]
    parts = [e["name"] for e in answer["effects"]]
    parts += [f"({'/'.join(a['names'])})" for a in answer["ambiguous"]]
    parts += [f"unexplained over {', '.join(u['depends_on'])}" for u in answer["unexplained"][:1]]
    parts += [f"suspect {s['column']}" for s in answer["suspect_data"][:2]]
    return "; ".join(parts) or "nothing"


def graded(code: Path, worlds: Path, out: Path) -> str:
    """A row: the grader's last lines, and the error over the floor of all answers."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        wrapper = Path(scratch) / "coaxlink"
        wrapper.write_text(WRAPPER.format(code=code, kept=out, python=sys.executable))
        wrapper.chmod(0o755)
        grader = [sys.executable, str(worlds.parent / "grade.py"), str(worlds.resolve())]
        environment = os.environ | {"COAX": str(wrapper)}
        done = subprocess.run(grader, env=environment, capture_output=True, text=True, check=False)
    (out / "grade.txt").write_text(done.stdout + done.stderr)
    over = [over_floor(json.loads(p.read_text())) for p in sorted(out.glob("*.json"))]
    lines = done.stdout.strip().splitlines()[-2:]
    floor = f"error over the floor {statistics.median(over):.2f} (middle), {max(over):.1f} (worst)"
    return "; ".join([*reversed(lines), floor])


def main() -> None:
    """Print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("code", type=Path, nargs="*", default=[ROOT], help="checkouts")
    parser.add_argument("--small", action="store_true", help="one log, for CI")
    parser.add_argument("--worlds", type=Path, nargs="*", default=[])
    parser.add_argument("--data", type=Path)
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "coaxlink-side-by-side")
    a = parser.parse_args()
    if a.small:
        a.data, a.out = SHARED / "coax", Path(tempfile.mkdtemp())
        if not a.data.is_dir():
            print("no shared data beside this checkout: nothing to answer")
            return
    named = [
        (code.resolve(), f"{code.name or 'here':12s}", a.out.resolve() / str(k))
        for k, code in enumerate(a.code)
    ]
    for worlds in a.worlds:
        for code, name, out in named:
            print(f"{worlds.name:8s} {name} {graded(code, worlds, out / worlds.name)}", flush=True)
    logs = [p for end in ("csv", "ulg", "bin") for p in sorted(a.data.rglob(f"*.{end}"))] if a.data else []
    for log in logs[:1] if a.small else logs:
        print(log.relative_to(a.data))
        for code, name, out in named:
            (out / "data").mkdir(parents=True, exist_ok=True)
            answer, seconds = answered(code, log, out / "data")
            assert not a.small or "error" not in answer, answer
            print(f"    {name} {said(answer)}; {over_floor(answer):.2f} floors, {seconds:.1f} s", flush=True)


if __name__ == "__main__":
    main()
