"""The nuisance model that the effects of a flight were fitted beside, as a rotor model.

An effect's numbers hold together with the small corrections of level, slope and wake that were fitted with
them (`flight_nuisance`): a supply that sags by 8 % and a stand that read 2 % high look alike over one flight.
Whoever uses the effects must use both; one without the other misses by what they shared.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coaxlink.frames import FlightFrame
from coaxlink.rotor import RotorModel
from coaxlink.rotor.polynomial import design_matrix

HALF_WIDTH, POINTS = 0.3, 15  # of the speeds around the flown ones that the terms are fitted over


def rebased_flight(frame: FlightFrame, corrections: Mapping[str, float]) -> RotorModel:
    """The frame's model with the fitted corrections in its own terms; `corrections` as `Refinement` has them.

    Single rotors beside pairs keep the pairs' upper corrections: one model serves both.
    """
    model, airframe = frame.model, frame.airframe
    middle = np.median(frame.speeds[frame.keep], axis=0)
    levels = np.array([r.level for r in airframe.rotors])
    first = "upper" if (levels == "upper").any() else "single"
    centre = [
        float(middle[levels == level].mean()) if (levels == level).any() else 0.0
        for level in (first, "lower")
    ]
    axes = [np.linspace(max(c - HALF_WIDTH, 0.0), min(c + HALF_WIDTH, 1.0), POINTS) for c in centre]
    u, v = (x.ravel() for x in np.meshgrid(*axes, indexing="ij"))
    # near hover a bias of the accelerometer and a level of thrust are the same force: they stay together
    lift = float(np.median(frame.thrust[frame.keep].sum(axis=1)))
    bias = -corrections.get("accel_z_bias_m_s2", 0.0) * airframe.mass_kg / lift
    terms = {load: dict(named) for load, named in model.terms().items()}
    for load, level in (("upper", first), ("lower", "lower")):
        for kind, key in (("thrust", "thrust_N"), ("torque", "torque_Nm")):
            named = terms[f"{load}.{key}"]
            own = (u - centre[0]) if load == "upper" else (v - centre[1])
            share = np.full(u.shape, corrections.get(f"{level}_{kind}_level", 0.0))
            share += corrections.get(f"{level}_{kind}_tilt", 0.0) * 2.0 * own
            if load == "lower":
                share += corrections.get(f"lower_{kind}_wake", 0.0) * 2.0 * (u - centre[0])
            if kind == "thrust":
                share = share + bias
            else:
                # one yaw rate tells torque over inertia: the torque that belongs to the declared inertia
                share = (1.0 + share) / (1.0 + corrections.get("inertia_z_share", 0.0)) - 1.0
            if not named or not np.any(share):
                continue
            values = design_matrix(named, u, v)
            change = np.linalg.lstsq(values, values @ np.array(list(named.values())) * share, rcond=1e-10)[0]
            for name, c in zip(list(named), change, strict=True):
                named[name] += float(c)
    return model.having(terms)
