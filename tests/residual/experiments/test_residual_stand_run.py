"""An ambiguous answer comes with a run that settles it: proposed, run on the virtual stand, and settled."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run

EXAMPLES = Path(__file__).parents[3] / "examples"
TRUTHS = {"battery_voltage": 0.5, "motor_heating": 0.12}


def coaxlink(*arguments: object) -> None:
    assert run(build_app(), [str(a) for a in arguments]) == 0


def measured(folder: Path, truth: str, schedule: Path, seed: int) -> Path:
    determined = folder / f"{truth}.toml"
    determined.write_text(
        f'[stand]\ndrive = "throttle"\n[[effects]]\nname = "{truth}"\nsize = {TRUTHS[truth]}\n'
    )
    log = folder / f"{truth}-{seed}.csv"
    coaxlink("sim", "--stand", log, "--truth", determined, "--schedule", schedule, "--seed", seed)
    return log


def refined(log: Path, *more: object) -> dict:
    answer = log.with_suffix(".json")
    coaxlink("refine", log, "--rotor", EXAMPLES / "rotor_paper.toml", "--json", answer, *more)
    return json.loads(answer.read_text())


@pytest.fixture(scope="module")
def doubt(tmp_path_factory):
    """A poor log, its answer, and the proposed run."""
    folder = tmp_path_factory.mktemp("doubt")
    log = measured(folder, "battery_voltage", EXAMPLES / "schedule_poor.toml", 2)
    plan = folder / "plan.toml"
    return refined(log, "--plan", plan), plan


@pytest.mark.slow
def test_a_poor_log_is_ambiguous_and_says_what_to_run(doubt):
    answer, plan = doubt
    assert not answer["effects"]
    # nothing was added
    assert all(c["rmse_after"] == c["rmse_before"] for c in answer["channels"].values())
    (ambiguous,) = answer["ambiguous"]
    assert {"battery_voltage", "motor_heating"} <= set(ambiguous["names"])
    assert "standard deviations" in ambiguous["separate_by"]
    assert len({p.get("supply_V") for p in ambiguous["plan"]["pieces"]}) > 1  # the supply has to be moved
    assert plan.read_text().count("[[pieces]]") == len(ambiguous["plan"]["pieces"])


@pytest.mark.slow
@pytest.mark.parametrize("truth", ["battery_voltage", "motor_heating"])
def test_the_run_names_whichever_is_true(doubt, tmp_path, truth):
    answer = refined(measured(tmp_path, truth, doubt[1], 11))
    assert [e["name"] for e in answer["effects"]] == [truth]
    assert not answer["ambiguous"]


def test_nothing_ambiguous_writes_no_plan(tmp_path):
    log, calm = tmp_path / "clean.csv", tmp_path / "calm.toml"
    calm.write_text('[stand]\npattern = "grid"\n')
    coaxlink("sim", "--stand", log, "--truth", calm, "--seed", 5)
    refined(log, "--plan", tmp_path / "none.toml")
    assert not (tmp_path / "none.toml").exists()


@pytest.mark.slow
def test_a_log_with_rpm_gets_a_plan_too():
    """No rotor turns in a rest alone, and a plan's exact rpm are no commands."""
    from residual_rig import run as rig

    from coaxlink.channels.stand import stand_frame
    from coaxlink.data import Samples
    from coaxlink.effects import stand_effects
    from coaxlink.residual.experiments.stand_run import Rival, stand_experiment

    columns = rig(seed=2)
    frame = stand_frame(Samples(columns, "stand"), None)
    known = {e.name: e for e in stand_effects()}
    drift = Rival(known["sensor_drift"], {"channel": 0.0, "per_minute": 0.3, "zero": 0.0})
    loss = {"thrust_loss_N": 3.0, "torque_loss_Nm": 0.0, "lower_power": 2.0, "upper_power": 1.0}
    found = stand_experiment(
        frame, np.full(6, 0.1), [drift, Rival(known["lower_on_upper_interference"], loss)]
    )
    assert found is not None and found.distance > 3.0 and found.channel == "upper_thrust"
