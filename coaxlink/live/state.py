"""What the live loop knows of the vehicle and its motors: one record, in Python and in compiled code."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

MOTORS = 8  # what the messages carry
FIRST_DT_S, MOST_DT_S = 0.004, 0.05  # between demands, where it is not known or out of the ordinary

RECORD = np.dtype(
    [
        ("count", "i8"),  # of motors
        ("last_us", "i8"),  # stamp of the last demand admitted, vehicle's clock; -1 before the first
        ("dt_s", "f8"),  # between the last two
        ("held", "f8", 4),  # that demand: roll, pitch, yaw, thrust
        ("extra", "f8", 4),  # wrench that the effects add, N and N m
        ("factor", "f8"),  # speed per command
        ("lag_s", "f8"),  # of the motors, and what it is led down to; 0 for no lead
        ("quick_s", "f8"),
        ("speeds", "f8", MOTORS),  # of the law
        ("motors", "f8", MOTORS),  # speeds the motors are taken to have
        ("commands", "f8", MOTORS),  # the last ones
        ("error", "f8", 4),  # delivered by the rotor model minus demanded, N and N m
        ("given_up", "i8"),  # whether the law gave an axis up
        # what `kernel.exchange` alone needs
        ("system", "i8"), ("component", "i8"), ("own_system", "i8"), ("own_component", "i8"),
        ("scale", "f8", (4, 4)),  # wrench by control
        ("inverse", "f8", 4), ("order", "i8", 4), ("slots", "i8", MOTORS),  # the exact law's units
        ("peer", "i8", 4), ("peer_size", "i8"),  # address of the vehicle, as the kernel has it
        ("deadline_ns", "i8"), ("quiet_ns", "i8"),  # later demands are Python's; from the last one
        ("until_ns", "i8"),  # Python has its turn; clocks are monotonic
        ("answers", "i8"),  # rows of the log written this turn
    ],
    align=True,
)  # fmt: skip
# one answer of the compiled function
LOG = np.dtype(
    [
        ("stamp_us", "i8"), ("came_ns", "i8"), ("sent_ns", "i8"), ("held", "f8", 4),
        ("commands", "f8", MOTORS), ("error", "f8", 4), ("given_up", "i8"),
        ("received", "u1", 64), ("sent", "u1", 64),  # frames
    ],
    align=True,
)  # fmt: skip
ROWS = 128
ANSWER = tuple[int, int, int, list[float], list[float], list[float], int, bytes, bytes]  # a row in Python


class SharedState:
    """The record for the compiled function, `array` (1,), and its fields as attributes for Python."""

    def __init__(self) -> None:
        self.array = np.zeros(1, RECORD)
        # views, made once: numpy's own record takes 3 us to find a field
        self._views = {name: self.array[name] for name in RECORD.names or ()}
        self.__dict__.update({name: view[0] for name, view in self._views.items() if view.ndim > 1})

    def __getattr__(self, name: str) -> Any:
        return self._views[name].item()

    def __setattr__(self, name: str, value: Any) -> None:
        if name in (RECORD.names or ()):
            self._views[name][0] = value
        else:
            super().__setattr__(name, value)


def shared_state() -> SharedState:
    """As new."""
    state = SharedState()
    state.last_us, state.dt_s, state.factor = -1, FIRST_DT_S, 1.0
    return state


def plain_state() -> Any:
    """The same in Python's own numbers and lists, which cost Python a fifth."""
    array = shared_state().array
    return SimpleNamespace(**{name: array[name][0].tolist() for name in RECORD.names or ()})
