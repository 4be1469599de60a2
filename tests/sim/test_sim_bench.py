"""The thrust stand with truths: each bends exactly what it says, and nothing else."""

from pathlib import Path

import numpy as np
import pytest

from sim.physics.rotors import read_pair
from sim.stand.effects import CHANNELS, StandEffect, StandSetup, measure, read_bench

EXAMPLES = Path(__file__).parents[2] / "examples"
PAIR = read_pair(EXAMPLES / "rotor_paper.toml")
LOADS = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")


def run(name: str = "", size: float = 0.0, channel: str = "lower_thrust", **how: object) -> dict:
    effects = (StandEffect(name, size, 0.0, CHANNELS.index(channel)),) if name else ()
    return measure(PAIR, StandSetup(effects, **how), seed=5)  # type: ignore[arg-type]


def moved(name: str, size: float, **how: object) -> dict[str, float]:
    """RMS change of every load by an effect, the noise being the same."""
    a, b = run(**how), run(name, size, **how)
    return {c: float(np.sqrt(np.mean((a[c] - b[c]) ** 2))) for c in LOADS}


def test_without_effects_it_reads_the_model() -> None:
    r = run()
    model = PAIR.loads(r["upper_throttle"], r["lower_throttle"])
    for k, c in enumerate(LOADS):
        assert (r[c] - model[k]).std() == pytest.approx((0.5, 0.01)[k % 2], rel=0.2)


EFFECTS = {  # size, the channels that change
    "battery_voltage": (0.8, LOADS),
    "air_density": (1.0, LOADS),
    "sensor_drift": (0.5, ("lower_thrust_N",)),
    "lower_on_upper_interference": (8.0, ("upper_thrust_N",)),
    "blade_speed_law": (0.15, LOADS),
    "hysteresis": (0.08, ("upper_thrust_N", "lower_thrust_N")),
    "rotor_lag": (1.0, LOADS),
    "motor_heating": (0.1, LOADS),
    "dead_band": (0.06, LOADS),
    "strange": (3.0, ("lower_thrust_N",)),
    "lying_tachometer": (0.05, ()),
    "swapped_labels": (1.0, ()),
}


@pytest.mark.slow
def test_an_effect_changes_its_own_channels() -> None:
    wrong = {}
    for name, (size, changes) in EFFECTS.items():
        by = moved(name, size)
        changed = tuple(c for c in LOADS if by[c] > (0.005 if c.endswith("Nm") else 0.2))
        if changed != changes:
            wrong[name] = by
    assert not wrong


def test_spacing_acts_on_the_wake_only_and_is_in_the_log() -> None:
    r = run("rotor_spacing", 0.15, sweeps=4)
    assert sorted(set(np.round(r["rotor_spacing_m"] / 0.15, 2))) == [0.4, 0.8, 1.2, 1.6]
    by = moved("rotor_spacing", 0.15, sweeps=4)
    assert by["lower_thrust_N"] > 0.5 and by["upper_thrust_N"] == 0.0


def test_a_lying_tachometer_and_swapped_labels_lie_in_the_log_only() -> None:
    true, lies, swapped = run(), run("lying_tachometer", 0.05), run("swapped_labels", 1.0)
    fast = true["upper_throttle"] > 0.55
    assert np.allclose(lies["upper_rpm"][fast] / true["upper_rpm"][fast], 1.05, atol=0.005)
    assert np.allclose(swapped["lower_throttle"], true["upper_throttle"])


def test_ramps_and_throttle_only_logs() -> None:
    r = run("rotor_lag", 0.4, pattern="ramps", drive="throttle")
    assert "upper_rpm" not in r and np.diff(r["time_s"]) == pytest.approx(0.1)
    up = np.gradient(r["upper_throttle"]) > 0
    level = (r["upper_throttle"] > 0.4) & (r["upper_throttle"] < 0.6)
    first = r["time_s"] < 18.0
    assert (
        r["upper_thrust_N"][level & up & first].mean() < r["upper_thrust_N"][level & ~up & first].mean() - 1
    )


def test_the_seed_decides_the_log_and_the_example_is_read() -> None:
    bench = read_bench(EXAMPLES / "truth_stand_spacing.toml")
    a, b = measure(PAIR, bench, seed=1), measure(PAIR, bench, seed=1)
    assert all(np.array_equal(a[c], b[c]) for c in a) and len(a["time_s"]) == 4 * 121
