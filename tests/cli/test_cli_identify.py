"""`coaxlink identify` as a user runs it: output, files, JSON of the contract, exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runs import coaxlink

from coaxlink.cli.shared.stand import StandOptions, read_stand
from coaxlink.files import example
from coaxlink.rotor import load_rotor_model

SHARED = Path(__file__).parents[2] / ".." / "shared" / "data" / "coax"
LOADS = {"upper.thrust_N", "upper.torque_Nm", "lower.thrust_N", "lower.torque_Nm"}
HEAD = "upper_throttle,lower_throttle,upper_thrust_N,upper_torque_Nm,lower_thrust_N,lower_torque_Nm"


def rcrm_log(path: Path, head: str = HEAD) -> Path:
    """A coarse grid whose truth is the paper's R-CRM, nearly without noise."""
    random = np.random.default_rng(0)
    lines = [head]
    for u in np.linspace(0, 1, 8):
        for v in np.linspace(0, 1, 8):
            loads = [77.65 * u**2, 1.93 * u**2, 69.89 * v**2 - 30.7 * u**2, 2 * v**2 - 0.5 * u**2]
            noisy = np.array(loads) + random.standard_normal(4) * [0.1, 0.002, 0.1, 0.002]
            lines.append(",".join(f"{x:.5f}" for x in (u, v, *noisy)))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.slow
def test_example_with_all_it_can_write(tmp_path: Path) -> None:
    rotor, report, page, pictures = (tmp_path / n for n in ("rotor.toml", "r.json", "r.html", "png"))
    outputs = ("--out", rotor, "--json", report, "--plot", pictures, "--report", page)
    run = coaxlink("identify", "example", "--max-order", 3, "--all", *outputs)
    assert run.code == 0
    assert "lower.thrust_N" in run.out and "R-CRM" in run.out and "noise floor" in run.out
    assert "held-out blocks" in run.err and "NRMSE" in run.err
    found = json.loads(report.read_text())
    assert found["form"] == "crm" and set(found["terms"]) == LOADS
    assert {"coaxial_thrust", "coaxial_torque", "upper_thrust", "lower_torque"} <= set(found["channels"])
    assert set(found["channels"]["coaxial_thrust"]) == {"rmse", "nrmse", "r", "held_out_rows"}
    assert found["channels"]["coaxial_thrust"]["rmse"] < 1.1614 / 1.4  # the paper's Table 2
    model = load_rotor_model(rotor)
    assert model.terms() == found["terms"]
    assert model.identified["rows"] == 121 and len(model.identified["sha256"]) == 64
    drawn = ("surfaces", "residuals")
    assert {p.name for p in pictures.iterdir()} == {
        f"{name}.{kind}" for name in drawn for kind in ("png", "svg", "pdf")
    }
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in pictures.glob("*.png"))
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 2 and "http" not in text.replace("http-equiv", "")
    assert "u_l^2" in text


@pytest.mark.slow
def test_the_answer_comes_first_and_what_it_rests_on_is_always_said(tmp_path: Path) -> None:
    log = rcrm_log(tmp_path / "log.csv", HEAD)
    run = coaxlink("identify", log, "--form", "rcrm")
    lines = run.out.splitlines()
    assert run.code == 0 and lines[0].startswith("The R-CRM predicts the thrust of the pair")
    assert len(lines) < 12 and "u_l^2" not in run.out
    assert "! the throttle is taken for the normalised speed" in run.err and "next: " in run.err
    assert "u_l^2" in coaxlink("identify", log, "--form", "rcrm", "--all").out


@pytest.mark.slow
def test_several_logs_give_a_model_each_joined_they_give_one(tmp_path: Path) -> None:
    log, alone = rcrm_log(tmp_path / "log.csv"), tmp_path / "alone.csv"
    lines = [f"{u},{77.65 * u * u:.4f},{1.93 * u * u:.5f}" for u in np.linspace(0.1, 1, 30)]
    alone.write_text("\n".join(["upper_throttle,upper_thrust_N,upper_torque_Nm", *lines]) + "\n")
    out, report = tmp_path / "rotor.toml", tmp_path / "r.json"
    options = ("--form", "rcrm", "--max-order", 2, "--json", report, "--out", out)
    assert coaxlink("identify", log, alone, *options).code == 0
    assert len(json.loads(report.read_text())["models"]) == 2
    assert load_rotor_model(tmp_path / "rotor_1.toml").form == "rcrm"
    assert load_rotor_model(tmp_path / "rotor_2.toml").identified["rows"] == 30
    run = coaxlink("identify", log, alone, "--join", *options)
    assert run.code == 0
    found = json.loads(report.read_text())
    assert any("joined" in note for note in found["notes"])
    assert found["rows"] == 94 and "models" not in found
    assert found["channels"]["upper_thrust"]["held_out_rows"] == 94
    assert found["channels"]["coaxial_thrust"]["held_out_rows"] == 64


@pytest.mark.slow
def test_a_tare_that_is_taken_off_is_said_without_asking(tmp_path: Path) -> None:
    log = rcrm_log(tmp_path / "log.csv")
    head, *rows = log.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    off = [",".join([*c[:3], f"{float(c[3]) + 0.4:.5f}", *c[4:]]) for c in cells]
    assert "taken off" not in coaxlink("identify", log).err
    log.write_text("\n".join([head, *off]))
    run = coaxlink("identify", log)
    assert run.code == 0 and "tare taken off: upper_torque_Nm 0.4 in 1 rows at rest" in run.err


