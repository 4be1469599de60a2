"""One allocation, side by side: the exact law against what else could solve the same problem.

    python research/allocation.py [--rows 1000] [--png allocation.png] [--json allocation.json]

The paper's vehicle and rotors (eq. 17); a smooth 1 kHz target with 4 % of it out of reach, and a jumping one.
Times are CPU times of this thread, so a busy machine inflates them less; read the ratios. Peers that are not
installed are left out (`pip install -e .[bench]`). The QP peers run the same SQP on the same compiled
expansion as the exact law, so they are charged for their QP and its calling convention alone.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from coaxlink.airframe import Airframe, Rotor, load_airframe
from coaxlink.files import example
from coaxlink.mixer import make_law
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.exact.loads import GL, GU, HLL, HUL, HUU, JL, JU, MISS
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle

FRAME = load_airframe(example("x8_paper.toml"))
MODEL = load_rotor_model(example("rotor_paper.toml"))
CLOCK = time.thread_time_ns


def smooth(rows: int) -> np.ndarray:
    """1 kHz; 4 % of the rows ask for more yaw than there is."""
    t = np.arange(rows) * 1e-3
    yaw = np.sin(2 * np.pi * 0.9 * t)
    yaw[(np.arange(rows) % 500) >= 480] += 9.0
    return np.column_stack([
        196.2 + 40 * np.sin(2 * np.pi * 0.7 * t), 4 * np.sin(2 * np.pi * 1.3 * t),
        4 * np.cos(2 * np.pi * 1.1 * t), yaw,
    ])  # fmt: skip


def jumping(rows: int) -> np.ndarray:
    """Independent wrenches of the paper's envelope, all within reach."""
    return np.random.default_rng(0).uniform([150, -4, -4, -1], [260, 4, 4, 1], (rows, 4))


Solver = Callable[[list[float]], Any]  # a wrench to speeds (N,)


def exact(compiled: bool) -> Solver:
    """The exact law; the call from Python is part of the time."""
    law = ExactLaw(Vehicle(FRAME, MODEL), compiled=compiled)
    slots = law.problem.slots

    def solve(wrench: list[float]) -> Any:
        law.solve(wrench)
        return lambda: np.array(law._x)[slots]

    return solve


def sqp(quadratic: Callable[..., np.ndarray]) -> Solver:
    """The same SQP, warm-started, with another solver for its quadratic problems."""
    import numba

    from coaxlink.mixer.exact import compiled, loads

    compiled.compiled()
    expand = numba.njit(loads.expand, **compiled.OPTIONS)
    law = ExactLaw(Vehicle(FRAME, MODEL), compiled=True)
    p = law.problem
    work, sums, _ = p.scratch()
    x, lam, mu = np.full(8, 0.5), np.zeros(4), np.zeros(4)
    h, j, g = np.zeros((8, 8)), np.zeros((4, 8)), np.zeros(8)

    def solve(wrench: list[float]) -> Any:
        mu[:] = np.array(wrench)[p.order] / p.scale
        for _ in range(10):
            expand(p.c, p.g, p.shape, x, lam, mu, work, sums)
            for k in range(4):
                h[2 * k, 2 * k], h[2 * k + 1, 2 * k + 1] = work[k, HUU], work[k, HLL]
                h[2 * k, 2 * k + 1] = h[2 * k + 1, 2 * k] = work[k, HUL]
                g[2 * k], g[2 * k + 1] = work[k, GU], work[k, GL]
                j[:, 2 * k], j[:, 2 * k + 1] = work[k, JU : JU + 4], work[k, JL : JL + 4]
            try:
                step, price = quadratic(h, g, j, sums[MISS : MISS + 4], -x, 1 - x)
            except (ValueError, RuntimeError):
                break
            x[:] = np.clip(x + step, 0, 1)
            lam[:] = np.clip(price, -50, 50)
            if np.abs(step).max() < 1e-5:
                break
        return lambda: x[p.slots].copy()

    return solve


