"""Keys of a file that nobody knows: the first one by name, with the known key that is nearest to it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping

NEAR = 0.6  # difflib's own cut-off for a close match
SLIP = 0.85  # a letter or two in ten: of names that may be anything, nearer than that is a slip


def unknown_key(table: Mapping[str, object], known: Iterable[str]) -> tuple[str, str] | None:
    """(key, problem) of the first key of `table` that is not in `known`, or None.

    >>> unknown_key({"motor_lag": 0.02}, ["mass_kg", "motor_lag_s"])
    ('motor_lag', 'unknown; motor_lag_s?')
    """
    names = list(known)
    key = next((key for key in table if key not in names), None)
    return None if key is None else (key, problem_of(key, names))


def problem_of(key: str, known: Iterable[str]) -> str:
    """Why `key` is refused: the nearest known key, or all of them where none is near."""
    names = list(known)
    by_case = {name.casefold(): name for name in names}
    near = difflib.get_close_matches(key.casefold(), list(by_case), 1, NEAR)
    return f"unknown; {by_case[near[0]]}?" if near else f"unknown; one of {', '.join(names)} is expected"


def misspelt(key: str, known: Iterable[str]) -> str | None:
    """The known name that `key` is meant to be, where names of other kinds are welcome too, or None.

    >>> misspelt("degraded_rotr", ["degraded_rotor", "wind"]), misspelt("blade_flutter", ["blade_speed_law"])
    ('degraded_rotor', None)
    """
    names = {name.casefold(): name for name in known}
    if key in names.values():
        return None
    near = difflib.get_close_matches(key.casefold(), list(names), 1, SLIP)
    return names[near[0]] if near else None


def is_near(key: str, names: Iterable[str]) -> bool:
    """Whether `key` may be one of `names`, misspelt."""
    return bool(difflib.get_close_matches(key.casefold(), [n.casefold() for n in names], 1, NEAR))