@pytest.mark.slow
def test_bad_input_is_one_line_and_nothing_is_written(tmp_path: Path) -> None:
    cases = {
        None: "cannot be read",
        "": "empty",
        "upper_rpm,lower_rpm,upper_thrust_N\n1,2,x\n": "line 2, column 'upper_thrust_N'",
        "upper_rpm,lower_rpm\n" + "1,2\n" * 9: "upper_thrust_N: missing",
        "upper_rpm,upper_thrust_N,upper_torque_Nm\n1,2,3\n": "too few",
        "upper_rpm,lower_rpm,upper_thrust_N\n1,2,nan\n": "a finite number is expected",
    }
    wrong = []
    for text, expected in cases.items():
        log = tmp_path / "log.csv"
        if text is not None:
            log.write_text(text)
        run = coaxlink("identify", log, "--out", tmp_path / "o.toml", "--json", tmp_path / "o.json")
        one_line = run.out == "" and run.err.count("\n") == 1 and "log.csv" in run.err
        if run.code != 2 or not one_line or expected not in run.err:
            wrong.append((expected, run))
    assert not wrong
    assert [p.name for p in tmp_path.iterdir() if p.is_file()] == ["log.csv"]
    assert coaxlink("identify").code == 2


def test_a_map_of_columns(tmp_path: Path) -> None:
    rcrm_log(tmp_path / "odd.csv", "a,b,c,d,e,f")
    pairs = zip(HEAD.split(","), "abcdef", strict=True)
    (tmp_path / "map.toml").write_text("".join(f'{n} = {{ column = "{c}" }}\n' for n, c in pairs))
    read = read_stand([tmp_path / "odd.csv"], StandOptions(tmp_path / "map.toml"), lambda text: None)[0]
    assert read.rows == 64 and read["lower_thrust_N"].max() == pytest.approx(69.89, abs=0.3)


@pytest.mark.slow
@pytest.mark.shared_data
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared real data is not beside this checkout")
def test_the_real_map_as_it_is(tmp_path: Path) -> None:
    out = tmp_path / "rotor.toml"
    run = coaxlink("identify", SHARED / "mn4014_16in_zD1.csv", "--all", "--out", out)
    assert run.code == 0 and "motors off (line 2, line 3, line 104)" in run.err
    model = load_rotor_model(out)
    assert 6447 < model.speed_max_rpm < 6447 / 0.95  # 6447 rpm at 0.95 of the throttle, and rpm bend
    assert float(model.upper_thrust(0.953, 0.111)) == pytest.approx(25.4, abs=0.6)  # its line 13


def test_each_log_is_sent_to_its_verb(tmp_path: Path) -> None:
    flight = tmp_path / "flight.csv"
    flight.write_text("time_s,motor1,motor2\n0,0.5,0.5\n1,0.5,0.5\n")
    run = coaxlink("identify", flight)
    assert run.code == 2 and "coaxlink refine flight.csv --airframe AIRFRAME.toml looks for causes" in run.err
    log = rcrm_log(tmp_path / "stand.csv")
    run = coaxlink("refine", log, "--airframe", example("x8_paper.toml"))
    assert run.code == 2 and "a stand log, and --airframe is of a flight" in run.err


def test_a_terminal_is_asked_which_rotor_is_upper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal speeds without torque: nothing tells the rotors apart."""
    log = tmp_path / "log.csv"
    rows = [f"{n},{n},{3e-6 * n**2:.4f},{2e-6 * n**2:.4f}" for n in range(1000, 5000, 200)]
    log.write_text("\n".join(["rpm A (rpm),rpm B (rpm),Thrust A (N),Thrust B (N)", *rows]) + "\n")
    run = coaxlink("identify", log)
    assert run.code == 2 and "which is the upper one? Say --upper A or --upper B" in run.err
    monkeypatch.setattr("coaxlink.cli.shared.stand.at_a_terminal", lambda: True)
    answers = iter(["C", "b"])
    monkeypatch.setattr("typer.prompt", lambda text, **options: next(answers))
    read = read_stand([log], StandOptions(), lambda text: None)[0]
    assert read.upper_label == "B" and read["upper_thrust_N"][-1] < read["lower_thrust_N"][-1]
    assert next(answers, "no more") == "no more"


def test_labels_of_one_log_hold_for_those_joined_with_it(tmp_path: Path) -> None:
    """A rotor alone has no neighbour to tell it by: the map beside it does."""
    head = "rpm A (rpm),Thrust A (N),Torque A (Nm),rpm B (rpm),Thrust B (N),Torque B (Nm)"

    def write(name: str, a: np.ndarray, b: np.ndarray) -> Path:
        lower = (6000 * a, 30 * a**2 - 12 * a * b, 0.5 * a**2 - 0.05 * a * b)
        upper = (6000 * b, 30 * b**2, 0.5 * b**2)
        rows = [",".join(f"{x:.5f}" for x in row) for row in np.array([*lower, *upper]).T]
        (tmp_path / name).write_text("\n".join([head, *rows]) + "\n")
        return tmp_path / name

    u, v = (x.ravel() for x in np.meshgrid(np.linspace(0.2, 1, 7), np.linspace(0.2, 1, 7)))
    single = np.linspace(0.2, 1, 12)
    logs = [write("pair.csv", u, v), write("alone.csv", single, 0 * single)]
    both = read_stand(logs, StandOptions(), lambda t: None, one_rotor=True)
    assert both[0].upper_label == "B"
    assert both[1]["lower_rpm"].max() == 6000 and not np.any(both[1]["upper_rpm"])
