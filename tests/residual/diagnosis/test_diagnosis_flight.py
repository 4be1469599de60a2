"""Flights by the stands' search: what noise is, which sets are one, and what is no name."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from coaxlink.effects import effect
from coaxlink.evidence.blocks import Block
from coaxlink.evidence.noise import autocorrelation_time, white
from coaxlink.residual.diagnosis import posterior as posteriors
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.decide import (
    FLIGHTS,
    alone,
    at_bound,
    calibration,
    flown_evidence,
    flown_open_terms,
    flown_terms,
    needed,
    probability,
)
from coaxlink.residual.diagnosis.flight_forms import Left
from coaxlink.residual.diagnosis.flight_search import left_by_all
from coaxlink.residual.diagnosis.hypotheses import Scorer, key_of
from coaxlink.residual.members import Member

ROWS, SIZE = 800, 100.0


def channels(target, slow):
    """One channel of a load of 100, a level that is open, and one candidate."""
    frame = SimpleNamespace(predicted=np.zeros((ROWS, 1)), free_nuisance=False)
    candidate = SimpleNamespace(name="slow", sudden=False)
    one = np.ones((ROWS, 1, 1))
    return Channels(
        frame=frame, bare=frame, known=(), names=("load",), units=("N",), reference=np.array([SIZE]),
        target=target[:, None], block=np.arange(ROWS) // 20, least_noise=np.array([1e-3]), variables={},
        speeds={}, weights=np.full((ROWS, 1), SIZE), nuisance=(Block("level", one, np.array([1.0])),),
        surface=(), forms={}, effects=(), reduce=lambda columns: columns,
        grid=[(candidate, {}, slow[:, None, None])],
    )  # fmt: skip


def test_what_a_candidate_explains_is_no_noise_though_it_is_in_no_set_yet():
    random = np.random.default_rng(2)
    slow = np.sin(np.arange(ROWS) / 60.0)
    ch = channels(3.0 * slow + random.normal(0.0, 0.5, ROWS), slow)
    empty = Scorer(ch, white(1)).empty
    assert autocorrelation_time(empty.left, ch.block)[0] > 10.0
    assert left_by_all(ch, empty)[0] == pytest.approx(1.0, abs=0.3)


def left_beside_nothing(target, **variables):
    """Free forms of a flight whose one channel follows these variables (rows,)."""
    ch = replace(channels(target, np.ones(ROWS)), variables=variables)
    return Left(SimpleNamespace(channels=ch), Scorer(ch, white(1)).empty)


def test_what_follows_the_heading_is_found_through_many_turns_and_by_its_size():
    random, yaw = np.random.default_rng(3), np.arange(ROWS) / 17.0
    noise = random.normal(0.0, 0.5, ROWS)
    (found,) = left_beside_nothing(noise + 2.0 * np.cos(3.0 * yaw), yaw_rad=yaw).forms
    assert found.log_evidence > 20.0 and found.shown.names == {"yaw_rad|load"}
    assert np.std(found.shown.left) == pytest.approx(0.5, rel=0.05)
    assert all(f.log_evidence < 5.0 for f in left_beside_nothing(noise, yaw_rad=yaw).forms)
    small = 0.05 * noise + 0.15 * np.cos(3.0 * yaw)  # clear, and 0.1 % of the load
    assert left_beside_nothing(small, yaw_rad=yaw).forms == ()


def test_a_gust_is_no_path_in_time_but_what_goes_with_a_velocity_is_told():
    random = np.random.default_rng(5)
    gust = np.convolve(random.normal(0.0, 1.0, ROWS + 79), np.ones(80) / 9.0, "valid")
    time = np.arange(ROWS) / 10.0
    bump = 4.0 * np.exp(-((np.sin(time) / 0.2) ** 2))
    noise = random.normal(0.0, 0.5, ROWS)
    assert all(f.log_evidence < 10.0 for f in left_beside_nothing(gust + noise, time_s=time).forms)
    (found,) = left_beside_nothing(bump + noise, time_s=time, vel_x_body_m_s=np.sin(time)).forms
    assert found.log_evidence > 20.0 and found.shown.names == {"vel_x_body_m_s|load"}


def band_passed(times, size, random):
    """A height that passes a band so many times, 40 rows in all, and a load with a bump there; of a gusty
    day's noise."""
    height, most = random.uniform(0.3, 1.0, ROWS), 40 // times
    for k in range(times):
        at = int((k + 0.5) * ROWS / times)
        height[at : at + most] = np.linspace(0.0, 0.2, most)
    return height, size * np.exp(-((height / 0.12) ** 2)) + random.normal(0.0, 2.0, ROWS)


