"""A name is only a name: refused where it is read, and harmless where a vehicle sends it."""

import dataclasses
import json
from pathlib import Path

import pytest
from case_table import case_table
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
from firmware_params.reading import read_params
from sim.errors import SimulationError
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
MADE = ("emoji", "path", "Lua's long bracket", "rich markup")  # a table each; the writers have all of them
# half a surrogate pair is no TOML
REFUSED_TOML = {what: name for what, name in REFUSED.items() if "\ud800" not in name}


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


@pytest.mark.slow
def test_an_airframe_of_such_a_name_is_refused(tmp_path, capsys):
    with case_table() as case:
        for what, name in REFUSED_TOML.items():
            path = airframe_called(tmp_path, name)
            with case(what):
                code, out, err = run(capsys, "table", path, "--firmware", "px4", "--out", tmp_path / "out")
                assert (code, out) == (2, "") and err.startswith(f"coaxlink: {path}: name: ")
                assert err.count("\n") == 1 and err.removesuffix("\n").isprintable() and len(err) < 500
                with pytest.raises(SimulationError, match="name"):
                    read_vehicle(path)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_an_odd_but_printable_name_is_kept_and_harmless(tmp_path, capsys):
    with case_table() as case:
        for number, (what, name) in enumerate((k, n) for k, n in NAMES.items() if k not in REFUSED):
            folder = tmp_path / str(number)
            folder.mkdir()
            path, out = airframe_called(folder, name), folder / "out"
            with case(what):
                assert load_airframe(path).name == name == read_vehicle(path).name
                if what not in MADE:
                    continue
                arguments = ("--firmware", "px4", "--law", "standard", "--out", out)
                code, reported, err = run(capsys, "table", path, *arguments)
                assert code == 0 and f"{name}: standard law" in reported, err
                assert len(list(out.glob("*.params"))) == 1
                assert sorted(p.name for p in folder.iterdir()) == ["out", "rotor_paper.toml", "x.toml"]


def test_a_line_of_its_own_in_a_name_writes_no_parameter(tmp_path):
    header = ["coaxlink bridge of X8\nARMING_CHECK,0"]
    ardupilot.write_param_file(tmp_path / "b.param", {"SCR_ENABLE": 1.0}, header)
    assert read_params(tmp_path / "b.param").params == {"SCR_ENABLE": 1.0}


def test_no_text_of_a_rotor_file_is_like_that(tmp_path):
    text = (EXAMPLES / "rotor_paper.toml").read_text()
    path = tmp_path / "r.toml"
    with case_table() as case:
        for what, name in REFUSED_TOML.items():
            if len(name) > 1000:  # a long text is no name
                continue
            path.write_text(f"{text}\n[identified]\nfile = {quoted(name)}\n", "utf-8")
            with case(what), pytest.raises(InputError, match=r"identified\.file: one line of printable text"):
                load_rotor_model(path)


def test_a_packed_parameter_of_that_name_is_refused():
    data = packed.pack({"AHRS_EKF_TYPE": (3.0, ardupilot.parameters.INT8)})
    head = data[:2] + (2).to_bytes(2, "little") + data[4:]
    with case_table() as case:
        for what, name in NAMES.items():
            raw = name.encode("utf-8", "surrogatepass")[:16]
            entry = head + bytes([4, max(len(raw) - 1, 0) << 4]) + raw + b"\0\0\x80\x3f"
            with case(what):
                if raw.isalnum():
                    assert set(packed.unpack(entry)) > {"AHRS_EKF_TYPE"}
                elif raw:  # the format holds no empty name
                    with pytest.raises(TableError, match="no name of a parameter"):
                        packed.unpack(entry)


def test_the_monitor_shows_a_vehicle_that_speaks_like_that():
    paper = load_airframe(files.example("x8_paper.toml"))
    model = load_rotor_model(paper.rotor_model)
    with case_table() as case:
        for what, name in NAMES.items():
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
            vehicle = Vehicle(dataclasses.replace(paper, name=name), model)
            view = observe(heard, vehicle, address="udpin:0.0.0.0:14550")
            with case(what):
                assert all(key.isidentifier() or key.isalnum() for key in heard.parameters)
                for words in (head(view, 120), notes(view), summary(view)):
                    assert all(line.isprintable() for line in words.plain.split("\n"))
                assert json.dumps(view.to_json()).isascii()
