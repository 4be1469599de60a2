"""`import coaxlink as cx` as a script uses it: every name, every docstring's example, every examples/*.py."""

import doctest
import importlib
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from case_table import case_table

import coaxlink as cx
from coaxlink.files import example
from coaxlink.rotor.model import EffectEntry
from coaxlink.uploading.plan import load_plan
from sim.testing import standin

SCRIPTS = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
PACKAGE = Path(cx.__file__).parent
ROOMS = sorted(
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
    for path in PACKAGE.rglob("*.py")
    if ">>> " in path.read_text()
)


def test_every_name_is_there_and_says_what_it_is():
    for name in cx.__all__:
        if name != "__version__":
            assert (getattr(cx, name).__doc__ or "").strip(), name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = cx.nothing


def test_the_import_itself_is_light():
    code = "import sys, coaxlink; print([m for m in ('numpy', 'scipy', 'pymavlink') if m in sys.modules])"
    reported = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert reported.stdout.strip() == "[]"


@pytest.mark.slow
def test_answers_print_as_equations_and_numbers():
    rotors = cx.load_rotor_model(example("rotor_paper.toml"))
    assert repr(rotors) == "RotorModel(crm, 14 terms, u = 1 at 5400 rpm)"
    assert "upper thrust = 55.95 u_u^2 + 22.45 u_u N" in str(rotors)
    found = cx.identify(example("stand_eq17.csv"), "rcrm")
    assert len(str(found).splitlines()) == 10 and len(repr(found)) < 80
    answer = cx.refine(example("stand_eq17.csv"), rotors=example("rotor_paper.toml"))
    assert "nothing to mend" in str(answer) and len(repr(answer)) < 80
    assert found.model.score(example("stand_eq17.csv")) > 0.97


def test_a_table_a_law_and_an_allocation_show_themselves():
    vehicle = cx.load_vehicle(example("x8_paper.toml"))
    for firmware, thrust in (("px4", "thrust"), ("ardupilot", "throttle")):
        table = cx.make_table(vehicle, firmware, "standard")
        head, columns, *rows = str(table).splitlines()
        assert head == repr(table) and columns.split()[-1] == thrust
        assert [row.split()[0] for row in rows[:8]] == list("12345678")
        assert float(rows[4].split()[-1]) == pytest.approx(table.mix[thrust][4], abs=1e-4)
    for name in ("standard", "reduced", "coaxial", "exact"):
        law = cx.make_law(name, vehicle)
        assert "8 rotors" in repr(law) and len(repr(law)) < 80
    answer = cx.allocate(law, vehicle, [196.1, 0.0, 0.0, 0.5])
    assert "exact law, 8 rotors, 1894 W" in repr(answer)
    assert "yaw 0.5000 N m of 0.5000" in str(answer).splitlines()


def test_what_is_exchanged_or_no_number_is_told_in_words():
    vehicle = cx.load_vehicle(example("x8_paper.toml"))
    law = cx.make_law("reduced", vehicle)
    for wrong, reported in (
        (lambda: cx.Vehicle(vehicle.rotors, vehicle.declared), "in this order; found RotorModel"),
        (lambda: cx.allocate(law, vehicle, ["a", 0, 0, 0]), r"four finite numbers .* found \['a'"),
        (lambda: cx.allocate("exact", vehicle, [1, 0, 0, 0]), "a law is expected, as make_law makes it"),
        (lambda: cx.check_health(example("stand_eq17.csv"), vehicle), "a flight log is expected"),
        (lambda: cx.write_report([], "page.html"), "one log or two are expected, found 0"),
    ):
        with pytest.raises(cx.InputError, match=reported):
            wrong()


def test_a_path_does_where_a_vehicle_is_expected():
    path = example("x8_paper.toml")
    vehicle = cx.Vehicle(path, example("rotor_paper.toml"))
    law = cx.make_law("reduced", str(path))
    wrench = [196.1, 0.0, 0.0, 0.0]
    assert cx.allocate(law, path, wrench).power_W == cx.allocate(law, vehicle, wrench).power_W
    assert cx.make_table(path, law="reduced").parameters == cx.make_table(vehicle, law="reduced").parameters
    with pytest.raises(cx.InputError, match=r"none\.toml: cannot be read"):
        cx.make_law("reduced", "none.toml")


@pytest.mark.slow
def test_examples_of_docstrings():
    with case_table() as case:
        for room in ROOMS:
            with case(f"{room}"):
                assert doctest.testmod(importlib.import_module(room)).failed == 0


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_examples_run_without_a_warning(script, tmp_path):
    reported = subprocess.run(
        [sys.executable, "-W", "error", str(script)], capture_output=True, text=True, cwd=tmp_path
    )
    assert reported.returncode == 0, reported.stderr
    assert reported.stdout.strip() and not reported.stderr


@pytest.mark.parametrize(("firmware", "law"), [("px4", "reduced"), ("ardupilot", "standard")])
def test_a_table_without_a_disk_is_the_one_on_disk(firmware, law, tmp_path):
    vehicle = cx.load_vehicle(str(example("x8_paper.toml")))
    table = cx.make_table(vehicle, firmware, law)
    assert firmware in repr(table) and all(text.strip() for text in table.files.values())
    table.write(str(tmp_path))
    plan = load_plan(tmp_path)
    assert plan.firmware == firmware
    assert dict(plan.params) == pytest.approx(dict(table.parameters))
    hover = table.speeds(0.0, 0.0, 0.0, 0.4)
    assert hover.shape == (8,) and hover.min() > 0.0 and hover.max() < 1.0


@pytest.mark.slow
def test_connect_and_upload(tmp_path, monkeypatch):
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))
    vehicle = cx.load_vehicle(example("x8_paper.toml"))
    table = cx.make_table(vehicle, "px4", "standard")
    with standin("--firmware", "px4") as port, cx.connect(f"udpout:127.0.0.1:{port}") as session:
        assert cx.upload(session, table, backup_folder=tmp_path, dry_run=True).result == "dry_run"
        assert cx.upload(session, table, backup_folder=str(tmp_path)).result == "verified"
        again = cx.upload(session, table, backup_folder=tmp_path)
    assert again.result == "verified" and not again.changed


def test_errors_are_the_librarys_own_and_speak_no_option(tmp_path):
    vehicle = cx.load_vehicle(example("x8_paper.toml"))
    for wrong in (
        lambda: cx.read_log(tmp_path / "none.csv"),
        lambda: cx.make_law("magic", vehicle),
        lambda: cx.make_table(vehicle, "betaflight"),
        lambda: cx.make_table(vehicle, "px4", "exact"),
        lambda: cx.load_vehicle(tmp_path / "none.toml"),
        lambda: cx.Vehicle(
            vehicle.declared, replace(vehicle.rotors, effects=(EffectEntry("cg_offset", {}),))
        ),
    ):
        with pytest.raises(cx.CoaxlinkError) as caught:
            wrong()
        assert "--" not in str(caught.value)
