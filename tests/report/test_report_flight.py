"""The flight page, from a hover made here: what is drawn, and that the page keeps to itself."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from browser import CHROMIUM, Browser

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.data import read_flights
from coaxlink.files import example
from coaxlink.mixer import make_law
from coaxlink.report.flight_charts import flight_charts
from coaxlink.vehicle import load_vehicle

SHAKEN_HZ = 20.0


@pytest.fixture(scope="module")
def hover(tmp_path_factory):
    """16 s of level hover by the standard law, shaken along x at SHAKEN_HZ; rotor 3 has an ESC that talks."""
    vehicle = load_vehicle(example("x8_demo.toml"))
    mass = vehicle.airframe.mass_kg
    u = make_law("standard", vehicle).speeds([mass * 9.80665, 0, 0, 0])
    lift = float(vehicle.airframe.wrench(*vehicle.airframe.loads(vehicle.model, u))[0])
    t = np.arange(0.0, 16.0, 0.01)
    noise = 0.01 * np.random.default_rng(1).normal(size=(len(t), 9))
    columns = {"time_s": t} | {f"motor{n + 1}": np.full(len(t), u[n]) for n in range(8)}
    still = ("accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2", "gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s",
             "roll_rad", "pitch_rad", "yaw_rad")  # fmt: skip
    columns |= {name: noise[:, k] for k, name in enumerate(still)}
    columns["accel_x_m_s2"] = columns["accel_x_m_s2"] + 2.0 * np.sin(2 * np.pi * SHAKEN_HZ * t)
    columns["accel_z_m_s2"] = columns["accel_z_m_s2"] - lift / mass
    columns |= {name: np.zeros(len(t)) for name in ("vel_n_m_s", "vel_e_m_s", "vel_d_m_s")}
    columns |= {"height_m": np.full(len(t), 5.0), "voltage_V": np.linspace(25.0, 24.0, len(t))}
    columns |= {
        "armed": (t > 1.0).astype(float),
        "rpm3": np.full(len(t), 4000.0),
        "current3_A": 12.0 + t / 16,
    }
    log = tmp_path_factory.mktemp("log") / "hover<1>.csv"
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(log, rows, delimiter=",", header=",".join(columns), comments="")
    return log, vehicle


def test_every_rotor_pair_and_axis_is_drawn(hover):
    [flight] = flight_charts(*hover)
    charts = {c.title: c for c in flight.charts}
    assert len(charts["Command of every rotor"].lines) == len(charts["Thrust of every rotor"].lines) == 8
    assert [line.name for line in charts["Current of every rotor"].lines] == ["rotor 3"]
    split = charts["Split: thrust of the lower rotor, of its pair"].lines
    flown, ideal = split[0], split[1]
    assert (
        ideal.dashed and ideal.y.mean() > flown.y.mean() + 5.0
    )  # the standard law leaves the lower one idle
    delivered, demanded = charts["Thrust, demanded and delivered"].lines
    assert demanded.y == pytest.approx(delivered.y, rel=0.01)
    x = charts["Vibration, spectrum of the accelerometer"].lines[0]
    assert x.x[np.argmax(x.y)] == pytest.approx(SHAKEN_HZ, abs=0.2)
    assert flight.events == ((pytest.approx(1.01), "armed"),)
    assert "lower rotors carried" in flight.answer and "roll -0" in flight.answer.replace("+", "-")


@pytest.mark.parametrize(
    "ct, reported", [(6.5, "PX4's default, 6.5"), (65.0, ""), (2.0, "not in newtons (5 N for 171 N)")]
)
def test_a_table_whose_ct_nobody_measured_is_not_held_against_the_flight(hover, monkeypatch, ct, reported):
    log, vehicle = hover
    board = {"CA_ROTOR_COUNT": 8.0, "CA_AIRFRAME": 0.0, "CA_METHOD": 2.0, "THR_MDL_FAC": 1.0}
    for n, rotor in enumerate(vehicle.airframe.rotors):
        entries = {"PX": rotor.position_m[0], "PY": rotor.position_m[1], "PZ": rotor.position_m[2]}
        entries |= {"AX": 0.0, "AY": 0.0, "AZ": -1.0, "CT": ct, "KM": 0.05 * rotor.yaw_sign}
        board |= {f"CA_ROTOR{n}_{key}": value for key, value in entries.items()}
    read = [replace(r, parameters=board) for r in read_flights(log)]
    monkeypatch.setattr("coaxlink.report.flight_charts.read_flights", lambda *_: read)
    [flight] = flight_charts(log, vehicle)
    assert ("of what the rotor model says" in flight.answer) == bool(reported)
    assert ("of what the table on board says" in flight.answer) != bool(reported)
    assert reported in flight.answer and ("measure the rotors" in flight.answer) == bool(reported)


def test_without_a_vehicle_the_log_alone_is_drawn_and_what_is_missing_is_said(hover):
    [flight] = flight_charts(hover[0], None)
    assert "file of the airframe" in flight.answer
    assert not any("hrust" in c.title for c in flight.charts)


def test_the_page_is_one_file_with_two_logs_beside_one_another(hover, tmp_path, capsys):
    page = tmp_path / "two.html"
    log = str(hover[0])
    assert (
        run(build_app(), ["report", log, log, "--airframe", str(example("x8_demo.toml")), "--out", str(page)])
        == 0
    )
    text = page.read_text()
    assert not re.search(r"(src|href)=.?https?:", text) and "hover<1>" not in text
    data = json.loads(re.search(r"const DATA=(\{.*\}),COLOURS", text).group(1))
    assert len(data["logs"]) == 2 and all(len(row["cells"]) == 2 for row in data["rows"])
    assert "lower rotors carried" in capsys.readouterr().out
    assert run(build_app(), ["report", log, log, log]) == 2
    assert run(build_app(), ["report", str(tmp_path / "none.ulg")]) == 2


@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed")
def test_a_drag_over_a_chart_zooms_all_of_them_and_two_clicks_zoom_out(hover, tmp_path):
    page, quiet = tmp_path / "hover.html", tmp_path / "quiet.csv"
    rows = hover[0].read_text().splitlines()
    quiet.write_text("\n".join(row.rsplit(",", 2)[0] for row in rows) + "\n")  # of the ESC that talks
    assert run(build_app(), ["report", str(hover[0]), str(quiet), "--out", str(page)]) == 0
    with Browser(tmp_path / "profile") as browser:
        tab = browser.open(page.as_uri())
        assert browser.says(tab, "time", "Object.keys(full)[0]")
        empty = "charts.filter(c => !c.lines.length).map(c => [c.note, c.svg.isConnected])"
        assert browser.value(tab, empty) == 2 * [["not in this log", False]]
        words = "[...document.querySelectorAll('.legend span')].map(e => e.textContent)"
        assert browser.value(tab, words).count("not in this log") == 2
        box = "charts[0].svg.getBoundingClientRect()"
        left, top, wide = browser.value(tab, f"[{box}.left, {box}.top, {box}.width]")
        first, last = whole = browser.value(tab, "range[charts[0].over]")
        x, y = [left + 52 + share * (wide - 60) for share in (0.25, 0.4, 0.5)], top + 100
        browser.mouse(tab, "mousePressed", x[0], y)
        for at in x[1:]:
            browser.mouse(tab, "mouseMoved", at, y)
        browser.mouse(tab, "mouseReleased", x[2], y)
        length = last - first
        for chart in (0, 1):
            zoomed = browser.value(tab, f"range[charts[{chart}].over]")
            assert zoomed == pytest.approx([first + 0.25 * length, first + 0.5 * length], abs=0.01 * length)
        for clicks in (1, 2):
            browser.mouse(tab, "mousePressed", x[0], y, clicks)
            browser.mouse(tab, "mouseReleased", x[0], y, clicks)
        assert browser.value(tab, "range[charts[0].over]") == whole
