"""`coaxlink compare`: every law's row, what each is known for, and a picture."""

import json
from pathlib import Path

import pytest

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.slow
def test_rows_say_what_each_law_is_known_for(tmp_path, capsys):
    out, png = tmp_path / "c.json", tmp_path / "c.png"
    arguments = ["compare", str(EXAMPLES / "x8_paper.toml"), "--printed", "--rows", "80"]
    assert run(build_app(), [*arguments, "--json", str(out), "--out", str(png)]) == 0
    rows = {row["law"]: row for row in json.loads(out.read_text())["laws"]}
    assert rows["exact"]["max_error"] == pytest.approx([0, 0, 0, 0], abs=1e-6)
    assert rows["fitted"]["mean_error"][0] <= 0.05
    assert rows["reduced (paper's numbers)"]["mean_error"][0] == pytest.approx(38.8, abs=0.6)
    assert rows["standard (paper's numbers)"]["mean_error"][0] == pytest.approx(7.9, abs=0.8)
    assert rows["coaxial-printed"]["mean_error"][3] == pytest.approx(0.5, abs=0.08)
    assert rows["coaxial-printed"]["most_yaw_Nm"] == pytest.approx(0, abs=1e-6)
    assert rows["coaxial"]["max_error"] == pytest.approx([0, 0, 0, 0], abs=1e-6)
    least = min(row["power"] for law, row in rows.items() if max(row["max_error"]) < 0.5)
    assert rows["exact"]["power"] <= least * 1.001
    assert png.read_bytes().startswith(b"\x89PNG")
    reported = capsys.readouterr().out
    assert "fitted" in reported and "e-0" not in reported  # no 6e-08 where there is no error
    assert rows["curved"]["most_thrust_N"] == pytest.approx(rows["standard"]["most_thrust_N"], rel=0.01)
    assert rows["curved"]["mean_error"] != rows["standard"]["mean_error"]


@pytest.mark.slow
def test_the_first_line_says_whether_to_bother(tmp_path, capsys):
    out = tmp_path / "c.json"
    arguments = ["compare", str(EXAMPLES / "x8_paper.toml"), "--rows", "20", "--battery-wh", "700"]
    assert run(build_app(), [*arguments, "--light", "18", "--heavy", "22", "--json", str(out)]) == 0
    reported = " ".join(capsys.readouterr().out.split())
    assert reported.startswith("The fitted table saves 4.9%") and "from 18 to 22 kg" in reported
    worth = json.loads(out.read_text())["worth"]
    assert worth["summary"][0].startswith("The fitted table saves") and worth["left_out"] == {}
    tables = {row["table"]: row for row in worth["tables"]}
    assert list(tables) == [
        "PX4 defaults", "standard", "curved", "reduced", "fitted", "exact, live",
    ]  # fmt: skip
    longer = tables["fitted"]["hover_minutes"] / tables["standard"]["hover_minutes"]
    assert longer == pytest.approx(tables["standard"]["hover_W"] / tables["fitted"]["hover_W"])
    assert tables["fitted"]["load_kg"] == pytest.approx([18.0, 22.0])


@pytest.mark.slow
def test_minutes_come_from_the_vehicle_file_and_scale_with_its_pack(tmp_path):
    lines = (EXAMPLES / "x8_paper.toml").read_text()
    (tmp_path / "rotor_paper.toml").write_text((EXAMPLES / "rotor_paper.toml").read_text())
    x8, out = tmp_path / "x8.toml", tmp_path / "c.json"

    def minutes(*more):
        arguments = ["compare", str(x8), "--rows", "10", "--json", str(out), *more]
        assert run(build_app(), arguments) == 0
        (fitted,) = [t for t in json.loads(out.read_text())["worth"]["tables"] if t["table"] == "fitted"]
        return float(fitted["hover_minutes"])

    x8.write_text("battery_Wh = 350.0\n" + lines)
    own = minutes()
    assert minutes("--battery-wh", "700", "--drive-efficiency", "0.4") == pytest.approx(own)
    assert minutes("--battery-wh", "700") == pytest.approx(2.0 * own)
    x8.write_text("battery_Wh = -1\n" + lines)
    assert run(build_app(), ["compare", str(x8)]) == 2


def test_wrong_use_is_one_line_and_exit_2(capsys):
    x8 = str(EXAMPLES / "x8_paper.toml")
    for arguments, says in (
        ([x8, "--light", "-1"], "--light"),
        ([x8, "--heavy", "nan"], "--heavy"),
        ([x8, "--light", "30"], "--light"),
        (["none.toml"], "none.toml"),
    ):
        assert run(build_app(), ["compare", *arguments]) == 2
        err = capsys.readouterr().err
        assert says in err and err.count("\n") == 1, arguments
