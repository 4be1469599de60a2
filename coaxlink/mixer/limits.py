"""What a user may require of a fitted table besides being right: limits, and the TOML file that states them.

    [[limit]]
    kind = "ceiling_N"      # level thrust when the first rotor is at full speed
    min = 440.0

`speed` (rotors, max): normalised speed over the envelope. `hover_share` (min, max): the upper rotor's share
of its pair's thrust in hover. `ceiling_N`, `yaw_Nm` (min): level thrust, and moment in hover, when the first
rotor is at a bound. `equal` (of = "levels" or "mirror"): the same numbers for all rotors of a level, or for
left and right.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from coaxlink import files
from coaxlink.airframe import Airframe
from coaxlink.errors import InputError
from coaxlink.rotor.model import input_error

# kind: (the numbers it takes, the range they make sense in, decimals shown, unit)
KINDS: dict[str, tuple[tuple[str, ...], tuple[float, float], int, str]] = {
    "speed": (("max",), (0.0, 1.0), 3, ""),
    "hover_share": (("min", "max"), (0.0, 1.0), 3, ""),
    "ceiling_N": (("min",), (0.0, 1e6), 1, " N"),
    "yaw_Nm": (("min",), (0.0, 1e5), 2, " N m"),
    "equal": ((), (0.0, 0.0), 0, ""),
}
WORDS = {
    "speed": "speed over the envelope",
    "hover_share": "upper rotors' share of the thrust in hover",
    "ceiling_N": "ceiling",
    "yaw_Nm": "yaw in hover",
    "equal": "the same numbers",
}


@dataclass(frozen=True)
class Limit:
    """One wish; see the module for the kinds."""

    kind: str
    low: float | None = None
    high: float | None = None
    rotors: tuple[int, ...] = ()  # numbers, of speed; none means all
    of: str = ""  # of equal: levels or mirror

    def __str__(self) -> str:
        if self.kind == "equal":
            return (
                "the same numbers left and right" if self.of == "mirror" else "the same numbers for a level"
            )
        shown = [
            f"at {w} {self.shown(x)}" for w, x in (("least", self.low), ("most", self.high)) if x is not None
        ]
        who = f" of rotor {', '.join(map(str, self.rotors))}" if self.rotors else ""
        return f"{WORDS[self.kind]}{who} {' and '.join(shown)}"

    def shown(self, value: float) -> str:
        """A value with its unit."""
        _, _, decimals, unit = KINDS[self.kind]
        return f"{value:.{decimals}f}{unit}"

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        given = {"kind": self.kind, "min": self.low, "max": self.high, "rotors": list(self.rotors)}
        return {key: value for key, value in (given | {"of": self.of}).items() if value not in (None, [], "")}


Number = Annotated[float | None, Field(allow_inf_nan=False)]


class _Limit(BaseModel):
    model_config = ConfigDict(extra="forbid")
    kind: Literal["speed", "hover_share", "ceiling_N", "yaw_Nm", "equal"]
    min: Number = None
    max: Number = None
    rotors: list[int] = Field(default_factory=list, max_length=64)
    of: Literal["", "levels", "mirror"] = ""


class _LimitsFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    limit: Annotated[list[_Limit], Field(min_length=1, max_length=32)]


def load_limits(path: str | Path, airframe: Airframe) -> tuple[Limit, ...]:
    """Read a file of limits for this vehicle. Raises InputError naming the file and the key."""
    path = Path(path)
    try:
        parsed = _LimitsFile.model_validate(files.read_toml(path))
    except ValidationError as error:
        raise input_error(path, error, _LimitsFile) from error
    found = []
    for n, raw in enumerate(parsed.limit, start=1):
        limit = Limit(raw.kind, raw.min, raw.max, tuple(raw.rotors), raw.of)
        if problem := _problem(limit, raw, airframe):
            raise InputError(path, f"limit[{n}] ({raw.kind})", problem)
        found.append(limit)
    return tuple(found)


def _problem(limit: Limit, raw: _Limit, airframe: Airframe) -> str:
    takes, (least, most), _, _ = KINDS[limit.kind]
    given: dict[str, Any] = {k: getattr(raw, k) for k in ("min", "max") if getattr(raw, k) is not None}
    if extra := [name for name in given if name not in takes]:
        return f"{extra[0]} is not for this kind; {' or '.join(takes) or 'of'} is expected"
    if takes and not given:
        return f"{' or '.join(takes)} is expected"
    if wrong := [name for name, value in given.items() if not least < value <= most]:
        return f"{wrong[0]}: above {least:g} and at most {most:g} is expected, found {given[wrong[0]]:g}"
    if limit.low is not None and limit.high is not None and limit.low > limit.high:
        return f"min {limit.low:g} is above max {limit.high:g}"
    if (limit.kind == "equal") != bool(limit.of):
        return 'of = "levels" or "mirror" is expected' if limit.kind == "equal" else "of is for kind equal"
    if limit.rotors and limit.kind != "speed":
        return "rotors is for kind speed"
    if unknown := [n for n in limit.rotors if not 1 <= n <= len(airframe.rotors)]:
        return f"rotors: {airframe.name} has 1 to {len(airframe.rotors)}, found {unknown[0]}"
    if limit.kind == "hover_share" and not airframe.pairs:
        return f"{airframe.name} has no coaxial pair"
    return ""