@pytest.mark.parametrize(("times", "size", "count"), [(2, 5.0, 0), (20, 5.0, 1), (2, 12.0, 1)])
def test_what_does_not_come_again_is_a_gust_unless_it_is_overwhelming(times, size, count):
    height, load = band_passed(times, size, np.random.default_rng(4))
    left = left_beside_nothing(load, height_m=height)
    assert [f.shown.names for f in left.forms] == [{"height_m|load"}] * count
    name = next(n for n in left.channels.forms if n.startswith("height_m"))
    assert left._form(left._about(name), "load").log_evidence > 12.0  # enough for all three


def strains_of(moment):
    """Of a flight with a constant moment, whose four rotors may each differ by 0.15 % of their thrust."""
    arms = (300.0, -300.0, 280.0, -280.0)  # N m of a whole thrust
    shares = tuple(
        Block(f"rotor{k}_thrust_share", np.full((ROWS, 1, 1), arm), np.array([0.0015]))
        for k, arm in enumerate(arms, start=1)
    )
    noise = np.random.default_rng(7).normal(0.0, 0.5, ROWS)
    ch = replace(channels(moment + noise, np.ones(ROWS)), nuisance=shares)
    empty = Scorer(ch, white(1)).empty
    return Left(SimpleNamespace(channels=ch), empty).strains(empty)


def test_rotors_that_differ_as_their_kind_does_are_strained_as_seldom_as_chance_has_it():
    drawn = np.random.default_rng(8).normal(0.0, 0.0015, (400, 4)) @ [300.0, -300.0, 280.0, -280.0]
    often = sum(any(s.log_evidence > 0.0 for s in strains_of(moment)) for moment in drawn)
    assert 0 < often < 12  # one in fifty of two kinds, of which one is there: four


def test_a_constant_moment_that_no_rotor_would_make_by_itself_strains_all_of_them():
    (found,) = strains_of(5.0)  # of a spread of 0.87
    assert found.log_evidence > 12.0 and found.channel == "load" and found.motor in ("motor1", "motor2")
    assert abs(found.share) < 4.0 * found.believed  # each is believable
    assert found.size == pytest.approx(0.05, rel=0.05)
    assert strains_of(0.1) == ()  # 0.1 % of the load is no pilot's concern


def test_one_name_at_two_rotors_is_two_sets():
    weak = effect("degraded_rotor").flight
    third, fourth = (Member(weak, {"rotor": r, "thrust_loss": 1.0}, np.array([0.1]), ()) for r in (3.0, 4.0))
    assert key_of([third], ()) != key_of([fourth], ())


def test_a_number_where_physics_ends_is_no_estimate(monkeypatch):
    monkeypatch.setattr("coaxlink.residual.diagnosis.decide._is_idle", lambda *_: False)
    lag = effect("rotor_lag").flight
    frame = SimpleNamespace(airframe=SimpleNamespace(motor_lag_s=0.02))
    low, high = lag.free(frame, {"share": 1.0, "lag_s": 0.1})["lag_s"]
    for lag_s, ends in ((low, True), (high, True), (0.5 * (low + high), False)):
        member = Member(lag, {"share": 1.0, "lag_s": lag_s}, np.ones(1), ("lag_s",))
        assert at_bound(SimpleNamespace(bare=frame), member) == ends


