"""The real ArduCopter mixed live through the Lua bridge: driven, not shared with a second, handed back."""

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from real_autopilots import AIRFRAME, PAIRS, ROOT, arducopter, coaxlink, real_time, take_off
from test_real_ardupilot import FACTORY

from coaxlink.airframe import load_airframe
from coaxlink.live.mixer import LiveMixer
from coaxlink.mavlink import connect
from coaxlink.mavlink.session import Session
from coaxlink.rotor import load_rotor_model
from coaxlink.studies.simulator import free_port
from coaxlink.vehicle import Vehicle

BINARY = os.environ.get("ARDUCOPTER_SITL", "")
pytestmark = [
    pytest.mark.skipif(not BINARY, reason="ARDUCOPTER_SITL names no binary"),
    pytest.mark.timeout(1800),
]
X8 = load_airframe(AIRFRAME)
CRM = load_rotor_model(ROOT / "examples" / "rotor_paper.toml")


def pair_split(session: Session, seconds: float) -> float:
    """Lower over upper pulse above 1000 us, mean of the pairs over so many seconds (wall)."""
    assert session.request_stream(36, 20.0)
    end, rows = time.monotonic() + seconds, []
    while time.monotonic() < end:
        message = session.wait(["SERVO_OUTPUT_RAW"], 2.0)
        rows.append([getattr(message, f"servo{n}_raw") - 1000.0 for n in range(1, 9)])
    pulses = np.mean(rows, axis=0)
    return float(np.mean([pulses[low] / pulses[up] for up, low in PAIRS]))


def mixer(session: Session) -> LiveMixer:
    return LiveMixer(session, Vehicle(X8, CRM), "exact")


def beside(url: str, component: int) -> str:
    """What a second companion comes to, which answers nothing."""
    with (
        connect(url, timeout_s=60.0, source_component=component) as session,
        mixer(session) as second,
    ):
        assert second.failed.wait(3.0)
        assert second.summary()["cycles"] < 20
        return f"{second.summary()['cycles']} cycles, {second.error}"


def test_it_is_mixed_live_by_one_companion_and_handed_back(tmp_path: Path) -> None:
    folder, files, port = tmp_path / "ap", tmp_path / "bridge", free_port()
    folder.mkdir()
    coaxlink("bridge", str(AIRFRAME), "--out", str(files))
    options = ("--airframe", str(AIRFRAME))
    with real_time(), arducopter(Path(BINARY), folder, FACTORY, *options, speed=1.0, second_port=port) as url:
        coaxlink("upload", str(files), "--connect", url, "--yes", "--reboot", cwd=tmp_path)
        with connect(url, timeout_s=60.0) as session:
            vehicle = take_off(session)
            time.sleep(3.0)
            own = pair_split(session, 3.0)
            with mixer(session) as first:
                time.sleep(1.5)
                mixed = pair_split(session, 3.0)
                assert first.state == "live"
                for component, reported in ((192, "component 191"), (191, "our own ids, on another link")):
                    outcome = beside(f"udpin:127.0.0.1:{port}", component)
                    sys.stdout.write(f"\nsecond companion, component {component}: {outcome}")
                    assert "another companion commands the motors (system" in outcome and reported in outcome
                assert first.summary()["cycles"] > 100
                assert not first.failed.is_set()
            time.sleep(1.0)
            again = pair_split(session, 3.0)
            vehicle.land()
    assert own == pytest.approx(1.0, abs=0.02)
    assert mixed > 1.3  # the exact law's lower rotors turn faster
    assert again == pytest.approx(1.0, abs=0.02)
