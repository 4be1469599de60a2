"""The physical effects that coaxlink knows, one module each; `register` adds one from outside.

A module of this package that defines `EFFECT` (or `EFFECTS`) is found by itself.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from contextlib import contextmanager

from coaxlink.effects.base import Parameter, PhysicalEffect, Stage
from coaxlink.effects.static import Conditions, LeftOut
from coaxlink.effects.tracing import NotShown, Tracing
from coaxlink.frames import FlightFrame, StandFrame

__all__ = [
    "Conditions",
    "LeftOut",
    "NotShown",
    "Parameter",
    "PhysicalEffect",
    "Stage",
    "Tracing",
    "effect",
    "effects",
    "flight_effects",
    "register",
    "registered",
    "stand_effects",
]

_known: dict[str, PhysicalEffect] = {}


def _find() -> None:
    for module in pkgutil.iter_modules(__path__):
        loaded = importlib.import_module(f"{__name__}.{module.name}")
        found = getattr(loaded, "EFFECTS", None) or [getattr(loaded, "EFFECT", None)]
        for one in found:
            if one is not None:
                register(one)


def register(new: PhysicalEffect) -> None:
    """Make an effect known everywhere: tracing, tables, live mixing, reports. Raises ValueError."""
    if new.name in _known:
        raise ValueError(f"an effect named {new.name} is known already")
    _known[new.name] = new


@contextmanager
def registered(new: PhysicalEffect) -> Iterator[PhysicalEffect]:
    """`register` for the length of a block."""
    register(new)
    try:
        yield new
    finally:
        del _known[new.name]


def effects() -> tuple[PhysicalEffect, ...]:
    """Every effect."""
    return tuple(_known.values())


def effect(name: str) -> PhysicalEffect | None:
    """The effect of that name, None where there is none."""
    return _known.get(name)


def flight_effects() -> tuple[Tracing[FlightFrame], ...]:
    """What can be traced in flights."""
    return tuple(e.flight for e in _known.values() if e.flight)


def stand_effects() -> tuple[Tracing[StandFrame], ...]:
    """What can be traced on stands."""
    return tuple(e.stand for e in _known.values() if e.stand)


_find()
