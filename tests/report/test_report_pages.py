"""What every report page must have: the answer first, stamped figures, cards on a phone, how it was made."""

import base64
import hashlib
import io
import re
import sys
from dataclasses import replace

import pytest
from rich.console import Console

from coaxlink.files import example
from coaxlink.report.html import PagePicture, PageTable, html_table, render
from coaxlink.report.made import Made
from coaxlink.report.page import chance, count, page, sentence
from coaxlink.report.refine import tables, verdict
from coaxlink.residual.result import (
    ChannelError,
    FoundEffect,
    ParameterValue,
    Refinement,
    Rejected,
    SmoothSurface,
    Step,
)

ERROR = ChannelError("N m", 0.0034, 0.647, 0.0034, (0.64, 0.65), (0.003, 0.004), 639, 0.66)
WEAK = FoundEffect(
    "degraded_rotor",
    ("torque_x",),
    (ParameterValue("rotor", 6.0, (6.0, 6.0), "1"),),
    {"torque_x": (0.647, 0.0034)},
    {},
    "a source",
)
FOUND = Refinement(
    "flight",
    {"torque_x": ERROR},
    (WEAK,),
    (),
    (),
    (),
    tuple(Rejected(name, "cannot be judged: never above 3 m") for name in "abcdef"),
    None,
    trace=(Step(1, "add", "degraded_rotor", 8648779.0, 0.0, 0.03, True, "kept"),),
    source="flight.csv",
)


@pytest.fixture
def made(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["/bin/coaxlink", "refine", "a flight.csv"])
    return Made.now([example("x8_paper.toml"), "/no/such/file"], "paper-x8")


def test_made_names_command_vehicle_file_and_its_hash(made):
    assert made.command == "coaxlink refine 'a flight.csv'"
    digest = hashlib.sha256(example("x8_paper.toml").read_bytes()).hexdigest()
    assert made.files == (("x8_paper.toml", digest),)
    assert re.fullmatch(
        r"paper-x8 · x8_paper\.toml · \d{4}-\d\d-\d\d \d\d:\d\d UTC · coaxlink \S+.*", made.line()
    )
    assert "numpy" in made.versions()


def test_the_answer_stands_first_and_every_number_can_be_read(made):
    shown = page(FOUND, made=made)
    first = re.search(r"<p[^>]*>(.*?)</p>", shown)[1]
    assert first.startswith("Found: degraded rotor (rotor 6); the error of the roll torque falls from 0.647")
    assert "8.65 million" in shown and "8648779" not in shown
    assert "below 1 in a million" in shown and "<td>0</td>" not in shown
    assert "roll torque" in shown and "torque_x" not in shown
    reported = shown[shown.index("<h2>Remarks") : shown.index("What was tried")]
    assert reported.count("never above 3 m") == 1 and "a, b, c, d, e, f: cannot be judged" in reported
    assert made.files[0][1] in shown and "http" not in shown


def test_the_sentence_has_a_unit_once_no_switch_and_no_part_larger_than_the_whole():
    inflow = replace(
        WEAK,
        name="axial_inflow",
        parameters=(
            ParameterValue("thrust_per_climb_N_s_m", 1.34, (1.33, 1.36), "N s/m"),
            ParameterValue("by_thrust", 1.0, (1.0, 1.0), "1"),
            ParameterValue("levelling_s_m", 0.0182, (0.016, 0.0216), "s/m"),
        ),
    )
    reported = sentence(replace(FOUND, effects=(inflow,)))
    assert "axial inflow (thrust per climb 1.34 N s/m, levelling 0.0182 s/m)" in reported
    assert "to 0.0034 N m (noise alone: 0.0034)" in reported


def test_what_was_chosen_has_no_interval_on_the_screen_and_a_share_no_unit():
    console = Console(width=80, record=True, file=io.StringIO())
    for table in tables(replace(FOUND, effects=(WEAK,))):
        console.print(table)
    row = next(line for line in console.export_text().splitlines() if line.startswith("degraded_rotor"))
    assert row.split() == ["degraded_rotor", "rotor", "6"]


def test_nothing_found_is_a_sentence_too():
    nothing = replace(FOUND, effects=(), trace=())
    assert sentence(nothing).startswith("Nothing to explain") and sentence(nothing).endswith(".")


def test_numbers_and_chances():
    assert [count(x) for x in (0.0123, 123.0, 45678.0, 8648779.0)] == [
        "0.0123",
        "123",
        "45,678",
        "8.65 million",
    ]
    assert [chance(p) for p in (0.0, 0.03)] == ["below 1 in a million", "0.03"]


def test_a_table_of_many_columns_is_cards_on_a_phone_and_one_of_few_is_not():
    wide = html_table(tuple("abcde"), [tuple("12345")])
    assert 'class="cards"' in wide and '<td data-label="c">3</td>' in wide
    assert "data-label" not in html_table(("a", "b"), [("1", "2")])


def test_a_picture_is_whole_in_its_page_however_large(made):
    png = bytes(range(256)) * 400
    page = PagePicture(png, "<c>")
    shown = render("compare.html", title="t", made=made, lead="", reported=(), picture=page,
                  worths=PageTable((), ()), terms="", laws=PageTable((), ()))  # fmt: skip
    (encoded,) = re.findall(r'src="data:image/png;base64,([^"]*)"', shown)
    assert base64.b64decode(encoded) == png and "<c>" not in shown


@pytest.mark.parametrize("found", [{}, {"surface": (SmoothSurface("upper_thrust", 0.1, 0.01, "N"),)}])
def test_that_nothing_is_found_says_how_probable_it_is_that_something_is_there(found):
    reported = Refinement("stand", {}, (), (), (), (), (), None, more=0.44, **found)
    assert verdict(reported).endswith("probability that something is there: 0.44")
    assert "probability" not in verdict(replace(reported, more=None))


def test_a_centre_of_mass_is_read_in_millimetres():
    place = ParameterValue("offset_x_m", 0.0123, (0.0113, 0.0133), "m")
    found = replace(FOUND, effects=(replace(WEAK, name="cg_offset", parameters=(place,)),))
    assert "cg offset (offset x 12.3 mm)" in sentence(found)
    assert ">offset_x_mm<" in page(found)


def test_an_error_that_small_corrections_would_take_is_told_as_it_came():
    taken = replace(ERROR, rmse_before=0.0265, ci_before=(0.0257, 0.0273))
    found = replace(FOUND, channels=dict.fromkeys(FOUND.channels, taken))
    assert "falls from 0.66 to 0.0034 N m (noise alone: 0.0034; 0.0265 with small" in verdict(found)
