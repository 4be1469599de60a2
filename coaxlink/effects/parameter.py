"""What an effect is: its numbers with units, bounds and what is believed of them, and where it acts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Any

Numbers = Mapping[str, float]
Range = tuple[float, float]
LEAST = 1e-12  # of an amount that another comes per unit of


@dataclass(frozen=True)
class Linear:
    """What a contribution is linear in, where that is not the number itself: 1 - 1 / m of a mass m.

    `amount` (frame, numbers, value) works it out, `value` (frame, numbers, amount) turns it back; of the
    numbers those before it are there.
    """

    amount: Callable[[Any, Numbers, float], float]
    value: Callable[[Any, Numbers, float], float]


@dataclass(frozen=True)
class Parameter:
    """One number of an effect: its unit ("1" for none), the bounds that physics sets, and what is believed.

    `prior` is what is believed before any data: (mean, standard deviation) of a sound vehicle that has the
    effect; None where any value between the bounds is as likely. `source` says where prior and bounds are
    from: a paper, a law of physics, "assumed: ..." with the reasoning, or, without a prior, "wide: ..." with
    the reason why nothing is known, "a switch, ..." for a form, "a number of ..." for a label.

    How it enters: an `amount` is what the contribution is linear in, with the other amounts (or a `Linear`
    of it is); what `moves` bends it, and is fitted; a switch or label stays as a start has it. `moves` may
    name numbers of which one must be there too. What `follows` (frame, numbers) from the others is worked
    out, not fitted; None: here it does not. `nil` is what it reads where there is no effect, if it says how
    much of one there is; `within` (frame or None, numbers) are narrower bounds than `low` and `high`: beside
    these numbers, or in this log.
    """

    name: str
    unit: str
    low: float
    high: float
    prior: tuple[float, float] | None = None
    source: str = field(kw_only=True)
    amount: bool | Linear = field(default=False, kw_only=True)
    moves: bool | tuple[str, ...] = field(default=False, kw_only=True)
    follows: Callable[[Any, Numbers], float | None] | None = field(default=None, kw_only=True)
    nil: float | Callable[[Any], float] | None = field(default=None, kw_only=True)
    within: Callable[[Any, Numbers], Range] | None = field(default=None, kw_only=True)

    def is_moved(self, beside: Numbers) -> bool:
        """Whether a fit moves it beside these numbers."""
        return self.moves if isinstance(self.moves, bool) else any(name in beside for name in self.moves)

    def bounds(self, frame: Any, beside: Numbers) -> Range:
        """Beside these numbers; with a frame, what that log can tell."""
        return (self.low, self.high) if self.within is None else self.within(frame, beside)

    def refused(self, numbers: Numbers) -> str | None:
        """Why its value is not physical, or None."""
        value, (low, high) = numbers[self.name], self.bounds(None, numbers)
        if low <= value <= high:
            return None
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name} = {value:.3g}{unit} is outside {low:g} .. {high:g}"


def per(*names: str, origin: Callable[[Any], float] = lambda _: 0.0) -> Linear:
    """Of a number that counts, from `origin` (frame), per unit of an amount: the one of `names` that is
    there."""

    def unit(p: Numbers) -> float:
        return next(p[name] for name in names if name in p)

    def value(frame: Any, p: Numbers, amount: float) -> float:
        beside = unit(p)
        return origin(frame) + amount / (beside if abs(beside) > LEAST else LEAST)

    return Linear(lambda frame, p, value: unit(p) * (value - origin(frame)), value)


class Stage(Enum):
    """Where in the chain from command to column an effect acts."""

    DRIVE = "drive"  # command -> rotor speed
    ROTOR = "rotor"  # rotor speed -> loads of the pair
    AIR = "air"  # what the air around does to the loads
    BODY = "body"  # loads -> motion of the vehicle
    STAND = "stand"  # loads -> what the stand holds
    INSTRUMENT = "instrument"  # what is there -> what is recorded


@dataclass(frozen=True, eq=False)
class Described:
    """An effect by its numbers: what happens (`physics`), and where its formula is from."""

    name: str
    stage: Stage
    physics: str
    source: str
    parameters: tuple[Parameter, ...]
    place: int = field(
        default=0, kw_only=True
    )  # in its stage, whose effects act on one another in this order

    @property
    def order(self) -> tuple[int, int]:
        """Effects act in this order, each on what the earlier ones left."""
        return list(Stage).index(self.stage), self.place

    @cached_property
    def known(self) -> dict[str, Parameter]:
        """{name: parameter}."""
        return {p.name: p for p in self.parameters}

    @cached_property
    def amounts(self) -> tuple[Parameter, ...]:
        """What contributions are linear in."""
        return tuple(p for p in self.parameters if p.amount)

    @cached_property
    def following(self) -> tuple[Parameter, ...]:
        """What follows from the others."""
        return tuple(p for p in self.parameters if p.follows)

    @cached_property
    def units(self) -> dict[str, str]:
        """{parameter: unit}."""
        return {p.name: p.unit for p in self.parameters}
