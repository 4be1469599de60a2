"""What a vehicle file may have wrong is found, one mistake at a time; a sound one gives nothing."""

from dataclasses import replace

from case_table import case_table

from coaxlink.airframe import load_airframe
from coaxlink.files import example, examples
from coaxlink.rotor import load_rotor_model
from coaxlink.setup import Layout, Mount, check_against, check_airframe

X8 = load_airframe(example("x8_paper.toml"))
MODEL = load_rotor_model(example("rotor_paper.toml"))


def changed(number, **fields):
    """The paper's vehicle with one rotor changed."""
    rotors = tuple(replace(r, **fields) if r.number == number else r for r in X8.rotors)
    return replace(X8, rotors=rotors)


def scaled(factor):
    return replace(
        X8,
        rotors=tuple(replace(r, position_m=tuple(p * factor for p in r.position_m)) for r in X8.rotors),
    )


MISTAKES = (
    (scaled(1000.0), "airframe.units"),
    (scaled(0.0), "airframe.authority airframe.units airframe.pair-height"),
    (scaled(0.01), "airframe.units"),
    (replace(X8, mass_kg=20000.0), "airframe.mass"),
    (replace(X8, mass_kg=0.02), "airframe.mass"),
    (replace(X8, mass_kg=200.0), "airframe.mass"),
    (replace(X8, inertia_kg_m2=(0.92, 0.95, 16.0)), "airframe.inertia"),
    (replace(X8, inertia_kg_m2=(9.2e-5, 9.5e-5, 1.6e-4)), "airframe.inertia"),
    (changed(6, yaw_sign=1), "airframe.co-rotating airframe.spin-balance"),
    (changed(6, position_m=(0.1807, -0.1807, 0.075)), "airframe.pair-apart airframe.centre"),
    (changed(6, position_m=(0.1807, 0.1807, -0.2)), "airframe.pair-height"),
)


def test_each_mistake_is_found_and_no_other():
    with case_table() as case:
        for frame, expected in MISTAKES:
            with case(expected):
                ids = {f.id for f in check_airframe(frame, MODEL)}
                # a unit slip shows in the inertia too
                assert set(expected.split()) <= ids <= {*expected.split(), "airframe.inertia"}


def test_sound_vehicles_give_nothing_and_shipped_ones_no_error():
    for name in ("x8_paper.toml", "x8_demo.toml", "y6.toml", "coax_quad_plus.toml"):
        assert check_airframe(load_airframe(example(name)), MODEL) == (), name
    vehicles = [p for p in examples() if p.suffix == ".toml" and "[[rotors]]" in p.read_text()]
    assert len(vehicles) >= 5
    for path in vehicles:
        assert not [f for f in check_airframe(load_airframe(path), MODEL) if f.severity == "error"], path


def board_of(frame, **changes):
    mounts = tuple(
        replace(
            Mount(*r.position_m, "ccw" if r.yaw_sign > 0 else "cw", r.level),
            **changes.get(f"r{r.number}", {}),
        )
        for r in frame.rotors
    )
    return Layout("board", mounts, metres=True)


def test_a_board_with_the_same_rotors_or_one_of_another_kind():
    assert check_against(X8, board_of(X8)) == ()
    for change, reported in (
        ({"spin": "cw"}, "spin"),
        ({"x": -0.1807}, "front or rear"),
        ({"y": -0.1807}, "left or right"),
        ({"level": "lower"}, "level"),
    ):
        (finding,) = check_against(X8, board_of(X8, r1=change))
        assert finding.severity == "error"
        assert "rotor 1" in finding.text and reported in finding.text


def test_a_board_with_fewer_rotors_or_longer_arms():
    fewer = Layout("board", board_of(X8).mounts[:6], metres=True)
    assert [f.id for f in check_against(X8, fewer)] == ["airframe.count"]
    # 2: a diagonal for an arm; 1.15: a tape; longer ahead only: another vehicle
    for board, severity in ((scaled(2.0), "error"), (scaled(1.15), "warning"), (stretched(1.5), "error")):
        (finding,) = check_against(X8, board_of(board))
        assert (finding.id, finding.severity) == ("airframe.place", severity)
    assert check_against(X8, board_of(scaled(1.05))) == ()


def stretched(factor):
    """The paper's vehicle with its rotors further ahead and behind."""
    mounts = [(r, (factor * r.position_m[0], *r.position_m[1:])) for r in X8.rotors]
    return replace(X8, rotors=tuple(replace(r, position_m=position) for r, position in mounts))


def test_a_mass_in_another_unit_is_found_without_a_rotor_model():
    for mass in (5000.0, 1e300, 1e-4):
        # the inertia goes with it, as `init` estimates it: only the mass itself can tell
        inertia = tuple(value * mass / X8.mass_kg for value in X8.inertia_kg_m2)
        found = check_airframe(replace(X8, mass_kg=mass, inertia_kg_m2=inertia))
        assert [f.id for f in found if f.severity == "error"] == ["airframe.mass"]
        assert "kilograms" in found[0].text
