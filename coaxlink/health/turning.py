"""Whether every rotor turned as its command asks: the ESCs' rpm held against the commands, rotor by rotor.

What all rotors have in common (the pack, the air, full speed) says nothing of one of them: each is held
against the others of its level, which bear the same load. A rotor that turns slower is a motor or an ESC that
fails, or a column that is off; one that turns faster is a column, whatever the motor does.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.channels.logged_speeds import LEAST_ROWS, has_speed
from coaxlink.constants import FULL, NORMAL_999, TURNING
from coaxlink.data.logs.flight import impossible_commands
from coaxlink.data.samples import Samples
from coaxlink.rotor.model import RotorModel

# priors: name = value  # unit, source
MOTORS_APART = (
    0.03  # of speed, sd: motors of one type (makers give their speed constant to 5 %), and their ESCs
)
APART = NORMAL_999 * MOTORS_APART  # one sound rotor in a thousand
FEWEST = 3  # rotors of a level, of which one is told by the others


def speed_ratios(
    log: Samples, airframe: Airframe, model: RotorModel, since_s: float = -np.inf
) -> Mapping[int, float]:
    """{rotor: what it turned at over what its command asks, the others of its level at 1}, from a time on.

    Empty where a level has fewer than FEWEST speeds.
    """
    given = np.stack([log[f"motor{rotor.number}"] for rotor in airframe.rotors], axis=1)
    volts = log["voltage_V"] if log.has("voltage_V") else None
    asked = airframe.turned(model, np.where(impossible_commands(given), np.nan, given), volts)
    levels: dict[str, dict[int, float]] = {}
    for k, rotor in enumerate(airframe.rotors):
        if not has_speed(log, rotor.number):
            continue
        turned = log[f"rpm{rotor.number}"] / model.speed_max_rpm
        rows = (given[:, k] > TURNING) & (given[:, k] < FULL) & (turned > 0.0) & (log["time_s"] >= since_s)
        if rows.sum() >= LEAST_ROWS:
            ratio = float(np.nanmedian(turned[rows] / asked[rows, k]))
            levels.setdefault(rotor.level, {})[rotor.number] = ratio
    found: dict[int, float] = {}
    for own in levels.values():
        if len(own) >= FEWEST:
            usual = float(np.median(list(own.values())))
            found |= {number: ratio / usual for number, ratio in own.items()}
    return found


def apart(ratios: Mapping[int, float]) -> dict[int, float]:
    """Those that no motors of one type are apart.

    >>> apart({1: 1.01, 2: 0.8, 3: 0.99, 4: 1.2})
    {2: 0.8, 4: 1.2}
    """
    return {number: ratio for number, ratio in ratios.items() if abs(ratio - 1.0) > APART}


def turning_words(ratios: Mapping[int, float]) -> str:
    """Their rotors in words.

    >>> turning_words({3: 0.84})
    "by the ESCs' rpm rotor 3 turns at 0.84 times what its command asks, against the others of its level"
    """
    named = " and ".join(f"rotor {n} turns at {r:.2f} times" for n, r in ratios.items())
    return f"by the ESCs' rpm {named} what its command asks, against the others of its level"
