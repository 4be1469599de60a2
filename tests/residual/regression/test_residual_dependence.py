"""What is left and hangs together: bursts, lines and recorded causes are told, noise with a colour is not."""

from __future__ import annotations

import numpy as np
import pytest
from case_table import case_table
from scipy.signal import lfilter

from coaxlink.residual.regression.coloured_noise import Colours
from coaxlink.residual.regression.dependence import dependences, time_path

ROWS, HZ = 1200, 10.0
TIME = np.arange(ROWS) / HZ
BLOCK = np.arange(ROWS) * 40 // ROWS
FOLD = BLOCK % 5


def gusts(seed: int, memory_s: float = 0.8) -> np.ndarray:
    """(rows,) of unit power, a per cent of the load: an autoregressive model of first order."""
    keep = np.exp(-1.0 / (HZ * memory_s))
    white = np.random.default_rng(seed).standard_normal(ROWS + 200)
    return lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white)[200:]


def found(left: np.ndarray, **variables: np.ndarray) -> list[str]:
    """Names of variables that a channel of a flight goes with; its noise from row to row is a tenth."""
    every = {"time_s": TIME, **variables}
    size, noise = np.array([100.0]), np.array([0.1])
    return [d.variable for d in dependences(left[:, None], every, BLOCK, FOLD, size, noise)]


def test_gusts_go_with_nothing() -> None:
    with case_table() as case:
        for seed in range(12):
            with case(f"{seed}"):
                motors = {f"motor{n}": 0.5 + 0.05 * gusts(100 * seed + n) for n in range(1, 5)}
                answered = {"motor5": 0.5 - 0.05 * gusts(seed)}  # a motor that answers the gust
                assert found(gusts(seed), **motors, **answered, yaw_rad=0.03 * TIME) == []


def test_what_no_gust_brings_is_told_though_it_wanders_as_one() -> None:
    assert "time_s" in found(3.0 * gusts(2, 3.0))


def test_a_burst_is_told_among_gusts() -> None:
    assert found(gusts(3) + 9.0 * np.exp(-(((TIME - 70.0) / 1.5) ** 2))) == ["time_s"]


def test_a_periodic_disturbance_is_told_among_gusts() -> None:
    assert found(gusts(4) + 2.0 * np.sin(2.0 * np.pi * TIME / 9.3)) == ["time_s"]


def test_a_trend_is_told_among_gusts() -> None:
    assert "time_s" in found(gusts(5) + 3.0 * TIME / TIME[-1])


def test_what_bends_over_one_motors_speed_has_its_name() -> None:
    speeds = {f"motor{n}": 0.5 + 0.08 * gusts(20 + n, 2.0) for n in range(1, 5)}
    bump = 4.0 * np.exp(-(((speeds["motor3"] - 0.52) / 0.03) ** 2))
    assert found(0.5 * gusts(6) + bump, **speeds)[0] == "motor3"


def test_what_comes_twice_a_turn_goes_with_the_heading() -> None:
    yaw = np.angle(np.exp(1j * (0.35 * TIME + 2.5 * np.sin(TIME / 7.0))))
    assert found(gusts(7) + 1.5 * np.cos(2.0 * yaw), yaw_rad=yaw)[0] == "yaw_rad"


def test_a_cell_may_wander_by_a_little_on_a_stand() -> None:
    """Up to twice the noise from row to row, or 2 % of the load where it soon forgets."""
    with case_table() as case:
        for size, memory_s, told in (
            (0.12, 8.0, False),
            (1.0, 8.0, True),
            (1.0, 2.0, False),
            (2.5, 2.0, True),
        ):
            with case(f"{size}, {memory_s}, {told}"):
                left = size * gusts(8, memory_s) + 0.1 * np.random.default_rng(9).standard_normal(ROWS)
                speed = 0.5 + 0.3 * np.sin(TIME / 3.0)
                names = found(left, upper_speed=speed, lower_speed=0.5 + 0.3 * np.cos(TIME / 4.1))
                assert ("time_s" in names) == told


def on_stand(left: np.ndarray, **more: np.ndarray) -> set[str]:
    """Channels and variables that a stand's loads (rows, C) go with; a load of 100, a tenth of noise."""
    full, noise = np.full(left.shape[1], 100.0), np.full(left.shape[1], 0.1)
    levels = 0.3 + 0.1 * (np.arange(ROWS) // 30 % 7), 0.3 + 0.1 * (np.arange(ROWS) // 210 % 6)
    variables = {"time_s": TIME, "upper_speed": levels[0], "lower_speed": levels[1], **more}
    return {f"{d.channel} {d.variable}" for d in dependences(left, variables, BLOCK, FOLD, full, noise)}


def test_a_cells_own_noise_that_soon_forgets_goes_with_nothing() -> None:
    """Rows that stand at one level share some of it, and no level may take it for its own."""
    with case_table() as case:
        for seed in range(12):
            with case(f"{seed}"):
                assert on_stand(np.stack([gusts(10 * seed + c, 0.4) for c in range(4)], axis=1)) == set()


def test_a_cell_drifts_within_its_noise() -> None:
    """A zero that goes to and fro ten times a log, and what was logged of the room meanwhile."""
    with case_table() as case:
        for seed in range(12):
            with case(f"{seed}"):
                white = np.random.default_rng(seed).standard_normal((ROWS, 4))
                wander = np.stack([gusts(30 * seed + c, 6.0) for c in range(4)], axis=1)
                assert on_stand(0.1 * (wander + white), humidity_pct=40.0 + 0.1 * TIME) == set()


def test_what_stands_out_in_a_few_rows_is_no_noise() -> None:
    random = np.random.default_rng(0)
    normal = random.standard_normal(ROWS)
    band = 0.4 * normal + 7.0 * (random.random(ROWS) < 0.02)
    for left, noise in ((normal, True), (band, False)):
        one = np.array([1.0])
        colours = Colours(left[:, None], 0.1 * one, 100.0 * one, flown=False)
        assert colours.hold(0, *time_path(left)) is noise


def test_what_two_loads_share_is_no_cells_noise() -> None:
    one, shared = gusts(1, 0.4), gusts(2, 0.4)
    told = on_stand(np.stack([one, shared, shared + 0.3 * gusts(3, 0.4)], axis=1))
    assert told == {"1 time_s", "2 time_s"}


def test_a_bump_over_the_speeds_is_told_beside_noise_with_a_colour() -> None:
    upper = 0.3 + 0.1 * (np.arange(ROWS) // 30 % 7)
    bump = 3.0 * (upper > 0.75) * (np.arange(ROWS) // 210 % 6 > 2)
    assert "0 upper_speed x lower_speed" in on_stand((0.5 * gusts(4, 0.4) + bump)[:, None])


@pytest.mark.filterwarnings("error")
def test_a_channel_that_is_left_with_nothing_goes_with_nothing() -> None:
    assert on_stand(np.zeros((ROWS, 2))) == set()
