"""Measured data against a model: find the residual, trace it to effects, report before and after.

All of it is many small products of matrices: more threads than one only wait for each other, and on a busy
machine take five times as long.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from coaxlink.airframe import Airframe
from coaxlink.channels.flight import flight_frame, flown
from coaxlink.channels.flight_corrections import (
    ACCEL_BIAS_M_S2,
    flight_corrections,
    lift_room,
    lift_share,
)
from coaxlink.channels.stand_rows import in_order_of_time, without_empty_cells
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from coaxlink.frames import FlightFrame
from coaxlink.instruments.flight.commands import motors_too_many
from coaxlink.instruments.flight.flown_log import FlownLog
from coaxlink.instruments.flight.inputs import Inputs, checked
from coaxlink.premises import (
    Moved,
    NotJudged,
    OtherVehicle,
    as_if,
    damage,
    lacking,
    motors_differ,
    moves,
    not_judged,
    other_motors,
    other_vehicle,
    unseen,
)
from coaxlink.premises.moves import UNKNOWN
from coaxlink.residual.answer.by_speeds import CLEARLY, held_against_speeds
from coaxlink.residual.answer.judge_flight import judge_flight
from coaxlink.residual.answer.mass_or_thrust import MASS_OR_THRUST, lift_beside, weighing
from coaxlink.residual.result import Refinement
from coaxlink.rotor import RotorModel

Progress = Callable[[str], None]
# effects that are a premise's own number: finding one is measuring it
OWN = {"mass_kg": "mass_change", "motor_lag_s": "rotor_lag"}
AT_BOUND = 0.999  # of a correction's bound
LARGEST = 1e17  # microseconds of a clock reach 1e16; nothing on a vehicle is larger in SI units


def refine(
    logs: Samples | Sequence[Samples],
    airframe: Airframe,
    model: RotorModel,
    *,
    progress: Progress = lambda _: None,
) -> Refinement:
    """Hold flight logs against a rotor model on its airframe.

    `model` may carry effects already: they are part of the prediction, and are fitted again where the log
    demands other numbers. `progress` is told each stage. Where the log is another vehicle's, or the names
    hang on a number that nobody measured, nothing is claimed and the answer says why (`coaxlink.premises`).
    Raises InputError when a log lacks what every flight needs.
    """
    several = _several(logs)

    def run() -> Refinement:
        progress("are these readings?")
        inputs = checked(several, airframe)
        progress("aligning")
        bare = flight_frame(inputs.logs, airframe, model)
        found = judge_flight(inputs, bare, progress)
        differs = (*vehicle_differs(several, airframe), *other_vehicle(bare, inputs.logs))
        if found.suspect_data and not found.effects:
            # an instrument that is wrong makes another vehicle of this one; its motors it leaves alone
            differs = tuple(d for d in differs if d.check in ("motors", "outputs"))
            lacks = list(damage(several))
            return found.claiming_nothing(lacks, differs) if differs or lacks else found
        if differs:
            return found.claiming_nothing(not_this_vehicle=differs)
        found, bare = held_against_speeds(found, inputs, bare, progress)
        names = " and ".join(sorted(e.name for e in found.effects)) or found.verdict
        if lacks := [*lacking(bare), *damage(several, names)]:
            return found.claiming_nothing([*lacks, *at_bounds(found, bare)])
        progress("moving what nobody measured")
        if (answered := _whatever_lifts(found, inputs, bare)) is not None:
            return answered
        hangs_on = [*at_bounds(found, bare)] or _hangs_on(found, inputs, bare)
        return found.unnamed(hangs_on) if hangs_on else found

    def noted() -> Refinement:
        found = run()
        return replace(found, notes=(*found.notes, *unseen(several)))

    if differs := tuple(other_motors(several, airframe)):
        return Refinement("flight", {}, (), (), (), (), (), None, not_this_vehicle=differs)
    several = flown(several, airframe, model)
    return _answered(several, noted)


def vehicle_differs(logs: Sequence[Samples], airframe: Airframe) -> tuple[OtherVehicle, ...]:
    """Motors that the file has and the log has not, or that fly and the file does not know."""
    have = len(airframe.rotors)
    numbers = [r.number for r in airframe.rotors]
    return (
        *other_motors(logs, airframe),
        *(
            OtherVehicle("motors", have + many, (have, have), motors_differ(log, have + many, have))
            for log in logs
            for names, _, _ in motors_too_many(FlownLog.of(log, numbers))
            for many in [len(names.split(","))]
        ),
    )


def at_bounds(found: Refinement, frame: FlightFrame) -> Iterator[NotJudged]:
    """Corrections that end where no specimen of this vehicle can be: what they correct is not known.

    Of the lift as a whole, since one level may make up for another. Of inertia and delay where nobody gave
    them; of declared ones gusts that the loops answer shorten the response, and mean nothing.
    """
    bounds = {c.name: c.bound for c in flight_corrections(frame)}

    def ends(name: str) -> bool:
        return abs(found.corrections.get(name, 0.0)) > AT_BOUND * bounds.get(name, np.inf)

    lift, room = lift_share(frame, found.corrections), lift_room(frame)
    if not found.effects:  # levels and slopes may make up for one another: together they are what is lifted
        lift = min(lift, lift_beside(frame, frame.airframe.mass_kg), key=abs)
    if abs(lift) > AT_BOUND * room:
        why = f"the lift is {100 * abs(lift):.1f} % off, this rotor model is good to {100 * room:.0f} %"
        guessed = set(UNKNOWN) & set(frame.model.sources.values())
        weighed = guessed or frame.airframe.source_of("mass_kg") == "measured"
        yield not_judged("rotor_model" if weighed else "mass_kg", why)
    body = frame.airframe
    names = {e.name for e in found.effects}
    if body.source_of("inertia_kg_m2") in UNKNOWN and any(ends(f"inertia_{a}_share") for a in "xyz"):
        yield not_judged("inertia_kg_m2", "the flight asks for another one than the estimate")
    late = ends("torque_delay_s") or ends("force_delay_s")
    if body.source_of("motor_lag_s") in UNKNOWN and late and "rotor_lag" not in names:
        yield not_judged("motor_lag_s", "the flight asks for another one than none")


def _whatever_lifts(found: Refinement, inputs: Inputs, bare: FlightFrame) -> Refinement | None:
    """The answer where the lift is off by more than a stand errs by, and a vehicle of the mass that is lifted
    shows the same names: they hang on no mass, and whether it is one is what stays open.

    None where the lift is not off, other numbers are at their bounds too, or the names are others.
    """
    body, lift = bare.airframe, lift_share(bare, found.corrections)
    off = [reason.premise for reason in at_bounds(found, bare)]
    if off != ["mass_kg"] or body.source_of("mass_kg") in UNKNOWN or "mass_change" in found.names:
        return None
    other = judge_flight(
        inputs, as_if(bare, replace(body, mass_kg=body.mass_kg / (1.0 + lift))), lambda _: None
    )
    if other.names - {"mass_change"} != found.names:
        return None
    groups = [a for a in found.ambiguous if MASS_OR_THRUST[0] not in a.names]
    return replace(found, ambiguous=(*groups, weighing(bare, lift)))


def _hangs_on(found: Refinement, inputs: Inputs, bare: FlightFrame) -> list[NotJudged]:
    """Premises that change the set of names when they are moved."""
    hangs: dict[str, NotJudged] = {}
    for moved in moves(bare.airframe):
        own = OWN.get(moved.premise)
        names = found.names - {own}
        declared = moved.premise == "mass_kg"
        if moved.premise in hangs or (declared and (not names or _held(moved, found, bare))):
            continue
        other = judge_flight(inputs, as_if(bare, moved.airframe), lambda _: None)
        now = other.names - {own}
        # somebody's word counts where the log bears it out against the other number
        if now == names or (declared and _error(other) > _error(found) + CLEARLY):
            continue
        reported, instead = (" and ".join(sorted(n)) or "nothing" for n in (names, now))
        hangs[moved.premise] = not_judged(
            moved.premise, f"{moved.words} {instead} is found in place of {reported}"
        )
    return list(hangs.values())


def _held(moved: Moved, found: Refinement, bare: FlightFrame) -> bool:
    """Whether the corrections of the lift, the accelerometer's zero among them, have room for that mass."""
    change = moved.airframe.mass_kg / bare.airframe.mass_kg - 1.0
    room = lift_room(bare) + ACCEL_BIAS_M_S2[2] / GRAVITY_M_S2
    return abs(change + lift_share(bare, found.corrections)) <= room


