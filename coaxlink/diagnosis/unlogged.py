"""What no column tells may have happened all the same: a supply that sags without a voltage in the log.

Every rotor then turns slower or faster with time, by a course that nobody recorded. As a free form over time
that acts through all rotors it is weighed like any other explanation, and stands for `battery_voltage`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from coaxlink.diagnosis.channels import Channels
from coaxlink.diagnosis.claims import APART, Claims, ahead
from coaxlink.diagnosis.parts import Block, waves
from coaxlink.diagnosis.posterior import Posterior
from coaxlink.effects.battery_voltage import speed_sensitivity
from coaxlink.frames import Array, FlightFrame

SUPPLY = "battery_voltage"
# of every speed, one deviation: a pack sags by 10 to 20 % from full to empty, speeds by as much or half of it
SAG = 0.05
LENGTHS = (0.4, 1.0)  # of the flight: a pack empties over all of it
FORM = "time_s|force_z"


def unlogged_supply(frame: FlightFrame, reduce: Callable[[Array], Array]) -> dict[str, Callable[[], Block]]:
    """Free forms of a supply that no column tells, by name; none where a voltage is logged."""
    if frame.voltage is not None:
        return {}
    return {f"{FORM}|{length}|{SAG}": partial(_sag, frame, reduce, length) for length in LENGTHS}


def _sag(frame: FlightFrame, reduce: Callable[[Array], Array], length: float) -> Block:
    functions, deviation = waves(frame.time_s, length)
    columns = [reduce(speed_sensitivity(frame, functions[:, k])) for k in range(functions.shape[1])]
    return Block("supply", np.stack(columns, axis=-1), SAG * deviation)


def with_unlogged(ch: Channels, found: Posterior, said: Claims) -> Claims:
    """The claims, where a supply that was not recorded is one of the names of which one is there."""
    if ch.kind != "flight" or said.group or ch.bare.voltage is not None:
        return said
    for name in sorted(said.sure, key=found.of):
        rivals = [
            h
            for h in found.sets
            if found.best.effects - h.effects == {name}
            and not h.effects - found.best.effects
            and FORM in h.names
            and FORM not in found.best.names
        ]
        if any(ahead(found, h, name) < APART for h in rivals):
            return replace(said, sure=said.sure - {name}, group=(name, SUPPLY))
    return said
