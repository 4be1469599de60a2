"""The companion at the PX4 module in the stand-in: flown, silenced, late, lying, rivalled."""

from __future__ import annotations

import itertools
import re
import struct
from collections.abc import Iterator
from dataclasses import replace
from importlib import resources
from typing import Any

import numpy as np
import pytest
from live_flight import CRM, EXAMPLES, X8, Companion, Flight
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.cli.mix import _line
from coaxlink.cli.sim import coax_firmware
from coaxlink.errors import CheckFailed, SafetyRefusal
from coaxlink.live import onboard
from coaxlink.live.mixer import LiveMixer
from coaxlink.live.onboard import card
from coaxlink.live.onboard.description import board_law
from coaxlink.live.onboard.px4 import module_files
from coaxlink.vehicle import Vehicle, load_vehicle

VEHICLE = Vehicle(X8, CRM)
EXTRAS = module_files(board_law(VEHICLE), "tests")["etc/extras.txt"].encode()
OUT_S, GRAIN_S = 0.020, 0.012  # COAX_TIMEOUT; ticks of the world and of the loop
slow = pytest.mark.slow


class ModuleFlight(Flight):
    firmware = "px4:1.16"
    extras = EXTRAS

    def prepare(self) -> None:
        a = self.autopilot
        a.firmware_module = coax_firmware(VEHICLE)
        a.store.write("MPC_THR_HOVER", 9, board_law(VEHICLE).hover)
        a.files.files["etc/extras.txt"] = self.extras
        a.boot()


@pytest.fixture(scope="module")
def in_the_air() -> ModuleFlight:
    return ModuleFlight()


@pytest.fixture
def flight(in_the_air: ModuleFlight) -> Iterator[ModuleFlight]:
    in_the_air.rows.clear()
    yield in_the_air
    for companion in list(in_the_air.companions.values()):
        companion.close()
    in_the_air.companions.clear()
    in_the_air.stays_up(2.0)


def refused(flight: Flight) -> dict[str, int]:
    names = ("foreign", "rival", "invalid", "stale", "implausible")
    return dict(zip(names, flight.autopilot.module.refused, strict=True))


def flown(flight: ModuleFlight) -> tuple[Companion, LiveMixer]:
    """A companion in the loop, with the reduced law: another split than the module's own."""
    companion = Companion(flight)
    live = companion.mix("reduced")
    companion.until_live(live)
    return companion, live


@slow
def test_the_companion_flies_px4_and_every_answer_is_counted(flight: ModuleFlight) -> None:
    own = np.array(flight.autopilot.command)
    _, live = flown(flight)
    flight.fly(1.5)
    assert all(row.driven for row in flight.rows) and live.error is None
    assert np.array(flight.autopilot.command) == pytest.approx(np.array(live.core.sent), abs=0.03)
    assert np.abs(own - flight.autopilot.command).max() > 0.03  # another split
    reported = live.summary()
    assert reported["arrival"]["by"] == "bridge" and reported["arrival"]["share"] < 0.01
    assert reported["board"]["taken"] > 350 and sum(refused(flight).values()) == 0


@slow
@pytest.mark.parametrize(
    ("fault", "counted"),
    [("dead", ""), ("late", "stale"), ("nan", "invalid"), ("above one", "invalid"), ("lie", "implausible"),
     ("another vehicle's", "foreign")],
)  # fmt: skip
def test_a_faulty_companion_is_out_within_its_time(flight: ModuleFlight, fault: str, counted: str) -> None:
    companion, _ = flown(flight)
    before, since = refused(flight), flight.clock.now
    spoil(companion, fault)
    flight.fly(0.5)
    handed = flight.own_since(since)
    assert handed is not None and handed < OUT_S + GRAIN_S
    grown = {name for name, count in refused(flight).items() if count > before[name]}
    assert grown == ({counted} if counted else set())
    assert flight.outputs_are_sound()


@slow
def test_the_least_time_out_bears_a_lost_demand(flight: ModuleFlight) -> None:
    companion, _ = flown(flight)
    text = (resources.files(onboard) / "px4_module" / "module.yaml").read_text()
    least_ms = int(re.findall(r"min: (\d+)", text)[0])
    module, sent = flight.autopilot.module, itertools.count()
    built = module.built
    try:
        module.built = replace(built, timeout_s=least_ms / 1e3)
        companion.line.late_s = 0.002
        companion.line.steal = lambda data: next(sent) % 10 == 0
        flight.fly(0.5)
        before = module.handed_back
        flight.fly(1.0)
    finally:
        module.built = built
    assert next(sent) > 300 and module.handed_back == before and module.share == 1.0