def _error(found: Refinement) -> float:
    """Logarithm of what is left of all channels."""
    return float(sum(np.log(max(c.rmse_after, 1e-12)) for c in found.channels.values()))


def refine_stand(
    logs: Samples | Sequence[Samples],
    model: RotorModel | None = None,
    *,
    progress: Progress = lambda _: None,
) -> Refinement:
    """Hold stand logs against a rotor model, or without one against the coaxial model fitted to themselves.

    Rows without a number in a load or a speed, and other columns with gaps, are left out, rows
    that stand in another order than that of `time_s` are sorted by it; notes say so.
    Raises InputError when speeds or loads are missing, or no fit can be made of the numbers.
    """
    several = [in_order_of_time(without_empty_cells(log)) for log in _several(logs)]

    def run() -> Refinement:
        from coaxlink.residual.answer.judge_stand import diagnose_stand

        return diagnose_stand(several, model, progress)

    return _answered(several, run)


def _several(logs: Samples | Sequence[Samples]) -> list[Samples]:
    return [logs] if isinstance(logs, Samples) else list(logs)


def _answered(logs: Sequence[Samples], run: Callable[[], Refinement]) -> Refinement:
    """The answer to logs whose numbers can be numbers of a measurement; else InputError."""
    for log in logs:
        for name, values in log.columns.items():
            most = float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))
            if most > LARGEST:
                raise InputError(log.source, name, f"{most:.3g} is no measured value: mend or drop its rows")
    try:
        with threadpool_limits(limits=1, user_api="blas"), np.errstate(all="ignore"):
            return run()
    except np.linalg.LinAlgError as error:
        source = logs[0].source if logs else ""
        raise InputError(
            source, "", f"no fit can be made of these numbers ({error}): are columns damaged?"
        ) from error
