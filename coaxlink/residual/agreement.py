"""Where the selection leaves a stand log open a second method looks: the posterior over explanations.

Stepwise selection on held-out blocks (`answer.stand`) is hard to fool, and misses what has another form than
those it tries. The posterior (`diagnosis`) finds such forms, and names now and then what is not
there, on a pair that its rotor map does not follow. On logs that neither was built with they are about as
good as one another and err on different ones. So only what the selection leaves
unexplained is asked about, and an answer is taken from the posterior where it

    flags a column, or
    names one effect whose cause the log records, with positive evidence and numbers that physics allows, and
    the error shows it, or
    holds several names for one of which the log records the cause.

A supply or an air that nobody logged changes all loads with time and load, as heat and a cell's drift do: of
what acts on all loads, only a supply or an air that was logged, and goes another way than the clock, counts.
On noise with a colour hundreds of nats come together without the error falling; so it has to fall, and what
is left far above its noise had another cause.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from coaxlink.data.samples import Samples
from coaxlink.effects import stand_effects
from coaxlink.frames import Array
from coaxlink.residual.checks.residual_check import ENOUGH
from coaxlink.residual.regression.gates import GAIN
from coaxlink.residual.result import FoundEffect, Refinement

POSTERIOR = "posterior"  # in an effect's evidence: the method that named it
# what acts on all loads at once, and the columns that bear it out: heat and drift have none of their own
WITNESSES: dict[str, tuple[str, ...]] = {
    "air_density": ("air_temperature_C", "air_pressure_Pa"),
    "battery_voltage": ("voltage_V",),
    "motor_heating": (),
    "sensor_drift": (),
}
SLOW, CLOCK = 3, 0.9  # order of a slow time profile; share of a column's variance that makes it one


def leaves_open(selection: Refinement) -> bool:
    """Whether something is left that the selection has no name for, and nothing else is said of the log."""
    named = selection.effects or selection.ambiguous or selection.suspect_data
    return bool(selection.unexplained) and not named


def agreed(selection: Refinement, posterior: Refinement, logs: Sequence[Samples]) -> Refinement:
    """The answer to logs of which the selection leaves something open."""
    names = [effect.name for effect in posterior.effects]
    rivals = [name for doubt in posterior.ambiguous for name in doubt.names]
    positive = all(
        effect.evidence.get("nats", 0.0) > 0.0
        and possible(effect)
        and lowers(effect)
        and explains(effect, posterior)
        for effect in posterior.effects
    )
    if posterior.suspect_data:
        return posterior if positive else replace(selection, suspect_data=posterior.suspect_data)
    single = len(names) == 1 and recorded(names, logs)
    if not positive or not (single or (not names and recorded(rivals, logs))):
        return selection
    effects = tuple(replace(e, evidence={**e.evidence, "method": POSTERIOR}) for e in posterior.effects)
    return replace(posterior, effects=effects)


def possible(effect: FoundEffect) -> bool:
    """Whether physics allows the numbers that all rows gave it."""
    numbers = {p.name: p.value for p in effect.parameters}
    return all(e.refuse(numbers) is None for e in stand_effects() if e.name == effect.name)


def lowers(effect: FoundEffect) -> bool:
    """Whether a channel's squared held-out error falls as the selection asks (`GAIN`), and none rises."""
    left = [(after / before) ** 2 for before, after in effect.rmse.values()]
    return min(left) <= 1.0 - GAIN and max(left) <= 1.0


def explains(effect: FoundEffect, answer: Refinement) -> bool:
    """Whether no channel that it acts on is left far above its noise."""
    left = ENOUGH[-1][0]
    return all(
        after <= left * max(answer.channels[name].noise_floor, 1e-12)
        for name, (_, after) in effect.rmse.items()
    )


def recorded(names: Iterable[str], logs: Sequence[Samples]) -> bool:
    """Whether the logs record the cause of one of these effects, and it is none that the clock stands for."""
    return any(name not in WITNESSES or _recorded(WITNESSES[name], logs) for name in names)


def _recorded(witnesses: tuple[str, ...], logs: Sequence[Samples]) -> bool:
    """Whether a column of such a name, or a rotor's own, goes another way than the clock."""
    return any(
        not follows_clock(log["time_s"], log[column])
        for log in logs
        for column in log.columns
        if log.has("time_s") and column.endswith(witnesses)
    )


def follows_clock(time_s: Array, values: Array) -> bool:
    """Whether values (rows,) are a slow time profile of time.

    >>> t = np.linspace(0.0, 600.0, 100)
    >>> follows_clock(t, 25.0 - t / 400.0), follows_clock(t, np.sin(t / 10.0))
    (True, False)
    """
    good = np.isfinite(time_s) & np.isfinite(values)
    t, v = time_s[good], values[good] - np.mean(values[good])
    if len(v) <= SLOW or not np.any(v) or np.ptp(t) <= 0.0:
        return True
    time_profile = np.polynomial.Polynomial.fit(t, v, SLOW)(t)
    return bool(np.sum((v - time_profile) ** 2) < (1.0 - CLOCK) * np.sum(v**2))
