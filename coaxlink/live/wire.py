"""How a demand and its answer travel: which messages, and what stands in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from coaxlink.mavlink import codec

Demand = tuple[Any, ...]  # as ACTUATOR_CONTROL_TARGET has it: stamp (us), eight controls, group
Header = tuple[int, int, int]  # of a frame: sequence, our system and component


class Wire(Protocol):
    """Between the live loop and what commands the motors on board."""

    demand: codec.Hot
    answer: codec.Hot

    def read(self, payload: bytes) -> Demand | None:
        """The demand in a payload of `demand`; None: this one is something else."""

    def is_command(self, payload: bytes) -> bool:
        """Whether a payload of `answer`, somebody's, commands motors."""

    def pack(self, header: Header, stamp: int, commands: Sequence[float], target: tuple[int, int]) -> bytes:
        """A frame with eight commands for the demand of this stamp, which was read last."""


class ActuatorWire:
    """ACTUATOR_CONTROL_TARGET and SET_ACTUATOR_CONTROL_TARGET: PX4 up to 1.13, and ArduPilot's script."""

    demand, answer = codec.ACTUATOR_CONTROL_TARGET, codec.SET_ACTUATOR_CONTROL_TARGET

    def read(self, payload: bytes) -> Demand | None:
        """See Wire."""
        return self.demand.unpack(payload)

    def is_command(self, payload: bytes) -> bool:
        """See Wire; other groups only ask."""
        return bool(self.answer.unpack(payload)[9] == 0)

    def pack(self, header: Header, stamp: int, commands: Sequence[float], target: tuple[int, int]) -> bytes:
        """See Wire."""
        return self.answer.pack(*header, stamp, *commands, 0, *target)
