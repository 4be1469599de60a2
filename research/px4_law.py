"""The law on board (C++, single precision where it can) against the Python law on the same demands.

    python research/px4_law.py [--rows 200000] [--airframe F] [--small] [--json F]        (needs g++)

Demands of four kinds, each with all rotors and with rotor 3 dead: `smooth` at 250 Hz; `steps` that are
held for a fifth of a second; `beyond`, smooth and up to four times out of reach; `jumps`, anywhere at
every call, which no vehicle demands. Of the calls that both settle: the worst difference of a speed. Of
all: was what flew worse than the reduced mixer? Where arm-none-eabi-g++ is: flash and RAM on a
Cortex-M7, and where qemu-arm is as well the instructions of a call, counted one by one.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from coaxlink.files import example
from coaxlink.live.onboard.description import board_law
from coaxlink.vehicle import load_vehicle

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from board_law import build, compare  # type: ignore[import-not-found]


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=200_000)
    parser.add_argument("--airframe", type=Path, default=example("x8_paper.toml"))
    parser.add_argument("--small", action="store_true", help="1,600 demands")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    vehicle = load_vehicle(options.airframe)
    with tempfile.TemporaryDirectory() as folder:
        found = compare(
            vehicle,
            build(Path(folder), board_law(vehicle), "-O2"),
            (1600 if options.small else options.rows) // 8,
        )
    for f in found:
        passes, micros = ("/".join(f"{v:.{d}f}" for v in f[k]) for k, d in (("passes", 0), ("micros", 1)))
        print(
            f"{f['kind']:7} {'rotor 3 dead' if f['dead'] else 'all rotors  '} "
            f"settled {100 * f['settled']:7.3f} %  "
            f"worst {f['worst']:.1e}  within 1e-4 {100 * f['within']:7.3f} %  another and worse "
            f"{f['worse']}  worse than reduced {f['worse_than_reduced']}  passes {passes}  us {micros}"
        )  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))
    sys.exit(any(f["worse_than_reduced"] for f in found))


if __name__ == "__main__":
    main()
