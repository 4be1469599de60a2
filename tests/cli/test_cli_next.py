"""The line after `refine`: it follows from the answer, whatever that is."""

from pathlib import Path
from types import SimpleNamespace

from case_table import case_table

from coaxlink.cli.shared.next import (
    after_compare,
    after_identify,
    after_refine,
    after_upload,
    after_verify,
    on_simulator,
    unanswered,
)
from coaxlink.effects import effects
from coaxlink.live.counts import Counters


def answer(*effects, **rest):
    parts = {"suspect_data": (), "ambiguous": (), "unexplained": (), "channels": {}, "more": 0.3}
    parts = parts | {"surface": ()} | rest
    return SimpleNamespace(effects=[SimpleNamespace(name=n) for n in effects], **parts)


def test_what_no_table_can_hold_is_said_with_what_can():
    line = after_refine(answer("rotor_drag"), None, True)
    assert "no table can hold rotor_drag" in line and "feed-forward" in line
    assert "coaxlink table" not in line


def test_what_a_table_can_hold_names_the_file_and_the_condition():
    line = after_refine(answer("battery_voltage"), Path("new.toml"), True)
    assert "coaxlink table AIRFRAME --rotor new.toml --voltage V" in line and "coaxlink mix" in line
    named = after_refine(answer("cg_offset"), Path("new.toml"), True, Path("mine.toml"))
    assert "coaxlink table mine.toml --rotor new.toml" in named
    assert "--out ROTOR.toml" in after_refine(answer("cg_offset"), None, True)


def test_a_weak_rotor_calls_for_a_screwdriver_not_for_a_table():
    line = after_refine(answer("degraded_rotor", "battery_voltage"), Path("new.toml"), True)
    assert line == "next: ground it, change its propeller or motor, fly the check again"


def test_other_answers():
    with case_table() as case:
        for found, reported in (
            (answer(), "nothing to mend"),
            (answer(more=None), "nothing to mend"),
            (answer(more=0.8), "a longer flight would show what may be there"),
            (answer(suspect_data=[SimpleNamespace(column="rpm3")]), "rpm3"),
            (
                answer(
                    ambiguous=[SimpleNamespace(names=("a", "b"), experiment=None, separate_by="warm motors")]
                ),
                "warm motors",
            ),
            (
                answer(ambiguous=[SimpleNamespace(names=("a", "b"), experiment=object(), separate_by="")]),
                "--plan PLAN.toml writes the run that separates a from b",
            ),
            (answer(unexplained=[SimpleNamespace(depends_on=("yaw_rad",))]), "yaw_rad"),
            (answer(unexplained=[SimpleNamespace(depends_on=("power_of_50_s",))]), "after a rest"),
            (answer(unexplained=[SimpleNamespace(depends_on=("time_s",))]), "record more of what acts"),
        ):
            with case(f"{found}, {reported}"):
                line = after_refine(found, None, True)
                assert reported in line and "\n" not in line


def test_what_is_left_above_the_noise_is_not_said_to_be_explained():
    left = {"torque_x": SimpleNamespace(rmse_after=0.02, rmse_as_given=0.03, noise_floor=0.001)}
    line = after_refine(answer(channels=left), None, True)
    assert line == "next: a flight in calm air would show what is in torque_x; no model was changed"
    assert "explains these data" in after_refine(answer(), None, True)


def test_what_a_smooth_surface_holds_is_not_said_to_be_the_models():
    line = after_refine(answer(surface=[object()]), None, False)
    assert "explains these data" not in line and "coaxlink identify LOG" in line


def test_every_effect_can_be_put_into_a_table_or_says_why_not():
    for e in effects():
        assert e.static or e.no_static, e.name
        assert e.live or e.live_speed or e.no_live or e.surface is not None, e.name


def test_demands_without_an_answer_are_told_with_their_reasons():
    counters = Counters(late=3, settling=2)
    reported = unanswered(counters.unanswered())
    assert "3 no newer than the one before" in reported and "2 while three good ones" in reported
    assert unanswered(Counters().unanswered()) == ""
    for reason in counters.unanswered():  # every reason there is has its words
        assert unanswered({reason: 1}).startswith("not answered: 1 ")


def test_lines_for_the_other_verbs_are_one_line_each():
    lines = [
        after_identify(None, "crm"),
        after_identify(Path("r.toml"), "crm"),
        after_compare(Path("x8.toml"), Path("r.toml")),
        after_upload(Path("t"), "udpin:0.0.0.0:14550"),
        after_verify(True, Path("t"), "udpin:0.0.0.0:14550"),
        after_verify(False, Path("t"), "udpin:0.0.0.0:14550"),
        on_simulator("px4:1.13", "udpin:127.0.0.1:14540"),
    ]
    assert all(line and "\n" not in line for line in lines)
    assert "--out" in lines[0] and "r.toml" in lines[1] and "x8.toml" in lines[2]
    assert "table x8.toml --rotor r.toml" in lines[2] and "upload t --connect" in lines[5]
    assert "rotor" not in after_compare(Path("x8.toml"), None)
    assert "restore" in lines[5] and "mix" in lines[6] and "mix" not in on_simulator("px4", "x")
