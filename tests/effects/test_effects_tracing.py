"""What is derived from an effect's numbers and from what they add, for every effect in many of its forms."""

from __future__ import annotations

import numpy as np
import pytest
from case_table import case_table
from residual_rig import run

from coaxlink.airframe import load_airframe
from coaxlink.channels.stand import stand_frame
from coaxlink.data import Samples
from coaxlink.effects import NotShown, flight_effects, stand_effects
from coaxlink.files import example
from coaxlink.frames import FLIGHT_CHANNELS, FlightFrame
from coaxlink.rotor import load_rotor_model

ROWS, RATE_HZ = 120, 20.0


@pytest.fixture(scope="module")
def flight():
    """A vehicle that sways: nothing is measured of it."""
    airframe = load_airframe(example("x8_paper.toml"))
    model, count = load_rotor_model(example("rotor_paper.toml")), len(airframe.rotors)
    time = np.arange(ROWS) / RATE_HZ

    def sway(size, columns, middle=0.0):
        return middle + size * np.sin(time[:, None] * np.linspace(0.6, 3.1, columns) + np.arange(columns))

    level = {"north": [1.0, 0.0, 0.0], "east": [0.0, 1.0, 0.0]}
    frame = FlightFrame(
        airframe, model, RATE_HZ, time, np.zeros(ROWS, int), np.zeros(ROWS, int), sway(0.1, count, 0.5),
        sway(0.1, count, 0.5), *[np.zeros((ROWS, count))] * 2, sway(0.5, 3), sway(1.0, 3), sway(1.0, 3, -9.0),
        sway(0.6, 3), sway(3.0, 3), height=sway(0.9, 1, 1.0)[:, 0], voltage=24.0 - 0.3 * time,
        predicted=np.zeros((ROWS, 6)), measured=np.zeros((ROWS, 6)), keep=np.arange(ROWS), cutoff_hz=5.0,
        step_s=1.0 / RATE_HZ, **{name: np.tile(way, (ROWS, 1)) for name, way in level.items()},
    )  # fmt: skip
    return frame.turning_at(frame.speeds)


@pytest.fixture(scope="module", params=["speeds and throttles", "throttles alone", "speeds alone"])
def stand(request):
    rpm, throttle = request.param != "throttles alone", request.param != "speeds alone"
    log = Samples(run(seed=21, rpm=rpm, throttle=throttle), "rig.csv")
    return stand_frame(log, load_rotor_model(example("rotor_paper.toml")))


def test_every_form_on_a_stand(stand):
    every_form(stand, stand_effects())


def test_every_form_in_a_flight(flight):
    every_form(flight, flight_effects())
    assert {c for t in flight_effects() for c in t.channels} == set(FLIGHT_CHANNELS)


def test_a_rotor_files_numbers_are_completed_or_it_says_which_is_missing(stand, flight):
    density, spacing, drag = (
        next(t for t in (*stand_effects(), *flight_effects()) if t.name == name)
        for name in ("air_density", "rotor_spacing", "rotor_drag")
    )
    known = density.completed(stand, {"density_exponent": 1.0})
    assert known["reference_density_kg_m3"] == pytest.approx(1.2, abs=0.1)
    with pytest.raises(NotShown, match="upper_gain_N is missing"):
        spacing.completed(stand, {"wake_thrust_share": 0.1, "wake_torque_share": 0.1})
    whole = {"drag_per_speed_N_s_m": 0.5, "moment_share": 1.0}
    assert drag.completed(flight, whole) == whole


def every_form(frame, effects):
    with case_table() as case:
        for tracing in effects:
            if tracing.missing(frame):
                continue
            starts = tracing.starts(frame)
            for start in starts[:: 1 + len(starts) // 8]:
                for p in (start, *tracing.further(frame, start)):
                    with case(f"{tracing.name} {p}"):
                        holds(tracing, frame, p)


def holds(tracing, frame, numbers):
    """There and back; what it adds is its columns times coefficients; what moves lies within its bounds."""
    assert set(numbers) <= set(tracing.units)
    form, _ = tracing.inverse(frame, numbers)
    for name, (low, high) in tracing.free(frame, form).items():
        known = tracing.effect.known[name]
        assert known.low <= low < high <= known.high
        assert low <= numbers[name] <= high
    columns = tracing.columns(frame, form)
    coefficients = 1e-3 * 0.01 ** (np.arange(columns.shape[-1]) > 0)
    p = tracing.parameters(frame, form, coefficients)
    assert list(p) == [name for name in tracing.units if name in p]  # a rotor's number before its loss
    again, back = tracing.inverse(frame, p)
    assert again == form
    assert back == pytest.approx(coefficients, rel=1e-6)
    if tracing.adds is not None:
        added = tracing.contribution(frame, p)
        np.testing.assert_allclose(added, columns @ coefficients, rtol=1e-3, atol=1e-3 * np.abs(added).max())
    assert np.all(np.isfinite(tracing.acting(frame, p).predicted))
    label, rows = tracing.cause(frame, p, tracing.channels[0])
    assert label and len(rows) == len(frame.time_s)
