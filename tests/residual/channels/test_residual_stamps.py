"""The last digit of a log's stamps moves nothing."""

from __future__ import annotations

import numpy as np
from residual_world import fly

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import Samples
from coaxlink.residual.channels.flight import flight_frame
from coaxlink.rotor import load_rotor_model


def test_rows_that_are_judged_do_not_hang_on_a_last_digit() -> None:
    columns = dict(fly([{}])[0])
    airframe = load_airframe(files.example("x8_paper.toml"))
    model = load_rotor_model(files.example("rotor_paper.toml"))
    steps = np.arange(len(columns["time_s"]))
    for step_s in (0.016, 0.02, 0.004):  # 0.4 s are 25, 20 and 100 rows: as many where a row is 1e-14 shorter
        exact, other = (
            flight_frame([Samples(columns | {"time_s": step * steps}, "s")], airframe, model)
            for step in (step_s, step_s * (1.0 - 1e-13))
        )
        assert exact.rate_hz == other.rate_hz and np.array_equal(exact.keep, other.keep)
        assert np.allclose(exact.measured, other.measured, rtol=1e-6, atol=1e-6)
