"""The real PX4 with the module of `bridge` (PX4_MODULE_SITL names its binary), alone and with a companion.

Real time, in the real-time class. The companion is the verb, behind a line that a test may spoil. Every test
prints what it measured: `pytest -s`.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from losing_world import Loss
from module_air import HERE, LAW, Air, exact_split, flying, rms_m, split, tell
from pyulog import ULog
from real_autopilots import AIRFRAME, coaxlink, hover, px4, real_time, take_off
from test_real_px4 import factory

from coaxlink.fly.trajectory import Circle, Hold, Move
from coaxlink.live.module_end import REFUSALS
from coaxlink.mavlink import connect
from coaxlink.mavlink.session import Session
from coaxlink.studies.simulator import free_port

BINARY = os.environ.get("PX4_MODULE_SITL", "")
pytestmark = [
    pytest.mark.skipif(not BINARY, reason="PX4_MODULE_SITL names no binary with the module"),
    pytest.mark.timeout(900),
]
THERE, RIM = (1.0, 0.0, -3.0), (2.0, 0.0, -3.0)
TIMEOUT_S, GRAIN_S = 0.020, 0.012  # COAX_TIMEOUT; the demand's period, twice, and the world's


@pytest.fixture(scope="module")
def air(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Air]:
    with flying(Path(BINARY), tmp_path_factory.mktemp("module"), SDLOG_PROFILE=17) as air:
        yield air


def test_the_module_flies_alone(air: Air) -> None:
    flown = air.fly(
        Hold("hover", HERE, 8.0), Hold("step", THERE, 5.0), Hold("back", HERE, 5.0),
        Hold("yaw", HERE, 5.0, np.pi / 2), Hold("yaw back", HERE, 5.0),
        Move("to the circle", HERE, RIM, 3.0), Circle("circle", 2.0, -3.0, 8.0, 2),
        Move("home", RIM, HERE, 3.0),
    )  # fmt: skip
    off = {str(name): flown["off"][flown["segment"] == name] for name in dict.fromkeys(flown["segment"])}
    height = {name: float(np.abs(rows[:, 2]).max()) for name, rows in off.items()}
    for name, rows in off.items():
        tell(f"{name}: {100 * rms_m(rows):.1f} cm rms, height {100 * height[name]:.1f} cm at most")
    assert rms_m(off["hover"]) < 0.15 and rms_m(off["circle"]) < 0.5
    assert max(height.values()) < 0.4 and rms_m(off["step"][-50:]) < 0.2
    assert not flown["share"][:, 1].any()
    still = air.fly(Hold("hover", HERE, 5.0))
    assert still["split"] == pytest.approx(exact_split(), rel=0.02)


FAULTS = (  # and what the module counts
    ("killed", ""), ("stopped", ""), ("line dead", ""), ("late", "stale"), ("not a number", "invalid"),
    ("a lie", "implausible"),
)  # fmt: skip


@pytest.mark.parametrize("law", ["reduced", "exact"])
@pytest.mark.parametrize(("fault", "counted"), FAULTS)
def test_a_faulty_companion_is_out_within_its_time(air: Air, fault: str, counted: str, law: str) -> None:
    with air.mix(law) as process:
        began: list[float] = []

        def spoil(segment: str, t: float) -> None:
            if segment != "spoilt" or began:
                return
            began.append(air.session.latest("DEBUG_FLOAT_ARRAY").time_usec / 1e6)
            if fault in ("killed", "stopped"):
                process.send_signal(signal.SIGKILL if fault == "killed" else signal.SIGSTOP)
            elif fault == "late":
                air.line.late_s = 0.030
            else:
                air.line.fault = fault

        before = air.fly(Hold("driven", HERE, 3.0))
        flown = air.fly(Hold("driven", HERE, 1.0), Hold("spoilt", HERE, 2.0), watch=spoil)
        air.line.late_s, air.line.fault = 0.0, ""
        if fault == "stopped":
            process.send_signal(signal.SIGCONT)
        again = air.fly(Hold("after", HERE, 3.0)) if fault != "killed" else None
    share, since = flown["share"], began[0]
    own = share[(share[:, 0] > since) & (share[:, 1] == 0.0), 0]
    after = flown["segment"] == "spoilt"
    lost = flown["down"][after] - flown["down"][~after][-1]
    sideways = np.linalg.norm(flown["off"][after][:, :2], axis=1).max()
    grown = {k: int(flown["facts"][n] - before["facts"][n]) for n, k in enumerate(REFUSALS)}
    driven = again is not None and again["share"][-1, 1] == 1.0
    tell(
        f"{law}, {fault}: own law after {1e3 * (own[0] - since):.0f} ms, "
        f"height lost {100 * lost.max():.0f} cm, gained {-100 * lost.min():.0f} cm, "
        f"sideways {100 * sideways:.0f} cm, refused {grown}, {driven=}"
    )
    assert own[0] - since < TIMEOUT_S + GRAIN_S
    assert np.abs(lost).max() < (0.3 if law == "reduced" else 0.1)
    assert [k for k in REFUSALS if grown[k]] == [counted] * bool(counted)
    assert driven == (fault != "killed")


def test_a_second_companion_drives_nothing(air: Air) -> None:
    own, theirs = free_port(), free_port()
    air.link(own, theirs)
    with air.mix():
        before = air.fly(Hold("driven", HERE, 3.0))
        second = air.start_mix(theirs, "reduced", "second")
        flown = air.fly(Hold("two of them", HERE, 10.0))
        code, reported = second.wait(30.0), (air.folder / "second.log").read_text()
    grown = {k: int(flown["facts"][n] - before["facts"][n]) for n, k in enumerate(REFUSALS)}
    moved = np.abs(flown["down"] - flown["down"][0]).max()
    tell(
        f"a second companion: exit {code}, refused {grown}, height {100 * moved:.0f} cm; it said: {reported}"
    )
    assert code == 4 and "another companion" in reported
    assert flown["share"][:, 1].min() == 1.0


def test_back_to_px4s_own_allocator_and_to_the_module_again(air: Air) -> None:
    with pytest.raises(AssertionError, match="armed"):
        air.board.shell("coax_mixer", "stop")
    air.vehicle.land()
    air.board.shell("coax_mixer", "stop")
    air.board.shell("control_allocator", "start")
    assert settled_split(air) == pytest.approx(1.0, abs=0.03)
    air.vehicle.land()
    air.board.start_module(LAW.hover)
    assert settled_split(air) == pytest.approx(exact_split(), rel=0.02)
    air.vehicle.land()


def test_what_is_not_delivered_holds_the_integrators(air: Air) -> None:
    """Half a turn at once asks for more yaw than there is: PX4's integrator may not wind up meanwhile."""
    air.vehicle = take_off(air.session)
    air.fly(Hold("settle", HERE, 6.0), Hold("turn", HERE, 5.0, np.pi), Hold("back", HERE, 5.0))
    air.vehicle.land()
    newest = max((air.folder / "px4").glob("log/*/*.ulg"), key=lambda file: file.stat().st_mtime)
    log = ULog(str(newest), ["control_allocator_status", "rate_ctrl_status"])
    status, rates = (log.get_dataset(name).data for name in ("control_allocator_status", "rate_ctrl_status"))
    left, at, grown = status["unallocated_torque[2]"], status["timestamp"], []
    for a, b, u, v in zip(at, at[1:], left, left[1:], strict=False):
        within = (rates["timestamp"] >= a) & (rates["timestamp"] <= b)
        if u * v > 0 and within.sum() > 1:
            integral = np.sign(u) * rates["yawspeed_integ"][within]
            grown.append(float((integral - integral[0]).max()))
    tell(
        f"yaw not delivered: {np.abs(left).max():.2f} at most, {len(grown)} spans; integrator "
        f"{np.abs(rates['yawspeed_integ']).max():.3f} at most, in these spans by {max(grown):.4f}"
    )
    assert len(grown) >= 2 and max(grown) < 1e-3


