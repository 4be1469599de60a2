"""A fleet over time: which logs are whose, what is believed, how it grows."""

from __future__ import annotations

import datetime
import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from coaxlink.errors import InputError
from coaxlink.report import fleet as report
from coaxlink.studies.engine import Machine
from coaxlink.studies.fleet import FALSE_ALARM, Log, LogFinding, find_logs, fleet_of, growth, look_through

START = datetime.datetime(2026, 1, 5)


def row(vehicle, week, *found):
    date = START + datetime.timedelta(weeks=week)
    findings = tuple(LogFinding(n, p, v, (v - 0.01, v + 0.01), "1") for n, p, v in found)
    name = f"{vehicle}/{date.isoformat()}.ulg"
    return {"log": Log(name, name, vehicle, date), "problem": "", "findings": findings}


@pytest.mark.slow
def test_a_rotor_that_weakens_is_found_and_one_false_alarm_is_not():
    random = np.random.default_rng(1)
    rows = []
    for v in range(10):
        for week in range(20):
            found = []
            if v == 4 and week >= 8:
                found.append(("degraded_rotor", "rotor 3", 0.01 * (week - 7) + random.normal(0.0, 0.004)))
            if v == 6:
                found.append(("cg_offset", "", 0.01 + random.normal(0.0, 0.0005)))
            if (v, week) in ((1, 5), (8, 19)):
                found.append(("wind", "", 3.0))
            rows.append(row(f"v{v}", week, *found))
    fleet = fleet_of(rows)
    steady, weak = fleet.believed
    assert (steady.vehicle, steady.name, steady.grows) == ("v6", "cg_offset", False)
    assert (weak.vehicle, weak.part, weak.grows) == ("v4", "rotor 3", True)
    assert weak.per_week_ci[0] < 0.01 < weak.per_week_ci[1] and weak.logs == len(weak.dates) == 12
    assert "growing" not in steady.words()
    assert {t.vehicle for t in fleet.trends if not t.believed} == {"v1", "v8"}
    page = report.page(fleet)
    assert "v4: degraded_rotor, rotor 3: in 12 of 12 logs since 2026-03-02" in page
    assert page.count("data:image/png;base64,") == 1
    assert json.loads(json.dumps(fleet.to_json(), allow_nan=False))["findings"][1]["grows"] is True


@pytest.mark.slow
def test_false_alarms_alone_are_believed_no_oftener_than_said():
    """60 fleets of 400 logs with false alarms at the full rate, all of one kind, which is the worst."""
    random, believed = np.random.default_rng(7), 0
    for _ in range(60):
        rows = [
            row(f"v{v}", week, *([("rotor_drag", "", 1.0)] if random.random() < FALSE_ALARM else []))
            for v in range(20)
            for week in range(20)
        ]
        believed += bool(fleet_of(rows).believed)
    assert believed <= 2  # at 1 in 1000 three of 60 come once in 30,000 times


def test_growth_holds_the_slope_as_often_as_it_says():
    random, inside = np.random.default_rng(2), 0
    dates = [(START + datetime.timedelta(days=7 * k)).isoformat() for k in range(8)]
    for _ in range(400):
        _, (low, high) = growth(dates, [0.01 * k + random.normal(0.0, 0.02) for k in range(8)])
        inside += low <= 0.01 <= high
    assert 0.915 * 400 <= inside <= 0.98 * 400
    assert all(np.isnan(growth(dates[:2], [1.0, 2.0])[1]))


def test_whose_log_and_of_when(tmp_path):
    for name in ("a/2026-03-04_10_20.ulg", "a/log_7_20260102.bin", "b-1 2026-5-6.csv", "notes.txt"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text("")
    found = [(log.vehicle, log.date.isoformat(), log.name) for log in find_logs(str(tmp_path))]
    assert found == [
        ("a", "2026-01-02T00:00:00", "a/log_7_20260102.bin"),
        ("a", "2026-03-04T10:20:00", "a/2026-03-04_10_20.ulg"),
        ("b-1", "2026-05-06T00:00:00", "b-1 2026-5-6.csv"),
    ]
    (tmp_path / "flight.ulg").write_text("")
    index = tmp_path / "fleet.csv"
    for text, reported in (
        (None, r"flight.ulg: no date"),
        ("log,vehicle,date\nflight.ulg,c,soon\n", r"line 2: a date is expected, found 'soon'"),
        ("log,date\n", "line 1: the columns log, vehicle, date are expected"),
    ):
        if text is not None:
            index.write_text(text)
        with pytest.raises(InputError, match=reported):
            find_logs(str(tmp_path))
    index.write_text("log,vehicle,date\nflight.ulg,c,2026-07-08\n")
    assert [log.vehicle for log in find_logs(str(tmp_path))] == ["a", "a", "b-1", "c"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no logs there"):
        find_logs(str(tmp_path / "empty"))


@dataclass(frozen=True)
class Words:
    """An analysis that finds what the log's text says."""

    def __call__(self, log: Path):
        text = log.read_text()
        if text == "broken":
            raise InputError(log, "", "broken")
        return [LogFinding(text, "", 1.0, (0.9, 1.1), "N")] if text else []


@pytest.mark.slow
def test_every_log_is_looked_at_and_a_broken_one_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent), prepend=os.pathsep)
    for v, text in (("a", "drag"), ("b", ""), ("c", "broken")):
        (tmp_path / v).mkdir()
        for day in range(1, 5):
            (tmp_path / v / f"2026-01-0{day}.csv").write_text(text)
    fleet = look_through(find_logs(str(tmp_path)), Words(), Machine(1))
    assert fleet.logs == 12 and len(fleet.problems) == 4
    assert all("broken" in why for why in fleet.problems.values())
    assert [(t.vehicle, t.name, len(t.dates)) for t in fleet.believed] == [("a", "drag", 4)]
