"""`coaxlink health` on flights of the simulator, whose truth the verb never sees."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table

import coaxlink
from coaxlink.cli import main
from coaxlink.rotor import RotorModel, load_rotor_model, save_rotor_model

EXAMPLES = Path(__file__).parents[2] / "examples"
SHARED = Path(__file__).parents[2] / ".." / "shared" / "data" / "flights"
LOST, ROTOR = 0.12, 6


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    """Two flights of one vehicle: a sound one, then rotor 6 has lost 12 %."""
    folder = tmp_path_factory.mktemp("flights")
    (folder / "truth.toml").write_text(
        f'[[effects]]\nname = "degraded_rotor"\nsize = {LOST}\nrotor = {ROTOR}\n'
    )
    for name, *determined in (("monday",), ("friday", "--truth", str(folder / "truth.toml"))):
        log = folder / f"{name}.csv"
        call = [sys.executable, "-m", "coaxlink", "sim", "--fly", "vigorous", "--log", str(log)]
        subprocess.run([*call, "--seed", str(len(name)), *determined], check=True, capture_output=True)
    return folder


def run(*arguments):
    with pytest.raises(SystemExit) as ended:
        main(["health", *(str(a) for a in arguments)])
    return int(ended.value.code or 0)


VEHICLE = ("--airframe", EXAMPLES / "x8_demo.toml")


@pytest.mark.slow
def test_a_sound_vehicle_is_sound(flights, tmp_path, capsys):
    assert run(flights / "monday.csv", *VEHICLE, "--json", tmp_path / "h.json") == 0
    found = json.loads((tmp_path / "h.json").read_text())
    assert found["verdict"] == "sound" and found["probability"] < 0.05
    assert len(found["flights"]) == 1 and len(found["flights"][0]["rotors"]) == 8
    assert all(
        low <= 1.0 <= high for f in found["flights"] for p in f["pairs"] for _, low, high in [p["thrust"]]
    )
    reported = capsys.readouterr()
    from_python = coaxlink.check_health(flights / "monday.csv", VEHICLE[1])
    assert json.loads(json.dumps(from_python.as_json())) == found
    assert str(from_python).startswith("Health(sound, 1 flight)\nrotor ")
    page = coaxlink.write_report(flights / "monday.csv", tmp_path / "monday.html", VEHICLE[1])
    assert page.read_text().lower().startswith("<!doctype html>")
    assert "sound" in reported.out and "shipped" not in reported.err
    assert f"a loss of {100 * found['detects']:.0f} % would have been seen" in " ".join(reported.out.split())


@pytest.mark.slow
def test_a_vehicle_that_nobody_named_is_said(flights, capsys):
    assert run(flights / "monday.csv") == 0
    assert "no --airframe: held against the shipped x8_paper.toml" in capsys.readouterr().err


@pytest.mark.slow
def test_a_weak_rotor_is_named_with_its_flight(flights, tmp_path, capsys):
    logs = [flights / f"{day}.csv" for day in ("monday", "friday")]
    out, drawn = tmp_path / "h.json", tmp_path / "h.png"
    page = tmp_path / "h.html"
    assert run(*logs, *VEHICLE, "--json", out, "--plot", drawn, "--report", page) == 1
    reported = capsys.readouterr()
    assert f"rotor {ROTOR}" in reported.err and "friday" in reported.out
    first = json.loads(out.read_text())["suspects"][0]
    assert first["rotor"] == ROTOR and first["probability"] > 0.9
    assert first["loss"][1] < LOST < first["loss"][2]
    assert drawn.read_bytes().startswith(b"\x89PNG")
    shown = page.read_text()
    lead = re.search(r'<p class="lead">(.*?)</p>', shown)[1]
    assert lead.startswith(f"Ground it: rotor {ROTOR}, ") and "since friday.csv" in lead
    assert shown.count("data:image/png;base64,") == 1 and "http" not in re.sub(r"base64,[^\"]*", "", shown)
    assert "friday.csv thrust" in shown and "How this page was made" in shown


def test_wrong_input_gets_one_line(tmp_path, capsys):
    stand = tmp_path / "stand.csv"
    stand.write_text("upper_rpm,upper_thrust_N,upper_torque_Nm\n1000,1,0.1\n")
    assert run(stand) == 2
    assert "a flight log is expected" in capsys.readouterr().err
    assert run(stand, "--plot", tmp_path / "h.html") == 2
    assert "h.html: a name that ends in .png, .svg, .pdf is expected" in capsys.readouterr().err
    assert not (tmp_path / "h.html").exists()
    assert run(tmp_path / "none.ulg") == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.shared_data
@pytest.mark.skipif(not SHARED.is_dir(), reason="no ../shared/data/flights: they are not redistributed")
def test_real_firmware_without_a_fault_is_sound(tmp_path, capsys):
    text = (EXAMPLES / "x8_paper.toml").read_text()
    (tmp_path / "x8.toml").write_text("motor_lag_s = 0.02\n" + text)
    (tmp_path / "rotor_paper.toml").write_text((EXAMPLES / "rotor_paper.toml").read_text())
    assert run(SHARED / "px4_null_fitted.ulg", "--airframe", tmp_path / "x8.toml") == 0
    assert "sound" in capsys.readouterr().out


def identify(*arguments):
    with pytest.raises(SystemExit) as ended:
        main(["identify", *(str(a) for a in arguments)])
    return int(ended.value.code or 0)


@pytest.mark.slow
def test_a_prior_that_is_off_is_updated_by_a_flight(flights, tmp_path, capsys):
    true = load_rotor_model(EXAMPLES / "rotor_paper.toml")
    random = np.random.default_rng(3)
    terms = {
        load: {term: c * (1 + 0.15 * random.standard_normal()) for term, c in of_load.items()}
        for load, of_load in true.terms().items()
    }
    prior, after, report = tmp_path / "prior.toml", tmp_path / "after.toml", tmp_path / "i.json"
    save_rotor_model(prior, RotorModel.from_terms("crm", true.speed_max_rpm, terms))
    log = flights / "monday.csv"
    assert identify(log, *VEHICLE, "--rotor", prior, "--out", after, "--json", report) == 0
    found = json.loads(report.read_text())
    speeds = np.array([found["hover"]["upper_speed"]]), np.array([found["hover"]["lower_speed"]])
    pair = true.loads(*speeds)
    for load, value in found["hover"]["loads"].items():
        name = load.replace(".", "_").rsplit("_", 1)[0]
        assert abs(value["value"] - getattr(pair, name)[0]) < 2.6 * value["sd"], load
        assert value["sd"] < value["prior_sd"]
    model = load_rotor_model(after)
    determined = model.loads(*speeds)
    both = determined.upper_thrust + determined.lower_thrust
    assert both == pytest.approx(pair.upper_thrust + pair.lower_thrust, rel=0.02)  # the weight tells it
    assert model.identified["flights"][0]["file"] == "monday.csv"
    for t in found["told"]:
        left = t["sd"] / t["prior_sd"]
        assert t["verdict"] == ("told" if left < 0.5 else "partly" if left < 0.8 else "not told")
    assert {"partly", "not told"} <= {t["verdict"] for t in found["told"]}
    reported = capsys.readouterr()
    assert "not determined by these flights" in reported.err and "upper against lower" in reported.err
    # the posterior is the next flight's prior
    assert identify(log, *VEHICLE, "--rotor", after, "--json", report) == 0
    assert "own covariance" in capsys.readouterr().err


def test_identify_says_what_flights_need(flights, tmp_path, capsys):
    assert identify(flights / "monday.csv", "--rotor", EXAMPLES / "rotor_paper.toml") == 2
    assert "--airframe" in capsys.readouterr().err
    stand = tmp_path / "stand.csv"
    stand.write_text("upper_rpm,upper_thrust_N,upper_torque_Nm\n1000,1,0.1\n")
    assert identify(stand, *VEHICLE) == 2
    assert "a flight log is expected" in capsys.readouterr().err


@pytest.mark.slow
def test_a_folder_is_a_fleet_judged_vehicle_by_vehicle(flights, tmp_path, capsys):
    for name, place in (
        ("monday", "x8-01/2026-03-02.csv"),
        ("monday", "x8-02/2026-03-02.csv"),
        ("friday", "x8-02/2026-03-06.csv"),
    ):
        (tmp_path / "logs" / place).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "logs" / place).write_bytes((flights / f"{name}.csv").read_bytes())
    (tmp_path / "logs" / "x8-03").mkdir()
    (tmp_path / "logs" / "x8-03" / "2026-03-02.csv").write_text("time_s,motor1\n0,1\n")
    assert run(tmp_path / "logs", *VEHICLE, "--json", tmp_path / "f.json") == 1
    reported = capsys.readouterr()
    assert "ground x8-02" in reported.err and "says nothing: x8-03" in reported.err
    found = json.loads((tmp_path / "f.json").read_text())["vehicles"]
    assert found["x8-01"]["verdict"] == "sound" and found["x8-02"]["verdict"] == "ground it"
    assert run(tmp_path / "logs", "--plot", tmp_path / "p.png") == 2
    (tmp_path / "empty").mkdir()
    assert run(tmp_path / "empty") == 2


def with_speeds(log, path, **times):
    """The log, some of its columns `times`."""
    heads, *rows = (line.split(",") for line in log.read_text().splitlines())
    columns = {heads.index(name): factor for name, factor in times.items()}
    lines = [
        ",".join(f"{columns[i] * float(v):.1f}" if i in columns else v for i, v in enumerate(row))
        for row in rows
    ]
    path.write_text("\n".join([",".join(heads), *lines]))
    return path


@pytest.mark.slow
def test_rpm_against_the_command_of_the_same_rotor(flights, tmp_path, capsys):
    out = tmp_path / "h.json"
    with case_table() as case:
        with case("an ESC that counts other magnets, all sound"):
            log = with_speeds(flights / "monday.csv", tmp_path / "a.csv", rpm3=0.83)
            assert run(log, *VEHICLE, "--json", out) == 0
            found = json.loads(out.read_text())
            assert found["verdict"] == "sound" and [s["column"] for s in found["suspect_data"]] == ["rpm3"]
            assert found["speed_ratios"]["3"] == pytest.approx(0.83, abs=0.01)
        with case("a weak rotor whose motor turns slower"):
            log = with_speeds(flights / "friday.csv", tmp_path / "b.csv", rpm6=0.85)
            capsys.readouterr()
            assert run(log, *VEHICLE, "--json", out) == 1
            assert json.loads(out.read_text())["suspects"][0]["rotor"] == ROTOR
            assert "rotor 6 turns at 0.85 times what its command asks" in capsys.readouterr().err
        with case("a weak rotor, while another turns faster than it is asked to"):
            log = with_speeds(flights / "friday.csv", tmp_path / "c.csv", rpm2=1.25)
            assert run(log, *VEHICLE, "--json", out) == 1
            found = json.loads(out.read_text())
            assert found["verdict"] == "cannot judge" and found["suspects"] == []
            (reason,) = found["cannot_judge"]
            assert reason["premise"] == "rpm" and "rotor 2 turns at 1.25 times" in reason["why"]


@pytest.mark.slow
def test_identify_makes_no_model_of_an_rpm_that_its_command_contradicts(flights, tmp_path, capsys):
    out, report = tmp_path / "after.toml", tmp_path / "i.json"
    log = with_speeds(flights / "monday.csv", tmp_path / "a.csv", rpm3=0.83)
    assert identify(log, *VEHICLE, "--out", out, "--json", report) == 1
    (reason,) = json.loads(report.read_text())["cannot_judge"]
    assert reason["premise"] == "rpm" and "rotor 3 turns at 0.83 times" in reason["why"]
    assert not out.exists()
    assert identify(flights / "monday.csv", *VEHICLE, "--out", out) == 0
