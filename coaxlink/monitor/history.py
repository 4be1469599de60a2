"""The split over time, on the vehicle's own clock."""

from __future__ import annotations

from dataclasses import dataclass

from coaxlink.monitor.state import View


@dataclass(frozen=True)
class SplitPoint:
    """Upper share of the thrust of each arm at one moment."""

    time_s: float
    shares: tuple[float | None, ...]  # (arms,) 0..1


@dataclass(frozen=True)
class History:
    """The last `span_s` seconds of the split, oldest first."""

    span_s: float = 60.0
    points: tuple[SplitPoint, ...] = ()

    def extended(self, view: View, received_s: float) -> History:
        """With the view's split added, unless it is stale or nothing has moved on.

        `received_s` is the time of a vehicle that sends none. A clock that jumps back (a reboot) or far
        ahead starts the history anew.
        """
        shares = tuple(arm.upper_share for arm in view.arms)
        if view.link.state != "live" or view.speeds_stale or all(s is None for s in shares):
            return self
        clock = view.vehicle.clock_s if view.vehicle else None
        now = received_s if clock is None else clock
        points = self.points
        if points:
            if points[-1].time_s - 1.0 < now <= points[-1].time_s:
                return self
            if not 0.0 < now - points[-1].time_s <= self.span_s or len(points[-1].shares) != len(shares):
                points = ()
        kept = tuple(p for p in points if p.time_s >= now - self.span_s)
        return History(self.span_s, (*kept, SplitPoint(now, shares)))

    def series(self) -> tuple[tuple[tuple[float, float], ...], ...]:
        """(time in s before the newest point, upper share in %) of each arm; unknown shares are left out."""
        if not self.points:
            return ()
        end = self.points[-1].time_s
        arms = len(self.points[-1].shares)
        return tuple(
            tuple((p.time_s - end, 100.0 * share) for p in self.points if (share := p.shares[k]) is not None)
            for k in range(arms)
        )
