"""Measured data against a model: find the residual, trace it to effects, report before and after.

All of it is many small products of matrices: more threads than one only wait for each other, and on a busy
machine take five times as long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from threadpoolctl import threadpool_limits

from coaxlink.airframe import Airframe
from coaxlink.data.samples import Samples
from coaxlink.residual.judge_flight import judge_flight
from coaxlink.residual.judge_stand import judge_stand
from coaxlink.residual.result import Refinement
from coaxlink.rotor import RotorModel

Progress = Callable[[str], None]


def refine(
    logs: Samples | Sequence[Samples],
    airframe: Airframe,
    model: RotorModel,
    *,
    progress: Progress = lambda _: None,
) -> Refinement:
    """Hold flight logs against a rotor model on its airframe.

    `model` may carry effects already: they are part of the prediction, and are fitted again where the log
    demands other numbers. `progress` is told each stage.
    Raises InputError when a log lacks what every flight needs.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        return judge_flight(_several(logs), airframe, model, progress)


def refine_stand(
    logs: Samples | Sequence[Samples],
    model: RotorModel | None = None,
    *,
    progress: Progress = lambda _: None,
) -> Refinement:
    """Hold stand logs against a rotor model, or without one against the coaxial model fitted to themselves.

    Raises InputError when speeds or loads are missing.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        return judge_stand(_several(logs), model, progress)


def _several(logs: Samples | Sequence[Samples]) -> list[Samples]:
    return [logs] if isinstance(logs, Samples) else list(logs)
