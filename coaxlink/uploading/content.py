"""What an upload touches on board: parameters by name, files by path."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from coaxlink.mavlink.parameters import Value

BoardFiles = Mapping[str, bytes | None]  # by path; None: no such file


@dataclass(frozen=True)
class Content:
    """Parameters and files as they are or as they are to be."""

    values: Mapping[str, Value] = field(default_factory=dict)
    files: BoardFiles = field(default_factory=dict)

    def over(self, other: Content) -> Content:
        """This content, and what only `other` has."""
        return Content({**other.values, **self.values}, {**other.files, **self.files})

    def differs_from(self, other: Content) -> Content:
        """The part of this content that `other` lacks or has otherwise."""
        return Content(
            {n: v for n, v in self.values.items() if n not in other.values or not v.same(other.values[n])},
            {p: d for p, d in self.files.items() if p not in other.files or other.files[p] != d},
        )

    def only(self, names: Content) -> Content:
        """The part of this content that `names` has too, whatever it says there."""
        return Content(
            {n: v for n, v in self.values.items() if n in names.values},
            {p: d for p, d in self.files.items() if p in names.files},
        )

    def without(self, names: Collection[str]) -> Content:
        """This content but for some parameters."""
        return Content({n: v for n, v in self.values.items() if n not in names}, self.files)
