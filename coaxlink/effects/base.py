"""What an effect is to all of coaxlink: its numbers, and what tracing, tables and live mixing make of it.

One module an effect. Each defines `EFFECT` (or `EFFECTS`), a `PhysicalEffect`, and keeps its formula in one
function that tracing, the static mixers and live mixing all call.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from coaxlink.effects.live import LiveView, Part, SpeedPart
from coaxlink.effects.parameter import Described, Numbers, Parameter, Stage
from coaxlink.effects.static import StaticVehicle
from coaxlink.effects.tracing import Tracing
from coaxlink.errors import InputError
from coaxlink.frames import FlightFrame, StandFrame

__all__ = ["FORMERLY", "Numbers", "Parameter", "PhysicalEffect", "Stage"]

# switches that rotor files of earlier versions have; their other numbers say as much
FORMERLY = frozenset({"alike", "amplifier", "apart", "beside_drag", "both", "command", "creep", "each"})
FORMERLY |= {"magnets", "room", "span", "whole"}


@dataclass(frozen=True, eq=False)
class PhysicalEffect(Described):
    """An effect and everything that is made of it.

    `static` puts it into a vehicle at stated conditions and says in words what it did, or raises LeftOut;
    `live` gives the wrench (4,) it adds, `live_speed` the speed per command, from what the vehicle sends.
    Where one of them is None, `no_static` and `no_live` say why.
    """

    flight: Tracing[FlightFrame] | None = None
    stand: Tracing[StandFrame] | None = None
    static: Callable[[StaticVehicle, Numbers], str] | None = None
    live: Callable[[LiveView, Numbers], Part] | None = None
    live_speed: Callable[[LiveView, Numbers], SpeedPart] | None = None
    required: tuple[str, ...] = ()  # numbers that static and live mixing cannot do without
    messages: Mapping[str, float] = field(default_factory=dict)  # MAVLink message -> Hz for live mixing
    surface: int | None = None  # its place among those that change the rotors' own surfaces
    no_static: str = ""
    no_live: str = ""

    def __post_init__(self) -> None:
        for tracing in (self.flight, self.stand):
            if tracing is not None:
                object.__setattr__(tracing, "effect", self)

    def check(self, numbers: Numbers) -> None:
        """Raise InputError when a number that mixing needs is missing or out of what physics allows."""
        for name in self.required:
            if name not in numbers:
                raise InputError(
                    "rotor model", f"effects.{self.name}.{name}", "this number of the effect is missing"
                )
        for parameter in self.parameters:
            value = numbers.get(parameter.name)
            if value is not None and not parameter.low <= value <= parameter.high:
                unit = "" if parameter.unit == "1" else f" {parameter.unit}"
                problem = f"{parameter.low:g} to {parameter.high:g}{unit} is expected, found {value:g}"
                raise InputError("rotor model", f"effects.{self.name}.{parameter.name}", problem)

    @property
    def is_live(self) -> bool:
        """Whether live mixing can measure and compensate it."""
        return self.live is not None or self.live_speed is not None