def peers() -> dict[str, Callable[[], Solver]]:
    """Whatever is installed."""

    def here(name: str) -> bool:
        return importlib.util.find_spec(name) is not None

    found: dict[str, Callable[[], Solver]] = {}
    if here("daqp"):
        found["same SQP, daqp"] = lambda: sqp(_daqp())
    if here("quadprog"):
        found["same SQP, quadprog"] = lambda: sqp(_quadprog())
    if here("piqp"):
        found["same SQP, piqp"] = lambda: sqp(_piqp())
    if here("osqp"):
        found["same SQP, cvxpy + OSQP (DPP)"] = lambda: sqp(_cvxpy())
    if here("casadi"):
        found["CasADi sqpmethod, qrqp"] = _casadi
    found["scipy SLSQP"] = _slsqp
    return found


def _daqp() -> Callable[..., Any]:
    from ctypes import c_int

    import daqp

    sense = np.array([0] * 8 + [5] * 4, c_int)

    def quadratic(h: Any, g: Any, j: Any, r: Any, low: Any, high: Any) -> Any:
        upper, lower = np.concatenate([high, r]), np.concatenate([low, r])
        step, _, flag, info = daqp.solve(h, g, j, upper, lower, sense)
        if flag < 1:
            raise ValueError("infeasible")
        return step, -np.asarray(info["lam"])[8:]

    return quadratic


def _quadprog() -> Callable[..., Any]:
    import quadprog

    eye = np.eye(8)

    def quadratic(h: Any, g: Any, j: Any, r: Any, low: Any, high: Any) -> Any:
        rows = np.concatenate([j, eye, -eye]).T
        found = quadprog.solve_qp(h, -g, rows, np.concatenate([r, low, -high]), 4)
        return found[0], found[4][:4]

    return quadratic


def _piqp() -> Callable[..., Any]:
    import piqp

    solver = piqp.DenseSolver()
    solver.settings.verbose = False
    state = {"ready": False}

    def quadratic(h: Any, g: Any, j: Any, r: Any, low: Any, high: Any) -> Any:
        if state["ready"]:
            solver.update(P=h, c=g, A=j, b=r, x_l=low, x_u=high)
        else:
            solver.setup(h, g, j, r, None, None, None, low, high)
            state["ready"] = True
        if solver.solve() != piqp.PIQP_SOLVED:
            raise ValueError("infeasible")
        return np.array(solver.result.x), -np.array(solver.result.y)

    return quadratic


def _cvxpy() -> Callable[..., Any]:
    import cvxpy as cp

    d = cp.Variable(8)
    root, g, j = cp.Parameter((8, 8)), cp.Parameter(8), cp.Parameter((4, 8))
    r, low, high = cp.Parameter(4), cp.Parameter(8), cp.Parameter(8)
    met = j @ d == r
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(root @ d) + g @ d), [met, d >= low, d <= high])

    def quadratic(h: Any, gv: Any, jv: Any, rv: Any, lv: Any, hv: Any) -> Any:
        root.value, g.value, j.value, r.value, low.value, high.value = (
            np.linalg.cholesky(h).T,
            gv,
            jv,
            rv,
            lv,
            hv,
        )
        problem.solve(solver=cp.OSQP, eps_abs=1e-9, eps_rel=1e-9, warm_start=True)
        if d.value is None:
            raise ValueError("infeasible")
        return d.value, -met.dual_value

    return quadratic


def _slsqp() -> Solver:
    from scipy.optimize import minimize

    per_thrust, per_torque = FRAME.effectiveness()
    x = np.full(8, 0.5)

    def solve(wrench: list[float]) -> Any:
        def miss(u: Any) -> Any:
            f, q = FRAME.loads(MODEL, u)
            return per_thrust @ f + per_torque @ q - wrench

        found = minimize(
            lambda u: FRAME.loads(MODEL, u)[1] @ u, x, method="SLSQP", bounds=[(0, 1)] * 8,
            constraints={"type": "eq", "fun": miss}, options={"ftol": 1e-10},
        )  # fmt: skip
        if np.isfinite(found.x).all():
            x[:] = np.clip(found.x, 0, 1)
        return lambda: x.copy()

    return solve


