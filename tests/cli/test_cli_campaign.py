"""`coaxlink campaign`: flown, stopped, gone on, replayed, told; rubbish refused in a line."""

import hashlib
import json
import os
import signal
import subprocess
import sys

import pytest
from cli_runs import coaxlink

SMALL = """
flights = 24
laws = ["standard", "reduced"]
seconds = 4
settle_s = 1
mass_share = { low = 0.9, high = 1.1 }
[effects.wind]
size = { low = 0.0, high = 6.0 }
law = "dryden"
"""


@pytest.fixture
def spec(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def _rows(folder) -> list[str]:
    return [hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted((folder / "rows").iterdir())]


@pytest.mark.slow
def test_a_campaign_is_flown_summed_up_resumed_and_replayed(spec, tmp_path) -> None:
    done = coaxlink("campaign", spec, "--json", "s.json", "--workers", "1")
    assert done.code == 0, done.err
    assert "24 of 24 flights (100 %)" in done.err and "reduced against standard" in done.out
    assert f"coaxlink campaign {spec} --out campaign-small --replay CELL" in done.err
    folder = tmp_path / "campaign-small"
    assert (folder / "report.html").read_text().startswith("<!doctype html>")
    summary = json.loads((tmp_path / "s.json").read_text())
    assert summary["laws"]["reduced"]["flown"] == 12 and summary["manifest"]["finished"] is True
    again = coaxlink("campaign", spec)
    assert again.code == 0 and "24 of 24 are there already" in again.err

    import pyarrow.dataset as ds

    table = ds.dataset(folder / "rows").to_table().to_pydict()
    assert table["cell"] == list(range(24)) and table["draw"] == [n // 2 for n in range(24)]
    alone = coaxlink("campaign", spec, "--replay", "5", "--json", "row.json")
    assert alone.code == 0, alone.err
    row = json.loads((tmp_path / "row.json").read_text())
    stored = {name: column[5] for name, column in table.items()}
    assert row.keys() == stored.keys()
    for name, value in stored.items():  # freshly compiled or from the cache: the last bit may differ
        same = pytest.approx(value, rel=1e-12, nan_ok=True) if isinstance(value, float) else value
        assert row[name] == same, name
    assert (folder / "cell-000000005" / "truth.toml").read_text().startswith('[[effects]]\nname = "wind"')
    from coaxlink.data import read_flight_log

    assert len(read_flight_log(folder / "cell-000000005" / "flight.csv")["time_s"]) == 500
    spec.write_text(SMALL.replace("seconds = 4", "seconds = 5"))
    other = coaxlink("campaign", spec)
    assert other.code == 2 and "digest: the folder holds another campaign" in other.err


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_done(spec, tmp_path) -> None:
    spec.write_text(SMALL.replace("flights = 24", "flights = 200000"))
    command = [sys.executable, "-m", "coaxlink", "campaign", str(spec), "--workers", "1", "--out", "c"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
                               start_new_session=True)  # fmt: skip
    assert process.stderr is not None
    for line in process.stderr:
        if " a second" in line:
            break
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the workers get it, too
    try:
        reported = process.communicate(timeout=600)[1]
    finally:
        process.kill()
    assert process.returncode == 130, reported
    assert "of 200000; the same command goes on from there" in reported and "Traceback" not in reported
    assert any((tmp_path / "c" / "rows").glob("*.parquet"))


@pytest.mark.slow
def test_what_is_wrong_is_one_line(spec, tmp_path) -> None:
    for arguments, code, reported in (
        (("campaign", "none.toml"), 2, "none.toml: cannot be read"),
        (("campaign", spec, "--replay", "24"), 2, "--replay: 24: a cell from 0 to 23 is expected"),
        (("campaign", spec, "--out", "/proc/none"), 2, "/proc/none: cannot be written"),
    ):
        ended = coaxlink(*arguments)
        assert ended.code == code and reported in ended.err, ended
        assert "Traceback" not in ended.err
    plan = coaxlink("campaign", spec, "--dry-run")
    assert plan.code == 0 and "24 flights of 4 s: 12 draws x standard, reduced" in plan.out
