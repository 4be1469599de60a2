"""What a user would otherwise do with a residual, side by side with `refine`, on the same hidden stand logs.

    python research/peers.py [--seeds 1] [--clean 8] [--small] [--json F]      (needs the `bench` extra)

Every peer gets the residual of each channel (measured minus the given rotor model), every recorded column
as a variable, and the held-out blocks that `refine` uses. Its answer is read as it is meant: PySINDy
(STLSQ, polynomials to degree 2) and LassoCV (pairwise products) name the terms they keep, gradient
boosting the variables whose permutation hurts (scikit-learn), a Gaussian process the shortest length scales.
Printed: held-out error after over the noise that was really there, how often the first thing named is the
variable that the hidden effect works through, how often anything at all is claimed on clean logs, time.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from worlds import own as worlds

from coaxlink import files
from coaxlink.channels.stand import stand_frame
from coaxlink.data import Samples
from coaxlink.frames import STAND_CHANNELS, StandFrame
from coaxlink.residual import refine_stand
from coaxlink.rotor import load_rotor_model

Array = NDArray[np.float64]
FOLDS = 4
MOST_ROWS = 400
CLAIM = 0.02  # of the held-out variance: a peer that gains less says nothing
# the recorded variables that an effect works through: naming any of them first counts as the cause
CAUSES = {
    "battery_voltage": {"voltage_V"},
    "air_density": {"air_temperature_C", "air_pressure_Pa"},
    "sensor_drift": {"time_s"},
    "lower_on_upper_interference": {"lower"},
    "blade_speed_law": {"upper", "lower"},
    "hysteresis": {"upper_rate", "lower_rate"},
    "rotor_lag": {"upper_rate", "lower_rate"},
    "rotor_spacing": {"rotor_spacing_m"},
    "motor_heating": {"motor_temperature_C"},
    "dead_band": {"upper", "lower"},
}


@dataclass(frozen=True)
class Task:
    """One channel of one log."""

    x: Array  # (rows, V) standardised
    names: tuple[str, ...]
    y: Array  # (rows,)
    fold: NDArray[np.intp]


@dataclass(frozen=True)
class Answer:
    """What one peer made of one channel."""

    after: float  # held-out RMS
    gain: float  # of the held-out variance
    named: tuple[str, ...]  # variables or terms, most important first


def logs(effects: Iterable[str], seeds: int, clean: int) -> Iterator[tuple[str, worlds.Made]]:
    """Hidden runs with the rotor model given."""
    for hidden, count in [*((n, seeds) for n in effects), ("", clean)]:
        found, seed = 0, 700
        while found < count:
            seed += 1
            made = worlds.make_stand((hidden,) if hidden else (), seed, 0.03 + 0.05 * (seed % 3) / 2.0)
            if made.rotor is not None and int(str(made.truth["rows"])) < 2500:
                found += 1
                yield hidden, made


def tasks(frame: StandFrame, most_rows: int) -> list[tuple[int, Task]]:
    """The residual of every channel that was measured, against every variable."""
    columns = {"upper": frame.speeds[:, 0], "lower": frame.speeds[:, 1]}
    for side, values in (("upper", frame.speeds[:, 0]), ("lower", frame.speeds[:, 1])):
        columns[f"{side}_rate"] = np.gradient(values, frame.time_s)
    for name, column in frame.columns.items():
        if not name.endswith(("_rpm", "_throttle", "_thrust_N", "_torque_Nm")):
            columns[name] = column
    varied = {n: v for n, v in columns.items() if np.std(v) > 1e-9}
    x = np.stack([(v - v.mean()) / v.std() for v in varied.values()], axis=1)
    step = max(1, len(x) // most_rows)
    fold = (frame.block % FOLDS)[::step]
    left = frame.measured - frame.predicted
    return [(c, Task(x[::step], tuple(varied), left[::step, c], fold)) for c in frame.present]


def crossed(
    task: Task, fit: Callable[[Array, Array], Callable[[Array], Array]], named: tuple[str, ...]
) -> Answer:
    """Held-out error of a fitting function."""
    guess = np.zeros_like(task.y)
    for f in np.unique(task.fold):
        test = task.fold == f
        mean = float(task.y[~test].mean())
        guess[test] = fit(task.x[~test], task.y[~test] - mean)(task.x[test]) + mean
    after = float(np.sqrt(np.mean((task.y - guess) ** 2)))
    return Answer(after, 1.0 - after**2 / max(float(np.var(task.y)), 1e-300), named)


def pairwise(x: Array) -> Array:
    """(rows, V + V (V + 1) / 2) variables and their products."""
    i, j = np.triu_indices(x.shape[1])
    return np.concatenate([x, x[:, i] * x[:, j]], axis=1)


def pair_names(names: tuple[str, ...]) -> list[str]:
    """Of `pairwise`."""
    i, j = np.triu_indices(len(names))
    return [*names, *(f"{names[a]} * {names[b]}" for a, b in zip(i, j, strict=True))]


def lasso(task: Task) -> Answer:
    """LassoCV on variables and pairwise products."""
    from sklearn.linear_model import LassoCV

    def fit(x: Array, y: Array) -> Callable[[Array], Array]:
        model = LassoCV(cv=4, max_iter=1000).fit(pairwise(x), y)
        return lambda z: np.asarray(model.predict(pairwise(z)))

    first = LassoCV(cv=4, max_iter=1000).fit(pairwise(task.x), task.y)
    order = np.argsort(-np.abs(first.coef_))
    chosen = [pair_names(task.names)[k] for k in order if first.coef_[k] != 0.0]
    return crossed(task, fit, tuple(chosen))


def sindy(task: Task) -> Answer:
    """PySINDy: thresholded least squares on polynomials to degree 2, the residual as the derivative."""
    import pysindy

    threshold = 0.05

    def made(x: Array, y: Array) -> tuple[pysindy.SINDy, float]:
        scale = float(y.std()) or 1.0
        model = pysindy.SINDy(
            optimizer=pysindy.STLSQ(threshold=threshold, alpha=0.05),
            feature_library=pysindy.PolynomialLibrary(degree=2),
        )
        steps = np.arange(float(len(x)))
        model.fit(x, t=steps, x_dot=np.repeat((y / scale)[:, None], x.shape[1], axis=1))
        return model, scale

    def fit(x: Array, y: Array) -> Callable[[Array], Array]:
        model, scale = made(x, y)
        return lambda z: scale * np.asarray(model.predict(z))[:, 0]

    model, _ = made(task.x, task.y - task.y.mean())
    weights = np.abs(model.coefficients()[0])
    labels = model.get_feature_names()
    named = []
    for k in np.argsort(-weights):
        if weights[k] > 0 and labels[k] != "1":
            parts = [f for f in labels[k].replace("^2", "").split(" ") if f.startswith("x")]
            named.append(" * ".join(task.names[int(p[1:])] for p in parts))
    return crossed(task, fit, tuple(named))


def boosting(task: Task) -> Answer:
    """Gradient boosting; variables by permutation importance on held-out rows."""
    from sklearn.ensemble import HistGradientBoostingRegressor
    from sklearn.inspection import permutation_importance

    def grown(x: Array, y: Array) -> HistGradientBoostingRegressor:
        return HistGradientBoostingRegressor(max_iter=60, max_leaf_nodes=15, random_state=0).fit(x, y)

    test = task.fold == 0
    model = grown(task.x[~test], task.y[~test])
    hurt = permutation_importance(model, task.x[test], task.y[test], n_repeats=5, random_state=0)
    order = np.argsort(-hurt.importances_mean)
    named = [task.names[k] for k in order if hurt.importances_mean[k] > 2.0 * hurt.importances_std[k] + 1e-12]
    return crossed(task, lambda x, y: grown(x, y).predict, tuple(named))


def process(task: Task) -> Answer:
    """A Gaussian process with a length scale for every variable, on at most 100 rows."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    wide = task.x.shape[1]

    def fitted(x: Array, y: Array) -> GaussianProcessRegressor:
        pick = np.random.default_rng(0).permutation(len(x))[:100]
        scales = RBF(np.full(wide, 2.0), (0.1, 100.0))
        kernel = ConstantKernel(1.0, (1e-3, 1e3)) * scales + WhiteKernel(1.0, (1e-3, 1e2))
        return GaussianProcessRegressor(kernel, normalize_y=True).fit(x[pick], y[pick])

    lengths = np.asarray(fitted(task.x, task.y).kernel_.k1.k2.length_scale)
    named = [task.names[k] for k in np.argsort(lengths) if lengths[k] < 10.0]
    return crossed(task, lambda x, y: fitted(x, y).predict, tuple(named))


