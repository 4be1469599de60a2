"""The best split from hovers over real maps: share and saving found, and how often the intervals hold them.

    python research/split.py [FOLDER] [--flights 60] [--only mn4014] [--reach 0.12] [--small]

FOLDER holds the coaxial maps of the shared data (default: ../shared/data/coax beside the repository). Of each
map: battery watts over the upper rotor's share at constant thrust by a surface through its raw rows (as
`real_pairs` has it), as a world of twelve minutes with gusts of 1 m/s, a pack and windings that drift, and a
bad power module (`tests/helpers/split_world`). Within a reach of 0.12 the intervals hold; at 0.24 the maps
bend more than the polynomial and they do not, so `fly` stops at 0.15. The hover itself is simulated by its
power alone: no autopilot is flown here.

`--small` takes seconds: a world of momentum theory, 20 flights.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from real_pairs import STEMS, RawMap, polynomial

from coaxlink.fly.split_answer import best_split, dwells_of
from coaxlink.fly.split_plan import DWELL_S, SETTLE_S, SplitPlan

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "tests" / "helpers"))
from split_world import Simulation, hover  # noqa: E402

MINUTES, LEVELS = 12.0, 7


class MapWorld:
    """Watts of four pairs over the upper rotor's share, at the thrust of `real_pairs`' hover."""

    def __init__(self, path: Path) -> None:
        surfaces = RawMap(path, polynomial(3))
        thrust_N, _, _ = surfaces.equal()
        pwm = np.repeat(np.linspace(surfaces.low, surfaces.high, 801)[:, None], 2, axis=1)
        rpm = surfaces.speeds(pwm)
        grid = np.stack(np.meshgrid(*np.linspace(0.3 * rpm[-1], rpm[-1], 401).T, indexing="ij"), axis=-1)
        grid = grid.reshape(-1, 2)
        own, total = surfaces.upper_thrust(grid), surfaces.at("thrust", grid)
        near = np.abs(total / thrust_N - 1.0) < 4e-3
        share, watts = own[near] / total[near], surfaces.at("battery", grid[near])
        self.low, self.high = (float(v) for v in np.quantile(share, [0.02, 0.98]))
        both = surfaces.at("thrust", rpm)  # at equal commands
        self.equal = float(np.interp(thrust_N, both, surfaces.upper_thrust(rpm) / both))
        self._fit = np.polynomial.Polynomial.fit(share, 4.0 * watts, 5)

    def watts(self, share):
        """Four pairs."""
        return self._fit(share)

    def least(self, low: float, high: float) -> float:
        """Share of least watts between these."""
        grid = np.linspace(low, high, 2001)
        return float(grid[np.argmin(self._fit(grid))])


def flights(world, board: float, count: int, reach: float) -> str:
    """A line of figures."""
    levels = tuple(np.linspace(board - reach, board + reach, LEVELS))
    plan = SplitPlan(levels, board, int(60.0 * MINUTES / DWELL_S))
    order = np.array([plan.level((k + 0.5) * DWELL_S) for k in range(plan.dwells)])
    best = world.least(levels[0], levels[-1])
    saving = 1.0 - world.watts(best) / world.watts(board)
    found = []
    for seed in range(count):
        t, watts, share, up, tilt = hover(world, order, DWELL_S, np.random.default_rng(seed))
        columns = {"load": (1.0 + up / 9.81) ** 1.5, "tilt": tilt**2}
        found.append(best_split(dwells_of(t // DWELL_S, t, watts, share, SETTLE_S, columns), board))
    within = sum(a.share_ci[0] - 1e-3 <= best <= a.share_ci[1] + 1e-3 for a in found)
    saved = sum(a.saving_ci[0] - 1e-6 <= saving <= a.saving_ci[1] + 1e-6 for a in found)
    off = np.abs([a.share - best for a in found])
    missed = 100 * np.abs([a.saving - saving for a in found])
    return (
        f"on board {board:.3f}, best {best:.3f}, saves {100 * saving:.2f} %: share off {np.median(off):.3f} "
        f"(most {off.max():.3f}), saving off {np.median(missed):.2f} (most {missed.max():.2f}) points; "
        f"intervals hold {within} and {saved} of {count}; "
        f"nothing to gain said {sum(not a.worth_it for a in found)}"
    )


def main() -> None:
    """As the module says."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path, default=HERE.parents[1] / "shared" / "data" / "coax")
    parser.add_argument("--flights", type=int, default=60)
    parser.add_argument("--only", default="")
    parser.add_argument("--reach", type=float, default=0.12, help="of shares, to both sides of the board's")
    parser.add_argument("--small", action="store_true")
    given = parser.parse_args()
    if given.small:
        world = Simulation(lower_efficiency=0.8, wake=0.3)
        for off in (0.0, 0.06):
            print("made:", flights(world, world.least(0.3, 0.8) + off, 20, given.reach))
        return
    paths = [path for stem in STEMS for path in sorted(given.folder.glob(f"{stem}_zD*.csv"))]
    for path in paths:
        if given.only in path.name and path.stem.count("_") == 2:
            world = MapWorld(path)
            print(f"{path.stem}:", flights(world, world.equal, given.flights, given.reach), flush=True)
            best = world.least(world.low, world.high)
            print(f"{path.stem}, at its best:", flights(world, best, given.flights, given.reach), flush=True)


if __name__ == "__main__":
    main()
