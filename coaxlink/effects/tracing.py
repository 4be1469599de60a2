"""How an effect is traced in a log: what its file says, and what is derived from it.

A file says what the effect does with its numbers (`adds` or `changes`) and where a search begins (`starts`,
`further`). Columns, what a fit may move, what physics refuses and the way back from a fit's coefficients are
derived here, from its parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from coaxlink.effects.parameter import Described, Linear, Numbers, Parameter

Array = NDArray[np.float64]
Shape = Mapping[str, float]  # the numbers of a form, its amounts at one
Frame = TypeVar("Frame")
KEPT_ROWS = 40_000  # of what a frame keeps: megabytes
SMALL = 1e-3  # of an amount that is believed to be nothing: where its slope is taken


class NotShown(Exception):
    """Why a log cannot show an effect, in words."""


@dataclass(frozen=True, eq=False)
class Tracing(Generic[Frame]):
    """How an effect shows in one kind of log, on top of the rotor model.

    `needs` are the log's columns, `channels` where it shows. `starts` (frame) are the numbers that a search
    begins from, one mapping a form, and raise NotShown where the log cannot show the effect; `further`
    (frame, numbers) are other forms to try from there. `cause` (frame, numbers, channel) is the variable
    (label, rows) that the picture of a channel is drawn over.

    One of two says what it does: `adds` (frame, numbers) is what it adds to the predicted loads,
    (rows, channels), linear in its amounts. `changes` (frame, numbers) is the frame with it in, for what
    turns rotors at other speeds or changes their pull, on which later effects act.
    """

    needs: tuple[str, ...]
    channels: tuple[str, ...]
    starts: Callable[[Frame], Sequence[Numbers]]
    cause: Callable[[Frame, Numbers, str], tuple[str, Array]]
    adds: Callable[[Frame, Numbers], Array] | None = None
    changes: Callable[[Frame, Numbers], Frame] | None = None
    further: Callable[[Frame, Numbers], Sequence[Numbers]] = lambda _, __: ()
    effect: Described = field(init=False, repr=False)  # whose file it stands in

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.effect.name

    @property
    def units(self) -> Mapping[str, str]:
        """{parameter: unit}."""
        return self.effect.units

    @property
    def physics(self) -> str:
        """What happens, in a sentence."""
        return self.effect.physics

    @property
    def source(self) -> str:
        """Where the formula is from."""
        return self.effect.source

    @property
    def stage(self) -> tuple[int, int]:
        """Effects act in this order, each on the frame that the earlier ones left."""
        return self.effect.order

    @property
    def sudden(self) -> bool:
        """Whether it may begin in mid-log."""
        return "onset_s" in self.effect.known

    def missing(self, frame: Frame) -> str | None:
        """Why this log cannot show it, or None."""
        try:
            self.starts(frame)
        except NotShown as why:
            return str(why)
        return None

    def shapes(self, frame: Frame) -> list[Shape]:
        """The forms that a search begins from."""
        return [self.inverse(frame, p)[0] for p in self.starts(frame)]

    def forms(self, frame: Frame) -> int:
        """How many of these differ by more than what a fit moves."""
        memo: dict[object, int] = frame.memo  # type: ignore[attr-defined]
        if self not in memo:
            shapes = [(s, self.free(frame, s)) for s in self.shapes(frame)]
            memo[self] = len({tuple(sorted((k, v) for k, v in s.items() if k not in f)) for s, f in shapes})
        return memo[self]

    def variants(self, frame: Frame, shape: Shape, coefficients: Array) -> list[tuple[Shape, Array]]:
        """Other forms, with coefficients to start from there."""
        own = self._own(frame, shape, coefficients)
        return [self.inverse(frame, p) for p in self.further(frame, own)]

    def free(self, frame: Frame, shape: Shape) -> dict[str, tuple[float, float]]:
        """What a fit moves in a form, and between which bounds."""
        known = self.effect.known
        return {name: known[name].bounds(frame, shape) for name in shape if known[name].is_moved(shape)}

    def inverse(self, frame: Frame, p: Numbers) -> tuple[Shape, Array]:
        """The form and its coefficients (K,) of named physical numbers."""
        own = {name: p[name] for name in p if name in self.effect.known}
        for follower in self.effect.following:
            if follower.name in own and follower.follows(frame, p) is not None:  # type: ignore[misc]
                del own[follower.name]
        amounts = self._amounts(own)
        values = [
            a.amount.amount(frame, own, own[a.name]) if isinstance(a.amount, Linear) else own[a.name]
            for a in amounts
        ]
        return own | dict.fromkeys((a.name for a in amounts), 1.0), np.array(values, float)

    def parameters(self, frame: Frame, shape: Shape, coefficients: Array) -> dict[str, float]:
        """The named physical numbers of a form and its coefficients (K,)."""
        out = self._own(frame, shape, coefficients)
        for p in self.effect.following:
            value = p.follows(frame, out)  # type: ignore[misc]
            if value is not None:
                out[p.name] = value
        return {name: out[name] for name in self.effect.known if name in out}  # as its file lists them

    def completed(self, frame: Frame, numbers: Numbers) -> dict[str, float]:
        """A rotor file's numbers, with what follows from them here; raises NotShown where one is missing."""
        out = dict(numbers)
        try:
            for p in self.effect.following:
                value = None if p.name in out else p.follows(frame, out)  # type: ignore[misc]
                out |= {} if value is None else {p.name: value}
            self.acting(frame, out)
        except KeyError as absent:
            raise NotShown(f"its number {absent.args[0]} is missing") from None
        return out

    def _own(self, frame: Frame, shape: Shape, coefficients: Array) -> dict[str, float]:
        """As `parameters`, without what follows from them; amounts first."""
        amounts = self._amounts(shape)
        out = dict.fromkeys((a.name for a in amounts), 0.0) | dict(shape)
        for a, c in zip(amounts, map(float, coefficients), strict=True):
            out[a.name] = a.amount.value(frame, out, c) if isinstance(a.amount, Linear) else c
        return out

    def _amounts(self, shape: Shape) -> list[Parameter]:
        return [p for p in self.effect.amounts if p.name in shape and not p.is_moved(shape)]

    def refuse(self, p: Numbers) -> str | None:
        """Why physics does not allow these numbers, or None."""
        known = self.effect.known
        return next((why for name in p if (why := known[name].refused(p))), None)

    def nil(self, frame: Frame) -> dict[str, float]:
        """What the numbers that say how much of it there is read where there is none; {}: not asked."""
        asked = {p.name: p.nil for p in self.effect.parameters if p.nil is not None}
        return {name: nil(frame) if callable(nil) else nil for name, nil in asked.items()}

    def columns(self, frame: Frame, shape: Shape) -> Array:
        """(rows, channels, K) that unit amounts add: where they bend, about what is believed of them."""
        amounts = self._amounts(shape)
        out: list[Array] = []
        nothing = np.zeros(len(amounts))
        none = 0.0 if self.changes is None else self._at(frame, shape, nothing)
        for k, a in enumerate(amounts):
            step, base, c = self._step(a), none, nothing.copy()
            if k and isinstance(a.amount, Linear):  # it may count per unit of the first
                c[0] = self._step(amounts[0])
                base = none + c[0] * out[0]
            c[k] = step
            added = self._at(frame, shape, c)
            out.append((added - base) / step)
        return np.stack(out, axis=-1) if len(out) > 1 else out[0][..., None]

    def _step(self, a: Parameter) -> float:
        if isinstance(a.amount, Linear):
            return SMALL
        if self.changes is None:
            return 1.0
        return a.prior[0] if a.prior and a.prior[0] else SMALL

    def _at(self, frame: Frame, shape: Shape, coefficients: Array) -> Array:
        """(rows, channels) added, or predicted, with these coefficients (K,)."""
        numbers = self.parameters(frame, shape, coefficients)
        if self.changes is not None:
            return np.asarray(self.changes(frame, numbers).predicted)  # type: ignore[attr-defined]
        assert self.adds is not None
        return np.asarray(self.adds(frame, numbers))

    def contribution(self, frame: Frame, parameters: Numbers) -> Array:
        """(rows, channels) that the effect adds with these physical parameters."""
        if self.adds is None:
            return np.asarray(self.acting(frame, parameters).predicted - frame.predicted)  # type: ignore[attr-defined]
        memo: dict[object, Any] = frame.memo  # type: ignore[attr-defined]
        last, added = memo.get("added", (None, np.empty(0)))
        if last != (self, parameters):
            added = np.asarray(self.adds(frame, parameters))
            if len(added) < KEPT_ROWS:
                memo["added"] = (self, dict(parameters)), added
        return added

    def acting(self, frame: Frame, parameters: Numbers) -> Frame:
        """The frame with the effect in its prediction."""
        if self.changes is not None:
            return self.changes(frame, parameters)
        predicted = frame.predicted + self.contribution(frame, parameters)  # type: ignore[attr-defined]
        return replace(frame, predicted=predicted)  # type: ignore[type-var]