def settled_split(air: Air) -> float:
    """Of a hover after a take-off."""
    air.vehicle = take_off(air.session)
    air.fly(Hold("settle", HERE, 6.0))
    return float(air.fly(Hold("hover", HERE, 5.0))["split"])


def test_the_cards_file_starts_it_and_without_it_px4s_own_allocator_flies(tmp_path: Path) -> None:
    """`bridge --connect`, the file, a reboot; then `--back` and a reboot."""
    verb = ("bridge", str(AIRFRAME), "--firmware", "px4")
    (tmp_path / "px4" / "fs" / "microsd").mkdir(parents=True)
    card = tmp_path / "px4" / "fs" / "microsd" / "etc" / "extras.txt"
    world = ("--airframe", str(AIRFRAME), "--speed", "1")
    with real_time(), px4(Path(BINARY), tmp_path / "px4", *world) as board:
        with board.boot(factory(tmp_path / "standard"), cut=True) as url:
            coaxlink(*verb, "--out", str(tmp_path / "module"), "--connect", url)
        with board.boot(cut=True) as url, connect(url, timeout_s=90.0) as session:
            board.extras()
            assert f"0x{LAW.identity:06x}" in board.shell("coax_mixer", "status")
            assert hovering_split(session) == pytest.approx(exact_split(), rel=0.02)
        with board.boot(cut=True) as url:
            coaxlink(*verb, "--connect", url, "--back")
            assert not card.exists()
        with board.boot(cut=True) as url, connect(url, timeout_s=90.0) as session:
            with pytest.raises(AssertionError, match="not running"):
                board.shell("coax_mixer", "status")
            assert "Running" in board.shell("control_allocator", "status")
            assert hovering_split(session) == pytest.approx(1.0, abs=0.03)
            board.shell("control_allocator", "stop")
            board.shell("param", "set", "COAX_EN", "0")
            with pytest.raises(AssertionError, match="COAX_EN is 0"):
                board.shell("coax_mixer", "start")
            board.shell("control_allocator", "start")


