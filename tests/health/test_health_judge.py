"""The judgement over flights, on linear worlds made here: what is drawn must be found, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from case_table import case_table
from scipy.signal import butter, sosfiltfilt

from coaxlink.evidence.blocks import Block
from coaxlink.health.columns import Flight, passing_events
from coaxlink.health.evidence import Further, gained, together
from coaxlink.health.hypotheses import compared
from coaxlink.health.judge import judge

N, ROWS = 8, 400
TIMES = 100.0 + np.arange(ROWS) / 10.0
PAIRS = ((0, 5), (1, 4), (2, 7), (3, 6))
PLACE = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * 0.18
SPIN = np.array([1, -1, 1, -1, 1, -1, 1, -1.0])


SLOWED = -np.eye(N)  # thrust of rows where columns turn slower
SLOWED[[low for _, low in PAIRS], [up for up, _ in PAIRS]] = 0.4


def slower(thrust, torque):
    """(rows, 4, N) of motors that turn slower: own loads gone, the rotor below gets better air."""
    out = -thrust - torque
    for upper, lower in PAIRS:
        out[..., upper] += 0.4 * thrust[..., lower]
    return out


def flight(rng, loss=None, cg=(0.0, 0.0), specimen=0.0, share=0.5, time_profile=1.0, weak=None):
    """A flight of four channels: rotors' loads wander, `loss` = (rotor, thrust, torque) is gone.

    `time profile` (rows, 1): how much of the loss, of `weak` = (rotor, lost speed as thrust) and of `cg` is
    there.
    """
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
    y = thrust @ gains + time_profile * (centre @ np.array(cg)) + noise * rng.standard_normal((ROWS, 4))
    if loss:
        rotor, of_thrust, of_torque = loss
        y = y - time_profile * (of_thrust * thrust[..., rotor] + of_torque * torque[..., rotor])
    slow = slower(thrust, torque)
    if weak:
        y = y + time_profile * weak[1] * slow[..., weak[0]]
    push = np.zeros((ROWS, 4, 1))
    push[:, 3] = total[:, None] * 0.25

    def block(name, columns, sd):
        return Block(name, columns, np.full(columns.shape[-1], sd))

    return Flight(
        target=y,
        lasting=(block("centre", centre, 5e-3), block("thrust", thrust, 0.02), block("torque", torque, 0.03)),
        passing=(
            block("lift_today", thrust.sum(-1, keepdims=True), 0.1),
            block("torque_today", torque.sum(-1, keepdims=True), 0.05),
            block("cg_right_m", centre[..., :1], 3e-3),
            block("cg_forward_m", centre[..., 1:], 3e-3),
        ),
        yaw_push=block("yaw_push", push, 0.05),
        loads=np.stack([-thrust, -torque, slow], axis=-1),
        slowed=np.stack([SLOWED, -np.eye(N)]),
        time_s=TIMES,
        cutoff_hz=4.0,
        least=1e-6 * noise,
        noise=noise,
        together=1.0 / share,
    )


def health(*flights, **how):
    names = [f"flight {i}" for i in range(1, len(flights) + 1)]
    return judge(flights, names, list(range(1, N + 1)), PAIRS, **how)


@pytest.mark.slow
@pytest.mark.parametrize("rotor", [0, 5])
def test_a_rotor_that_was_changed_between_flights_is_sound_again_and_no_other_one_is_weak(rotor):
    rng = np.random.default_rng(40 + rotor)
    weak = [flight(rng, specimen=0.01, loss=(rotor, 0.2, 0.15)) for _ in range(2)]
    sound = [flight(rng, specimen=0.01) for _ in range(2)]
    for flights, back in (((weak[0], sound[0]), 2), ((sound[0], *weak, sound[1]), 4)):
        found = health(*flights)
        assert found.verdict == "sound"
        (mended,) = found.mended
        assert mended.rotor == rotor + 1 and mended.until == f"flight {back}"
        assert mended.loss.low < 0.2 < mended.loss.high
    found = health(sound[0], *weak)
    assert found.verdict == "ground it" and found.suspects[0].rotor == rotor + 1 and not found.mended


@pytest.mark.slow
def test_sound_flights_are_sound():
    rng = np.random.default_rng(1)
    for _ in range(4):
        found = health(flight(rng, specimen=0.01), flight(rng, specimen=0.01))
        assert found.verdict == "sound" and found.probability < 0.02


@pytest.mark.slow
def test_a_rotor_that_lost_a_tenth_is_named_with_the_flight_and_the_size():
    with case_table() as case:
        for rotor in (0, 3, 6):
            with case(f"{rotor}"):
                rng = np.random.default_rng(2 + rotor)
                found = health(flight(rng), flight(rng), flight(rng, (rotor, 0.1, 0.07)))
                assert found.verdict == "ground it" and found.probability > 0.9
                first = found.suspects[0]
                assert (first.rotor, first.since) == (rotor + 1, "flight 3")
                assert first.loss.low < 0.1 < first.loss.high and first.loss.high - first.loss.low < 0.1
                share = found.flights[2].rotors[rotor].thrust
                assert share.low < 0.9 < share.high


@pytest.mark.slow
def test_the_tables_interval_holds_a_loss_that_is_not_told_from_none():
    """One flight alone: nothing is called, and the rotor's share is within its interval all the same."""
    for seed in range(12):
        rng = np.random.default_rng(60 + seed)
        rotor = seed % N
        found = health(flight(rng, (rotor, 0.08, 0.07), cg=(0.004, -0.003), share=0.004))
        assert found.verdict == "sound"
        for k, rotor_health in enumerate(found.flights[0].rotors):
            true = 1.0 - 0.08 * (k == rotor)
            assert rotor_health.thrust.low < true < rotor_health.thrust.high, (seed, k)


