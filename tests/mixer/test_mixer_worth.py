"""What a table is worth, against the same figures by brute force: the rotor file's own polynomials, a
pseudo-inverse normalised by hand, finite differences and fine grids. None of it is the code under test."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from case_table import case_table

from coaxlink.airframe import load_airframe
from coaxlink.mixer.fitted import envelope
from coaxlink.mixer.worth import front, weigh
from coaxlink.report.worth import remark_on_curve, rows, verdict
from coaxlink.rotor.model import load_rotor_model
from coaxlink.tables.ardupilot import ap_commands, report_ap
from coaxlink.tables.px4 import px4_commands, report_px4
from coaxlink.tables.worth import CURVED, DEFAULTS, LIVE, px4_worths
from coaxlink.vehicle import Vehicle

pytestmark = pytest.mark.slow  # every table of the vehicle is made and weighed
EXAMPLES = Path(__file__).parents[2] / "examples"
FRAME = load_airframe(EXAMPLES / "x8_paper.toml")
MODEL = load_rotor_model(EXAMPLES / "rotor_paper.toml")
VEHICLE = Vehicle(FRAME, MODEL)
WEIGHT = 20.0 * 9.80665
LAWS = ("standard", "reduced", "fitted")

_ROTOR = tomllib.loads((EXAMPLES / "rotor_paper.toml").read_text())
_PLACES = tomllib.loads((EXAMPLES / "x8_paper.toml").read_text())["rotors"]
_XY = np.array([r["position_m"][:2] for r in _PLACES])
_SPIN = np.array([1.0 if r["spin"] == "ccw" else -1.0 for r in _PLACES])
_PAIR = np.array([r["pair"] - 1 for r in _PLACES])
_LOWER = np.array([r["level"] == "lower" for r in _PLACES])


def _surface(side: str, load: str, upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
    total = np.zeros(np.broadcast(upper, lower).shape)
    for term, c in _ROTOR[side][load].items():
        part = np.full(total.shape, float(c))
        for factor in term.split():
            base, _, power = factor.partition("^")
            if base != "1":
                part = part * (upper if base == "u_u" else lower) ** int(power or 1)
        total = total + part
    return total


def _wrench(u: np.ndarray) -> tuple[np.ndarray, float]:
    """(4,) thrust, roll, pitch, yaw and shaft watts of speeds (8,), rotor by rotor."""
    thrust, torque = np.zeros(8), np.zeros(8)
    for i in range(8):
        a, b = (u[_PAIR[i]], u[i]) if _LOWER[i] else (u[i], u[_PAIR[i]])
        side = "lower" if _LOWER[i] else "upper"
        thrust[i], torque[i] = (_surface(side, load, a, b) for load in ("thrust_N", "torque_Nm"))
    wrench = [thrust.sum(), -(_XY[:, 1] @ thrust), _XY[:, 0] @ thrust, _SPIN @ torque]
    return np.array(wrench), float(torque @ u) * _ROTOR["speed_max_rpm"] * 2.0 * math.pi / 60.0


@cache
def _table(name: str) -> tuple[np.ndarray, float]:
    """(8, 4) mix of thrust, roll, pitch, yaw as PX4 normalises it, and its curve, from the parameters."""
    params = report_px4(VEHICLE, name).params
    ct = np.array([params[f"CA_ROTOR{n}_CT"] for n in range(8)])
    km = np.array([params[f"CA_ROTOR{n}_KM"] for n in range(8)])
    x, y = (np.array([params[f"CA_ROTOR{n}_P{k}"] for n in range(8)]) for k in "XY")
    mix = np.linalg.pinv(np.stack([ct, -y * ct, x * ct, km * ct]))
    rms = max(math.sqrt(float(c @ c) / 4.0) for c in (mix[:, 1], mix[:, 2]))
    return mix / [np.abs(mix[:, 0]).mean(), rms, rms, mix[:, 3].max()], float(params["THR_MDL_FAC"])


def _setpoints(name: str, demand: Any) -> np.ndarray:
    return _table(name)[0] @ np.asarray(demand, float)


def _commands(name: str, setpoints: np.ndarray) -> np.ndarray:
    """The larger root of fac u^2 + (1 - fac) u = s."""
    fac = _table(name)[1]
    return (fac - 1.0 + np.sqrt((1.0 - fac) ** 2 + 4.0 * fac * setpoints)) / (2.0 * fac)


def _flown(name: str, demand: Any) -> np.ndarray:
    """Without desaturation: for demands that need none."""
    return _wrench(_commands(name, _setpoints(name, demand)))[0]


def _where(lift: Callable[[float], float], wanted: float) -> float:
    grid = np.linspace(0.15, 0.6, 150)
    return float(np.interp(wanted, [lift(t) for t in grid], grid))


@cache
def _hover(name: str) -> float:
    return _where(lambda t: _flown(name, [t, 0, 0, 0])[0], WEIGHT)


@cache
def worths():
    return px4_worths(VEHICLE)


def _row(name):
    row = worths().named(name)
    assert row is not None
    return row


@pytest.mark.parametrize("name", LAWS)
def test_gains_and_their_span_are_those_of_finite_differences(name: str):
    def slopes(kg: float) -> np.ndarray:
        h = _where(lambda t: _flown(name, [t, 0, 0, 0])[0], kg * 9.80665)
        found = []
        for axis in range(4):
            at, step = np.array([h, 0.0, 0.0, 0.0]), 2e-3 * np.eye(4)[axis]
            found.append((_flown(name, at + step)[axis] - _flown(name, at - step)[axis]) / 4e-3)
        return np.array(found)

    row, loads = _row(name), np.array([slopes(kg) for kg in np.linspace(15.0, 25.0, 5)])
    assert row.gain == pytest.approx(loads[2], rel=2e-3)
    assert row.load_span - 1.0 == pytest.approx(
        loads.max(axis=0) / loads.min(axis=0) - 1.0, rel=0.03, abs=2e-4
    )
    hover = _hover(name)
    assert row.lift_exponent == pytest.approx(loads[2][0] * hover / WEIGHT, rel=2e-3)


def test_power_and_ceiling_are_the_rotor_files_own():
    with case_table() as case:
        for name in LAWS:
            with case(f"{name}"):
                row, mix = _row(name), _table(name)[0]
                hover = _hover(name)
                level = _commands(name, _setpoints(name, [hover, 0, 0, 0]))
                assert row.hover_W == pytest.approx(_wrench(level)[1], rel=1e-4)
                # desaturation keeps the ratio of the columns: the first rotor at full speed ends it
                full = mix[:, 0] / mix[:, 0].max()
                assert row.ceiling_N == pytest.approx(_wrench(_commands(name, full))[0][0], rel=1e-4)
                assert row.minutes(700.0, 0.8) == pytest.approx(60.0 * 700.0 * 0.8 / row.hover_W)


def test_the_first_rotor_at_its_bound_is_the_one_of_a_fine_grid():
    with case_table() as case:
        for name in LAWS:
            with case(f"{name}"):
                hover = _hover(name)
                base = _setpoints(name, [hover, 0, 0, 0])
                for axis in (1, 2, 3):
                    turn, found = _table(name)[0][:, axis], []
                    for sign in (1.0, -1.0):
                        at = base + sign * np.linspace(0.0, 1.0, 4001)[:, None] * turn
                        s = at[np.argmax((at.min(axis=1) <= 1e-7) | (at.max(axis=1) >= 1.0))]
                        moment = abs(_wrench(_commands(name, np.clip(s, 0.0, 1.0)))[0][axis])
                        found.append(
                            (moment, {int(n) + 1 for n in np.flatnonzero((s <= 1e-3) | (s >= 0.999))}, s)
                        )
                    moment, rotors, s = (
                        found[1] if found[1][0] < 0.999 * found[0][0] else found[0]
                    )  # a tie: the first
                    limit = _row(name).limits[axis - 1]
                    assert limit.moment_Nm == pytest.approx(moment, rel=5e-3), axis
                    assert limit.rotors and set(limit.rotors) <= rotors, axis
                    assert limit.full == bool(s[limit.rotors[0] - 1] > 0.5), axis


def test_coupling_and_what_a_constant_gain_leaves():
    with case_table() as case:
        for name in LAWS:
            with case(f"{name}"):
                row = _row(name)
                hover = _hover(name)
                still = _flown(name, [hover, 0, 0, 0])
                for axis in (1, 2, 3):
                    ask = np.eye(4)[axis] * row.hard_Nm[axis - 1]
                    off = _flown(name, [hover, 0, 0, 0] + ask / row.gain) - still - ask
                    other = _flown(name, [hover, 0, 0, 0] - ask / row.gain) - still + ask
                    worst = np.where(np.abs(off) >= np.abs(other), off, other)
                    assert np.abs(row.coupling[axis - 1]) == pytest.approx(np.abs(worst), rel=0.02, abs=0.01)
                demands = envelope(FRAME) / [WEIGHT / hover, *row.gain[1:]]
                delivered = np.array([_flown(name, d) for d in demands])
                for axis in range(4):
                    gain = np.linalg.lstsq(demands[:, [axis]], delivered[:, axis], rcond=None)[0][0]
                    left = np.abs(delivered[:, axis] - gain * demands[:, axis]).mean()
                    assert row.shape_error[axis] == pytest.approx(left, rel=0.02, abs=2e-4)


def test_unregulated_speed_controllers_change_the_gain_as_scaled_speeds_do():
    def slope(share: float) -> float:
        def lift(t: float) -> float:
            return float(_wrench(share * _commands("standard", _setpoints("standard", [t, 0, 0, 0])))[0][0])

        h = _where(lift, WEIGHT)
        return (lift(h + 1e-3) - lift(h - 1e-3)) / 2e-3

    assert _row("standard").sag_span[0] == pytest.approx(slope(1.0) / slope(0.85), rel=2e-3)


def test_the_exact_law_keeps_every_gain_and_the_curve_alone_most():
    exact, curved, standard = _row(LIVE), _row(CURVED), _row("standard")
    assert exact.load_span == pytest.approx([1.0] * 4, abs=1e-4)
    assert exact.shape_error == pytest.approx([0.0] * 4, abs=1e-4)
    assert worths().own_curve is not None
    # a curve moves no rotor in hover: the same power and ceiling, other gains
    assert curved.hover_W == pytest.approx(standard.hover_W, rel=1e-6)
    assert curved.ceiling_N == pytest.approx(standard.ceiling_N, rel=1e-6)
    assert curved.load_span.max() < standard.load_span.max() < _row(DEFAULTS).load_span.max()
    # a u^2 + b u is proportional to s = fac u^2 + (1 - fac) u where fac = a / (a + b): level flight of eq. 17
    u = np.linspace(0.45, 0.75, 50)
    lift = _surface("upper", "thrust_N", u, u) + _surface("lower", "thrust_N", u, u)
    a, b = np.linalg.lstsq(np.stack([u**2, u], axis=-1), lift, rcond=None)[0]
    assert pytest.approx(a / (a + b), abs=0.02) == worths().own_curve


def test_the_sentence_says_what_is_gained_and_what_is_lost():
    reported = verdict(_row("fitted"), _row("standard"))
    assert reported.startswith(
        "The fitted table saves 4.9% of hover power at the shafts against the standard one (+5.1% time"
    )
    assert "0.9% from 15 to 25 kg (standard: 8.1%)" in reported
    assert "gives up: ceiling 2.09 times the weight (2.43, -14%), yaw 6.2 N m" in reported
    assert "THR_MDL_FAC 0.69" in remark_on_curve(_row(CURVED), _row("fitted"), worths().own_curve)
    shown = {row[0]: row[1:] for row in rows(worths().rows, 700.0)}
    assert len(shown["hover on 700 Wh, drive 80%, minutes"]) == len(worths().rows) == 6


def test_the_front_of_power_ceiling_and_yaw_leaves_out_what_another_beats_in_all():
    best = dict(zip([row.name for row in worths().rows], front(worths().rows), strict=True))
    assert best[LIVE] and best["fitted"] and best[DEFAULTS]
    assert not best["reduced"] and not best["standard"]  # the exact law, the defaults
    assert worths().chosen == worths().used == "fitted"
    assert [row.name for row in worths().serving()] == ["standard", "fitted", LIVE]


def test_sink_grows_where_the_ceiling_is_near_and_the_exact_law_has_none_below():
    fitted, exact = _row("fitted"), _row(LIVE)
    assert np.interp(20.0, exact.sink_kg, exact.sink_m_s2) == pytest.approx(0.0, abs=1e-3)
    assert fitted.sink_m_s2[-1] > 2.0 > exact.sink_m_s2[-1] > 0.5
    curved = _row(CURVED)  # as no rotor is at a bound yet
    kg = float(curved.sink_kg[2])
    hover = _where(lambda t: _flown(CURVED, [t, 0, 0, 0])[0], kg * 9.80665)
    roll, _, yaw = curved.hard_Nm / curved.gain[1:]
    lift = min(_flown(CURVED, [hover, a * roll, 0.0, b * yaw])[0] for a in (1, -1) for b in (1, -1))
    assert curved.sink_m_s2[2] == pytest.approx(9.80665 - lift / kg, abs=1e-3)


def test_beyond_the_load_that_is_held_in_a_turn_every_table_sinks_and_the_exact_law_only_there():
    for row in worths().rows:
        beyond = row.sink_kg > row.held_kg
        assert beyond.any() and (row.sink_m_s2[beyond] > 0).all(), row.name
        assert row.held_kg < row.ceiling_N / 9.80665
    exact = _row(LIVE)
    assert np.abs(exact.sink_m_s2[exact.sink_kg < exact.held_kg - 1.0]).max() < 1e-3
    assert _row("fitted").held_kg == pytest.approx(26.3, abs=0.3)  # as the documents have it


def test_a_y6_of_equal_rotors_tips_over_in_a_turn_and_the_fitted_table_keeps_it_level():
    frame = load_airframe(EXAMPLES / "y6.toml")
    assert frame.rotor_model is not None
    y6 = px4_worths(Vehicle(frame, load_rotor_model(frame.rotor_model)))
    tipped = {row.name: float(np.abs(row.coupling[2, 1:3]).max()) for row in y6.rows}
    assert tipped["standard"] > 5.0 and tipped[CURVED] > 5.0  # N m: a curve mends no geometry
    assert tipped["fitted"] < 1.0 and tipped[LIVE] < 1e-3
    assert "N m into roll or pitch (fitted: 0." in remark_on_curve(
        y6.named(CURVED), y6.rows[list(tipped).index("fitted")], y6.own_curve
    )


def test_what_cannot_hover_is_said_and_not_a_number():
    stone = replace(FRAME, mass_kg=60.0)
    row = weigh(Vehicle(stone, MODEL), px4_commands(report_px4(VEHICLE, "fitted").mix), "fitted")
    assert math.isnan(row.hover_W) and row.to_json()["hover_W"] is None
    assert row.thrust_to_weight == pytest.approx(_row("fitted").thrust_to_weight / 3.0)
    loaded = weigh(
        VEHICLE,
        px4_commands(report_px4(VEHICLE, "fitted").mix),
        "fitted",
        heavy=2.2,
    )
    assert "Not both tables carry 15 to 44 kg" in verdict(loaded, _row("standard"))
    assert "needs the hover power of the standard one" in verdict(_row(CURVED), _row("standard"))
    assert "cannot carry" in verdict(row, _row("standard"))
    assert "does not" in verdict(_row("fitted"), row)
    assert rows([row])[0][1] == "cannot"


def test_the_curved_law_is_a_table_that_both_firmwares_take():
    report, plain = report_px4(VEHICLE, "curved"), report_px4(VEHICLE, "standard")
    assert report.params["THR_MDL_FAC"] == pytest.approx(worths().own_curve, abs=1e-6)
    differing = {name for name, value in report.params.items() if plain.params[name] != value}
    assert differing == {"THR_MDL_FAC", "MPC_THR_HOVER"} and not report.blocking
    copter = [weigh(VEHICLE, ap_commands(report_ap(VEHICLE, law).mix)) for law in ("standard", "curved")]
    assert copter[1].load_span.max() - 1.0 < 0.5 * (copter[0].load_span.max() - 1.0)
    assert copter[1].lift_exponent > copter[0].lift_exponent
