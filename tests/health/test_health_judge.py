"""The judgement over flights, on linear worlds made here: what is drawn must be found, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink.health.columns import Flight
from coaxlink.health.judge import judge

N, ROWS = 8, 400
PAIRS = ((0, 5), (1, 4), (2, 7), (3, 6))
PLACE = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * 0.18
SPIN = np.array([1, -1, 1, -1, 1, -1, 1, -1.0])


def flight(rng, loss=None, cg=(0.0, 0.0), specimen=0.0, share=0.5):
    """A flight of four channels: rotors' loads wander, `loss` = (rotor, thrust, torque) is gone."""
    lift = 25.0 * (1 + 0.15 * rng.standard_normal((ROWS, N)))
    drag = 0.02 * lift * (1 + 0.05 * rng.standard_normal((ROWS, N)))
    thrust = np.zeros((ROWS, 4, N))
    thrust[:, 0], thrust[:, 1], thrust[:, 2] = -lift, -lift * PLACE[:, 1], lift * PLACE[:, 0]
    torque = np.zeros((ROWS, 4, N))
    torque[:, 3] = drag * SPIN
    total = lift.sum(1)
    centre = np.zeros((ROWS, 4, 2))
    centre[:, 1, 0], centre[:, 2, 1] = total, total
    noise = np.array([0.4, 0.03, 0.03, 0.02])
    gains = specimen * rng.standard_normal(N)
    y = thrust @ gains + centre @ np.array(cg) + noise * rng.standard_normal((ROWS, 4))
    if loss:
        rotor, of_thrust, of_torque = loss
        y = y - of_thrust * thrust[..., rotor] - of_torque * torque[..., rotor]
    alike = np.concatenate([thrust.sum(-1, keepdims=True), torque.sum(-1, keepdims=True)], axis=-1)

    def flat(columns):
        return (columns / noise[None, :, None]).reshape(-1, columns.shape[-1])

    return Flight(
        (y / noise).ravel(), flat(centre), flat(np.concatenate([alike, centre], axis=-1)), flat(thrust),
        flat(torque), np.array([5e-3, 5e-3]), np.array([0.1, 0.05, 3e-3, 3e-3]),
        ("lift_today", "torque_today", "cg_right_m", "cg_forward_m"), share, ROWS / 10.0, noise,
    )  # fmt: skip


def health(*flights):
    names = [f"flight {i}" for i in range(1, len(flights) + 1)]
    return judge(flights, names, list(range(1, N + 1)), PAIRS)


def test_sound_flights_are_sound():
    rng = np.random.default_rng(1)
    for _ in range(4):
        found = health(flight(rng, specimen=0.01), flight(rng, specimen=0.01))
        assert found.verdict == "sound" and found.probability < 0.02


@pytest.mark.parametrize("rotor", [0, 3, 6])
def test_a_rotor_that_lost_a_tenth_is_named_with_the_flight_and_the_size(rotor):
    rng = np.random.default_rng(2 + rotor)
    found = health(flight(rng), flight(rng), flight(rng, (rotor, 0.1, 0.07)))
    assert found.verdict == "ground it" and found.probability > 0.9
    first = found.suspects[0]
    assert (first.number, first.since) == (rotor + 1, "flight 3")
    assert first.loss.low < 0.1 < first.loss.high and first.loss.high - first.loss.low < 0.1
    share = found.flights[2].rotors[rotor].thrust
    assert share.low < 0.9 + 0.1 / 8 < share.high


def test_a_payload_that_moved_is_no_rotor():
    rng = np.random.default_rng(5)
    found = health(flight(rng), flight(rng, cg=(0.02, -0.015)))
    assert found.verdict == "sound"
    assert found.payload > 0.9


def test_probability_grows_with_the_loss_and_with_the_flights():
    chances = []
    for loss in (0.0, 0.05, 0.1):
        rng = np.random.default_rng(7)
        chances.append(health(flight(rng), flight(rng, (2, loss, 0.8 * loss))).probability)
    assert chances[0] < chances[1] < chances[2]
    rng = np.random.default_rng(8)
    alone = health(flight(rng))
    with_another = health(flight(rng), flight(rng))
    assert with_another.detects < alone.detects


def test_rows_that_go_together_count_less():
    rng = np.random.default_rng(9)
    state = rng.bit_generator.state
    widths = []
    for share in (1.0, 0.1):
        rng.bit_generator.state = state
        found = health(flight(rng, (1, 0.2, 0.1), share=share))
        widths.append(found.suspects[0].loss.high - found.suspects[0].loss.low)
    assert widths[1] > widths[0]