def _casadi() -> Solver:
    import casadi as ca

    u, mu = ca.SX.sym("u", 8), ca.SX.sym("mu", 4)
    per_thrust, per_torque = FRAME.effectiveness()
    f, q = [ca.SX(0)] * 8, [ca.SX(0)] * 8

    def poly(load: Any, a: Any, b: Any) -> Any:
        terms = zip(load.exponents, load.coefficients, strict=True)
        return sum(c * a ** e[0] * b ** e[1] for e, c in terms)

    for i, k in FRAME.pairs:
        f[i], q[i] = poly(MODEL.upper_thrust, u[i], u[k]), poly(MODEL.upper_torque, u[i], u[k])
        f[k], q[k] = poly(MODEL.lower_thrust, u[i], u[k]), poly(MODEL.lower_torque, u[i], u[k])
    wrench = ca.DM(per_thrust) @ ca.vertcat(*f) + ca.DM(per_torque) @ ca.vertcat(*q)
    quiet = dict.fromkeys(("print_time", "print_header", "print_iteration", "print_status"), False)
    qp = {"print_iter": False, "print_header": False, "error_on_fail": False}
    options = {"qpsol": "qrqp", "qpsol_options": qp, "error_on_fail": False, **quiet}
    problem = {"x": u, "p": mu, "f": ca.dot(ca.vertcat(*q), u), "g": wrench - mu}
    solver = ca.nlpsol("s", "sqpmethod", problem, options)
    state = {"x0": np.full(8, 0.5), "lam_g0": np.zeros(4)}

    def solve(wrench: list[float]) -> Any:
        found = solver(p=wrench, lbx=0, ubx=1, lbg=0, ubg=0, **state)
        x = np.array(found["x"]).ravel()
        if np.isfinite(x).all():
            state["x0"], state["lam_g0"] = np.clip(x, 0, 1), found["lam_g"]
        return lambda: state["x0"]

    return solve


def measure(solve: Solver, demands: np.ndarray, reachable: np.ndarray) -> dict[str, float]:
    """Median and p99 CPU time (us) and the worst error (N, N m) on reachable demands."""
    times, errors = [], []
    solve(demands[0].tolist())
    for row in demands.tolist():
        began = CLOCK()
        speeds = solve(row)
        times.append((CLOCK() - began) / 1e3)
        u = speeds() if callable(speeds) else speeds
        errors.append(np.abs(FRAME.wrench(*FRAME.loads(MODEL, u)) - row).max())
    met = np.array(errors)[reachable]
    return {
        "median_us": float(np.median(times)), "p99_us": float(np.percentile(times, 99)),
        "error_p50": float(np.median(met)), "error_max": float(met.max()),
    }  # fmt: skip


def compiled_loop(demands: np.ndarray, reachable: np.ndarray, airframe: Airframe = FRAME) -> dict[str, float]:
    """The exact law inside one compiled loop: batches of 20, so that a clock's own cost does not count."""
    law = ExactLaw(Vehicle(airframe, MODEL), compiled=True)
    law.many(demands[:20])
    p, state = law.problem, law._state
    scaled = np.clip(demands[:, p.order] / p.scale, -4, 4)
    speeds, misses = np.zeros((len(demands), 2 * p.arms)), np.zeros((len(demands), 4))
    steps, times = np.zeros(len(demands), np.int64), []
    for start in range(0, len(demands) - 19, 20):
        part = slice(start, start + 20)
        rest = (*state[11:], 6, speeds[part], misses[part], steps[part])
        began = CLOCK()
        law._batch(*state[:10], scaled[part], *rest)
        times.append((CLOCK() - began) / 1e3 / 20)
    u = speeds[: len(times) * 20, p.slots]
    error = np.abs(airframe.wrench(*airframe.loads(MODEL, u)) - demands[: len(u)]).max(axis=1)
    met = error[reachable[: len(u)]]
    return {
        "median_us": float(np.median(times)), "p99_us": float(np.percentile(times, 99)),
        "error_p50": float(np.median(met)), "error_max": float(met.max()),
    }  # fmt: skip


def batch(rows: int = 100_000) -> float:
    """us each for many wrenches in one call, the best of three."""
    law = ExactLaw(Vehicle(FRAME, MODEL), compiled=True)
    demands = smooth(rows)
    law.many(demands[:10])
    best = float("inf")
    for _ in range(3):
        began = CLOCK()
        law.many(demands)
        best = min(best, (CLOCK() - began) / 1e3 / rows)
    return best


