"""The share of the upper rotors in the module of the real PX4 (PX4_MODULE_SITL): flown, tried, let go.

Real time, in the real-time class; `pytest -s` prints what was measured.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from module_air import HERE, LAW, VEHICLE, Air, exact_split, flying, tell
from pymavlink.dialects.v20 import common as m
from real_autopilots import PAIRS

from coaxlink.fly.trajectory import Hold
from coaxlink.mavlink.parameters import Parameters
from coaxlink.mavlink.values import FLOAT
from coaxlink.mixer.shares import LeaningLaw

BINARY = os.environ.get("PX4_MODULE_SITL", "")
pytestmark = [
    pytest.mark.skipif(not BINARY, reason="PX4_MODULE_SITL names no binary with the module"),
    pytest.mark.timeout(900),
]
BACK_S = 0.5
LOOK_S = 0.5  # at the height, before PX4's failsafe for lost set-points (COM_OF_LOSS_T, 1 s) begins to land
ON_BOARD, TRIAL = "COAX_SHARE", "COAX_SHARE_TRY"
HOLD = m.MAVLink_command_long_message(0, 1, 176, 0, 1, 4, 3, 0, 0, 0, 0)


@pytest.fixture
def air(tmp_path: Path) -> Iterator[Air]:
    with flying(Path(BINARY), tmp_path) as air:
        yield air


def put(air: Air, name: str, value: float) -> None:
    parameters = Parameters(air.session)
    parameters.write_many([parameters.encode(name, value, FLOAT)])


def splits(share: float) -> float:
    """Lower over upper command of a hover with it."""
    law = LeaningLaw(VEHICLE)
    law.lean(LAW.shares.lean_of(share))
    u = law.speeds([9.80665 * VEHICLE.airframe.mass_kg, 0.0, 0.0, 0.0])
    return float(np.mean([u[low] / u[up] for up, low in PAIRS]))


def told(air: Air, act: Callable[[], None], seconds: float) -> np.ndarray:
    """(rows, 4) what the module says from `act` on: s since, share flown, on trial, m lost."""
    with air.session.listen(("DEBUG_FLOAT_ARRAY",)) as heard:
        before = air.session.latest("DEBUG_FLOAT_ARRAY").time_usec
        z = air.session.latest("LOCAL_POSITION_NED").z
        act()
        rows, end = [], air.session.clock.monotonic() + seconds
        while air.session.clock.monotonic() < end:
            message = air.session.take(heard, 0.1)
            if message is not None:
                lost = air.session.latest("LOCAL_POSITION_NED").z - z
                rows.append(((message.time_usec - before) / 1e6, message.data[13], message.data[14], lost))
    return np.array(rows)


def test_a_share_is_flown_and_one_that_is_none_is_not(air: Air) -> None:
    own = LAW.shares.own
    for share in (own + 0.1, own - 0.08):
        put(air, ON_BOARD, share)
        air.fly(Hold("moves", HERE, 5.0))
        flown = air.fly(Hold("there", HERE, 5.0))
        height = np.abs(flown["down"] - flown["down"][0]).max()
        tell(f"share {share:.3f}: lower over upper {flown['split']:.4f}, {splits(share):.4f} by the law")
        assert flown["split"] == pytest.approx(splits(share), rel=0.01) and height < 0.2
    for wrong in (0.9, -1.0, float("nan")):
        air.board.shell("param", "set", ON_BOARD, str(wrong))
        air.fly(Hold("back", HERE, 5.0))
        assert air.fly(Hold("own", HERE, 3.0))["split"] == pytest.approx(exact_split(), rel=0.01)
    air.vehicle.land()


def test_a_trial_ends_with_whoever_flies_it(air: Air) -> None:
    own = LAW.shares.own

    def tried(share: float) -> None:
        put(air, TRIAL, share)
        air.fly(Hold("tried", HERE, 5.0))
        assert air.fly(Hold("there", HERE, 2.0))["split"] == pytest.approx(splits(share), rel=0.01)

    def nobody() -> None:
        """The process that flies it is dead."""

    def pilot() -> None:
        HOLD.target_system = air.session.identity.system
        air.session.send(HOLD)

    def taken_back() -> None:
        put(air, TRIAL, 0.0)

    for number, (what, act) in enumerate(
        (("set-points end", nobody), ("the pilot's mode", pilot), ("taken back", taken_back))
    ):
        tried(own + 0.08 + 0.001 * number)
        rows = told(air, act, 2.5)
        off = rows[np.abs(rows[:, 1] - own) > 0.002, 0]
        after = off.max() if len(off) else 0.0
        lost = rows[rows[:, 0] < after + LOOK_S, 3].max()
        tell(f"{what}: the share on board after {after:.2f} s, {100 * lost:.0f} cm lost {LOOK_S:g} s later")
        assert after < BACK_S and not rows[-1, 2] and lost < 0.2
        air.fly(Hold("again", HERE, 3.0))  # nothing changed it: the trial that is left stays what it is
        assert air.fly(Hold("own", HERE, 3.0))["split"] == pytest.approx(exact_split(), rel=0.01)
    air.vehicle.land()


def test_a_trial_that_was_left_is_not_flown_after_a_start(tmp_path: Path) -> None:
    with flying(Path(BINARY), tmp_path, COAX_SHARE_TRY=LAW.shares.own + 0.08) as air:
        assert air.fly(Hold("own", HERE, 4.0))["split"] == pytest.approx(exact_split(), rel=0.01)
        air.vehicle.land()