PEERS: dict[str, Callable[[Task], Answer]] = {
    "PySINDy": sindy,
    "LassoCV, products": lasso,
    "gradient boosting": boosting,
    "Gaussian process": process,
}


def ours(hidden: str, made: worlds.Made) -> dict[str, object]:
    """One log through `refine`."""
    samples = Samples({k: np.asarray(v, float) for k, v in made.columns.items()}, "blind")
    truth = made.truth["sigma"]
    assert isinstance(truth, dict)
    sigma = {name.rsplit("_", 1)[0]: float(s) for name, s in truth.items()}
    start = time.process_time()
    mine = refine_stand(samples, load_rotor_model(files.example(str(made.rotor))))
    found = [e.name for e in mine.effects]
    over = [c.rmse_after / sigma[n] for n, c in mine.channels.items() if n in sigma]
    return {
        "over": max(over), "claims": bool(found), "cause": found == [hidden], "first": "+".join(found),
        "terms": len(found), "seconds": time.process_time() - start,
    }  # fmt: skip


def judge(hidden: str, made: worlds.Made, most_rows: int = MOST_ROWS) -> dict[str, dict[str, object]]:
    """One log through everyone."""
    samples = Samples({k: np.asarray(v, float) for k, v in made.columns.items()}, "blind")
    model = load_rotor_model(files.example(str(made.rotor)))
    frame = stand_frame(samples, model)
    truth = made.truth["sigma"]
    assert isinstance(truth, dict)
    sigma = {name.rsplit("_", 1)[0]: float(s) for name, s in truth.items()}
    out: dict[str, dict[str, object]] = {}
    for name, peer in PEERS.items():
        start, over, claims = time.process_time(), [1.0], []
        for c, task in tasks(frame, most_rows):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                answer = peer(task)
            if STAND_CHANNELS[c] in sigma:
                over.append(answer.after / sigma[STAND_CHANNELS[c]])
            if answer.named and answer.gain > CLAIM:
                claims.append((answer.gain, answer.named[0], len(answer.named)))
        top = max(claims, default=(0.0, "", 0))
        cause = set(top[1].split(" * ")) & CAUSES.get(hidden, set())
        out[name] = {
            "over": max(over), "claims": bool(claims), "cause": bool(cause), "first": top[1], "terms": top[2],
            "seconds": time.process_time() - start,
        }  # fmt: skip
    out["coaxlink refine"] = ours(hidden, made)
    return out


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=1, help="logs of each effect")
    parser.add_argument("--clean", type=int, default=8)
    parser.add_argument("--small", action="store_true", help="forty rows of one log")
    parser.add_argument("--json", type=Path, help="kept log by log, and gone on with")
    a = parser.parse_args()
    if importlib.util.find_spec("pysindy") is None:
        print("PySINDy is not installed (the `bench` extra): without it", flush=True)
        PEERS.pop("PySINDy")
    judged = json.loads(a.json.read_text()) if a.json and a.json.exists() else []
    run = logs(("battery_voltage",), 1, 0) if a.small else logs(worlds.STAND_EFFECTS, a.seeds, a.clean)
    for k, (hidden, made) in enumerate(run):
        if k < len(judged):
            continue
        judged.append({"hidden": hidden, "answers": judge(hidden, made, 40 if a.small else MOST_ROWS)})
        reported = "; ".join(f"{n}: {v['first'] or '-'}" for n, v in judged[-1]["answers"].items())
        print(f"# {hidden or 'clean'}: {reported}", flush=True)
        if a.json:
            a.json.write_text(json.dumps(judged))
    print(
        f"{'':20s} {'after / noise':>14s} {'cause first':>12s} {'claims, clean':>14s} "
        f"{'terms':>6s} {'s a log':>8s}"
    )
    for name in [*PEERS, "coaxlink refine"]:
        mine = [r["answers"][name] for r in judged if r["hidden"]]
        calm = [r["answers"][name] for r in judged if not r["hidden"]]
        over, terms = (float(np.median([v[k] for v in mine])) for k in ("over", "terms"))
        seconds = float(np.median([v["seconds"] for v in [*mine, *calm]]))
        cause = f"{sum(v['cause'] for v in mine)}/{len(mine)}"
        claims = f"{sum(v['claims'] for v in calm)}/{len(calm)}"
        print(f"{name:20s} {over:14.2f} {cause:>12s} {claims:>14s} {terms:6.0f} {seconds:8.1f}")


if __name__ == "__main__":
    main()
