"""What an effect is to all of coaxlink: its numbers, and what tracing, tables and live mixing make of it.

One module an effect. Each defines `EFFECT` (or `EFFECTS`), a `PhysicalEffect`, and keeps its formula in one
function that tracing, the static mixers and live mixing all call.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from coaxlink.effects.live import LiveView, Part, SpeedPart
from coaxlink.effects.static import StaticVehicle
from coaxlink.effects.tracing import Tracing
from coaxlink.errors import InputError
from coaxlink.frames import FlightFrame, StandFrame

Numbers = Mapping[str, float]


class Stage(Enum):
    """Where in the chain from command to column an effect acts."""

    DRIVE = "drive"  # command -> rotor speed
    ROTOR = "rotor"  # rotor speed -> loads of the pair
    AIR = "air"  # what the air around does to the loads
    BODY = "body"  # loads -> motion of the vehicle
    STAND = "stand"  # loads -> what the stand holds
    INSTRUMENT = "instrument"  # what is there -> what is recorded


@dataclass(frozen=True)
class Parameter:
    """One number of an effect: its unit ("1" for none), the bounds that physics sets, and what is believed.

    `prior` is what is believed before any data: (mean, standard deviation) of a sound vehicle that has the
    effect; None where any value between the bounds is as likely. `source` says where prior and bounds are
    from: a paper, a law of physics, "assumed: ..." with the reasoning, or, without a prior, "wide: ..." with
    the reason why nothing is known, "a switch, ..." for a form, "a number of ..." for a label.
    """

    name: str
    unit: str
    low: float
    high: float
    prior: tuple[float, float] | None = None
    source: str = field(kw_only=True)


@dataclass(frozen=True)
class PhysicalEffect:
    """An effect and everything that is made of it.

    `static` puts it into a vehicle at stated conditions and says in words what it did, or raises LeftOut;
    `live` gives the wrench (4,) it adds, `live_speed` the speed per command, from what the vehicle sends.
    Where one of them is None, `no_static` and `no_live` say why.
    """

    name: str
    stage: Stage
    parameters: tuple[Parameter, ...]
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

    @property
    def words(self) -> str:
        """What happens, in a sentence."""
        return self._traced.physics

    @property
    def source(self) -> str:
        """Where the formula is from."""
        return self._traced.source

    @property
    def _traced(self) -> Tracing[FlightFrame] | Tracing[StandFrame]:
        traced = self.flight or self.stand
        if traced is None:
            raise ValueError(f"{self.name} can be traced neither in flight nor on a stand")
        return traced

    @property
    def units(self) -> dict[str, str]:
        """{parameter: unit}."""
        return {p.name: p.unit for p in self.parameters}
