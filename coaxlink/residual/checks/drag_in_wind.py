"""A wind whose drag is the rotors': then rotor drag is there as well, an effect of its own.

A wind is felt through drag. If it is the body's, the rotors feel none of it; if it is the rotors', their hubs
are dragged when the vehicle turns on the spot, too, and yaw is damped by the same coefficient (Faessler,
Franchi and Scaramuzza 2018). Both witnesses together name `rotor_drag`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from coaxlink.effects import rotor_drag
from coaxlink.effects.tracing import Array
from coaxlink.effects.wind import apart
from coaxlink.residual.regression.blocks import bootstrap
from coaxlink.residual.regression.irls import channel_errors, reweighted_fit
from coaxlink.residual.regression.joint_model import Fitter, Joint, Member, columns_of, member

DRAWS = 200
WORSE = 0.05  # of the logarithm of errors, channels together
SURE, ALIKE = 0.25, 0.4  # half an interval over the drag; how far the damping may lie from the drag


def drag_beside(
    fitter: Fitter, joint: Joint, nuisance: Callable[[Any, Callable[[Array], Array]], Array]
) -> Joint | None:
    """The joint fit with rotor drag of its own beside the wind, where force and yaw both show it; or None.

    `base(frame, reduce)` gives the nuisance model corrections of a frame, (rows, C, B).
    """
    members = _apart(fitter.bare, joint)
    if members is None:
        return None
    first, _ = fitter.settle(members)
    rest = (fitter.problem, fitter.bare, fitter.fixed, fitter.reduce)
    trial = reweighted_fit(first, *rest, nuisance, alternatives=False)
    before, after = (
        float(np.sum(np.log(channel_errors(j.problem, j.problem.options)))) for j in (joint, trial)
    )
    refused = any(m.effect.refuse(m.parameters(fitter.bare)) for m in trial.members)
    return None if refused or after > before + WORSE else trial


def _apart(frame: Any, joint: Joint) -> list[Member] | None:
    """The members with rotor drag of its own beside the wind, where force and yaw both show it; or None."""
    place = next((k for k, m in enumerate(joint.members) if m.name == "wind"), None)
    if place is None or any(m.name == "rotor_drag" for m in joint.members):
        return None
    m, q = joint.members[place], joint.problem
    if "moment_N_s_m" not in m.shape:
        return None
    named = m.parameters(frame)
    draws = bootstrap(q.blocks, columns_of(q), DRAWS)
    drag, damping = (
        np.quantile([joint.named(place, d)[name] for d in draws], [0.025, 0.975])
        for name in ("drag_per_speed_N_s_m", "moment_N_s_m")
    )
    k = named["drag_per_speed_N_s_m"]
    sure = k > 0.0 and drag[1] - drag[0] < 2.0 * SURE * k and damping[0] > 0.0
    if not sure or abs(named["moment_N_s_m"] / k - 1.0) > ALIKE:
        return None
    wind, own = apart(named)
    still = member(frame, rotor_drag.FLIGHT, *rotor_drag.FLIGHT.inverse(frame, own))
    blown = member(frame, m.effect, *m.effect.inverse(frame, wind))
    return [*(x for x in joint.members if x is not m), still, blown]
