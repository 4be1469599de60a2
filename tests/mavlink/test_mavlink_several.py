"""Several vehicles on one line: none is chosen in silence, whatever brings them there."""

from contextlib import contextmanager

import pytest
from case_table import case_table
from memory_net import Line, Net, plugged
from px4_board import params_text, x8
from pymavlink.dialects.v20 import common as m
from scripted_autopilot import ScriptedAutopilot
from verb import run

from coaxlink.errors import SafetyRefusal
from coaxlink.mavlink import connect
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.worker import Uploader

OTHERS = (  # heartbeats that make nobody a second vehicle: a ground station, a companion, a gimbal, an ADS-B
    (255, m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID),
    (2, m.MAV_TYPE_ONBOARD_CONTROLLER, m.MAV_AUTOPILOT_INVALID),
    (3, m.MAV_TYPE_GIMBAL, m.MAV_AUTOPILOT_GENERIC),
    (4, m.MAV_TYPE_ADSB, m.MAV_AUTOPILOT_INVALID),
)


class Hub:
    """A router or a radio: what its vehicles say comes from one address, what is said there goes to all."""

    def __init__(self, net, *vehicles):
        self.net, self.address, self._line = net, net.address(), None
        self._vehicles = [v.address for v in vehicles]
        net.bind(self.address, self._hear)
        for vehicle in vehicles:
            vehicle._peer = self.address

    def _hear(self, data, source):
        if source in self._vehicles:
            if self._line:
                self.net.send(data, self.address, self._line)
            return
        self._line = source
        for vehicle in self._vehicles:
            self.net.send(data, self.address, vehicle)


class _Stream(Line):
    """The same line as a stream: nothing says who sent what."""

    def read(self, timeout_s):
        return super().read(timeout_s)[0], None


@contextmanager
def _two(kind):
    """(net, URL, options of `connect`, vehicles 1 and 2) where both are heard."""
    net = Net()
    listens = net.address()
    towards = listens if kind == "listening" else None
    with (
        ScriptedAutopilot(x8(), net=net, system=1, uid=0xC0A1, towards=towards) as first,
        ScriptedAutopilot(x8(), net=net, system=2, uid=0xC0A2, towards=towards) as second,
    ):
        hub = Hub(net, first, second) if kind != "listening" else None
        if hub is None:
            yield net, f"udpin:{listens[0]}:{listens[1]}", lambda: Line(net, address=listens), first, second
        else:
            line = _Stream if kind == "stream" else Line
            url = f"udpout:{hub.address[0]}:{hub.address[1]}"
            yield net, url, lambda: line(net, hub.address), first, second


def test_where_two_are_heard_none_is_chosen_and_the_named_one_is_talked_to():
    with case_table() as case:
        for kind in ("listening", "routed", "stream"):
            with case(kind), _two(kind) as (net, url, line, *_):
                with pytest.raises(SafetyRefusal, match=r"system 1 \(PX4.*, system 2 \(PX4.*`target_system`"):
                    connect(url, transport=line(), clock=net.clock)
                for wanted in (1, 2):
                    with connect(url, transport=line(), clock=net.clock, target_system=wanted) as session:
                        session.clock.sleep(1.5)
                        assert session.identity.uid == f"{0xC0A0 + wanted:016x}"
                        (other,) = session.autopilots.beside(wanted)
                        assert other.startswith(f"system {3 - wanted} (PX4")


def test_what_is_no_autopilot_is_no_second_vehicle():
    net = Net()
    with ScriptedAutopilot(x8(), net=net) as board:
        line = Line(net, board.address)
        for system, kind, autopilot in OTHERS:
            packer = m.MAVLink(None, system, 1)
            for n in range(30):
                beat = m.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3).pack(packer)
                net.clock.later(0.1 * n, lambda beat=beat: net.send(beat, board.address, line.address))
        with connect(board.url, transport=line, clock=net.clock) as session:
            session.refuse_several(3.0)


def test_one_that_comes_before_the_first_write_stops_the_upload(tmp_path):
    """Two seconds after the session began a second vehicle is switched on."""
    (tmp_path / "px4.params").write_text(params_text())
    net = Net()
    listens = net.address()
    with ScriptedAutopilot(x8(), net=net, towards=listens) as first:
        line = Line(net, address=listens)
        with connect(f"udpin:{listens[0]}:{listens[1]}", transport=line, clock=net.clock) as session:
            session.clock.sleep(2.0)
            with ScriptedAutopilot(x8(), net=net, system=7, uid=0xC0A2, towards=listens) as late:
                outcome = Uploader(session, backup_folder=tmp_path).upload(load_plan(tmp_path / "px4.params"))
            assert outcome.result == "refused" and outcome.error.exit_code == 4
            assert "system 1 (PX4" in outcome.reason and "system 7 (PX4" in outcome.reason
            assert first.sets == [] and late.sets == []


@pytest.mark.slow
def test_every_verb_that_connects_asks_which_and_says_whom_it_talks_to(tmp_path, monkeypatch, capsys):
    from coaxlink.files import example

    monkeypatch.chdir(tmp_path)
    (tmp_path / "t").mkdir()
    (tmp_path / "t/x8.params").write_text(params_text())
    x8_file = str(example("x8_paper.toml"))
    verbs = {
        "upload": ("t", "--dry-run"),
        "verify": ("t",),
        "motors": (x8_file,),
        "mix": (x8_file, "--seconds", "0.2", "--dry-run"),
        "fly": ("--dry-run",),
        "bridge": (x8_file, "--firmware", "px4", "--out", "b"),
        "init": ("new.toml", "--timeout", "5"),
        "airframe": (x8_file,),
        "compare": (x8_file,),
        "table": (x8_file, "--firmware", "px4", "--law", "standard"),
    }
    with case_table() as case:
        for verb, arguments in verbs.items():
            with case(verb), _two("listening") as (net, url, _, first, second), plugged(net):
                code, _, err = run(capsys, verb, *arguments, "--connect", url)
                assert code == 4 and "system 1 (PX4" in err and "system 2 (PX4" in err
                assert "--system" in err.splitlines()[-1]
                if verb in ("upload", "verify", "bridge", "airframe"):
                    _, _, err = run(capsys, verb, *arguments, "--connect", url, "--system", 2)
                    assert "system 2: PX4 1.16.1 at" in err and "not talked to: system 1 (PX4" in err
                assert first.sets == second.sets == []
