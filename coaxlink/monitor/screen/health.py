"""Rotors' health in words: a line a rotor, what was called, the worst one over time. Formats only."""

from __future__ import annotations

from rich.text import Text

from coaxlink.live.in_air import Call, RotorsInAir
from coaxlink.monitor.arms import ArmView, RotorView
from coaxlink.monitor.screen.history import History, Window, suspicion
from coaxlink.monitor.screen.marks import BAD, DIM, GOOD, LOWER, STALE, UPPER, WARN, clock, number
from coaxlink.monitor.screen.plots import one_plot
from coaxlink.monitor.state import View

_LABEL, _ARM, _WORD = 5, 14, 30  # cells of "▲3x", the arm's name, the verdict


def health_words(view: View) -> Text:
    """`rotors: sound`, or why there is no word."""
    h = view.health
    return Text(f"rotors: {h.word}" if h.word else f"rotors: not judged ({h.why})", "" if h.word else DIM)


def health_notes(view: View) -> list[Text]:
    """Rotors that lost thrust, and one that may have."""
    lines = []
    for c in view.health.calls:
        size = f"{100 * c.loss:.1f} +/- {196 * c.loss_sd:.1f} % of its thrust at the commanded speed"
        words = (
            f"rotor {c.rotor} (x) lost {size}, at {clock(c.time_s)}, probability {c.probability:.2f}: land"
        )
        lines.append(Text(words, f"bold {BAD}"))
    if view.health.word == "watch":
        s = view.health.suspicions[0]
        words = f"rotor {s.rotor} (?) may have lost {100 * s.loss:.0f} % of its thrust"
        lines.append(Text(f"{words}, probability {s.probability:.2f}", WARN))
    return lines


def rotor_table(view: View, *, stale: bool) -> Text:
    """A line a rotor: arm, verdict, speed and where they are sent current and temperature."""
    head = f"{'':<{_LABEL}}{'arm':<{_ARM}}{'lost of its thrust':<{_WORD}}{'rpm':>7}{'A':>7}{'°C':>6}"
    lines = [Text(head, DIM)]
    for arm in view.arms:
        lines += [_rotor(arm, r, view, stale) for r in (arm.upper, arm.lower) if r is not None]
    return Text("\n").join(lines)


def health_plot(history: History, window: Window, width: int, height: int) -> Text:
    """How likely it is that the most suspected rotor lost thrust, 0 to 100 %, over the vehicle's clock."""
    points = history.inside(window)
    line = suspicion(points)
    if not line:
        return Text("no verdict in this window", DIM)
    return one_plot(line, (0.0, 100.0), "%", window, history.range_s(window), width, height)


def _rotor(arm: ArmView, rotor: RotorView, view: View, stale: bool) -> Text:
    lower = rotor.level == "lower"
    old = stale or view.link.state == "lost"
    label = f"{'▼' if lower else '▲'}{rotor.number}{rotor.health}"
    word, style = _verdict(view.health, rotor)
    word += STALE if view.link.state == "lost" and view.health.word else ""
    values = (
        f"{number(rotor.rpm, 0, stale=old):>7}"
        f"{number(rotor.current_A, 1, stale=view.escs_stale or old):>7}"
        f"{number(rotor.temperature_C, 0, stale=view.escs_stale or old):>6}"
    )
    return Text.assemble(
        (f"{label:<{_LABEL}}", f"bold {LOWER if lower else UPPER}"),
        f"{arm.name[: _ARM - 1]:<{_ARM}}",
        (f"{word:<{_WORD}}", style),
        (values, DIM if old else ""),
    )


def _verdict(health: RotorsInAir, rotor: RotorView) -> tuple[str, str]:
    """What is believed of one rotor, in words, and in what style."""
    call: Call | None = next((c for c in health.calls if c.rotor == rotor.number), None)
    if call is not None:
        size = f"{100 * call.loss:.1f} +/- {196 * call.loss_sd:.1f} %"
        return f"{size}, probability {call.probability:.2f}", f"bold {BAD}"
    if not health.word:
        return "not judged", DIM
    if rotor.health:
        s = health.suspicions[0]
        return f"{100 * s.loss:.0f} %? probability {s.probability:.2f}", WARN
    return "sound", GOOD