def test_a_flights_name_is_judged_by_the_terms_that_were_trained_and_more_nats_raise_it():
    level = calibration(FLIGHTS)["level"]["name"]
    lone = [{"tempered": log_evidence, "members": 1.0} for log_evidence in (2.0, flown_evidence(), 400.0)]
    reported = [probability("name", flown_terms(numbers), FLIGHTS) for numbers in lone]
    assert set(flown_terms(lone[0])) == set(calibration(FLIGHTS)["name"]["weights"])
    assert reported == sorted(reported) and reported[0] < level and reported[1] == pytest.approx(level)
    beside = probability("name", flown_terms({"tempered": 400.0, "members": 3.0}), FLIGHTS)
    assert level < beside < reported[2]  # what else it took speaks against a name


def test_more_evidence_makes_more_than_is_said_likelier_and_names_make_it_less_likely():
    beside_nothing = [alone("form", log_evidence) for log_evidence in (0.0, 8.0, 40.0, 1000.0)]
    terms = flown_open_terms({"form": 40.0}, ("wind",))
    assert set(terms) == set(calibration(FLIGHTS)["open"]["weights"])
    assert beside_nothing == sorted(beside_nothing)
    assert beside_nothing[1] < calibration(FLIGHTS)["level"]["open"] < beside_nothing[2]
    assert probability("open", terms, FLIGHTS) < beside_nothing[2]
    assert alone("lag", 40.0) < beside_nothing[2]  # loops that answer gusts feign one


def test_a_bend_of_nothing_is_no_end_of_physics():
    wave = np.sin(np.arange(50.0))
    bare = SimpleNamespace(predicted=np.zeros(50))

    def acting(frame, p):
        return SimpleNamespace(
            predicted=frame.predicted + p["size"] * wave / (1.0 + p["bend"] * np.abs(wave))
        )

    def plain(frame, p):
        return acting(frame, {"bend": 0.0, **p})

    def of(effect, bend):
        numbers = {"size": 2.0, "bend": bend}
        free = lambda *_: {"bend": (0.0, 1.0)}  # noqa: E731
        drawn = SimpleNamespace(name="x", stage=0, acting=effect, free=free)
        return SimpleNamespace(name="x", effect=drawn, shape={"bend": bend}, parameters=lambda _: numbers)

    ch = SimpleNamespace(bare=bare)
    assert not at_bound(ch, of(plain, 0.0))  # the form without it
    assert at_bound(ch, of(plain, 1.0))  # it does something there
    assert at_bound(ch, of(acting, 0.0))  # no form is without it


def test_of_sets_that_beat_one_another_in_a_circle_the_one_of_most_evidence_leads(monkeypatch):
    def of(name, score):
        fit = SimpleNamespace(log_evidence=score)
        return SimpleNamespace(names=frozenset(name), score=score, fit=fit, log_prior=0.0)

    sets = {"a": of("a", 30.0), "b": of("b", 20.0), "c": of("c", 10.0)}
    # nats of the first over the second, as their own pair is tempered: a over b over c over a
    ahead = {("a", "b"): 1.0, ("b", "c"): 1.0, ("c", "a"): 1.0}

    def temper(ch, colour, best, rival):
        one, two = (next(iter(h.names)) for h in (best, rival))
        if one == two:
            return 1.0
        log_evidence = ahead.get((one, two), -ahead.get((two, one), 0.0))
        return log_evidence / (best.score - rival.score)

    monkeypatch.setattr(posteriors, "temper", temper)
    found = posteriors.posterior(None, None, list(sets.values()), whole=True)
    assert found.best is sets["a"]


def test_what_explains_nothing_does_not_lead_beside_a_name():
    behind = {("drag", "wind"): 0.0, ("drag",): 2.0, ("wind",): 50.0, (): 90.0}
    sets = {names: SimpleNamespace(effects=frozenset(names)) for names in behind}
    log_evidence = {id(h): behind[names] for names, h in sets.items()}
    found = SimpleNamespace(sets=tuple(sets.values()), evidence_behind=lambda h: log_evidence[id(h)])
    assert needed(found, sets["drag", "wind"]) is sets["drag",]
    log_evidence[id(sets["drag",])] = 6.0  # more than a rival's odds
    assert needed(found, sets["drag", "wind"]) is sets["drag", "wind"]
