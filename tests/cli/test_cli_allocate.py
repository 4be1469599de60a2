"""`coaxlink allocate`: the JSON of the contract, and one line for each wrong use."""

import json
from pathlib import Path

import pytest

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = str(EXAMPLES / "x8_paper.toml")


def coaxlink(*arguments):
    return run(build_app(), list(arguments))


def test_json_is_as_the_contract_says(tmp_path, capsys):
    out = tmp_path / "a.json"
    wrench = "196.2,1,-1,0.3"
    assert coaxlink("allocate", X8, "--law", "coaxial", "--wrench", wrench, "--json", str(out)) == 0
    result = json.loads(out.read_text())
    for key in ("law", "speeds", "thrust_N", "torque_Nm", "wrench", "error", "power", "saturated", "dropped"):
        assert key in result
    assert [len(result[k]) for k in ("speeds", "thrust_N", "torque_Nm", "saturated")] == [8] * 4
    assert result["wrench"] == [196.2, 1, -1, 0.3]
    assert sum(result["thrust_N"]) == pytest.approx(196.2, abs=1e-6)
    assert result["dropped"] == []
    stdout = capsys.readouterr().out
    assert "thrust N" in stdout
    assert "coaxial" in stdout


def test_the_printed_numbers_can_be_weighed_on_the_printed_rotors(tmp_path):
    out = tmp_path / "a.json"
    believed = str(EXAMPLES / "rotor_rcrm_paper.toml")
    arguments = ["--law", "reduced", "--law-rotor", believed, "--wrench", "196.2,0,0,0", "--json", str(out)]
    assert coaxlink("allocate", X8, *arguments) == 0
    assert json.loads(out.read_text())["error"][0] == pytest.approx(39.5, abs=0.2)


def test_wrong_use_is_one_line_and_exit_2(tmp_path, capsys):
    out = tmp_path / "a.json"
    for arguments, says in (
        (["--wrench", "1,2,3"], "--wrench"),
        (["--wrench", "1,2,3,x"], "--wrench"),
        (["--wrench", "1,2,3,nan"], "--wrench"),
        ([], "--wrench"),
        (["--law", "magic", "--wrench", "1,2,3,4"], "magic"),
        (["--rotor", "none.toml", "--wrench", "1,2,3,4"], "none.toml"),
    ):
        assert coaxlink("allocate", X8, *arguments, "--json", str(out)) == 2, arguments
        stderr = capsys.readouterr().err
        assert says in stderr and stderr.count("\n") == 1 and not out.exists(), arguments


def test_the_effects_of_a_rotor_file_are_in_the_answer(tmp_path, capsys):
    rotor, out = tmp_path / "refined.toml", tmp_path / "a.json"
    weak = 'name = "degraded_rotor"\nparameters = { rotor = 3.0, thrust_loss = 0.3, torque_loss = 0.2 }\n'
    sag = 'name = "battery_voltage"\nparameters = { speed_exponent = 0.4, reference_voltage_V = 33.6 }\n'
    base = (EXAMPLES / "rotor_paper.toml").read_text()
    rotor.write_text(f"{base}\n[[effects]]\n{weak}\n[[effects]]\n{sag}")
    given = ["allocate", X8, "--rotor", str(rotor), "--wrench", "196.2,0,0,0", "--json", str(out)]
    assert coaxlink(*given) == 0
    result = json.loads(out.read_text())
    assert list(result["compensated"]) == ["degraded_rotor"]
    assert list(result["not_compensated"]) == ["battery_voltage"]
    assert result["speeds"][2] > 1.15 * result["speeds"][0]
    assert "--voltage" in capsys.readouterr().err
    assert coaxlink(*given, "--voltage", "30") == 0
    sagged = json.loads(out.read_text())
    assert sagged["not_compensated"] == {}
    assert sagged["speeds"] == pytest.approx(result["speeds"], rel=1e-6)
    assert sagged["commands"][0] == pytest.approx(result["commands"][0] * (33.6 / 30) ** 0.4, rel=1e-6)


def test_a_wrench_beyond_all_measure_fits_the_screen(capsys):
    assert coaxlink("allocate", X8, "--law", "exact", "--wrench=1e300,0,0,0") == 1
    reported = capsys.readouterr().out
    assert "1e+300" in reported
    assert max(len(line) for line in reported.splitlines()) <= 80


def test_rotors_that_do_not_lift_are_refused(tmp_path, capsys):
    rotor = tmp_path / "sinking.toml"
    base = (EXAMPLES / "rotor_srm_paper.toml").read_text()
    head, sep, tail = base.partition("[upper.thrust_N]")
    assert sep
    lines = tail.splitlines()
    at = next(i for i, line in enumerate(lines) if "=" in line)
    name, _, number = lines[at].partition("=")
    lines[at] = f"{name}= -{number.strip()}"
    rotor.write_text(head + sep + "\n".join(lines))
    assert coaxlink("allocate", X8, "--rotor", str(rotor), "--wrench", "196.2,0,0,0") == 2
    reported = capsys.readouterr().err.strip()
    assert len(reported.splitlines()) == 1
    assert "upper.thrust_N" in reported


def test_out_of_reach_is_said_in_words_and_is_exit_1(tmp_path, capsys):
    out, wrong = tmp_path / "a.json", {}
    full = "of 900 N; all rotors at a bound"
    for law, wrench, code, reported in (
        *((law, "900,0,0,0", 1, f"out of reach of the {law} law: thrust 476.1 {full}")
          for law in ("standard", "reduced", "coaxial", "exact")),
        ("exact", "476,0,0,0", 0, ""),
        ("exact", "477,0,0,0", 1, "thrust 476.1 of 477 N; all rotors at a bound"),  # 0.2 % short
        ("coaxial", "480,0,0,0", 1, "thrust 476.1 of 480 N; all rotors at a bound"),
        ("exact", "196.2,0,0,6", 0, ""),
        ("exact", "196.2,0,0,50", 1, "yaw 8.3"),
        ("exact", "196.2,500,0,0", 1, "roll 42.73 of 500 N m"),
        ("exact", "-50,0,0,0", 1, "of -50 N"),
        ("standard", "196.2,0,0,0.3", 0, ""),  # its own error, every rotor within its bounds
    ):  # fmt: skip
        found = coaxlink("allocate", X8, "--law", law, f"--wrench={wrench}", "--json", str(out))
        shown = capsys.readouterr()
        if found != code or reported not in shown.err or ("out of reach" in shown.err) != bool(code):
            wrong[law, wrench] = found, shown.err
        assert "thrust N" in shown.out and json.loads(out.read_text())["law"] == law  # said all the same
    assert not wrong
