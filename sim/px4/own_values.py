"""What a PX4 writes into its own parameters: on disarming its counters and the offsets its estimator learned
(src/modules/commander, land_detector, ekf2, sensors/vehicle_imu), at once a hover thrust out of bounds
(src/modules/mc_pos_control). It tells nobody: ground stations see it when they ask.
"""

from __future__ import annotations

import math

from sim.px4.store import Px4Store

DECLINATION_DEG = 3.2  # of the field at home
_WORD = 1 << 32


def disarmed(store: Px4Store, flown_s: float) -> None:
    """A flight has ended."""
    flights = int(store["COM_FLIGHT_UUID"]) + 1
    store.own("COM_FLIGHT_UUID", flights)
    total = int(store["LND_FLIGHT_T_HI"]) * _WORD + int(store["LND_FLIGHT_T_LO"]) % _WORD
    total += int(1e6 * flown_s)
    low = total % _WORD
    store.own("LND_FLIGHT_T_HI", total // _WORD)
    store.own("LND_FLIGHT_T_LO", low - _WORD if low >= _WORD // 2 else low)
    if abs(float(store["EKF2_MAG_DECL"]) - DECLINATION_DEG) > 0.1:
        store.own("EKF2_MAG_DECL", DECLINATION_DEG)
    for k, axis in enumerate("XYZ"):
        store.own(f"CAL_GYRO0_{axis}OFF", 1e-3 * math.sin(flights + 2.0 * k))


def bounded_hover(store: Px4Store) -> str:
    """MPC_THR_HOVER within MPC_THR_MIN and MPC_THR_MAX; what it says, nothing where it was."""
    low, high = float(store["MPC_THR_MIN"]), float(store["MPC_THR_MAX"])
    hover = float(store["MPC_THR_HOVER"])
    if low <= hover <= high:
        return ""
    store.own("MPC_THR_HOVER", min(max(hover, low), high))
    return "Hover thrust has been constrained by min/max"
