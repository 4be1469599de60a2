"""Whether the intervals of `identify FLIGHT...` hold what is true, on flights of real firmware.

    python research/identify_real.py

The flights of ../shared/data/flights: PX4 and ArduCopter in lockstep on rotors of `rotor_paper.toml`.
Four priors, each load of each 15 % too large or too small; a log each; no rpm in these logs.
"""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path

import numpy as np

from coaxlink.airframe import load_airframe
from coaxlink.data import read_flight_log
from coaxlink.health.coefficients import coefficients_from_flights
from coaxlink.rotor.model import RotorModel, load_rotor_model

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
DATA = EXAMPLES.parent.parent / "shared" / "data" / "flights"
LOGS = ("px4_null_fitted.ulg", "px4_rotor_drag.ulg", "ap_null.bin")
OFF, EVERY, NORMAL_95 = 0.15, 5, 1.96  # every fifth of the 16 ways to be off


def main() -> None:
    """A line a log and prior."""
    true = load_rotor_model(EXAMPLES / "rotor_paper.toml")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "x8.toml"
        place.write_text("motor_lag_s = 0.02\n" + (EXAMPLES / "x8_paper.toml").read_text())
        (Path(folder) / "rotor_paper.toml").write_text((EXAMPLES / "rotor_paper.toml").read_text())
        airframe = load_airframe(place)
    for name in LOGS:
        log = read_flight_log(DATA / name)
        for signs in itertools.islice(itertools.product((-1, 1), repeat=4), 0, 16, EVERY):
            terms = {
                load: {term: (1.0 + OFF * sign) * c for term, c in own.items()}
                for (load, own), sign in zip(true.terms().items(), signs, strict=True)
            }
            prior = RotorModel.from_terms(true.form, true.speed_max_rpm, terms)
            update = coefficients_from_flights([log], airframe, prior)
            off = [(c.value - true.terms()[c.load][c.term]) / c.sd for c in update.coefficients]
            inside = sum(abs(z) <= NORMAL_95 for z in off)
            told = sum(c.verdict == "told" for c in update.coefficients)
            worst = float(np.abs(off).max())
            print(
                f"{name} {signs}: {inside} of {len(off)} inside, {told} told, worst {worst:.1f} sd",
                flush=True,
            )


if __name__ == "__main__":
    main()
