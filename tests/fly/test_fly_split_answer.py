"""The split of least power from hovers in worlds of momentum theory, read by a bad power module."""

import numpy as np
import pytest
from split_world import Simulation, hover

from coaxlink.errors import InputError
from coaxlink.fly.split_answer import Dwells, best_split, dwells_of, joined

FLIGHTS, HELD = 60, 53  # 95 % of 60 are fewer than this once in a hundred
WORLD = Simulation(lower_efficiency=0.8, wake=0.3)
LOW, HIGH = 0.3, 0.8


def flown(board, seed, reach=0.1, dwells=56, **sensor):
    up = np.linspace(board - reach, board + reach, 7)
    order = np.resize(np.concatenate([up, up[::-1], up[::-1], up]), dwells)
    t, watts, share, up, tilt = hover(WORLD, order, 12.0, np.random.default_rng(seed), **sensor)
    columns = {"load": (1.0 + up / 9.81) ** 1.5, "tilt": tilt**2}
    return best_split(dwells_of(t // 12.0, t, watts, share, 3.0, columns), board)


@pytest.mark.parametrize("off", [0.0, -0.05, 0.07])
def test_least_and_saving_lie_in_their_intervals_in_19_of_20(off):
    best = WORLD.least(LOW, HIGH)
    saving = 1.0 - WORLD.watts(best) / WORLD.watts(best + off)
    answers = [flown(best + off, seed) for seed in range(FLIGHTS)]
    inside = sum(a.share_ci[0] - 1e-3 <= best <= a.share_ci[1] + 1e-3 for a in answers)
    saved = sum(a.saving_ci[0] - 1e-6 <= saving <= a.saving_ci[1] + 1e-6 for a in answers)
    assert inside >= HELD
    assert saved >= HELD
    assert np.sqrt(np.mean([(a.share - best) ** 2 for a in answers])) < 0.02
    assert max(abs(a.saving - saving) for a in answers) < 0.007
    if off == 0.0:
        assert sum(not a.worth_it for a in answers) >= HELD
        assert "nothing to gain" in next(a for a in answers if not a.worth_it).words()


def test_another_pack_is_another_level_and_the_rows_survive_a_file():
    order = np.resize(np.concatenate([np.linspace(0.45, 0.65, 5), np.linspace(0.65, 0.45, 5)]), 30)
    parts = []
    for seed, more in ((1, 0.0), (2, 150.0)):
        t, watts, share, up, _ = hover(WORLD, order, 12.0, np.random.default_rng(seed))
        parts.append(dwells_of(t // 12.0, t, watts + more, share, 3.0, {"load": (1.0 + up / 9.81) ** 1.5}))
    read = [Dwells.of_json(part.as_json(), 1) for part in parts]
    both = best_split(joined(read), 0.55)
    assert both.dwells == 60
    assert both.share == pytest.approx(WORLD.least(0.45, 0.65), abs=0.03)
    assert both.scatter < 40.0  # 150 W more in the second flight are no scatter
    with pytest.raises(ValueError, match="numbers"):
        Dwells.of_json(parts[0].as_json(), 3)


def test_a_wrong_scale_changes_the_watts_and_not_the_share():
    one, other = (flown(0.48, 3, sensor_scale=scale) for scale in (0.8, 1.2))
    assert other.watts > 1.4 * one.watts
    assert other.share == pytest.approx(one.share, abs=0.01)


def test_a_least_outside_of_what_was_flown_is_said():
    answer = flown(0.40, 5, reach=0.05)
    assert answer.at_edge
    assert "may lie beyond" in answer.words()
    assert " or more)" in answer.words()  # what ends where the flight ended is no end


def test_residuals_that_are_alike_widen_the_intervals():
    rng = np.random.default_rng(1)
    share = np.resize([0.4, 0.45, 0.5, 0.55, 0.6, 0.6, 0.55, 0.5, 0.45, 0.4], 60)
    noise = np.zeros(60)
    for k in range(1, 60):
        noise[k] = 0.8 * noise[k - 1] + rng.normal()
    plain = Dwells(12.0 * np.arange(60.0), 3000 + 2000 * (share - 0.5) ** 2 + noise, share, np.empty((60, 0)))
    assert best_split(plain, 0.5).correlation > 0.3


def test_stretches_that_did_not_settle_are_left_out():
    t = np.arange(0.0, 30.0, 0.1)
    share = np.where(t < 12, 0.5, np.where(t < 16, 0.6, 0.55))
    watts = np.where(t % 12 < 3, 9e9, 100.0 * share)
    number = np.where(t < 12, 0, np.where(t < 16, 1, 2))
    found = dwells_of(number, t, np.where((t > 16) & (t < 19), 9e9, watts), share, 3.0, {})
    assert found.share.tolist() == [0.5, 0.55]
    assert found.watts[0] == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("share", "board", "what"), [([0.5, 0.6] * 20, 0.5, "three"), ([0.4, 0.5, 0.6], 0.5, "more"),
                                 ([0.4, 0.5, 0.6] * 10, 0.7, "on board")],
)  # fmt: skip
def test_too_little_is_said(share, board, what):
    n = len(share)
    with pytest.raises(InputError, match=what):
        best_split(Dwells(np.arange(n) * 10.0, np.ones(n), np.array(share), np.empty((n, 0))), board)
