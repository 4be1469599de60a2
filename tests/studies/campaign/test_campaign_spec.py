"""What a campaign file may say, and which flight each of its cells is."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from coaxlink.errors import InputError
from coaxlink.studies.campaign.cells import cell
from coaxlink.studies.campaign.spec import read_spec
from coaxlink.studies.campaign_cells import known_effects

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


def _spec(tmp_path, text=GOOD):
    path = tmp_path / "c.toml"
    path.write_text(text)
    return read_spec(path, known_effects())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("flights = 10\nmas_share = 1.0", "mas_share: unknown; mass_share?"),
        ("flights = 10\nlaws = ['best']", "laws: one of standard, curved, reduced"),
        ("flights = 'ten'", "flights: a whole number is expected, found 'ten'"),
        ("seed = 1", "flights: is missing"),
        ("flights = 1", "flights: 2 to 10000000 flights are expected, found 0"),
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
    ],
)  # fmt: skip
def test_bad_files_get_one_line_with_the_key(tmp_path, text, said) -> None:
    with pytest.raises(InputError) as error:
        _spec(tmp_path, text)
    assert said in str(error.value) and "\n" not in str(error.value)


def test_draws_fill_their_ranges_and_laws_share_them(tmp_path) -> None:
    spec = _spec(tmp_path)
    cells = [cell(spec, n) for n in range(spec.cells)]
    assert spec.cells == 4000 and [c.number for c in cells] == list(range(4000))
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


def test_one_more_quantity_moves_no_other(tmp_path) -> None:
    before, after = _spec(tmp_path), _spec(tmp_path, GOOD + "direction_deg = { low = 0, high = 360 }\n")
    for n in (0, 7, 3999):
        old, new = cell(before, n), cell(after, n)
        assert old.seed == new.seed and old.values.items() <= new.values.items()
    assert before.digest != after.digest


def test_a_grid_has_every_combination_so_often(tmp_path) -> None:
    text = "draw = 'grid'\nrepeats = 2\nlaws = ['fitted']\nmass_share = { low = 1, high = 2, steps = 3 }\n"
    spec = _spec(tmp_path, text + "plan = ['hover', 'circle']\n")
    cells = [cell(spec, n) for n in range(spec.cells)]
    counted = Counter((c.values["mass_share"], c.values["plan"]) for c in cells)
    assert counted == {(m, p): 2 for m in (1.0, 1.5, 2.0) for p in ("hover", "circle")}
    assert len({c.seed for c in cells}) == 12
