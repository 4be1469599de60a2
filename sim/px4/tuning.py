"""What the vehicle's owner tuned before anyone came: hover thrust and rate gains for the table it boots with.

PX4's stock gains are for small quadrotors. A bench engineer would set P so that the loop closes at a chosen
rate: gain = bandwidth * inertia / (torque per unit of normalised control), measured here on the plant itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.plant import GRAVITY, Plant
from sim.px4.mixer import Mixer
from sim.px4.store import Store

BANDWIDTH = (12.0, 12.0, 5.0)  # rad/s of the rate loops; the motors' lag allows about a quarter of 1 / lag
NAMES = ("ROLLRATE", "PITCHRATE", "YAWRATE")


def tune(store: Store, plant: Plant) -> None:
    """Preset MPC_THR_HOVER and MC_*RATE_{P,I,D} for this plant and the mixer of the parameters on board."""
    mixer = Mixer(store, plant.vehicle.rotors)
    if mixer.mix is None:
        return
    low, high = 0.02, 1.0
    weight = plant.vehicle.mass_kg * GRAVITY
    for _ in range(40):
        middle = 0.5 * (low + high)
        lifted = wrench(plant, mixer.command(0.0, 0.0, 0.0, middle))[0] > weight
        low, high = (low, middle) if lifted else (middle, high)
    hover = round(0.5 * (low + high), 3)
    store.preset("MPC_THR_HOVER", hover)
    for k, name in enumerate(NAMES):
        a, b = (wrench(plant, mixer.command(*_nudge(k, s), hover))[1 + k] for s in (0.01, -0.01))
        authority = float(a - b) / 0.02
        if authority <= 0:
            continue
        gain = BANDWIDTH[k] * float(plant.vehicle.inertia_kg_m2[k]) / authority
        store.preset(f"MC_{name}_P", round(gain, 3))
        store.preset(f"MC_{name}_I", round(gain * 1.5, 3))
        store.preset(f"MC_{name}_D", round(gain * 0.015, 4) if k < 2 else 0.0)


def _nudge(axis: int, size: float) -> tuple[float, float, float]:
    return size * (axis == 0), size * (axis == 1), size * (axis == 2)


def wrench(plant: Plant, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) thrust up, roll, pitch, yaw of steady normalised speeds (N,)."""
    v = plant.vehicle
    thrust, torque = np.zeros(v.rotors), np.zeros(v.rotors)
    for i in range(v.rotors):
        other = u[v.partner[i]] if v.partner[i] >= 0 else 0.0
        lower = v.level[i] == 1
        loads = plant.pair.loads(other if lower else u[i], u[i] if lower else other)
        thrust[i], torque[i] = loads[2:] if lower else loads[:2]
    force = thrust[:, None] * v.axis
    moment = np.cross(v.position_m, force) - (v.spin * torque)[:, None] * v.axis
    return np.concatenate([[-force[:, 2].sum()], moment.sum(axis=0)])
