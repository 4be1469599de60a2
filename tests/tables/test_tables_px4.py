"""Laws as PX4 tables: the paper's numbers, and columns against the vehicle's own geometry."""

from pathlib import Path

import numpy as np
import pytest

from coaxlink.airframe import load_airframe
from coaxlink.cli import main
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.mixer import make_law
from coaxlink.rotor import load_rotor_model
from coaxlink.tables import px4 as tables
from coaxlink.vehicle import Vehicle
from firmware_params import px4

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = EXAMPLES / "x8_paper.toml"


def _report(law="reduced", rotor="rotor_paper.toml", frame=X8):
    return tables.report_px4(Vehicle(load_airframe(frame), load_rotor_model(EXAMPLES / rotor)), law)


def test_the_paper_s_printed_matrix_and_what_px4_makes_of_it():
    report = _report(rotor="rotor_eq15.toml")
    assert [r.ct for r in report.table.rotors] == pytest.approx([46.98] * 4 + [69.89] * 4)
    assert [r.km * r.ct for r in report.table.rotors] == pytest.approx(
        [2.44, -2.44, 2.44, -2.44, 2.0, -2.0, 2.0, -2.0]
    )
    for split in report.splits:
        assert split.squared_ratio == pytest.approx(1.487654, abs=2e-5)
        assert (split.hover[1] / split.hover[0]) ** 2 == pytest.approx(1.487654, abs=2e-5)
    assert report.ceiling_N == pytest.approx(405.9, abs=0.1)
    assert report.full_N == pytest.approx(467.5, abs=0.1)
    assert report.params["MPC_THR_HOVER"] == pytest.approx(0.404, abs=1e-6)
    assert report.findings == ()


def test_hover_by_the_rotor_model_carries_the_weight():
    report = _report()
    u, w = report.splits[0].hover
    # eq. 17, written out
    upper = 55.9517 * u**2 + 22.4464 * u
    lower = 2.755 * u**2 * w**2 + 64.721 * w**2 - 2.547 * u * w + 12.402 * w - 37.502 * u**2 + 0.801
    assert 4 * (upper + lower) == pytest.approx(20 * 9.80665, abs=0.01)


def test_the_standard_law_gives_every_rotor_the_same():
    report = _report("standard", "rotor_srm_paper.toml")
    assert {round(r.ct, 9) for r in report.table.rotors} == {73.06}
    assert {round(abs(r.km * r.ct), 9) for r in report.table.rotors} == {1.9}
    assert all(s.squared_ratio == 1.0 for s in report.splits)


def test_columns_are_the_law_s_own_matrix():
    """PX4's effectiveness (its own frame and signs) against the mixer's matrix, built another way."""
    model = load_rotor_model(EXAMPLES / "rotor_eq15.toml")
    for frame in ("x8_paper", "coax_quad_plus", "y6", "mixed_hexa", "coax_tilted"):
        vehicle = Vehicle(load_airframe(EXAMPLES / f"{frame}.toml"), model)
        matrix = make_law("reduced", vehicle).matrix
        columns = px4.effectiveness(tables.px4_table(vehicle, "reduced"))
        wrench = np.stack([-columns[5], columns[0], columns[1], columns[2]])
        close = 0.02 * np.abs(matrix).max() if frame == "coax_tilted" else 1e-4
        np.testing.assert_allclose(wrench, matrix, atol=close, err_msg=frame)


def test_a_law_without_a_table_and_a_trap_are_refused():
    with pytest.raises(InputError, match="coaxial: no table holds this law"):
        _report("coaxial")
    airframe = load_airframe(X8)
    weak = px4.Px4Table(tuple(px4.RotorEntry(r.position_m, r.axis, 1.0, 0.04) for r in airframe.rotors), 1.0)
    report = tables.assess_px4(
        Vehicle(airframe, load_rotor_model(EXAMPLES / "rotor_paper.toml")), "reduced", weak
    )
    with pytest.raises(SafetyRefusal, match=r"px4.weak-axis: PX4 drops yaw"):
        tables.refuse_traps(report)


@pytest.mark.slow
def test_a_table_of_leaning_rotors_that_turns_the_vehicle_the_other_way_is_refused():
    tilted = EXAMPLES / "coax_tilted.toml"
    airframe, model = load_airframe(tilted), load_rotor_model(EXAMPLES / "rotor_paper.toml")
    for law in ("reduced", "standard"):
        report = _report(law, frame=tilted)
        by_id = {f.id: f for f in report.findings}
        leaning = by_id["px4.leaning-axes"]
        assert leaning.severity == "warning" and "`law` fitted" in leaning.text
        assert by_id["px4.reversed-axis"] in report.blocking
        # the sign is the physics': a small pitch demand, through PX4's own mix and the rotors, by hand
        turned = []
        for pitch in (0.02, -0.02):
            control = [0.0, pitch, 0.0, 0.0, 0.0, -report.behaviour.hover]
            speeds = report.mix.throttle(report.mix.setpoints(control))
            turned.append(airframe.wrench(*airframe.loads(model, speeds))[2])
        assert turned[0] <= turned[1]
    assert _report("fitted", frame=tilted).findings == ()


def test_an_error_of_the_rotor_names_the_rotor_file(tmp_path, capsys):
    weak = tmp_path / "weak.toml"
    text = (EXAMPLES / "rotor_srm_paper.toml").read_text()
    weak.write_text(text.replace("73.06", "-73.06"))
    with pytest.raises(SystemExit) as ended:
        main(["table", str(X8), "--firmware", "px4", "--law", "standard", "--rotor", str(weak)])
    error = capsys.readouterr().err
    assert ended.value.code == 2 and str(weak) in error and "rotor_model" not in error
