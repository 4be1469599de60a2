"""What an answer rests on: numbers that nobody measured, whether this is the vehicle, what its log lacks."""

from coaxlink.premises.answer import NotJudged, OtherVehicle
from coaxlink.premises.log_needs import damage, lacking, unseen
from coaxlink.premises.moves import Moved, as_if, guesses, moves, not_judged
from coaxlink.premises.rotation import pairs_unmeasured, rotation_of, turned_otherwise
from coaxlink.premises.same_vehicle import motors_differ, other_motors, other_vehicle

__all__ = [
    "Moved",
    "NotJudged",
    "OtherVehicle",
    "as_if",
    "damage",
    "guesses",
    "lacking",
    "motors_differ",
    "moves",
    "not_judged",
    "other_motors",
    "other_vehicle",
    "pairs_unmeasured",
    "rotation_of",
    "turned_otherwise",
    "unseen",
]
