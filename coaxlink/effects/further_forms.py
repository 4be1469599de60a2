"""Forms of an effect that may be confounded with another one: without them the other would be claimed.

A cell that warms up with its room looks like the room's air, magnets that weaken like a pack that sags. The
selection of a log tries the plain forms of each effect (`Tracing.shapes`); whether a name may be claimed is
asked beside these too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from coaxlink.effects.battery_voltage import governed_shapes
from coaxlink.effects.dead_band import cell_shapes, of_cells
from coaxlink.effects.hysteresis import angle_shapes, relay_shapes
from coaxlink.effects.motor_heating import magnet_shapes, one_motor_shapes, winding_shapes
from coaxlink.effects.rotor_lag import ringing_shapes, wake_shapes
from coaxlink.effects.rotor_spacing import alike_shapes
from coaxlink.effects.sensor_drift import amplifier_shapes, room_shapes
from coaxlink.effects.tracing import Shape, Tracing
from coaxlink.frames import StandFrame

FURTHER = {
    "battery_voltage": (governed_shapes,),
    "dead_band": (cell_shapes,),
    "motor_heating": (magnet_shapes, winding_shapes, one_motor_shapes),
    "rotor_lag": (ringing_shapes, wake_shapes),
    "sensor_drift": (amplifier_shapes, room_shapes),
    "rotor_spacing": (alike_shapes,),
    "hysteresis": (relay_shapes, angle_shapes),
}


def further_shapes(frame: StandFrame, effect: Tracing[Any]) -> Sequence[Shape]:
    """Shapes of an effect beside its plain ones, as this log can show them."""
    return [shape for shapes in FURTHER.get(effect.name, ()) for shape in shapes(frame)]


def of_what_is_logged(frame: StandFrame, effect: Tracing[Any]) -> Tracing[Any]:
    """The effect, or what of it a log without throttles can show."""
    return of_cells(effect) if effect.name == "dead_band" and effect.missing(frame) is not None else effect


def in_all_forms(frame: StandFrame, effect: Tracing[Any]) -> Tracing[Any]:
    """The effect with its plain and its further shapes."""
    able = of_what_is_logged(frame, effect)

    def shapes(of: StandFrame) -> Sequence[Shape]:
        return [*able.shapes(of), *further_shapes(of, able)]

    return replace(able, shapes=shapes)
