"""From what was heard to moments: what must be remembered from one look to the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from coaxlink.errors import CoaxlinkError
from coaxlink.live.in_air import InAir
from coaxlink.mixer import Law, make_law
from coaxlink.monitor.incoming.heard import Heard
from coaxlink.monitor.incoming.table_reader import table_parameters
from coaxlink.monitor.state import table as table_px4
from coaxlink.monitor.state.moment import Moment, observe
from coaxlink.monitor.state.speeds import commanded_speeds
from coaxlink.monitor.state.table import TableOnBoard
from coaxlink.monitor.state.vehicle import Drain, battery_of
from coaxlink.premises.answer import Reason
from coaxlink.vehicle import Vehicle

OUTPUTS = ("SERVO_OUTPUT_RAW", "ACTUATOR_OUTPUT_STATUS")  # the first is taken where both come


class Watch:
    """What one screen looks at: `heard`, held against `vehicle`."""

    def __init__(
        self, heard: Heard, vehicle: Vehicle, address: str = "", reasons: Sequence[Reason] = ()
    ) -> None:
        """`reasons`: why a recording can be no base of a verdict."""
        self.heard, self.vehicle, self.address, self._reasons = heard, vehicle, address, reasons
        # the table that was judged last, and what it is
        self._judged: tuple[Mapping[str, float], TableOnBoard] = ({}, TableOnBoard("unread"))
        self._allocation = _exact(vehicle)
        self._outputs = ""  # the kind of message that tells the commands
        self._begun = heard.begun
        self._drain, self._in_air = Drain(), InAir(vehicle)
        heard.listener = self._hear

    def look(self) -> Moment:
        """The present."""
        heard, telemetry = self.heard, self.heard.telemetry
        self._begin_anew()
        pack = battery_of(telemetry)
        remaining = pack.value.remaining if pack else None
        self._drain = self._drain.extended(telemetry.clock_s, remaining, telemetry.armed)
        return observe(
            heard,
            self.vehicle,
            address=self.address,
            board=self._board(table_parameters(heard.parameters)),
            allocation=self._allocation,
            trend_min=self._drain.minutes,
            health=self._in_air.now.on((*self._reasons, *self._in_air.reasons)),
        )

    def _begin_anew(self) -> None:
        """Of the vehicle before, or of another place of a recording, nothing counts."""
        if self.heard.begun != self._begun:
            self._begun = self.heard.begun
            self._drain, self._in_air = Drain(), InAir(self.vehicle)

    def _board(self, table: Mapping[str, float]) -> TableOnBoard:
        """What the table is; judged again when another was heard."""
        if table != self._judged[0]:
            self._judged = table, table_px4.describe(table, self.vehicle)
        return self._judged[1]

    def _hear(self, message: Any) -> None:
        """Every message of the vehicle, on the link's thread: what its rotors' health is judged by."""
        self._begin_anew()
        kind = message.get_type()
        if kind in OUTPUTS and self._outputs in ("", kind, OUTPUTS[1]) and not getattr(message, "port", 0):
            self._outputs = kind
            commands = commanded_speeds(self.heard, len(self.vehicle.airframe.rotors)).u
            self._in_air.commanded(message.time_usec * 1e-6, commands)
        self._in_air.heard(message)


def _exact(vehicle: Vehicle) -> Law | None:
    """The allocation whose split is the ideal one; None for rotors that it cannot serve."""
    try:
        return make_law("exact", vehicle)
    except CoaxlinkError:
        return None