def hovering_split(session: Session) -> float:
    """Of one take-off, hover and landing."""
    return split(hover(session, take_off(session), 5.0))


def test_what_hangs_on_the_allocator_works_as_before(tmp_path: Path) -> None:
    """The actuator test, the hover estimate, a lost set-point, the motors' stop."""
    with flying(Path(BINARY), tmp_path, COM_OBL_RC_ACT=5) as air:  # hold
        for _ in range(3):
            air.fly(Hold("hover", HERE, 5.0))
        words = air.board.shell("listener", "hover_thrust_estimate").split()
        estimate = float(words[words.index("hover_thrust:") + 1])
        before = air.session.latest("LOCAL_POSITION_NED").z
        air.session.clock.sleep(5.0)  # no set-points: PX4 holds its place
        held = abs(air.session.latest("LOCAL_POSITION_NED").z - before)
        air.vehicle.land()
        with air.session.listen(("SERVO_OUTPUT_RAW",)) as heard:
            air.board.shell("actuator_test", "set", "-m", str(WEAK), "-v", "0.2", "-t", "2")
            air.session.clock.sleep(3.0)
            rows = []
            while (message := air.session.take(heard, 0.0)) is not None:
                rows.append([getattr(message, f"servo{n}_raw") for n in range(1, 9)])
        turned = np.array(rows).max(axis=0)
        take_off(air.session)
        air.board.shell("commander", "disarm", "-f")
        air.session.clock.sleep(0.5)
        stopped = air.session.wait("SERVO_OUTPUT_RAW", 2.0)
    tell(f"hover thrust {estimate:.3f}, as built {LAW.hover:.3f}; {100 * held:.0f} cm in Hold; test {turned}")
    assert estimate == pytest.approx(LAW.hover, abs=0.01) and held < 0.2
    assert [n + 1 for n in range(8) if turned[n] > turned.min() + 50] == [WEAK]
    assert max(getattr(stopped, f"servo{n}_raw") for n in range(1, 9)) <= 1000


