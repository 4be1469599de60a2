"""Lost links: when a ground station counts as gone, and what each firmware does then."""

from __future__ import annotations

from typing import Any

from sim.px4.modes import Mode

# COM_OBL_RC_ACT and NAV_DLL_ACT to a mode; None: the motors stop
OFFBOARD_LOST: dict[int, Mode | None] = {3: Mode.RTL, 4: Mode.LAND, 5: Mode.HOLD, 6: None, 7: None}
STATION_LOST: dict[int, Mode | None] = {1: Mode.HOLD, 2: Mode.RTL, 3: Mode.LAND, 5: None, 6: None}


class Links:
    """When the ground station was heard last, by the vehicle's clock; one never heard is not missed."""

    def __init__(self, autopilot: Any) -> None:
        self._autopilot = autopilot
        self._heard_s: float | None = None
        self._lost = False

    def heard(self, now_s: float) -> None:
        """A ground station's HEARTBEAT."""
        self._heard_s = now_s
        if self._lost:
            self._lost = False
            self._autopilot.say(6, "Connection to ground station regained")

    def there(self, now_s: float) -> bool:
        """Whether one has been heard of late."""
        return self._heard_s is not None and now_s - self._heard_s <= self._autopilot.station_timeout_s

    @property
    def required(self) -> bool:
        """Whether PX4 arms only with one: where its loss would matter."""
        return int(self._autopilot.settings["NAV_DLL_ACT"]) in STATION_LOST

    def watch(self, now_s: float) -> None:
        """In flight: tell the autopilot once when it is lost."""
        if self._heard_s is None or self._lost or self._autopilot.landed or self.there(now_s):
            return
        self._lost = True
        self._autopilot.station_lost()
