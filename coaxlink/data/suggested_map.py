"""A map (`columns_map`) of a log that was refused for its headings: what was understood, and what is likely.

It can be pasted as it stands. Which rotor is the upper one it cannot know, and says so.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType

from coaxlink.data.aliases import (
    OF_A_ROTOR,
    OWN_COLUMNS,
    PAIR,
    QUANTITIES,
    SIDES,
    Unit,
    find_unit,
    unit_names,
)
from coaxlink.data.headings import line_for, plain_line, recognised, rotor_and_unit, scale_line
from coaxlink.data.table import TextTable

BY_UNIT = ("thrust", "torque", "speed")  # quantities that a unit tells, where no word does
NONE: Mapping[str, float] = MappingProxyType({})


def suggested_map(table: TextTable, upper: str = "", scales: Mapping[str, float] = NONE) -> str:
    """Lines of TOML; "" where nothing of a rotor is understood. `scales` of our names replace their units."""
    lines: dict[str, str] = {}
    unsure: list[str] = []
    meanings = list(_meanings(table))
    labels = list(
        dict.fromkeys(label for _, quantity, label, _ in meanings if label or quantity in OF_A_ROTOR)
    )
    order = sorted(labels, key=lambda label: label.casefold() != upper.casefold()) if upper else labels
    sides = {label: label if label in SIDES else side for label, side in zip(order, SIDES, strict=False)}
    for index, quantity, label, unit in meanings:
        text, suffix = table.headings[index], QUANTITIES[quantity].suffix
        name = text if text in OWN_COLUMNS else f"{sides[label]}_{suffix}" if label in sides else suffix
        if name in lines or name not in OWN_COLUMNS:
            continue
        if name in scales:
            lines[name] = scale_line(name, text, scales[name])
        elif text == name:
            lines[name] = plain_line(name, text)
        else:
            unsure += [name] if unit is None else []
            lines[name] = line_for(name, text, unit.name if unit else unit_names(quantity)[0])
    if not any(name.startswith(SIDES) for name in lines):
        return ""
    reported = []
    if len(order) > 1 and not upper and not set(order) <= set(SIDES):
        first = order[0].upper() or "the unnamed one"
        reported.append(f"# {first} is taken for the upper rotor: exchange upper_ and lower_ if it is not")
    if unsure:
        reported.append(f"# no unit stands in the file: make sure of {', '.join(unsure)}")
    return "\n".join([*reported, *lines.values()])


def _meanings(table: TextTable) -> Iterator[tuple[int, str, str, Unit | None]]:
    """(column, quantity, rotor's label, unit) of columns of numbers, by their words, else by their units."""
    known = {h.index: h for h in recognised(table)}
    for index, text in enumerate(table.headings):
        if not text or table.column_is_empty(index) or not table.is_numbers(index):
            continue
        heading = known.get(index)
        if heading is not None:
            if not heading.shaft and heading.label != PAIR:
                yield index, heading.quantity, heading.label, heading.unit
            continue
        label, written = rotor_and_unit(text, table.units[index])
        quantity = next((q for q in BY_UNIT if label and written and find_unit(q, written)), None)
        if quantity is not None:
            yield index, quantity, label, find_unit(quantity, written)
