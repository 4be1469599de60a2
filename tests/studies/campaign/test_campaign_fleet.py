"""A fleet over time: which logs are whose, what is believed, how it grows."""

from __future__ import annotations

import datetime
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from coaxlink.errors import InputError
from coaxlink.report import fleet as report
from coaxlink.studies.campaign.engine import Machine
from coaxlink.studies.campaign.fleet import FALSE_ALARM, find_logs, fleet_of, growth, look_through

START = datetime.datetime(2026, 1, 5)


def _row(number: int, vehicle: str, week: int, *found: tuple[str, str, float]) -> tuple[object, ...]:
    date = (START + datetime.timedelta(weeks=week)).isoformat()
    findings = [
        {"name": n, "part": p, "value": v, "ci": [v - 0.01, v + 0.01], "unit": "1"} for n, p, v in found
    ]
    return number, f"{vehicle}/{date}.ulg", vehicle, date, "", json.dumps(findings)


def test_a_rotor_that_weakens_is_found_and_one_false_alarm_is_not() -> None:
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
            rows.append(_row(len(rows), f"v{v}", week, *found))
    fleet = fleet_of(rows)
    assert [(c.vehicle, c.name, c.part) for c in fleet.believed] == [
        ("v6", "cg_offset", ""), ("v4", "degraded_rotor", "rotor 3"),
    ]  # fmt: skip
    weak = fleet.believed[1]
    assert (
        weak.grows and weak.per_week_ci[0] < 0.01 < weak.per_week_ci[1] and weak.logs == len(weak.dates) == 12
    )
    assert not fleet.believed[0].grows and "growing" not in fleet.believed[0].words()
    assert {c.vehicle for c in fleet.trends if not c.believed} == {"v1", "v8"}
    page = report.page(fleet)
    assert "v4: degraded_rotor, rotor 3: in 12 of 12 logs since 2026-03-02" in page
    assert page.count("data:image/png;base64,") == 1
    assert json.loads(json.dumps(fleet.to_json(), allow_nan=False))["findings"][1]["grows"] is True


def test_false_alarms_alone_are_believed_no_oftener_than_said() -> None:
    """60 fleets of 400 logs with false alarms at the full rate, all of one kind, which is the worst."""
    random, believed = np.random.default_rng(7), 0
    for _ in range(60):
        rows = []
        for v in range(20):
            for week in range(20):
                alarm = [("rotor_drag", "", 1.0)] if random.random() < FALSE_ALARM else []
                rows.append(_row(len(rows), f"v{v}", week, *alarm))
        believed += bool(fleet_of(rows).believed)
    assert believed <= 2  # at 1 in 1000 three of 60 come once in 30,000 times


def test_growth_holds_the_slope_as_often_as_it_says() -> None:
    random, inside = np.random.default_rng(2), 0
    dates = [(START + datetime.timedelta(days=7 * k)).isoformat() for k in range(8)]
    for _ in range(400):
        _, (low, high) = growth(dates, [0.01 * k + random.normal(0.0, 0.02) for k in range(8)])
        inside += low <= 0.01 <= high
    assert 0.915 * 400 <= inside <= 0.98 * 400
    assert all(np.isnan(growth(dates[:2], [1.0, 2.0])[1]))


def test_whose_log_and_of_when(tmp_path) -> None:
    for name in ("a/2026-03-04_10_20.ulg", "a/log_7_20260102.bin", "b-1 2026-5-6.csv", "notes.txt"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text("")
    for folder in (str(tmp_path), f"file://{tmp_path}"):
        found = [(log.vehicle, log.date.isoformat(), log.name) for log in find_logs(folder)]
        assert found == [
            ("a", "2026-01-02T00:00:00", "a/log_7_20260102.bin"),
            ("a", "2026-03-04T10:20:00", "a/2026-03-04_10_20.ulg"),
            ("b-1", "2026-05-06T00:00:00", "b-1 2026-5-6.csv"),
        ]
    (tmp_path / "flight.ulg").write_text("")
    with pytest.raises(InputError, match=r"flight.ulg: no date"):
        find_logs(str(tmp_path))
    (tmp_path / "fleet.csv").write_text("log,vehicle,date\nflight.ulg,c,2026-07-08\n")
    assert [log.vehicle for log in find_logs(str(tmp_path))] == ["a", "a", "b-1", "c"]
    (tmp_path / "fleet.csv").write_text("log,vehicle,date\nflight.ulg,c,soon\n")
    with pytest.raises(InputError, match=r"fleet.csv: line 2: a date is expected, found 'soon'"):
        find_logs(str(tmp_path))
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no logs there"):
        find_logs(str(tmp_path / "empty"))


@dataclass(frozen=True)
class Words:
    """An analysis that finds what the log's text says."""

    def __call__(self, log: Path):
        from coaxlink.studies.campaign.fleet import Finding

        text = log.read_text()
        if text == "broken":
            raise InputError(log, "", "broken")
        return [Finding(text, "", 1.0, (0.9, 1.1), "N")] if text else []


def test_every_log_is_looked_at_from_a_bucket_too_and_a_broken_one_is_named(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    for v, text in (("a", "drag"), ("b", ""), ("c", "broken")):
        (tmp_path / v).mkdir()
        for day in range(1, 5):
            (tmp_path / v / f"2026-01-0{day}.csv").write_text(text)
    fleet = look_through(find_logs(f"file://{tmp_path}"), Words(), Machine(1))
    assert (
        fleet.logs == 12 and len(fleet.problems) == 4 and all("broken" in w for w in fleet.problems.values())
    )
    assert [(c.vehicle, c.name, len(c.dates)) for c in fleet.believed] == [("a", "drag", 4)]
