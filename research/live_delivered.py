"""Hover and circle on the stand-in, the companion mixing: desired against delivered, by the world's truth.

    python research/live_delivered.py [--laws exact coaxial reduced standard]

Desired is the demand the autopilot sent (its wrench by the reference table); delivered is what the plant's
own rotors did in the same 4 ms, read off its state, no sensor in between. No hidden effect. `low-passed` is
the same through the 4 Hz filter of `coaxlink.residual.allocation_error`; motors with a lag deliver a moving
demand late. The world waits for each answer, so that a busy machine does not look like a bad mixer.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "helpers"))

import live_flight  # type: ignore[import-not-found]
from live_flight import EXAMPLES, Companion, Flight

from coaxlink.airframe import load_airframe
from coaxlink.fly.trajectory import table_4_flight
from coaxlink.live.guard import Timing
from coaxlink.live.mixer import LiveMixer
from coaxlink.mixer import make_law
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle
from sim.px4.cascade import Goal

MODEL = load_rotor_model(EXAMPLES / "rotor_paper.toml")
JUDGED = ("hover", "circle")
CUTOFF_HZ = 4.0
PATIENT = Timing(hold_after_s=1.0, ramp_after_s=2.0)


def fly(
    airframe_file: str, law_name: str, quick_s: float | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict]:
    """(desired (rows, 4), delivered (rows, 4), commands (rows, 8), the mixer's account).

    `quick_s`: the declared lag of the motors is led down to this; None leaves it.
    """
    import threading

    frame = load_airframe(EXAMPLES / airframe_file)
    flight = Flight(airframe=airframe_file)
    a, vehicle = flight.autopilot, flight.autopilot.plant.vehicle
    companion = Companion(flight)
    law = make_law(law_name, Vehicle(frame, MODEL))
    live = LiveMixer(
        companion.session, Vehicle(frame, MODEL), law, own_curve=1.0, timing=PATIENT,
        lead_s=(0.0, 0.0) if quick_s is None else (frame.motor_lag_s, quick_s),
    )  # fmt: skip
    starting = threading.Thread(target=live.start)
    starting.start()
    flight.fly(3.0, until=lambda: not starting.is_alive())
    flight.fly(2.0, until=lambda: live.state == "live")
    flight.standin.speed = 0.0  # from here on the world waits for each answer
    plan = table_4_flight()
    last = max(s for s in np.arange(0.0, plan.duration_s, 0.1) if plan.at(float(s))[0] in JUDGED)
    rows: list[tuple[list[float], np.ndarray, list[float]]] = []
    for lead in (True, False):  # once to the start of the plan, then the plan
        for k in range(round((6.0 if lead else last) / live_flight.TICK_S)):
            segment, s = plan.at(0.0 if lead else k * live_flight.TICK_S)
            a.offboard(Goal(s.position_m, s.velocity_m_s, s.acceleration_m_s2, s.yaw_rad))
            if lead and k == 0:
                a.set_mode(type(a.mode).OFFBOARD)
            flight.rush(live_flight.TICK_S)
            if not lead and segment in JUDGED:
                force = a.plant.thrust[:, None] * vehicle.axis
                moment = np.cross(vehicle.position_m, force)
                moment = moment - (vehicle.spin * a.plant.torque)[:, None] * vehicle.axis
                d = a.demand
                got = np.concatenate([[-force[:, 2].sum()], moment.sum(axis=0)])
                rows.append(([d.roll, d.pitch, d.yaw, d.thrust], got, list(a.command)))
    account = live.summary()
    if live.error:
        raise live.error
    wanted = np.array([live.core.scale.wrench(r[0]) for r in rows])
    live.session.tap = None
    companion.close()
    flight.close()
    return wanted, np.array([r[1] for r in rows]), np.array([r[2] for r in rows]), account


def low_pass(x: np.ndarray, rate: float = 2 * math.pi * CUTOFF_HZ) -> np.ndarray:
    share = 1.0 - math.exp(-rate * live_flight.TICK_S)
    out = np.empty_like(x)
    state = x[0]
    for k, row in enumerate(x):
        state = state + share * (row - state)
        out[k] = state
    return out


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--laws", nargs="+", default=["exact", "coaxial", "reduced", "standard"])
    parser.add_argument("--lead", nargs="*", type=float, default=[0.0, 0.005], help="lags wanted, s")
    parser.add_argument("--skip", type=int, default=0, help="cases to leave out, from the first")
    o = parser.parse_args()
    print("mean |desired - delivered|, hover and circle; the paper's coaxial mixer: 0.58 N, 0.4667 N m (yaw)")
    cases: list[tuple[str, str, float | None]] = [("x8_paper.toml", "no lag", None)]
    cases += [("x8_demo.toml", "lag 20 ms", None)]
    cases += [("x8_demo.toml", f"lag 20 ms led to {1e3 * q:g} ms", q) for q in o.lead]
    for name, what, quick in cases[o.skip :]:
        for law in o.laws if quick is None else o.laws[:1]:
            wanted, got, commands, account = fly(name, law, quick)
            jump = float(np.abs(np.diff(commands, axis=0)).mean())
            ends = float(((commands <= 0.0) | (commands >= 1.0)).mean())
            raw = np.abs(wanted - got).mean(axis=0)
            smooth = np.abs(low_pass(wanted - got)).mean(axis=0)
            lag = load_airframe(EXAMPLES / name).motor_lag_s
            late = low_pass(wanted, 1.0 / lag) if lag else wanted
            lagged = np.abs(low_pass(late - got)).mean(axis=0)
            model = account["allocation_error"]["mean"]
            print(
                f"{what:22s} {law:8s} raw {raw[0]:7.3f} N {max(raw[1:]):7.4f} N m   "
                f"low-passed {smooth[0]:7.3f} N {max(smooth[1:]):7.4f} N m   "
                f"and after the declared lag {lagged[0]:.3f} N {max(lagged[1:]):.4f} N m   "
                f"by the rotor model {model[0]:.1e} N {max(model[1:]):.1e} N m   "
                f"commands move {jump:.4f} a step, {100 * ends:.2f} % at a bound "
                f"({len(wanted)} rows, hand-overs {account['hand_overs']})",
                flush=True,
            )


if __name__ == "__main__":
    main()
