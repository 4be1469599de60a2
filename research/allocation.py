"""One allocation, side by side: the exact law against what else could solve the same problem.

    python research/allocation.py [--rows 1000] [--small] [--json F]      (needs the `bench` extra)
    python research/allocation.py --board [--rows 200000] [--airframe F] [--json F]      (needs g++)

The paper's vehicle and rotors (eq. 17); a smooth 1 kHz target with 4 % of it out of reach, and a jumping one.
Times are CPU times of this thread, so a busy machine inflates them less; read the ratios. Peers that are not
installed are left out. The QP peers run the same SQP on the same compiled expansion as the exact law, so they
are charged for their QP and its calling convention alone. `--small`: 40 rows, nothing compiled.

`--board`: the law on board (C++, single precision where it can) against the Python law on the same demands,
of four kinds, each with all rotors and with rotor 3 dead: `smooth` at 250 Hz; `steps` that are held for a
fifth of a second; `beyond`, smooth and up to four times out of reach; `jumps`, anywhere at every call, which
no vehicle demands. Of the calls that both settle: the worst difference of a speed. Of all: was what flew
worse than the reduced mixer?
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from coaxlink.files import example
from coaxlink.mixer import make_law
from coaxlink.mixer.exact import ExactLaw, solver
from coaxlink.mixer.exact.arms import standing
from coaxlink.mixer.exact.compiled import OPTIONS, function
from coaxlink.vehicle import load_vehicle

X8 = load_vehicle(example("x8_paper.toml"))
FRAME, MODEL = X8.airframe, X8.model
CLOCK = time.thread_time_ns
Solver = Callable[[list[float]], Any]  # a wrench to speeds (N,)
Quadratic = Callable[..., tuple[Any, Any]]  # (H, g, J, missing, low, high) to the step and prices


def smooth(rows: int) -> np.ndarray:
    """1 kHz; 4 % of the rows demand more yaw than there is."""
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


def sqp(quadratic: Quadratic, compiled: bool) -> Solver:
    """The same SQP, warm-started, with another solver for its quadratic problems."""
    law = ExactLaw(X8)
    p, units, s = law.arms, law.units, standing(law.arms)
    expand: Any = solver.expand
    if compiled:
        import numba

        function()  # what `expand` calls is compiled with it
        expand = numba.njit(expand, **OPTIONS)
    h = np.zeros((8, 8))

    def solve(wrench: list[float]) -> Any:
        s.mu[:] = np.array(wrench)[units.order] / units.scale
        for _ in range(10):
            expand(p, s)
            for k, (uu, ul, ll) in enumerate(s.hessian):
                h[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = (uu, ul), (ul, ll)
            try:
                step, price = quadratic(h, s.slope, s.jacobian.T.copy(), s.miss, -s.x, 1 - s.x)
            except (ValueError, RuntimeError):
                break
            s.x[:] = np.clip(s.x + step, 0, 1)
            s.price[:] = np.clip(price, -50, 50)
            if np.abs(step).max() < 1e-5:
                break
        upper, least, most = s.x[::2], *(p.line[:, [0, 2]] + p.line[:, [1, 3]] * s.x[::2, None]).T
        return np.column_stack([upper, least + (most - least) * s.x[1::2]]).ravel()[units.slots]

    return solve


def daqp_qp() -> Quadratic:
    from ctypes import c_int

    import daqp

    sense = np.array([0] * 8 + [5] * 4, c_int)

    def quadratic(h: Any, g: Any, j: Any, r: Any, low: Any, high: Any) -> Any:
        step, _, flag, info = daqp.solve(h, g, j, np.concatenate([high, r]), np.concatenate([low, r]), sense)
        if flag < 1:
            raise ValueError("infeasible")
        return step, -np.asarray(info["lam"])[8:]

    return quadratic


def quadprog_qp() -> Quadratic:
    import quadprog

    eye = np.eye(8)

    def quadratic(h: Any, g: Any, j: Any, r: Any, low: Any, high: Any) -> Any:
        rows = np.concatenate([j, eye, -eye]).T
        found = quadprog.solve_qp(h, -g, rows, np.concatenate([r, low, -high]), 4)
        return found[0], found[4][:4]

    return quadratic


def piqp_qp() -> Quadratic:
    import piqp

    solving = piqp.DenseSolver()
    solving.settings.verbose = False
    first = [True]

    def quadratic(h: Any, g: Any, j: Any, r: Any, low: Any, high: Any) -> Any:
        if first.pop() if first else False:
            solving.setup(h, g, j, r, None, None, None, low, high)
        else:
            solving.update(P=h, c=g, A=j, b=r, x_l=low, x_u=high)
        if solving.solve() != piqp.PIQP_SOLVED:
            raise ValueError("infeasible")
        return np.array(solving.result.x), -np.array(solving.result.y)

    return quadratic


def slsqp() -> Solver:
    from scipy.optimize import minimize

    x = np.full(8, 0.5)

    def solve(wrench: list[float]) -> Any:
        met = {"type": "eq", "fun": lambda u: FRAME.wrench(*FRAME.loads(MODEL, u)) - wrench}
        found = minimize(
            lambda u: FRAME.loads(MODEL, u)[1] @ u, x, method="SLSQP", bounds=[(0, 1)] * 8,
            constraints=met, options={"ftol": 1e-10},
        )  # fmt: skip
        if np.isfinite(found.x).all():
            x[:] = np.clip(found.x, 0, 1)
        return x.copy()

    return solve


def casadi_sqp() -> Solver:
    import casadi as ca

    u, mu = ca.SX.sym("u", 8), ca.SX.sym("mu", 4)
    f, q = [ca.SX(0)] * 8, [ca.SX(0)] * 8

    def poly(load: Any, a: Any, b: Any) -> Any:
        terms = zip(load.exponents, load.coefficients, strict=True)
        return sum(c * a ** e[0] * b ** e[1] for e, c in terms)

    for i, k in FRAME.pairs:
        f[i], q[i] = poly(MODEL.upper_thrust, u[i], u[k]), poly(MODEL.upper_torque, u[i], u[k])
        f[k], q[k] = poly(MODEL.lower_thrust, u[i], u[k]), poly(MODEL.lower_torque, u[i], u[k])
    per_thrust, per_torque = FRAME.effectiveness()
    wrench = ca.DM(per_thrust) @ ca.vertcat(*f) + ca.DM(per_torque) @ ca.vertcat(*q)
    quiet = dict.fromkeys(("print_time", "print_header", "print_iteration", "print_status"), False)
    qp = {"print_iter": False, "print_header": False, "error_on_fail": False}
    options = {"qpsol": "qrqp", "qpsol_options": qp, "error_on_fail": False, **quiet}
    problem = {"x": u, "p": mu, "f": ca.dot(ca.vertcat(*q), u), "g": wrench - mu}
    solving = ca.nlpsol("s", "sqpmethod", problem, options)
    state = {"x0": np.full(8, 0.5), "lam_g0": np.zeros(4)}

    def solve(wrench: list[float]) -> Any:
        found = solving(p=wrench, lbx=0, ubx=1, lbg=0, ubg=0, **state)
        x = np.array(found["x"]).ravel()
        if np.isfinite(x).all():
            state["x0"], state["lam_g0"] = np.clip(x, 0, 1), found["lam_g"]
        return state["x0"]

    return solve


QPS = {"daqp": daqp_qp, "quadprog": quadprog_qp, "piqp": piqp_qp}  # by package


def solvers(compiled: bool) -> dict[str, Solver]:
    """The laws, and whatever peer is installed."""
    found: dict[str, Solver] = {}
    if compiled:
        found["exact, compiled, called from Python"] = ExactLaw(X8, compiled=True).plain
    found["exact, plain Python"] = ExactLaw(X8).plain
    found |= {law: make_law(law, X8).speeds for law in ("reduced", "coaxial")}
    for name, make in QPS.items():
        if importlib.util.find_spec(name):
            found[f"same SQP, {name}"] = sqp(make(), compiled)
    if importlib.util.find_spec("casadi"):
        found["CasADi sqpmethod, qrqp"] = casadi_sqp()
    return found | {"scipy SLSQP": slsqp()}


def measure(solve: Solver, demands: np.ndarray) -> dict[str, float]:
    """Median and p99 CPU time (us) and the worst error (N, N m) on reachable demands."""
    times, errors = [], []
    solve(demands[0].tolist())
    for row in demands.tolist():
        began = CLOCK()
        u = np.array(solve(row))
        times.append((CLOCK() - began) / 1e3)
        errors.append(np.abs(FRAME.wrench(*FRAME.loads(MODEL, u)) - row).max())
    met = np.array(errors)[demands[:, 3] < 5.0]
    return {
        "median_us": float(np.median(times)), "p99_us": float(np.percentile(times, 99)),
        "error_max": float(met.max()),
    }  # fmt: skip


def on_board(rows: int, airframe: Path) -> list[dict[str, Any]]:
    """A line a kind of demand, printed."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
    from board_law import build, compare  # type: ignore[import-not-found]

    from coaxlink.live.onboard.description import board_law

    vehicle = load_vehicle(airframe)
    with tempfile.TemporaryDirectory() as folder:
        found: list[dict[str, Any]] = compare(
            vehicle, build(Path(folder), board_law(vehicle), "-O2"), rows // 8
        )
    for f in found:
        passes, micros = ("/".join(f"{v:.{d}f}" for v in f[k]) for k, d in (("passes", 0), ("micros", 1)))
        print(
            f"{f['kind']:7} {'rotor 3 dead' if f['dead'] else 'all rotors  '} "
            f"settled {100 * f['settled']:7.3f} %  "
            f"worst {f['worst']:.1e}  within 1e-4 {100 * f['within']:7.3f} %  another and worse "
            f"{f['worse']}  worse than reduced {f['worse_than_reduced']}  passes {passes}  us {micros}"
        )  # fmt: skip
    return found


