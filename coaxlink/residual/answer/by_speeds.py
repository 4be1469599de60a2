"""A flight's answer held against the ESCs' rpm: what a drive does is no effect of the rotors, and so back.

Commands give the quicker and the quieter prediction, and are judged first. Where the rpm say that the rotors
turned as the file's drive gives, no supply slowed them. Where they turned otherwise, the flight is judged
again from the rpm: a name that this takes away was the drive's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from coaxlink.channels.flight import reduce_columns
from coaxlink.channels.flight_corrections import lift_room
from coaxlink.channels.logged_speeds import by_logged_speeds
from coaxlink.frames import FLIGHT_CHANNELS, Array, FlightFrame
from coaxlink.instruments.findings import Suspect
from coaxlink.instruments.flight.inputs import Inputs
from coaxlink.residual.answer.judge_flight import judge_flight
from coaxlink.residual.result import Refinement, Unexplained

SUPPLY = "battery_voltage"
SLOWS = {SUPPLY, "degraded_rotor"}  # what rpm show: all rotors slower, or one; a lag is too quick for them
HALF = 0.5  # of what an effect explains: nearer to none of it than to all
ALONE = 3.0  # times as far apart as the next: one column, and no trait of all (judgement)
CLEARLY = 0.1  # of the logarithm of errors, channels together, that another number must leave less: judgement


def held_against_speeds(
    found: Refinement, inputs: Inputs, bare: FlightFrame, progress: Callable[[str], None]
) -> tuple[Refinement, FlightFrame]:
    """What is `found` in these flights, aligned as `bare`, or what the rpm say in its place, and the frame by
    which this holds."""
    turned = None if inputs.blind else by_logged_speeds(bare, inputs.logs)
    if turned is None or not found.channels:
        return found, bare
    moved = np.std(reduce_columns(bare, turned.predicted - bare.predicted), axis=0)
    words = _ratio_words(bare, turned)
    if _denied(found, dict(zip(FLIGHT_CHANNELS, moved, strict=True))):
        progress("without the supply, which the rpm deny")
        bare = replace(bare, ruled_out={SUPPLY: f"the ESCs' rpm deny it: {words}"})
        return judge_flight(inputs, bare, progress), bare
    floor = np.array([found.channels[name].noise_floor for name in FLIGHT_CHANNELS])
    # a rotor's thrust by its rpm, over that by its commands, is apart by more than a stand promises
    apart = bool(np.any(np.abs(np.median(_ratios(bare, turned), axis=0) ** 2 - 1.0) > lift_room(bare)))
    if not apart and not np.any(moved > floor):
        return found, bare
    progress("from the rpm")
    why = "the flight is predicted from the ESCs' rpm, which have it in"
    turned = replace(turned, ruled_out={SUPPLY: why})
    by_rpm = judge_flight(inputs, turned, progress)
    gained = _left(found) - _left(by_rpm)
    if apart and gained < -CLEARLY:
        return replace(found, suspect_data=(*found.suspect_data, _untrue(bare, turned))), bare
    if gained < CLEARLY or (_alike(found, by_rpm) and (not apart or _names(found) & SLOWS)):
        return found, bare
    if drives := _names(found) - SLOWS - _names(by_rpm):
        progress("without what the rpm take away")
        why = "predicted from the ESCs' rpm nothing is left for it"
        taken = replace(bare, ruled_out=dict.fromkeys(drives, why))
        again = judge_flight(inputs, taken, progress)
        if _names(again) & SLOWS and _alike(again, by_rpm):
            return again, taken
    return _beside_the_drive(by_rpm, moved / floor, moved, words), turned


def _names(found: Refinement) -> frozenset[str]:
    """Of all effects that are named, alone or in a group."""
    return found.names.union(*(a.names for a in found.ambiguous))


def _alike(found: Refinement, by_rpm: Refinement) -> bool:
    """Whether commands tell no more than the rpm do, but for what slows rotors and is in the rpm already, and
    explain as much."""
    left, also = ({u.channel for u in answer.unexplained} for answer in (found, by_rpm))
    names, other = _names(found) - SLOWS, _names(by_rpm) - SLOWS
    after, least = (
        sum(np.log(max(c.rmse_after, 1e-12)) for c in answer.channels.values()) for answer in (found, by_rpm)
    )
    return left <= also and (names == other or (names < other and after < least + CLEARLY))


def _left(found: Refinement) -> float:
    """Logarithm of what all channels are off by as predicted, nothing put right."""
    return float(sum(np.log(max(c.rmse_as_given, 1e-12)) for c in found.channels.values()))


def _denied(found: Refinement, moved: Mapping[str, float]) -> bool:
    """Whether a supply is named that would have changed the loads by more than rotors turned otherwise."""
    if SUPPLY not in _names(found):
        return False
    errors = next((e.rmse for e in found.effects if e.name == SUPPLY), None) or {
        name: (c.rmse_before, c.rmse_after) for name, c in found.channels.items()
    }
    size = {name: float(np.sqrt(max(a**2 - b**2, 0.0))) for name, (a, b) in errors.items()}
    channel = max(size, key=lambda name: size[name] / found.channels[name].noise_floor)
    return moved[channel] < HALF * size[channel]


def _ratio_words(bare: FlightFrame, turned: FlightFrame) -> str:
    """How rotors turn against their commands."""
    low, high = np.quantile(np.mean(_ratios(bare, turned), axis=1), [0.025, 0.975])
    return f"the rotors turn at {low:.3f} to {high:.3f} times what their file's drive gives at their commands"


def _ratios(bare: FlightFrame, turned: FlightFrame) -> Array:
    """(kept, N) speeds by the rpm over the drive's."""
    return np.asarray(turned.speeds[bare.keep] / np.maximum(bare.speeds[bare.keep], 1e-12))


def _untrue(bare: FlightFrame, turned: FlightFrame) -> Suspect:
    """The rpm that the loads contradict: those of one rotor, where it alone is apart from the others."""
    each = np.median(_ratios(bare, turned), axis=0)
    apart = np.abs(each / np.median(each) - 1.0)
    *_, second, first = np.argsort(apart)
    why = f"{_ratio_words(bare, turned)}, and the loads follow the commands: magnets counted, another ESC"
    if apart[first] < ALONE * apart[second]:
        return Suspect("rpm", "all", why)
    number, ratio = bare.airframe.rotors[int(first)].number, each[first] / np.median(each)
    why = f"{ratio:.3f} times what its command gives, against the others, and the loads follow the command"
    return Suspect(f"rpm{number}", "all", why)


def _beside_the_drive(by_rpm: Refinement, share: Array, moved: Array, words: str) -> Refinement:
    """The answer from the rpm, with what the drive does beside its file, by no effect."""
    c = int(np.argmax(share))
    where = f"by the ESCs' rpm {words}; from the rpm this is not left: identify the drive again"
    drive = Unexplained(FLIGHT_CHANNELS[c], ("rpm",), float(moved[c]), where)
    return replace(by_rpm, unexplained=(*by_rpm.unexplained, drive))
