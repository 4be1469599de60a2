"""Every number of every effect: its unit, its bounds, what is believed of it, and why."""

import math

from case_table import case_table

from coaxlink.effects import effects

UNITS = {
    "N s/m",
    "N s2/m2",
    "s2/m2",
    "N^0.5 s/m",
    "kg/m",
    "kg/s",
    "1/min",
    "1",
    "s",
    "m",
    "N",
    "N m",
    "V",
    "kg",
    "kg/m3",
    "kg m2",
    "m/s",
    "s/m",
}
OF_A_CELL = {"N or N m", "N/min or N m/min"}  # of whichever load it drifts


def test_a_parameter_says_what_it_is_and_where_that_is_from():
    with case_table() as case:
        for effect in effects():
            for p in effect.parameters:
                with case(f"{effect.name}.{p.name}"):
                    _says_what_it_is(effect, p)


def _says_what_it_is(effect, p):
    assert p.unit in UNITS | OF_A_CELL
    assert math.isfinite(p.low) and math.isfinite(p.high) and p.low < p.high
    assert len(p.source.split()) >= 5
    if p.prior is None:
        assert p.source.startswith(
            ("wide: any value between the bounds; ", "a switch, 0 or 1: ", "a number of ")
        )
    else:
        mean, deviation = p.prior
        assert p.low <= mean <= p.high and 0.0 < deviation <= p.high - p.low
        assert not p.source.startswith(("wide", "a switch"))
    if p.source.startswith("a switch"):
        assert (p.low, p.high, p.unit) == (0.0, 1.0, "1")


def test_what_tracing_gives_and_mixers_need_are_parameters_in_the_same_units():
    with case_table() as case:
        for effect in effects():
            with case(effect.name):
                assert set(effect.required) <= set(effect.units)
                assert len(effect.units) == len(effect.parameters)
                assert effect.source and effect.physics
                assert effect.static or effect.no_static
                assert effect.is_live or effect.no_live or effect.surface is not None  # in the law
