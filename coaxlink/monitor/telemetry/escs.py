"""Current and temperature of each rotor's ESC, where they are sent.

PX4: ESC_STATUS (current) and ESC_INFO (temperature); ArduPilot: ESC_TELEMETRY_*. An ESC that does not measure
sends 0: a temperature of exactly 0 is taken for none, a current of 0 likewise when no ESC tells any.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from coaxlink.monitor.telemetry.readings import Readings
from coaxlink.monitor.telemetry.sources import STALE_S, motor_outputs
from firmware_params.ardupilot.messages import ESC_TELEMETRY, NAMES

INFO_STALE_S = 5.0  # ESC_INFO comes about once a second
_NO_TEMPERATURE = 32767  # INT16_MAX, in 0.01 degC
Values = tuple[float | None, ...]


@dataclass(frozen=True)
class Escs:
    """(N,) by rotor; None where it is not told."""

    current_A: Values
    temperature_C: Values
    stale: bool = False


def escs_of(readings: Readings, rotors: int, now_s: float) -> Escs:
    """What the ESCs of `rotors` rotors say."""
    outputs = motor_outputs(readings.parameters, rotors)
    current: dict[int, float] = {}
    temperature: dict[int, float] = {}
    times: list[float] = []
    for index, arrival in readings.batches("ESC_STATUS").items():
        current |= {index + k: float(a) for k, a in enumerate(arrival.message.current)}
        times.append(arrival.received_s + STALE_S)
    for index, arrival in readings.batches("ESC_INFO").items():
        reported = {index + k: t for k, t in enumerate(arrival.message.temperature)}
        temperature |= {output: t / 100.0 for output, t in reported.items() if t != _NO_TEMPERATURE}
        times.append(arrival.received_s + INFO_STALE_S)
    if not times:
        for first, name in zip(ESC_TELEMETRY.values(), NAMES, strict=True):
            arrived = readings.get(name)
            if arrived is not None:
                current |= {first + k: a / 100.0 for k, a in enumerate(arrived.message.current)}
                temperature |= {first + k: float(t) for k, t in enumerate(arrived.message.temperature)}
                times.append(arrived.received_s + STALE_S)
    known = any(current.values())
    return Escs(
        _by_rotor(current if known else {}, outputs),
        _by_rotor({output: t for output, t in temperature.items() if t}, outputs),
        bool(times) and now_s > min(times),
    )


def _by_rotor(by_index: Mapping[int, float], outputs: tuple[int | None, ...]) -> Values:
    found = (by_index.get(-1 if output is None else output) for output in outputs)
    return tuple(value if value is not None and math.isfinite(value) else None for value in found)
