"""What was chosen, fitted together: a first fit that goes astray must not decide the answer."""

from __future__ import annotations

from dataclasses import replace

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import Samples
from coaxlink.residual import refine
from coaxlink.rotor import load_rotor_model
from sim import flights
from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.px4.autopilot import Autopilot
from sim.truth import read_truth
from sim.vehicle import read_vehicle

TRUTH = """[[effects]]
name = "rotor_lag"
law = "asymmetric"
size = 0.0635
"""


def test_a_first_fit_that_went_astray_does_not_decide(tmp_path, monkeypatch):
    """Left at a share of five, which physics refuses, it still leads the weighed fit to the lag."""
    (tmp_path / "late.truth").write_text(TRUTH)
    plant = Plant(read_vehicle(files.example("x8_demo.toml")), read_pair(files.example("rotor_paper.toml")))
    log = flights.fly(Autopilot(plant, read_truth(tmp_path / "late.truth"), seed=56), "vigorous")

    def astray(fitter, members, **_):
        near = [replace(m, shape={"lag_s": 0.03}, coefficients=5.0 * m.coefficients) for m in members]
        return fitter.linear(near)  # 10 ms five times over in place of some 50

    monkeypatch.setattr("coaxlink.residual.search.joint_fit.fit", astray)
    every = {name: column[::2] for name, column in log.items() if not name.startswith("rpm")}
    model = load_rotor_model(files.example("rotor_paper.toml"))
    answer = refine(Samples(every, "late"), load_airframe(files.example("x8_demo.toml")), model)
    assert [e.name for e in answer.effects] == ["rotor_lag"]
    assert not answer.unexplained
    for name, shown in answer.channels.items():
        assert shown.rmse_after < 1.4 * shown.noise_floor, name
