"""A name is only a name: refused where it is read, and harmless where a vehicle sends it."""

import dataclasses
import json
from pathlib import Path

import pytest
from hostile_names import NAMES, REFUSED
from pymavlink.dialects.v20 import common as mavlink
from verb import run

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError
from coaxlink.monitor.incoming.heard import Heard
from coaxlink.monitor.screen.words import head, notes, summary
from coaxlink.monitor.state.moment import observe
from coaxlink.rotor import load_rotor_model
from coaxlink.vehicle import Vehicle
from firmware_params import ardupilot
from firmware_params.ardupilot import packed
from firmware_params.errors import TableError
from sim.errors import WorldError
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
each = pytest.mark.parametrize("name", NAMES.values(), ids=NAMES.keys())
each_refused = pytest.mark.parametrize("name", REFUSED.values(), ids=REFUSED.keys())


def quoted(name):
    """A TOML string that says exactly this (surrogates it cannot say)."""
    return json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007f")


def airframe_called(folder, name):
    text = (EXAMPLES / "x8_paper.toml").read_text()
    assert text.count('name = "paper-x8"') == 1
    (folder / "rotor_paper.toml").write_text((EXAMPLES / "rotor_paper.toml").read_text())
    (folder / "x.toml").write_text(
        text.replace('name = "paper-x8"', f"name = {quoted(name)}"), "utf-8", "replace"
    )
    return folder / "x.toml"


@each_refused
def test_an_airframe_of_that_name_is_refused(tmp_path, capsys, name):
    if "\ud800" in name:
        pytest.skip("no TOML file can hold half a surrogate pair")
    path = airframe_called(tmp_path, name)
    for verb in (
        ("bridge", path, "--out", tmp_path / "out"),
        ("table", path, "--firmware", "px4", "--out", tmp_path / "out"),
        ("table", path, "--firmware", "ardupilot", "--out", tmp_path / "out"),
    ):
        code, out, err = run(capsys, *verb)
        assert (code, out) == (2, "") and err.startswith(f"coaxlink: {path}: name: ")
        assert err.count("\n") == 1 and err.removesuffix("\n").isprintable() and len(err) < 500
    assert not (tmp_path / "out").exists()
    with pytest.raises(WorldError, match="name"):
        read_vehicle(path)


@pytest.mark.parametrize("name", [n for k, n in NAMES.items() if k not in REFUSED])
def test_an_odd_but_printable_name_is_kept_and_harmless(tmp_path, capsys, name):
    path = airframe_called(tmp_path, name)
    assert load_airframe(path).name == name == read_vehicle(path).name
    for firmware, suffix in (("px4", "params"), ("ardupilot", "param")):
        out = tmp_path / "out" / firmware
        code, said, err = run(
            capsys, "table", path, "--firmware", firmware, "--law", "standard", "--out", out
        )
        assert code == 0 and f"{name}: standard law" in said, err
        (made,) = out.glob(f"*.{suffix}")
        assert made.parent == out
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "rotor_paper.toml", "x.toml"]


def test_the_attack_of_the_issue(tmp_path, capsys):
    """A line of its own in the name wrote ARMING_CHECK on board."""
    path = airframe_called(tmp_path, "X8\nARMING_CHECK,0")
    code, _, err = run(capsys, "bridge", path, "--out", tmp_path / "b")
    assert code == 2 and "one line of printable text is expected, found 'X8\\nARMING_CHECK,0'" in err
    ardupilot.write_param_file(
        tmp_path / "b.param", {"SCR_ENABLE": 1.0}, ["coaxlink bridge of X8\nARMING_CHECK,0"]
    )
    assert ardupilot.read_param_file(tmp_path / "b.param").params == {"SCR_ENABLE": 1.0}


@each_refused
def test_no_text_of_a_rotor_file_is_like_that(tmp_path, name):
    if "\ud800" in name or len(name) > 1000:
        pytest.skip("half a surrogate pair is no TOML, and a long text is no name")
    text = (EXAMPLES / "rotor_paper.toml").read_text()
    path = tmp_path / "r.toml"
    path.write_text(f"{text}\n[identified]\nfile = {quoted(name)}\n", "utf-8")
    with pytest.raises(InputError, match=r"identified\.file: one line of printable text"):
        load_rotor_model(path)


@each
def test_a_packed_parameter_of_that_name_is_refused(name):
    raw = name.encode("utf-8", "surrogatepass")[:16]
    if not raw:
        pytest.skip("the format holds no empty name")
    entry = bytes([4, (len(raw) - 1) << 4]) + raw + b"\0\0\x80\x3f"
    data = packed.pack({"AHRS_EKF_TYPE": (3.0, ardupilot.parameters.INT8)})
    count = (2).to_bytes(2, "little")
    if raw.isalnum():
        assert set(packed.unpack(data[:2] + count + data[4:] + entry)) > {"AHRS_EKF_TYPE"}
        return
    with pytest.raises(TableError, match="no name of a parameter"):
        packed.unpack(data[:2] + count + data[4:] + entry)


@each
def test_the_monitor_shows_a_vehicle_that_speaks_like_that(name):
    frame = dataclasses.replace(load_airframe(files.example("x8_paper.toml")), name=name)
    model = load_rotor_model(frame.rotor_model)
    heard = Heard()
    heard.follow(1, 1)
    text = name.encode("utf-8", "surrogatepass")[:50]
    for message in (
        mavlink.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3),
        mavlink.MAVLink_statustext_message(2, text),
        mavlink.MAVLink_param_value_message(text[:16], 1.0, 9, 1, 0),
    ):
        message._header = mavlink.MAVLink_header(message.get_msgId(), srcSystem=1, srcComponent=1)
        heard.take(message)
    assert all(key.isidentifier() or key.isalnum() for key in heard.parameters)
    view = observe(heard, Vehicle(frame, model), address="udpin:0.0.0.0:14550")
    shown = [head(view, 120), notes(view), summary(view)]
    for words in shown:
        assert all(line.isprintable() for line in words.plain.split("\n"))
    assert json.dumps(view.to_json()).isascii()
