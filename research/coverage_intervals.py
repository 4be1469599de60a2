"""How often a 95 % interval holds the coefficient it is of: bench data of the paper's eq. 17, many draws.

    python research/coverage_intervals.py [DRAWS]

121 points (11 x 11, 0..0.9), 0.5 N and 0.01 N m of white noise. Held-out error beside the noise of the draw.
"""

from __future__ import annotations

import sys

import numpy as np

from coaxlink.data import Samples
from coaxlink.rotor import identify

LEVELS = np.arange(11) * 0.09
TRUTH = {
    "upper.thrust_N": {"u_u^2": 55.9517, "u_u": 22.4464},
    "upper.torque_Nm": {"u_u^2": 1.2437, "u_u": 0.7155},
    "lower.thrust_N": {
        "u_u^2 u_l^2": 2.755,
        "u_l^2": 64.721,
        "u_u u_l": -2.547,
        "u_l": 12.402,
        "u_u^2": -37.502,
        "1": 0.801,
    },
    "lower.torque_Nm": {"u_u u_l^2": 0.307, "u_l^2": 1.466, "u_l": 0.573, "u_u^2": -0.695},
}


def surfaces(u: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
    """Eq. 17 written out, by our column names."""
    return {
        "upper_thrust_N": 55.9517 * u**2 + 22.4464 * u,
        "upper_torque_Nm": 1.2437 * u**2 + 0.7155 * u,
        "lower_thrust_N": 2.755 * u**2 * v**2
        + 64.721 * v**2
        - 2.547 * u * v
        + 12.402 * v
        - 37.502 * u**2
        + 0.801,
        "lower_torque_Nm": 0.307 * u * v**2 + 1.466 * v**2 + 0.573 * v - 0.695 * u**2,
    }


def bench(seed: int) -> tuple[Samples, float]:
    """One draw, and the root mean square of its noise in coaxial thrust."""
    random = np.random.default_rng(seed)
    u, v = (g.ravel() for g in np.meshgrid(LEVELS, LEVELS, indexing="ij"))
    columns = {"upper_rpm": 5400 * u, "lower_rpm": 5400 * v, "upper_throttle": u, "lower_throttle": v}
    noise = {}
    for name, values in surfaces(u, v).items():
        noise[name] = (0.5 if name.endswith("_N") else 0.01) * random.standard_normal(len(u))
        columns[name] = values + noise[name]
    total = noise["upper_thrust_N"] + noise["lower_thrust_N"]
    return Samples(columns, f"draw {seed}"), float(np.sqrt(np.mean(total**2)))


def main(draws: int) -> None:
    """Print the table."""
    held: dict[tuple[str, str], list[bool]] = {}
    named: dict[tuple[str, str], int] = {}
    inside, printed, ratios, table2 = 0, 0, [], []
    for seed in range(draws):
        log, noise = bench(seed)
        result = identify(log, "crm", compare=False)
        error = result.channels["coaxial_thrust"]
        ratios.append(error.rmse / noise)
        u, v = log["upper_throttle"], log["lower_throttle"]
        true = sum(y for name, y in surfaces(u, v).items() if name.endswith("_thrust_N"))
        measured = log["upper_thrust_N"] + log["lower_thrust_N"]
        predicted = result.predicted["upper.thrust_N"] + result.predicted["lower.thrust_N"]
        rs = [float(np.corrcoef(*pair)[0, 1]) for pair in ((predicted, true), (true, measured))]
        table2.append((error.rmse, error.nrmse, error.r, *rs))
        for load, terms in TRUTH.items():
            intervals = result.intervals[load]
            for term, value in terms.items():
                low, high = intervals.bounds[term]
                held.setdefault((load, term), []).append(low <= value <= high)
                named[load, term] = named.get((load, term), 0) + any(term in g for g in intervals.indistinct)
            for term, value in result.model.terms()[load].items():
                low, high = intervals.bounds[term]
                printed += 1
                inside += low <= value <= high
    print(f"{draws} draws, 121 points, 0.5 N, 0.01 N m\n")
    print(f"{'load':<16} {'term':<12} {'true':>9} {'95 % holds it':>14} {'named indistinct':>17}")
    for (load, term), hits in held.items():
        share, doubt = 100 * np.mean(hits), 100 * named[load, term] / draws
        print(f"{load:<16} {term:<12} {TRUTH[load][term]:>9.3f} {share:>12.1f} % {doubt:>15.1f} %")
    print(f"\nvalues inside the interval printed beside them: {inside} of {printed}")
    print(f"held-out coaxial thrust RMSE / noise of the draw: mean {np.mean(ratios):.4f}", end=", ")
    print(f"95th percentile {np.quantile(ratios, 0.95):.4f}")
    for name, i, remark in (
        ("RMSE, N", 0, "1.1614 printed"),
        ("NRMSE", 1, "0.0106 printed"),
        ("R, held out, of model and measurement", 2, "0.9997 printed"),
        ("R, held out, of model and truth", 3, ""),
        ("R of the truth itself and the measurement", 4, "no model can have more"),
    ):
        column = [row[i] for row in table2]
        worst = min(column) if i >= 2 else max(column)
        print(f"{name}: mean {np.mean(column):.5f}, worst {worst:.5f}  {remark}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
