"""Whether the pairs of an airframe turn as the pair did whose loads the rotor model has.

A lower rotor meets the swirl of the upper one: against it, it works as a stator would and gives more thrust;
with it, less. No model of one kind of pair tells the other's.
"""

from __future__ import annotations

from collections.abc import Iterator

from coaxlink.airframe import Airframe
from coaxlink.premises.answer import NotJudged
from coaxlink.rotor.model import CO_ROTATING, COUNTER_ROTATING, RotorModel

MEASURE = "such a pair on a stand (coaxlink identify, co-rotating)"


def turned_otherwise(airframe: Airframe, model: RotorModel) -> str:
    """What the model is taken for and nobody measured, in words; "" where pairs turn as it says."""
    alike = set(airframe.co_rotating)
    wrong = [pair for pair in airframe.pairs if (pair in alike) != (model.rotation == CO_ROTATING)]
    if not wrong:
        return ""
    names = ", ".join(f"{u + 1}/{w + 1}" for u, w in wrong)
    turn = "against each other" if model.rotation == CO_ROTATING else "the same way"
    return (
        f"the rotors of {names} turn {turn}, the rotor model is of a {model.rotation} pair: nobody measured "
        "thrust and torque of their lower rotors"
    )


def pairs_unmeasured(airframe: Airframe, model: RotorModel) -> Iterator[NotJudged]:
    """Why nothing can be reported of such rotors."""
    if why := turned_otherwise(airframe, model):
        yield NotJudged("rotation", MEASURE, why)


def rotation_of(airframe: Airframe, model: RotorModel) -> str:
    """How the pairs of an airframe turn; as the model's where it has none, or some of each."""
    if not airframe.pairs or 0 < len(airframe.co_rotating) < len(airframe.pairs):
        return model.rotation
    return CO_ROTATING if airframe.co_rotating else COUNTER_ROTATING