def ring(arms: int, *, paired: bool) -> Airframe:
    """Arms on a circle, each with a contra-rotating pair, or with one rotor of alternate spin."""
    rotors = []
    for level, z in (("upper", -0.07), ("lower", 0.07)) if paired else (("single", 0.0),):
        for k in range(arms):
            angle, spin = 2 * np.pi * (k + 0.5) / arms, 1 if k % 2 == (level == "lower") else -1
            position = (0.4 * np.cos(angle), 0.4 * np.sin(angle), z)
            number = k + 1 + (arms if level == "lower" else 0)
            other = None if level == "single" else k + 1 + (arms if level == "upper" else 0)
            rotors.append(Rotor(number, position, (0.0, 0.0, -1.0), spin, level, other))
    return Airframe("ring", 2.5 * len(rotors), (1, 1, 1), tuple(rotors))


def by_rotors() -> dict[int, float]:
    """Median us by rotor count in the compiled loop: four single rotors, then pairs on a ring."""
    found = {}
    for airframe in (ring(4, paired=False), *(ring(arms, paired=True) for arms in range(3, 9))):
        count = len(airframe.rotors)
        demands = smooth(2000) * np.array([count / 8, count / 16, count / 16, count / 16])
        demands = np.ascontiguousarray(np.clip(demands, -1e9, [1e9, 1e9, 1e9, 1.0]))
        found[count] = compiled_loop(demands, np.ones(2000, bool), airframe)["median_us"]
    return found


def main() -> None:
    """Run, print, and write what was asked for."""
    warnings.filterwarnings("ignore")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=1000)
    parser.add_argument("--png", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    targets = {"smooth": smooth(options.rows), "jumping": jumping(options.rows)}
    result: dict[str, dict[str, dict[str, float]]] = {}
    for name, demands in targets.items():
        reachable = demands[:, 3] < 5.0
        rows = result[name] = {}
        rows["exact, compiled loop"] = compiled_loop(np.tile(demands, (4, 1)), np.tile(reachable, 4))
        rows["exact, compiled, called from Python"] = measure(exact(True), demands, reachable)
        rows["exact, plain Python"] = measure(exact(False), demands, reachable)
        for law in ("reduced", "coaxial-printed", "coaxial"):
            rows[law] = measure(make_law(law, Vehicle(FRAME, MODEL)).speeds, demands, reachable)
        for peer, make in peers().items():
            few = 200 if "scipy" in peer or "cvxpy" in peer else options.rows
            rows[peer] = measure(make(), demands[:few], reachable[:few])
        base = rows["exact, compiled loop"]["median_us"]
        print(f"\n{name}: {'median us':>46} {'p99 us':>9} {'ratio':>8} {'worst miss, reachable':>22}")
        for label, r in rows.items():
            ratio = r["median_us"] / base
            print(
                f"  {label:44s} {r['median_us']:10.2f} {r['p99_us']:9.1f} {ratio:8.1f} {r['error_max']:22.2g}"
            )
    each = batch()
    rotors = by_rotors()
    print(f"\nbatch of 100000: {each:.2f} us each")
    print("by rotors:", ", ".join(f"{n}: {us:.2f} us" for n, us in rotors.items()))
    if options.json:
        document = {"targets": result, "batch_us": each, "by_rotors_us": rotors}
        options.json.write_text(json.dumps(document, indent=2))
    if options.png:
        _draw(options.png, result, rotors)


def _draw(path: Path, result: dict[str, dict[str, dict[str, float]]], rotors: dict[int, float]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 5), layout="constrained")
    bars, cost = figure.subplots(1, 2, width_ratios=[2, 1])
    labels = list(result["smooth"])
    for k, (name, colour) in enumerate((("smooth", "#4477aa"), ("jumping", "#ee6677"))):
        at = np.arange(len(labels)) + 0.4 * k
        bars.barh(
            at, [result[name][n]["median_us"] for n in labels], 0.4, color=colour, label=f"{name}, median"
        )
        bars.plot([result[name][n]["p99_us"] for n in labels], at, "|", color="#222222", ms=10)
    bars.set_yticks(np.arange(len(labels)) + 0.2, labels)
    bars.invert_yaxis()
    bars.set_xscale("log")
    bars.set(xlabel="us per allocation (bar: median, tick: p99)", title="one allocation, paper's X8")
    bars.legend()
    cost.plot(list(rotors), list(rotors.values()), "o-", color="#4477aa")
    cost.set(xlabel="rotors", ylabel="us", title="exact, compiled loop, smooth target", ylim=(0, None))
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
