"""A discrepancy model: what polynomials of a fitted nuisance model miss, as a Gaussian process of every load.

Kennedy and O'Hagan, Bayesian calibration of computer models (2001): the effects are judged beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from coaxlink.frames import STAND_CHANNELS, Array, StandFrame
from coaxlink.residual.answer.assemble import Judged, held_out_residual
from coaxlink.residual.channels.stand import POLYNOMIALS, predict
from coaxlink.residual.channels.stand_problem import reducing, stand_floor, stand_problem, stand_variables
from coaxlink.residual.checks.posterior_check import undone
from coaxlink.residual.nuisance.gaussian_process import Process, find_process
from coaxlink.residual.regression.blocks import held_out
from coaxlink.residual.regression.irls import channel_errors
from coaxlink.residual.regression.joint_model import Joint, composed
from coaxlink.residual.search.joint_fit import fit_jointly
from coaxlink.residual.search.select import Selection
from coaxlink.residual.search.trial import ALPHA, Judge, columns_of
from coaxlink.rotor.model import LOADS

KNOWN = 1.0  # times the noise: a nuisance model less well known than that is none to hold a row against
MOST_UNKNOWN = 0.3  # of the rows
LEAST_NOISE = 2e-4  # of the reference load
OF_SPEED = {"blade_speed_law"}  # a law of the speeds: a process over them can always be confounded with it
LESS = 0.005  # of the error: by how much it must follow better than the polynomials


def floor_beside(frame: StandFrame, joint: Joint) -> Array:
    """(C,) noise of what the joint fit leaves."""
    q = joint.problem
    return stand_floor(frame, held_out_residual(q, held_out(q.blocks, columns_of(q, list(q.options)))[1]))


def log_error(joint: Joint) -> float:
    """Mean over channels of the logarithm of the held-out error, in the channels' units."""
    q = joint.problem
    return float(np.mean(np.log(np.maximum(channel_errors(q, q.options), 1e-12))))


def with_discrepancy_model(j: Judged) -> Judged:
    """The same effects beside Gaussian processes of every load, if these leave less; else as it was.

    What had was confounded with a misfit of the polynomials goes: a law of the speeds alone, whose place a
    process over the speeds can take, only if that leaves less. Rows at speeds that no other block covers
    are not judged.
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

    def beside(selection: Selection) -> Joint:
        return fit_jointly(problem, selection, rich, (), reducing(rich), settled)[0]

    selection, joint = j.selection, beside(j.selection)
    needless = _needless(joint)
    stood_in = needless - OF_SPEED
    if needless > stood_in and log_error(beside(undone(selection, needless))) < log_error(joint) - LESS:
        stood_in = needless
    if stood_in:
        selection = undone(selection, stood_in, "needless beside the discrepancy model")
        joint = beside(selection)
    more = log_error(joint) - log_error(j.joint)
    if {m.name for m in joint.members} != set(settled) - stood_in or more > (LESS if stood_in else -LESS):
        return j
    floor, variables = floor_beside(rich, joint), stand_variables(rich)
    return replace(j, problem=problem, selection=selection, joint=joint, floor=floor, variables=variables)


def _needless(joint: Joint) -> set[str]:
    """Names of members without which the other blocks are predicted as well."""
    judge, options = Judge(joint.problem), list(joint.problem.options)
    trials = {o.name: judge.trial([other for other in options if other is not o], o) for o in options}
    return {name for name, trial in trials.items() if trial.gain <= 0.0 or trial.p_value > ALPHA}


def _notes(bare: StandFrame, processes: Mapping[int, Process], unknown: int) -> tuple[str, ...]:
    """What was said before, but of curves that the processes take the place of."""
    names = ", ".join(STAND_CHANNELS[c] for c in processes)
    notes = [note for note in bare.notes if POLYNOMIALS not in note]
    notes.append(f"{names}: {POLYNOMIALS}; errors are beside a Gaussian process over the speeds")
    if unknown:
        notes.append(f"{unknown} rows at speeds that no other part of the log covers: not judged")
    return tuple(notes)