def test_the_share_of_a_motor_that_turns_slower_is_its_own_and_its_pairs():
    """It takes less of its own air from the rotor below: no blade's loss is the half of it."""
    for upper, lower in PAIRS[:2]:
        rng = np.random.default_rng(70 + upper)
        late = (TIMES - TIMES[0] > 20.0)[:, None].astype(float)
        found = health(flight(rng, time_profile=late, weak=(upper, 0.15)))
        assert found.suspects[0].rotor == upper + 1
        shares = [r.thrust for r in found.flights[0].rotors]
        common = 0.4 * 0.15 / (N - 1)  # of the others, and the rotor below is one of them
        assert shares[upper].low < 0.85 - common < shares[upper].high < 0.95
        assert shares[lower].low < 1.0 + 0.4 * 0.15 - common < shares[lower].high


def test_a_payload_that_moved_is_no_rotor():
    rng = np.random.default_rng(5)
    found = health(flight(rng), flight(rng, cg=(0.02, -0.015)))
    assert found.verdict == "sound"
    assert found.payload > 0.9


@pytest.mark.slow
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


def since(start_s, over_s=0.0):
    """(rows, 1) of what sets in so many seconds into the flight, low-passed at 4 Hz as a frame's rows are."""
    fine = np.arange(ROWS * 50) / 500.0
    raw = np.clip((fine - start_s) / max(over_s, 1e-9), 0.0, 1.0)
    smooth = sosfiltfilt(butter(2, 4.0, fs=500.0, output="sos"), raw)
    return np.interp(TIMES - TIMES[0], fine, smooth)[:, None]


@pytest.mark.slow
def test_a_loss_within_a_flight_is_named_with_its_time():
    with case_table() as case:
        for rotor, torque in ((1, 0.85), (4, 0.85), (2, -0.8), (7, -0.8)):
            with case(f"{rotor}, {torque}"):
                rng = np.random.default_rng(20 + rotor)
                found = health(flight(rng, (rotor, 0.12, 0.12 * torque), time_profile=since(23.4)))
                first = found.suspects[0]
                assert found.verdict == "ground it" and first.rotor == rotor + 1
                assert first.onset_s.low <= 123.4 <= first.onset_s.high < first.onset_s.low + 1.5
                assert first.loss.low < 0.12 < first.loss.high
                assert not first.gradual
                assert first.kind == ("a blade that lost a part" if torque > 0 else "a rough blade")
                for r in found.flights[0].rotors:  # at its end
                    truth = 1.0 - 0.12 * (r.rotor == rotor + 1)
                    assert abs(r.thrust.value - truth) < r.thrust.high - r.thrust.value + 0.005, r
                assert (
                    "rotor" in found.as_json()["suspects"][0]
                    and found.as_json()["suspects"][0]["onset_s"][0] > 123
                )


