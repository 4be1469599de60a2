"""Split, allocation error and suspicion of a rotor over time, on the vehicle's own clock."""

from __future__ import annotations

from dataclasses import dataclass

from coaxlink.monitor.state.moment import Moment

KEPT_S = 600.0
LEAST_S = 2.0  # the shortest window that is shown: ten looks
Line = tuple[tuple[float, float], ...]  # (time in s of the vehicle's clock, value)
Axes = tuple[float, ...]


@dataclass(frozen=True)
class Point:
    """One moment."""

    time_s: float
    shares: tuple[float | None, ...]  # (arms,) 0..1, upper share of thrust
    ideal: tuple[float | None, ...] = ()  # (arms,) 0..1
    error: Axes | None = None  # (4,) thrust N, roll, pitch, yaw N m
    suspicion: float | None = None  # 0..1, that the most suspected rotor lost thrust; None: not judged


@dataclass(frozen=True)
class Window:
    """What part of a history is shown: `span_s` seconds that end `back_s` before its newest point."""

    span_s: float = 60.0
    back_s: float = 0.0

    def zoomed(self, factor: float) -> Window:
        """`factor` times as long, its end where it is."""
        return Window(min(max(self.span_s * factor, LEAST_S), KEPT_S), self.back_s)

    def moved(self, share: float, history: History) -> Window:
        """Further back by that share of its length, but not beyond the history."""
        most = max(history.length_s - self.span_s, 0.0)
        return Window(self.span_s, min(max(self.back_s + share * self.span_s, 0.0), most))


@dataclass(frozen=True)
class History:
    """The last `span_s` seconds, oldest first."""

    span_s: float = KEPT_S
    points: tuple[Point, ...] = ()

    def extended(self, view: Moment) -> History:
        """With the moment added, unless it is stale or nothing has moved on.

        A vehicle that sends no time has ours. A clock that jumps back (a reboot) or far ahead starts the
        history anew.
        """
        shares = tuple(arm.upper_share for arm in view.arms)
        error = view.balance.error
        blank = all(s is None for s in shares) and error is None
        if view.link.state != "live" or view.speeds_stale or blank:
            return self
        clock = view.vehicle.clock_s if view.vehicle else None
        now = view.now_s if clock is None else clock
        points = self.points
        if points:
            if points[-1].time_s - 1.0 < now <= points[-1].time_s:
                return self
            if not 0.0 < now - points[-1].time_s <= self.span_s or len(points[-1].shares) != len(shares):
                points = ()
            elif points[0].time_s < now - self.span_s:
                points = tuple(p for p in points if p.time_s >= now - self.span_s)
        ideal = tuple(arm.ideal_share for arm in view.arms)
        return History(self.span_s, (*points, Point(now, shares, ideal, error, view.health.worst)))

    @property
    def length_s(self) -> float:
        """From the oldest to the newest point."""
        return self.points[-1].time_s - self.points[0].time_s if self.points else 0.0

    def range_s(self, window: Window) -> tuple[float, float]:
        """The window on the vehicle's clock, in s; (0, span) while nothing is known."""
        end = (self.points[-1].time_s if self.points else window.span_s) - window.back_s
        return end - window.span_s, end

    def inside(self, window: Window) -> tuple[Point, ...]:
        """The points that the window shows, and the next one on either side."""
        low, high = self.range_s(window)
        margin = window.span_s / 20
        return tuple(p for p in self.points if low - margin <= p.time_s <= high + margin)


def shares(points: tuple[Point, ...], arm: int, *, ideal: bool = False) -> Line:
    """(time, upper share in %) of one arm; unknown ones are left out."""
    sides = ((p.time_s, p.ideal if ideal else p.shares) for p in points)
    return tuple((t, 100.0 * s) for t, side in sides if arm < len(side) and (s := side[arm]) is not None)


def errors(points: tuple[Point, ...], axis: int) -> Line:
    """(time, allocation error in N or N m) of one axis; unknown ones are left out."""
    return tuple((p.time_s, p.error[axis]) for p in points if p.error is not None)


def suspicion(points: tuple[Point, ...]) -> Line:
    """(time, probability in % that the most suspected rotor lost thrust), where it is judged."""
    return tuple((p.time_s, 100.0 * p.suspicion) for p in points if p.suspicion is not None)