def spoil(companion: Companion, fault: str) -> None:
    """From now on, what the companion says."""
    if fault == "dead":
        companion.line.dead = True
    elif fault == "late":
        companion.line.late_s = 0.030
    else:
        companion.line.steal = lambda data: spoiled(companion, data, fault)


def spoiled(companion: Companion, data: bytes, fault: str) -> bool:
    """Send another TUNNEL in the place of this one."""
    if data[0] != 0xFD or data[7:10] != (385).to_bytes(3, "little"):
        return False
    packer, flight = mavlink.MAVLink(None, 245, 191), companion.flight
    message = mavlink.MAVLink(None).parse_buffer(data)[0]
    body = bytearray(message.payload[: message.payload_length])
    value = {"nan": float("nan"), "above one": 1.5, "lie": 1.0}.get(fault)
    if value is None:
        body[0] ^= 1
    else:
        body[16:] = struct.pack("<8f", *[value] * 8)
    payload = list(body) + [0] * (128 - len(body))
    packer.seq = message.get_seq()
    spoilt = mavlink.MAVLink_tunnel_message(1, 1, message.payload_type, len(body), payload).pack(packer)
    number = next(n for n, (_, who) in enumerate(flight.peers[0]) if who is companion)
    flight.ports[0].put(number, bytes(spoilt))
    return True


@slow
def test_who_turns_a_motor_that_the_board_took_out_is_not_flown_and_says_so(flight: ModuleFlight) -> None:
    _, live = flown(flight)
    module, before = flight.autopilot.module, refused(flight)
    module.stopped, since = 1 << 3, flight.clock.now
    flight.fly(0.2)
    handed = flight.own_since(since)
    module.stopped = 0
    assert handed is not None and handed < OUT_S + GRAIN_S
    assert refused(flight)["implausible"] > before["implausible"] and live.error is None
    assert live.summary()["board"]["failed_motors"] == 8 and "motor 4 failed" in _line(live.summary())


@slow
def test_a_second_companion_drives_nothing_and_lets_go_at_once(flight: ModuleFlight) -> None:
    _, live = flown(flight)
    late = Companion(flight, component=192).mix("reduced")
    flight.fly(0.5)
    assert isinstance(late.error, SafetyRefusal) and "system 245 component 191" in str(late.error)
    assert late.core.counters.cycles == 0 and live.error is None and all(row.driven for row in flight.rows)


@slow
def test_without_the_module_px4_is_refused_and_the_module_is_named() -> None:
    class Plain(ModuleFlight):
        extras = b""

    with pytest.raises(SafetyRefusal, match="px4_module"):
        Companion(Plain(airborne=False)).mix()


@slow
def test_another_vehicles_module_is_refused() -> None:
    y6 = load_vehicle(EXAMPLES / "y6.toml")
    with pytest.raises(SafetyRefusal, match="another vehicle"):
        Companion(ModuleFlight(airborne=False)).mix(vehicle=y6)


@slow
def test_extras_on_the_card_start_the_module_and_its_removal_brings_px4s_own_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Plain(ModuleFlight):
        extras = b""

    ground = Plain(airborne=False)
    session = Companion(ground).session
    for starts in (True, False):
        if starts:
            card.put_extras(session, EXTRAS.decode())
        else:
            assert card.remove_extras(session)
        reboot: Any = mavlink.MAVLink_command_long_message(1, 1, 246, 0, 1, 0, 0, 0, 0, 0, 0)
        session.send(reboot)
        ground.fly(2.0)
        assert (ground.autopilot.module is not None) is starts
    ground.autopilot.files.files["etc/extras.txt"] = b"somebody's own"
    with pytest.raises(SafetyRefusal, match="not coaxlink's"):
        card.put_extras(session, EXTRAS.decode())
    ground.autopilot.files.files.pop("etc/extras.txt")
    monkeypatch.setattr(card, "CARD", "/no/card")
    with pytest.raises(CheckFailed, match="no SD card on board"):
        card.put_extras(session, EXTRAS.decode())
