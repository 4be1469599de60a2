"""Measured data against a model: find the residual, trace it to effects, report before and after.

All of it is many small products of matrices: more threads than one only wait for each other, and on a busy
machine take five times as long.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from coaxlink.airframe import Airframe
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from coaxlink.residual.agreement import agreed, leaves_open
from coaxlink.residual.answer.flight import judge_flight
from coaxlink.residual.answer.stand import judge_stand
from coaxlink.residual.channels.empty_cells import without_empty_cells
from coaxlink.residual.channels.row_order import in_order_of_time
from coaxlink.residual.result import Refinement
from coaxlink.rotor import RotorModel

Progress = Callable[[str], None]
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
    demands other numbers. `progress` is told each stage.
    Raises InputError when a log lacks what every flight needs.
    """
    several = _several(logs)

    def run() -> Refinement:
        return judge_flight(several, airframe, model, progress)

    return _answered(several, run)


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
        from coaxlink.residual.diagnosis.judge import diagnose_stand, reads_wrong

        if posterior_alone():
            return diagnose_stand(several, model, progress)
        selected = judge_stand(several, model, progress)
        if not (leaves_open(selected) or (selected.at_floor and reads_wrong(several, model))):
            return selected
        progress("weighing what is left")
        return agreed(selected, diagnose_stand(several, model, progress), several)

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


def posterior_alone() -> bool:
    """Whether stands are answered by the posterior alone: benchmarks hold both methods side by side."""
    return os.environ.get("COAXLINK_ENGINE", "") == "evidence"
