"""A stand that reads power and no torque: torque = efficiency * power / speed, the efficiency a prior."""

from __future__ import annotations

import numpy as np

from coaxlink.constants import RAD_S_PER_RPM
from coaxlink.data import Samples
from coaxlink.data.aliases import SIDES
from coaxlink.errors import InputError
from coaxlink.rotor.drive import TURNS
from coaxlink.rotor.fit import Array
from coaxlink.rotor.prior import PRIORS


def with_torque_of_power(samples: Samples) -> Samples:
    """A log with the torques that its powers mean, where it has a rotor's thrust and rpm and no torque.

    Raises InputError where the log has no power either.
    """
    for side in SIDES:
        name = f"{side}_torque_Nm"
        if not samples.has(f"{side}_rpm", f"{side}_thrust_N") or samples.has(name):
            continue
        power, rpm = _power(samples, side), samples[f"{side}_rpm"]
        if not np.any(rpm > 0.0):
            continue  # it never turned: nobody saw its torque
        if power is None:
            hint = f"missing, and so is what would stand for it: {side}_current_A with a voltage"
            raise InputError(samples.source, f"column {name}", hint)
        mean, sd, _, what = PRIORS["motor_efficiency"]
        turns = rpm > TURNS * float(np.max(rpm, initial=0.0))
        torque = np.where(turns, mean * power / np.where(turns, rpm, 1.0) / RAD_S_PER_RPM, 0.0)
        note = (
            f"{name} assumed: {mean:g} ± {sd:g} of the electrical power ({what}); a torque cell measures it"
        )
        samples = samples.with_columns(**{name: torque}).with_notes(note)
    return samples


def _power(samples: Samples, side: str) -> Array | None:
    """W, electrical."""
    if samples.has(f"{side}_power_W"):
        return samples[f"{side}_power_W"]
    volts = next((samples[n] for n in (f"{side}_voltage_V", "voltage_V") if samples.has(n)), None)
    amps = f"{side}_current_A"
    return None if volts is None or not samples.has(amps) else volts * samples[amps]