DEAD, WEAK = 4, 3  # rotors


@pytest.mark.parametrize("flown_by", ["px4", "module", "companion"])
def test_a_rotor_dies_and_is_taken_out(tmp_path: Path, flown_by: str) -> None:
    """It stops in the plant; PX4's failure detector hears nothing of it any more (`failure motor off`)."""
    loss = Loss.by_word(DEAD, 1.0)
    cares = {"SYS_FAILURE_EN": 1, "CA_FAILURE_MODE": 1, "FD_ACT_EN": 1}
    with flying(Path(BINARY), tmp_path, loss=loss, module=flown_by != "px4", **cares) as air:
        board, session = air.board, air.session
        began: list[float] = []
        determined: list[subprocess.Popen[bytes]] = []

        def die(segment: str, t: float) -> None:
            if segment == "dead" and not began:
                began.append(session.latest("LOCAL_POSITION_NED").time_boot_ms / 1e3)
                loss.determined.set()
                command = [str(board.binary.parent / "px4-failure"), "--instance", str(board.instance)]
                determined.append(
                    subprocess.Popen([*command, "motor", "off", "-i", str(DEAD)], cwd=board.folder)
                )

        with air.mix() if flown_by == "companion" else nullcontext():
            flown = air.fly(Hold("sound", HERE, 3.0), Hold("dead", HERE, 8.0), watch=die)
        assert determined[0].wait(10.0) == 0
        air.vehicle.land()
    pulses, after = flown["pulses"], flown["segment"] == "dead"
    still = pulses[(pulses[:, 0] > began[0]) & (pulses[:, DEAD] <= 1000.0), 0]
    lost = flown["down"][after] - flown["down"][~after][-1]
    sideways = np.linalg.norm(flown["off"][after][:, :2], axis=1)
    late = flown["time"][after] > began[0] + 5.0
    tell(
        f"{flown_by}, rotor {DEAD} dies: stopped after {1e3 * (still[0] - began[0]):.0f} ms, "
        f"height lost {100 * lost.max():.0f} cm, sideways {100 * sideways.max():.0f} cm; from 5 s on "
        f"{100 * np.abs(lost[late]).max():.0f} and {100 * sideways[late].max():.0f} cm; {flown['facts']}"
    )
    assert np.abs(lost[late]).max() < 0.5 and sideways[late].max() < 0.5
    if flown_by == "companion":  # which goes on with eight rotors
        assert flown["share"][-1, 1] == 0.0 and flown["facts"][REFUSALS.index("implausible")] > 100


def test_mix_names_a_rotor_that_loses_a_tenth(tmp_path: Path) -> None:
    loss = Loss.by_word(WEAK, 0.1)
    with flying(Path(BINARY), tmp_path, loss=loss) as air:
        with air.mix("exact"):
            air.fly(Hold("sound", HERE, 20.0))
            since = air.session.latest("LOCAL_POSITION_NED").time_boot_ms / 1e3
            loss.determined.set()
            air.fly(Hold("weak", HERE, 8.0))
        air.vehicle.land()
    (call,) = json.loads((tmp_path / "mix.json").read_text())["health"]["calls"]
    tell(
        f"rotor {WEAK} loses 10 %: called rotor {call['rotor']} after {call['time_s'] - since:.1f} s, {call}"
    )
    assert call["rotor"] == WEAK and 0.0 < call["time_s"] - since < 3.0
    assert abs(call["loss"] - 0.1) < 3 * call["loss_sd"]
