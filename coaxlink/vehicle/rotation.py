"""Whether the pairs of an airframe turn as the pair did whose loads the rotor model has."""

from __future__ import annotations

from coaxlink.rotor.model import CO_ROTATING
from coaxlink.vehicle.vehicle import Vehicle


def turned_otherwise(vehicle: Vehicle) -> str:
    """What the model is taken for and nobody measured, in words; "" where pairs turn as it says.

    A lower rotor meets the swirl of the upper one: against it, it works as a stator would and gives more
    thrust; with it, less. No model of one kind of pair tells the other's.
    """
    airframe, model = vehicle.airframe, vehicle.model
    alike = set(airframe.co_rotating)
    wrong = [pair for pair in airframe.pairs if (pair in alike) != (model.rotation == CO_ROTATING)]
    if not wrong:
        return ""
    names = ", ".join(f"{u + 1}/{w + 1}" for u, w in wrong)
    turn = "against each other" if model.rotation == CO_ROTATING else "the same way"
    return (
        f"the rotors of {names} turn {turn}, the rotor model is of a {model.rotation} pair: thrust and "
        "torque of their lower rotors, and what follows from them, are not judged before such a pair is "
        "measured on a stand"
    )
