"""Commands of which a log holds a few: their noise is no inertia, and nothing that lasts is any either."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from coaxlink.channels.flight_corrections import _aliased, _moving

RATE_HZ = 10.0


@dataclass
class Frame:
    """What the corrections of inertia look at."""

    measured: np.ndarray
    predicted: np.ndarray
    keep: np.ndarray
    rate_hz: float = RATE_HZ
    cutoff_hz: float = 2.0


def flown(noise: float, step: float = 0.0) -> Frame:
    """200 s of moments around 0.7 Hz; predicted with noise, and with a step that the body did not follow."""
    rng, t = np.random.default_rng(4), np.arange(2000) / RATE_HZ
    phases = 2 * np.pi * rng.random((40, 6))
    true = sum(np.sin(2 * np.pi * (0.5 + 0.01 * k) * t[:, None] + p) for k, p in enumerate(phases))
    true = true / np.std(true)
    predicted = true + noise * rng.standard_normal(true.shape) + step * (t > 100.0)[:, None]
    return Frame(true, predicted, np.arange(50, 1950))


@pytest.mark.parametrize("step", [0.0, 3.0])
def test_the_share_that_is_noise(step: float) -> None:
    assert _aliased(flown(0.0)) == pytest.approx(0.0, abs=0.01)
    # of white noise of 1 some 0.3 pass a band of 0.3 to 2 Hz out of 5
    assert _aliased(flown(1.0, step)) == pytest.approx(0.3 / 1.3, abs=0.04)


def test_what_lasts_is_no_inertia() -> None:
    frame = flown(0.0, 3.0)
    moving = _moving(frame, frame.predicted)
    assert np.abs(moving[1100:].mean(axis=0) - moving[:900].mean(axis=0)).max() < 0.05
