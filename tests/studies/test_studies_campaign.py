"""What a campaign file may say, which flight each cell is, and what rows say whose answer is known."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from coaxlink.errors import InputError
from coaxlink.report import campaign as report
from coaxlink.studies.campaign.flights import known_effects
from coaxlink.studies.campaign.spec import cell, read_spec
from coaxlink.studies.campaign.summary import FIGURES, mean_interval, summarise

GOOD = """
seed = 3
flights = 4000
laws = ["standard", "exact"]
airframe = ["x8_demo.toml", "y6.toml"]
mass_share = { low = 0.8, high = 1.25, log = true }
[effects.degraded_rotor]
chance = 0.25
size = { low = 0.1, high = 0.3 }
rotor = "any"
[effects.wind]
size = [0.0, 5.0]
law = ["dryden", "shear"]
"""
DRAWS = 300
BAD = (
    ("flights = 10\nmas_share = 1.0", "mas_share: unknown; mass_share?"),
    ("flights = 10\nlaws = ['best']", "laws: one of standard, curved, reduced"),
    ("flights = 'ten'", "flights: a whole number is expected, found 'ten'"),
    ("seed = 1", "flights: is missing"),
    ("flights = 1", "flights: 2 to 1000000 flights are expected, found 0"),
    ("flights = 10\nmass_share = { low = 2, high = 1 }", "mass_share: low <= high is expected"),
    ("flights = 10\nmass_share = { lo = 2, high = 1 }", "mass_share.lo: unknown; low?"),
    ("flights = 10\nmass_share = 'heavy'", "mass_share: a number from 0.2 to 5 is"),
    ("flights = 10\nmass_share = nan", "mass_share: a number from 0.2 to 5 is expected, found nan"),
    ("flights = 10\nairframe = 'none.toml'", "none.toml: no such shipped example"),
    ("flights = 10\nplan = ['loop']", "plan: one of hover, circle, wander, steps is expected"),
    ("flights = 10\n[effects.winds]\nsize = 1", "effects.winds: unknown; wind?"),
    ("flights = 10\n[effects.wind]\ngust_m_s = 1", "effects.wind.size: is missing: m/s"),
    ("flights = 10\n[effects.wind]\nsize = 1\nsped = 2", "effects.wind.sped: unknown; one of size"),
    ("flights = 10\n[effects.wind]\nsize = 1\nlaw = 'x'", "effects.wind.law: one of steady"),
    ("flights = 10\n[effects.battery_swap]\nsize = 1", "effects.battery_swap: unknown; battery_voltage?"),
    ("draw = 'grid'\nmass_share = { low = 1, high = 2 }", "mass_share: a range in a grid needs"),
    ("draw = 'maybe'\nflights = 10", "draw: random or grid is expected"),
    ("flights = = 10", "line 1"),
)


def spec_of(tmp_path, text=GOOD):
    path = tmp_path / "c.toml"
    path.write_text(text)
    return read_spec(path, known_effects())


def test_bad_files_get_one_line_with_the_key(tmp_path):
    wrong = []
    for text, reported in BAD:
        with pytest.raises(InputError) as error:
            spec_of(tmp_path, text)
        if reported not in str(error.value) or "\n" in str(error.value):
            wrong.append((reported, str(error.value)))
    assert not wrong


@pytest.mark.slow
def test_draws_fill_their_ranges_and_laws_share_them(tmp_path):
    spec = spec_of(tmp_path)
    cells = [cell(spec, n) for n in range(spec.cells)]
    assert spec.cells == 4000
    for one, other in zip(cells[::2], cells[1::2], strict=True):
        assert (one.law, other.law) == ("standard", "exact")
        assert one.values == other.values and one.seed == other.seed and one.draw == other.draw
    draws = cells[::2]
    assert len({c.seed for c in draws}) == len(draws)
    mass = np.array([c.values["mass_share"] for c in draws])
    assert 0.8 <= mass.min() < 0.81 and 1.23 < mass.max() <= 1.25
    assert abs(np.median(np.log(mass))) < 0.02  # evenly in the logarithm
    weak = np.array([c.values["effects.degraded_rotor.size"] for c in draws])
    assert 0.21 < np.mean(weak > 0.0) < 0.29 and weak[weak > 0].min() >= 0.1  # 0.25 +- 4 standard deviations
    assert set(Counter(c.values["airframe"] for c in draws)) == {"x8_demo.toml", "y6.toml"}
    more = spec_of(tmp_path, GOOD + "direction_deg = { low = 0, high = 360 }\n")
    for n in (0, 7, 3999):  # one more quantity moves no other
        assert cells[n].seed == cell(more, n).seed and cells[n].values.items() <= cell(more, n).values.items()
    assert spec.digest != more.digest


def test_a_grid_has_every_combination_so_often(tmp_path):
    text = "draw = 'grid'\nrepeats = 2\nlaws = ['fitted']\nmass_share = { low = 1, high = 2, steps = 3 }\n"
    spec = spec_of(tmp_path, text + "plan = ['hover', 'circle']\n")
    cells = [cell(spec, n) for n in range(spec.cells)]
    counted = Counter((c.values["mass_share"], c.values["plan"]) for c in cells)
    assert counted == {(m, p): 2 for m in (1.0, 1.5, 2.0) for p in ("hover", "circle")}
    assert len({c.seed for c in cells}) == 12


@pytest.fixture
def spec(tmp_path):
    text = f"flights = {2 * DRAWS}\nlaws = ['standard', 'fitted']\nplan = ['hover', 'steps']\n"
    more = "mass_share = {low = 0.8, high = 1.2}\nlag_s = {low = 0.0, high = 0.1}\n"
    return spec_of(tmp_path, text + more)


def made_columns():
    """Fitted is 0.1 below standard on every draw but for noise; height follows mass."""
    random = np.random.default_rng(8)
    rows = 2 * DRAWS
    law = np.array(["standard", "fitted"] * DRAWS, dtype=object)
    mass, lag = (np.repeat(random.uniform(a, b, DRAWS), 2) for a, b in ((0.8, 1.2), (0.0, 0.1)))
    plan = np.repeat(random.choice(["hover", "steps"], DRAWS), 2).astype(object)
    shared = np.repeat(random.normal(0.0, 1.0, DRAWS), 2)
    empty = np.full(rows, "", dtype=object)
    found = {
        "cell": np.arange(rows), "draw": np.repeat(np.arange(DRAWS), 2), "law": law, "plan": plan,
        "mass_share": mass, "lag_s": lag, "failsafe": empty, "problem": empty.copy(),
    }  # fmt: skip
    for name in FIGURES:
        found[name] = 5.0 + shared + random.normal(0.0, 0.05, rows) - 0.1 * (law == "fitted")
    found["height_max_m"] = found["height_max_m"] + 20.0 * mass
    found["yaw_rms_deg"] = random.normal(0.0, 1.0, rows) + 4.0 * (plan == "steps")
    return found


def test_what_is_known_is_found(spec):
    columns = made_columns()
    columns["failsafe"][[6, 11]] = "attitude"  # a standard and a fitted flight, of two draws
    s = summarise(spec, columns, "coaxlink campaign c.toml --replay")
    pair = s.paired["fitted"]["tilt_rms_deg"]
    # draws differ by 1, laws by 0.1: only the pairs show it
    assert pair.ci[0] < -0.1 < pair.ci[1] < -0.08 and pair.p_value < 1e-20 and pair.better > 0.85
    assert s.figures["standard"]["tilt_rms_deg"].ci[1] > s.figures["fitted"]["tilt_rms_deg"].ci[0]
    assert s.counts["standard"].failsafe == {"attitude": 1} and s.counts["fitted"].flown == DRAWS
    worst = [w for w in s.worst if w.law == "standard"]
    assert worst[0].cell == 6 and worst[0].replay == "coaxlink campaign c.toml --replay 6"
    values = [w.value for w in worst[1:]]
    assert values == sorted(values, reverse=True)
    assert values[0] == max(v for n, v in enumerate(columns["height_max_m"]) if n % 2 == 0 and n != 6)
    with pytest.raises(InputError, match="judge: beauty: one of height_rms_m"):
        summarise(replace(spec, judge="beauty"), columns, "replay")


@pytest.mark.slow
def test_intervals_hold_the_mean_as_often_as_they_say():
    random, inside = np.random.default_rng(3), 0
    for k in range(200):
        low, high = mean_interval(random.exponential(1.0, 60), k)
        inside += low <= 1.0 <= high
    # 95 % less some for a skewed 60: Student's own covers 93.5 % there
    assert 0.87 * 200 < inside <= 0.995 * 200


@pytest.mark.slow
def test_the_page_is_one_file_answers_first_and_speaks_in_words(spec):
    columns = made_columns()
    columns["problem"][4] = "<script>alert(1)</script>"
    s = summarise(spec, columns, "replay")
    page = report.page(s, columns)
    assert "<script" not in page and 'src="http' not in page and page.count("data:image/png;base64,") == 2
    assert json.loads(json.dumps(s.to_json(), allow_nan=False))["laws"]["fitted"]["flown"] == DRAWS
    first = re.search(r'<p class="lead">(.*?)</p>', page)[1]
    energy = s.paired["fitted"]["energy_Wh"]
    assert energy.ci[1] < 0.0 and f"energy {100 * energy.share:+.2g} %" in first and "Worse: " in first
    text = re.sub(r'"data:[^"]*"|<style>.*?</style>', "", page, flags=re.DOTALL)
    assert not [name for name in FIGURES if name in text and name != "saturated"]
    assert "energy, Wh" in text and "How this page was made" in text
