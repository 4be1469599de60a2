"""Normalised speeds of a stand log: from rpm, or from throttle where no speed was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.data import Samples
from coaxlink.errors import InputError

PROPORTIONAL = 0.01  # rpm that follow the throttle this closely tell the speed at full throttle


@dataclass(frozen=True)
class Speeds:
    """u of both rotors, 0..1, and what u = 1 means."""

    upper: NDArray[np.float64]  # (rows,)
    lower: NDArray[np.float64]  # (rows,), 0 for a rotor alone
    speed_max_rpm: float
    source: str  # in words
    from_throttle: bool = False


def normalised_speeds(samples: Samples, speed_max_rpm: float | None = None) -> Speeds:
    """u = rpm / speed_max_rpm; by default the rpm at full throttle if proportional, or the fastest seen.

    Raises InputError when neither rpm nor throttle of a rotor that is measured is there.
    """
    upper, lower = (_raw(samples, side, "rpm") for side in ("upper", "lower"))
    if upper is None or lower is None:
        upper, lower = (_raw(samples, side, "throttle") for side in ("upper", "lower"))
        if upper is None or lower is None:
            samples.require("upper_rpm", "lower_rpm")
            raise AssertionError("unreachable")
        said = "the throttle is taken for the normalised speed: no rpm in the log"
        return Speeds(upper, lower, speed_max_rpm or 1.0, said, True)
    fastest = float(max(upper.max(), lower.max()))
    if fastest <= 0:
        raise InputError(samples.source, "column upper_rpm", "no rotor ever turns")
    if speed_max_rpm is not None:
        if speed_max_rpm <= 0:
            raise InputError("`speed_max_rpm`", "", f"more than 0 is expected, found {speed_max_rpm:g}")
        return Speeds(upper / speed_max_rpm, lower / speed_max_rpm, speed_max_rpm, "given")
    full = _at_full_throttle(samples)
    maximum, said = (
        (full, "rpm at full throttle, to which it is proportional")
        if full
        else (fastest, "fastest rpm in the log")
    )
    return Speeds(upper / maximum, lower / maximum, maximum, said)


def _raw(samples: Samples, side: str, what: str) -> NDArray[np.float64] | None:
    name = f"{side}_{what}"
    if samples.has(name):
        return samples[name]
    if samples.has(f"{side}_thrust_N") or samples.has(f"{side}_torque_Nm"):
        return None
    return np.zeros(samples.rows)  # a rotor that is not on the stand


def _at_full_throttle(samples: Samples) -> float | None:
    """rpm at throttle 1 when rpm are proportional to throttle (a governed or simulated motor), else None."""
    ratios = []
    for side in ("upper", "lower"):
        if not samples.has(f"{side}_rpm", f"{side}_throttle"):
            return None
        on = samples[f"{side}_throttle"] > 0.05
        ratios.append(samples[f"{side}_rpm"][on] / samples[f"{side}_throttle"][on])
    ratio = np.concatenate(ratios)
    if len(ratio) < 3 or np.ptp(ratio) > PROPORTIONAL * np.median(ratio):
        return None
    # written logs round throttle and rpm: a ratio this close to a round number is that number
    rounded = round(float(np.median(ratio)), -1)
    return rounded if abs(rounded - np.median(ratio)) < 1e-3 * rounded else float(np.median(ratio))
