"""`coaxlink identify` as a user runs it: output, files, JSON of the contract, exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.cli.shared.stand import Reading, read_stand
from coaxlink.files import example
from coaxlink.rotor import load_rotor_model
from sim.stand.schedule import read_schedule

SHARED = Path(__file__).parents[2] / ".." / "shared" / "data" / "coax"
LOADS = {"upper.thrust_N", "upper.torque_Nm", "lower.thrust_N", "lower.torque_Nm"}


def coaxlink(*arguments: object) -> int:
    return run(build_app(), [str(a) for a in arguments])


def rcrm_log(path: Path) -> Path:
    """A coarse grid whose truth is the paper's R-CRM, nearly without noise."""
    random = np.random.default_rng(0)
    lines = ["upper_throttle,lower_throttle,upper_thrust_N,upper_torque_Nm,lower_thrust_N,lower_torque_Nm"]
    for u in np.linspace(0, 1, 8):
        for v in np.linspace(0, 1, 8):
            loads = [77.65 * u**2, 1.93 * u**2, 69.89 * v**2 - 30.7 * u**2, 2 * v**2 - 0.5 * u**2]
            noisy = np.array(loads) + random.standard_normal(4) * [0.1, 0.002, 0.1, 0.002]
            lines.append(",".join(f"{x:.5f}" for x in (u, v, *noisy)))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_example_auto(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rotor, report = tmp_path / "rotor.toml", tmp_path / "r.json"
    assert coaxlink("identify", "example", "--form", "auto", "--out", rotor, "--json", report) == 0
    said = capsys.readouterr()
    assert "lower.thrust_N" in said.out and "R-CRM" in said.out and "noise floor" in said.out
    assert "held-out blocks" in said.err and "NRMSE" in said.err
    found = json.loads(report.read_text())
    assert found["form"] == "crm"
    assert set(found["terms"]) == LOADS
    assert {"coaxial_thrust", "coaxial_torque", "upper_thrust", "lower_torque"} <= set(found["channels"])
    assert set(found["channels"]["coaxial_thrust"]) == {"rmse", "nrmse", "r", "held_out_rows"}
    assert found["channels"]["coaxial_thrust"]["rmse"] < 1.1614 / 1.4  # the paper's Table 2
    model = load_rotor_model(rotor)
    assert model.terms() == found["terms"]
    assert model.identified["rows"] == 121 and len(model.identified["sha256"]) == 64


def test_rcrm_truth_is_given_back(tmp_path: Path) -> None:
    report = tmp_path / "r.json"
    assert coaxlink("identify", rcrm_log(tmp_path / "log.csv"), "--form", "rcrm", "--json", report) == 0
    terms = json.loads(report.read_text())["terms"]
    assert terms["upper.thrust_N"]["u_u^2"] == pytest.approx(77.65, abs=0.3)
    assert terms["lower.thrust_N"]["u_l^2"] == pytest.approx(69.89, abs=0.3)
    assert terms["lower.thrust_N"]["u_u^2"] == pytest.approx(-30.7, abs=0.3)


def test_several_logs_give_a_model_each(tmp_path: Path) -> None:
    log, report = rcrm_log(tmp_path / "a.csv"), tmp_path / "r.json"
    out = tmp_path / "rotor.toml"
    assert coaxlink("identify", log, "example", "--form", "rcrm", "--json", report, "--out", out) == 0
    assert len(json.loads(report.read_text())["models"]) == 2
    assert load_rotor_model(tmp_path / "rotor_1.toml").form == "rcrm"
    assert load_rotor_model(tmp_path / "rotor_2.toml").identified["rows"] == 121


def test_logs_joined_and_their_learning_curve(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    alone, report = tmp_path / "alone.csv", tmp_path / "r.json"
    lines = [f"{u},{77.65 * u * u:.4f},{1.93 * u * u:.5f}" for u in np.linspace(0.1, 1, 30)]
    alone.write_text("\n".join(["upper_throttle,upper_thrust_N,upper_torque_Nm", *lines]) + "\n")
    log = rcrm_log(tmp_path / "log.csv")
    options = ("--join", "--learning-curve", "--form", "rcrm", "--json", report)
    assert coaxlink("identify", log, alone, *options) == 0
    said = capsys.readouterr()
    assert "learning curve" in said.out and "joined" in said.err
    found = json.loads(report.read_text())
    assert found["rows"] == 94 and "models" not in found
    assert found["channels"]["upper_thrust"]["held_out_rows"] == 94
    assert found["channels"]["coaxial_thrust"]["held_out_rows"] == 64
    assert found["learning_curve"][-1]["rmse"]["coaxial_thrust"] < 0.2


def test_pictures_and_page(tmp_path: Path) -> None:
    page = tmp_path / "r.html"
    assert coaxlink("identify", "example", "--plot", tmp_path / "png", "--report", page) == 0
    names = {p.name for p in (tmp_path / "png").iterdir()}
    drawn = ("surfaces", "residuals", "tolerance", "efficiency")
    assert names == {f"{name}.{kind}" for name in drawn for kind in ("png", "svg", "pdf")}
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in (tmp_path / "png").glob("*.png"))
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 4 and "http" not in text.replace("http-equiv", "")
    assert "u_l^2" in text and "thrust of the pair" in text


def test_tolerance_form(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = tmp_path / "r.json"
    assert coaxlink("identify", "example", "--tolerance", "10,0.2", "--raw", "--json", report) == 0
    terms = json.loads(report.read_text())["terms"]["lower.thrust_N"]
    assert "u_l" in terms  # contradiction 3: raw terms keep the linear ones
    capsys.readouterr()
    assert coaxlink("identify", "example", "--tolerance", "0.01,0.0001") == 2
    said = capsys.readouterr()
    assert "--tolerance" in said.err and "cannot be met" in said.err and said.err.count("\n") == 1
    assert coaxlink("identify", "example", "--tolerance", "2") == 2
    assert coaxlink("identify", "example", "--tolerance", "2,-1") == 2


@pytest.mark.parametrize(
    "text, expected",
    [
        (None, "cannot be read"),
        ("", "empty"),
        ("upper_rpm,lower_rpm,upper_thrust_N\n1,2,x\n", "line 2, column 'upper_thrust_N'"),
        ("upper_rpm,lower_rpm\n" + "1,2\n" * 9, "upper_thrust_N: missing"),
        ("upper_rpm,upper_thrust_N,upper_torque_Nm\n1,2,3\n", "too few"),
        ("upper_rpm,lower_rpm,upper_thrust_N\n1,2,nan\n", "a finite number is expected"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str | None, expected: str
) -> None:
    log = tmp_path / "log.csv"
    if text is not None:
        log.write_text(text)
    assert coaxlink("identify", log, "--out", tmp_path / "o.toml", "--json", tmp_path / "o.json") == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1
    assert expected in said.err and "log.csv" in said.err
    assert sorted(p.name for p in tmp_path.iterdir()) == (["log.csv"] if text is not None else [])


def test_a_map_of_columns(tmp_path: Path) -> None:
    lines = rcrm_log(tmp_path / "log.csv").read_text().splitlines()
    (tmp_path / "odd.csv").write_text("\n".join(["a,b,c,d,e,f", *lines[1:]]) + "\n")
    names = lines[0].split(",")
    mapping = "".join(f'{n} = {{ column = "{c}" }}\n' for n, c in zip(names, "abcdef", strict=True))
    (tmp_path / "map.toml").write_text(mapping)
    report = tmp_path / "r.json"
    code = coaxlink(
        "identify",
        tmp_path / "odd.csv",
        "--columns",
        tmp_path / "map.toml",
        "--form",
        "srm",
        "--json",
        report,
    )
    assert code == 0
    found = json.loads(report.read_text())
    assert found["rows"] == 64 and "coaxial_torque" in found["channels"]


@pytest.mark.shared_data
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared real data is not beside this checkout")
def test_the_real_map_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rotor.toml"
    assert coaxlink("identify", SHARED / "mn4014_16in_zD1.csv", "--out", out) == 0
    said = capsys.readouterr()
    assert "motors off (line 2, line 3, line 104)" in said.err
    model = load_rotor_model(out)
    assert model.speed_max_rpm == pytest.approx(6447, abs=1)
    assert float(model.upper_thrust(0.989, 0.116)) == pytest.approx(25.4, abs=0.6)  # its line 13


def test_spacing_as_a_variable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, out, report = rcrm_log(tmp_path / "log.csv"), tmp_path / "o.toml", tmp_path / "r.json"
    options = ("--form", "rcrm", "--spacings", "0.5,0.7,0.9", "--out", out, "--json", report)
    assert coaxlink("identify", log, log, log, *options, "--at-spacing", 0.6) == 0
    assert "spacing" in capsys.readouterr().err
    assert json.loads(report.read_text())["spacing"]["middle"] == pytest.approx(0.7)
    assert load_rotor_model(out).terms()["lower.thrust_N"]["u_l^2"] == pytest.approx(69.89, abs=0.3)
    assert coaxlink("identify", log, "--spacings", "0.5,0.7") == 2
    assert coaxlink("identify", log, log, log, *options, "--at-spacing", 2) == 2


def test_what_to_measure_next_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan, report = tmp_path / "next.toml", tmp_path / "r.json"
    assert coaxlink("identify", rcrm_log(tmp_path / "log.csv"), "--next", plan, "--json", report) == 0
    said = capsys.readouterr().err
    assert "error over a table" in said and "of a 5 x 5 map" in said
    found = json.loads(report.read_text())
    assert [line[:21] for line in found["oddities"]] == ["with thrust in kgf, l", "no speed was measured"]
    assert found["coverage"]["cells"] == 1.0
    assert found["next"]["share"] < 0.51 and found["next"]["seconds"] > 0
    assert plan.read_text().startswith("# ")
    schedule = read_schedule(plan)
    assert schedule.upper.max() <= 1.0 and len(schedule.time_s) == round(10 * found["next"]["seconds"])


def test_each_log_is_sent_to_its_verb(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flight = tmp_path / "flight.csv"
    flight.write_text("time_s,motor1,motor2\n0,0.5,0.5\n1,0.5,0.5\n")
    assert coaxlink("identify", flight) == 2
    assert "coaxlink refine flight.csv --airframe AIRFRAME.toml takes it" in capsys.readouterr().err
    log = rcrm_log(tmp_path / "stand.csv")
    assert coaxlink("refine", log, "--airframe", example("x8_paper.toml")) == 2
    assert "a stand log, and --airframe is of a flight" in capsys.readouterr().err


def lettered_log(path: Path) -> Path:
    """Equal speeds without torque: nothing tells the rotors apart."""
    rows = [f"{n},{n},{3e-6 * n**2:.4f},{2e-6 * n**2:.4f},0.1,0.1" for n in range(1000, 5000, 200)]
    head = "rpm A (rpm),rpm B (rpm),Thrust A (N),Thrust B (N)"
    path.write_text("\n".join([head, *(row.rsplit(",", 2)[0] for row in rows)]) + "\n")
    return path


def test_a_terminal_is_asked_which_rotor_is_upper(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = lettered_log(tmp_path / "log.csv")
    assert coaxlink("identify", log) == 2
    assert "which is the upper one? Say --upper A or --upper B" in capsys.readouterr().err
    monkeypatch.setattr("coaxlink.cli.shared.stand.at_a_terminal", lambda: True)
    answers = iter(["C", "b"])
    monkeypatch.setattr("typer.prompt", lambda text, **options: next(answers))
    read = read_stand([log], Reading(), lambda text: None)[0]
    assert read.upper_label == "B" and read["upper_thrust_N"][-1] < read["lower_thrust_N"][-1]
    assert next(answers, "no more") == "no more"


def test_labels_told_by_one_log_hold_for_those_joined_with_it(tmp_path: Path) -> None:
    """A rotor alone has no neighbour to tell it by: the map beside it does."""
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(0.2, 1, 7), np.linspace(0.2, 1, 7)))
    head = "rpm A (rpm),Thrust A (N),Torque A (Nm),rpm B (rpm),Thrust B (N),Torque B (Nm)\n"

    def text(a: np.ndarray, b: np.ndarray) -> str:
        lower = (6000 * a, 30 * a**2 - 12 * a * b, 0.5 * a**2 - 0.05 * a * b)
        upper = (6000 * b, 30 * b**2, 0.5 * b**2)
        return (
            head + "\n".join(",".join(f"{x:.5f}" for x in row) for row in np.array([*lower, *upper]).T) + "\n"
        )

    pair, alone = tmp_path / "pair.csv", tmp_path / "alone.csv"
    pair.write_text(text(u, v))
    single = np.linspace(0.2, 1, 12)
    alone.write_text(text(single, 0 * single))
    both = read_stand([pair, alone], Reading(), lambda t: None, one_rotor=True)
    assert both[0].upper_label == "B"
    assert both[1]["lower_rpm"].max() == 6000 and not np.any(both[1]["upper_rpm"])