@pytest.mark.slow
def test_a_loss_that_comes_gradually_is_told_from_one_at_once():
    rng = np.random.default_rng(30)
    found = health(flight(rng), flight(rng, (3, 0.15, 0.12), time_profile=since(12.0, 18.0)))
    first = found.suspects[0]
    assert first.rotor == 4 and first.gradual and first.since == "flight 2"
    assert first.onset_s.low < 112.0 < first.onset_s.high


@pytest.mark.parametrize("rotor", [0, 5])
def test_a_motor_that_turns_slower_is_told_from_a_blade(rotor):
    rng = np.random.default_rng(40 + rotor)
    first = health(flight(rng, weak=(rotor, 0.15), time_profile=since(15.0))).suspects[0]
    assert first.rotor == rotor + 1 and first.kind == "a motor that turns slower"
    assert first.loss.low < 0.15 < first.loss.high


@pytest.mark.slow
def test_what_was_there_from_the_start_has_no_time():
    rng = np.random.default_rng(50)
    first = health(flight(rng), flight(rng, (2, 0.15, 0.12))).suspects[0]
    assert first.onset_s is None and not first.gradual


def test_a_load_that_slides_is_no_rotor():
    rng = np.random.default_rng(60)
    flown = flight(rng, cg=(0.02, 0.01), time_profile=since(20.0))
    found = health(flown)
    assert found.verdict == "sound" and found.payload > 0.9 and found.slid > 0.9
    for load in (getattr(r, name) for r in found.flights[0].rotors for name in ("thrust", "torque")):
        assert load.low < 1.0 < load.high
    assert health(flown, slides=False).slid == 0.0


def test_what_is_over_within_a_second_is_no_rotor():
    rng = np.random.default_rng(70)
    time = np.arange(600) / 10.0
    rest = rng.standard_normal((600, 4))
    rest[300:304] += 20.0
    found = time[passing_events(rest, time)]
    assert 29.6 <= found.min() < 30.0 and 30.3 < found.max() <= 30.8
    assert not passing_events(rng.standard_normal((600, 4)), time).any()
    rest[::5] += 20.0  # that many are no events
    assert not passing_events(rest, time).any()


def test_noise_is_what_the_likeliest_hypothesis_leaves():
    own = flight(np.random.default_rng(80), (2, 0.2, 0.15))
    before = replace(own, noise=own.noise * [1.0, 1.0, 1.0, 1 / 3])
    (found,) = compared([before]).flights
    assert found.noise == pytest.approx(own.noise, rel=0.15)


def test_what_columns_gain_beside_flights_is_what_the_evidence_grows_by():
    """Of a column in one flight, and of one that two have in common from some moment on."""
    rng = np.random.default_rng(90)
    flights = [flight(rng, share=1.0), flight(rng, (2, 0.1, 0.08), share=1.0)]
    drawn, sd = together(flights, {}), np.array([0.2, 0.2])
    profiles = [np.ones((1, ROWS)), since(20.0).T]
    loads = [f.loads[:, :, 2:3, :2] for f in flights]
    reported = [
        Further(f, x, w).beside(drawn, k)
        for k, (f, x, w) in enumerate(zip(flights, loads, profiles, strict=True))
    ]
    blocks = [[Block("loss", x[:, :, 0] * w.T[:, None], sd)] for x, w in zip(loads, profiles, strict=True)]
    for found, grown in (
        (reported[1], together(flights, {1: blocks[1]})),
        (reported[0] + reported[1], together(flights, {}, blocks)),
    ):
        more = grown.fit.log_evidence - drawn.fit.log_evidence
        assert gained(found, sd)[0, 0] == pytest.approx(more, rel=1e-6)
