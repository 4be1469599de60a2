"""Which of a board's parameters the board writes by itself: by its own metadata where it serves any, else by
the lists in `firmware_params`.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from coaxlink.mavlink.identity import Identity
from coaxlink.mavlink.parameters import Snapshot, Value
from coaxlink.uploading.content import Content
from coaxlink.uploading.limits import Limits
from firmware_params.ardupilot.owned import OWNED as ARDUPILOT
from firmware_params.owned import LEARNED, Owned, kind_of
from firmware_params.px4.owned import OWNED as PX4


@dataclass(frozen=True)
class Ownership:
    """What one board owns, given what it holds now."""

    identity: Identity
    values: Mapping[str, Value] = field(default_factory=dict)
    limits: Mapping[str, Limits] | None = None  # the board's own metadata

    def kind(self, name: str) -> str:
        """Why `name` is the board's ("counter", "learned" ...), "" when it is the user's."""
        if self.limits is not None and name in self.limits:
            if not self.limits[name].volatile:
                return ""
            return self._listed(name) or "volatile"
        return self._listed(name)

    def learned(self, name: str) -> bool:
        """Whether another value than the one written is what the board learned since."""
        return self.kind(name) == LEARNED

    def _listed(self, name: str) -> str:
        return kind_of(_rows(self.identity), name, self._numbers)

    @functools.cached_property
    def _numbers(self) -> dict[str, float]:
        return {n: float(v.value) for n, v in self.values.items()}


def switches(identity: Identity, names: Iterable[str]) -> list[str]:
    """The parameters that say whether the board learns any of `names`."""
    wanted = list(names)
    return [row.switch for row in _rows(identity) if row.switch and any(row.owns(n, {}) for n in wanted)]


def learned_since(changes: Content, snapshot: Snapshot, identity: Identity) -> tuple[str, ...]:
    """The names of `changes` when a board that holds all else has merely learned these; else none.

    A table that changes anything else wants its own value: it is another vehicle's hover then.
    """
    ownership = Ownership(identity, snapshot.values)
    if changes.files or not all(n in snapshot.values and ownership.learned(n) for n in changes.values):
        return ()
    return tuple(changes.values)


def _rows(identity: Identity) -> tuple[Owned, ...]:
    return PX4 if identity.is_px4 else ARDUPILOT if identity.is_ardupilot else ()