def main() -> None:
    """Run, print, write the JSON."""
    warnings.filterwarnings("ignore")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int)
    parser.add_argument("--board", action="store_true", help="the law on board against this one")
    parser.add_argument("--airframe", type=Path, default=example("x8_paper.toml"), help="of the law on board")
    parser.add_argument("--small", action="store_true", help="40 rows, nothing compiled; 1,600 on board")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.board:
        found = on_board(options.rows or 200_000, options.airframe)
        if options.json:
            options.json.write_text(json.dumps(found, indent=1))
        sys.exit(any(f["worse_than_reduced"] for f in found))
    rows = 40 if options.small else options.rows or 1000
    result: dict[str, dict[str, dict[str, float]]] = {}
    for name, demands in (("smooth", smooth(rows)), ("jumping", jumping(rows))):
        print(f"\n{name}: {'median us':>46} {'p99 us':>9} {'worst miss, reachable':>22}")
        result[name] = {}
        for label, solve in solvers(not options.small).items():
            few = rows if not label.endswith(("SLSQP", "osqp")) else min(rows, 200)
            r = result[name][label] = measure(solve, demands[:few])
            print(f"  {label:44s} {r['median_us']:10.2f} {r['p99_us']:9.1f} {r['error_max']:22.2g}")
    document: dict[str, Any] = {"targets": result}
    if options.json:
        options.json.write_text(json.dumps(document, indent=2))
    if options.small and shutil.which("g++"):
        sys.exit(any(f["worse_than_reduced"] for f in on_board(1600, options.airframe)))


if __name__ == "__main__":
    main()
