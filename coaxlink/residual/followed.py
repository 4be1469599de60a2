"""An own fit judged beside a base that follows the pair wherever the log tells what it does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from coaxlink.residual.answer import Judged, held_out_residual
from coaxlink.residual.blocks import held_out
from coaxlink.residual.frames import STAND_CHANNELS, Array, StandFrame
from coaxlink.residual.joint import Joint, composed
from coaxlink.residual.kriging import Process, find_process
from coaxlink.residual.reweigh import channel_errors
from coaxlink.residual.select import columns_of
from coaxlink.residual.stand import POLYNOMIALS, predict
from coaxlink.residual.stand_problem import reducing, stand_floor, stand_problem, stand_variables
from coaxlink.residual.together import together
from coaxlink.rotor.model import LOADS

KNOWN = 1.0  # times the noise: a base less well known than that is none to hold a row against
MOST_UNKNOWN = 0.3  # of the rows
LEAST_NOISE = 2e-4  # of the reference load
LESS = 0.005  # of the error: by how much it must follow better than the polynomials


def own_floor(frame: StandFrame, joint: Joint) -> Array:
    """(C,) noise of what the joint fit leaves."""
    q = joint.problem
    return stand_floor(frame, held_out_residual(q, held_out(q.blocks, columns_of(q, list(q.options)))[1]))


def log_error(joint: Joint) -> float:
    """Mean over channels of the logarithm of the held-out error, in the channels' units."""
    q = joint.problem
    return float(np.mean(np.log(np.maximum(channel_errors(q, q.options), 1e-12))))


def followed(j: Judged) -> Judged:
    """The same effects beside Gaussian processes of every load, if these leave less; else as it was.

    Rows at speeds of which no other block tells enough are not judged.
    """
    bare, q = j.problem.frame, j.joint.problem
    if j.selection.ambiguous or j.selection.doubtful:
        return j
    acting = composed(bare, [(m.effect, m.parameters(bare)) for m in j.joint.members])
    loads = bare.measured - (acting.predicted - bare.predicted)
    u, fold = bare.speeds[bare.keep], q.blocks.fold[q.block]
    processes: dict[int, Process] = {}
    unknown = np.zeros(len(u))
    for k, c in enumerate(bare.present):
        if c < 4:
            terms, reference = tuple(bare.model.terms()[LOADS[c]]), float(bare.reference[c])
            noise = max(float(j.floor[k]), LEAST_NOISE * reference)
            found = find_process(u, loads[bare.keep, c], fold, noise, reference, terms, c > 1)
            processes[c] = found[0]
            unknown = np.maximum(unknown, found[1])
    judged = unknown <= max(KNOWN, float(np.quantile(unknown, 1.0 - MOST_UNKNOWN)))
    notes = _notes(bare, processes, int(np.sum(~judged)))
    rich = predict(replace(bare, surfaces=processes, keep=bare.keep[judged], notes=notes))
    problem = stand_problem(rich, [m.effect for m in j.joint.members])
    problem = replace(problem, impossible=j.problem.impossible)
    settled = {m.name: m for m in j.joint.members}
    joint, _ = together(problem, j.selection, rich, (), reducing(rich), settled)
    if {m.name for m in joint.members} != set(settled) or log_error(joint) > log_error(j.joint) - LESS:
        return j
    variables = stand_variables(rich)
    return replace(j, problem=problem, joint=joint, floor=own_floor(rich, joint), variables=variables)


def _notes(bare: StandFrame, processes: Mapping[int, Process], unknown: int) -> tuple[str, ...]:
    """What was said before, but of curves that the processes take the place of."""
    names = ", ".join(STAND_CHANNELS[c] for c in processes)
    notes = [note for note in bare.notes if POLYNOMIALS not in note]
    notes.append(
        f"{names}: {POLYNOMIALS}; errors are beside a Gaussian process over the speeds, which a rotor file"
        " does not hold"
    )
    if unknown:
        notes.append(f"{unknown} rows at speeds of which no other part of the log tells enough: not judged")
    return tuple(notes)
