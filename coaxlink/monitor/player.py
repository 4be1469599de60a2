"""Plays a recording to a watch, at any speed, from anywhere in it. Its clock is the recording's."""

from __future__ import annotations

import threading
from typing import Protocol

from coaxlink.monitor.state import View
from coaxlink.monitor.telemetry.readings import Collector
from coaxlink.monitor.watch import Watch

WARM_S = (
    10.0  # what is played before the place that is sought: rarer messages are older than any screen shows
)
MOST_AHEAD_S = 60.0  # a step of more than this is a leap
SLOWEST, FASTEST = 1 / 64, 1024.0


class Recording(Protocol):
    """What can be played: `tape.Tape`, `tape.SampleTape`."""

    name: str
    length_s: float
    notes: tuple[str, ...]

    def begin(self, collector: Collector) -> None:
        """Make the collector follow the recorded vehicle, knowing nothing of it yet."""

    def play(self, collector: Collector, from_s: float, to_s: float, *, only_lasting: bool = False) -> None:
        """Give the collector what came in [from_s, to_s)."""


class Player:
    """`look(now_s)` is the view where the recording has got to; it stops at its end."""

    def __init__(
        self, recording: Recording, watch: Watch, *, speed: float = 1.0, start_s: float = 0.0
    ) -> None:
        self.recording, self._watch = recording, watch
        self.speed, self.playing = speed, True
        self.position_s = 0.0
        self._last_s: float | None = None
        self._judging: threading.Thread | None = None
        self.seek(start_s)

    def look(self, now_s: float) -> View:
        """Play on to `now_s` (monotonic, s) and look."""
        gone = 0.0 if self._last_s is None else max(now_s - self._last_s, 0.0)
        self._last_s = now_s
        if self.playing:
            self._advance(self.position_s + gone * self.speed)
        view = self._watch.look(self.position_s)
        if view.board.state == "partial" and not (self._judging and self._judging.is_alive()):
            # comparing an ArduPilot's table with the laws' takes seconds
            self._judging = threading.Thread(target=self._watch.judge_table, daemon=True)
            self._judging.start()
        return view

    def look_once(self) -> View:
        """The view at the place where it stands, with its table judged whatever time that takes."""
        self._watch.judge_table()
        return self._watch.look(self.position_s)

    def seek(self, to_s: float) -> None:
        """Go to a place, in s from the start; beyond either end to that end."""
        to = min(max(to_s, 0.0), self.recording.length_s)
        collector = self._watch.collector
        warm = max(to - WARM_S, 0.0)
        self.recording.begin(collector)
        self.recording.play(collector, 0.0, warm, only_lasting=True)
        self.recording.play(collector, warm, _beyond(to))
        self.position_s = to

    def toggle(self) -> None:
        """Stop or go on; at the end, from the start."""
        if not self.playing and self.position_s >= self.recording.length_s:
            self.seek(0.0)
        self.playing = not self.playing

    def scaled(self, factor: float) -> None:
        """Play so many times as fast."""
        self.speed = min(max(self.speed * factor, SLOWEST), FASTEST)

    def _advance(self, to_s: float) -> None:
        to = min(to_s, self.recording.length_s)
        if to - self.position_s > MOST_AHEAD_S:
            self.seek(to)
        else:
            self.recording.play(self._watch.collector, _beyond(self.position_s), _beyond(to))
            self.position_s = to
        self.playing = to < self.recording.length_s


def _beyond(time_s: float) -> float:
    """Just after, so that what came at that very moment has come."""
    return time_s + 1e-9
