"""A moment in words and bars (rich Text), for the screen and for `--once`. Formats only."""

from __future__ import annotations

import math
from datetime import datetime, timedelta

from rich.text import Text

from coaxlink.live.in_air import Call, RotorsInAir
from coaxlink.monitor.incoming.recording import Player
from coaxlink.monitor.screen.marks import (
    BAD,
    DIM,
    GOOD,
    LOWER,
    NONE,
    STALE,
    UPPER,
    WARN,
    bar,
    clock,
    number,
    overlaid,
    percent,
    seconds,
)
from coaxlink.monitor.state.moment import Moment
from coaxlink.monitor.state.rotors import ArmView, RotorView

_BATTERY = {"ok": GOOD, "charging": GOOD, "low": WARN, "unhealthy": WARN}  # all else is bad
_SHORT = 12.0  # cells of a bar from which "at max" fits, else "MAX"
_LABEL, _ARM, _WORD, _CHANCE = 5, 13, 16, 8  # cells of "▲3x", the arm's name, the verdict, its probability


def rotor_line(rotor: RotorView, width: int, stale: bool) -> Text:
    """`▲1 █████···· 24.9 N 2381 rpm 44 %`, torque where there is room, `▲1! ██████at max` at its bound."""
    colour = LOWER if rotor.level == "lower" else UPPER
    style = DIM if stale else colour
    mark = "▼" if rotor.level == "lower" else "▲"
    thrust, rpm = number(rotor.thrust_N, stale=stale), number(rotor.rpm, 0, stale=stale)
    throttle = percent(rotor.throttle, stale=stale)
    values = f"{thrust:>5} N{rpm:>6}rpm {throttle:>5}"
    if width < 30:
        values = f"{thrust:>5} N{rpm:>5}rpm{throttle:>5}"
    if width >= 44:
        values = f"{thrust:>6} N {rpm:>6} rpm {throttle:>6}"
    if width >= 54:
        values += f" {number(rotor.torque_Nm, 2, stale=stale):>6} N m"
    label = f"{mark}{rotor.number}{'!' if rotor.bound else ''}{rotor.health}".ljust(4)
    fraction = None if rotor.thrust_N is None else rotor.thrust_N / max(rotor.full_N, 1e-9)
    room = max(width - len(label) - len(values), 3)
    shown = bar(fraction, room, style)
    if rotor.bound:
        word = f" at {rotor.bound}" if room >= _SHORT else rotor.bound.upper()
        shown = overlaid(shown, word, f"bold reverse {DIM if stale else BAD}")
    return Text.assemble((label, f"bold {style}"), shown, (values, DIM if stale else ""))


def arm_body(arm: ArmView, width: int, stale: bool) -> Text:
    """The rotors of an arm, a line each."""
    rotors = [arm.upper] if arm.lower is None else [arm.upper, arm.lower]
    return Text("\n").join(rotor_line(r, width, stale) for r in rotors)


def arm_title(arm: ArmView, stale: bool) -> Text:
    """The arm's name, and where they are sent current and temperature, upper / lower."""
    rotors = [arm.upper] if arm.lower is None else [arm.upper, arm.lower]
    title = Text(arm.name, "bold")
    for values, digits, unit in (
        ([r.current_A for r in rotors], 1, "A"),
        ([r.temperature_C for r in rotors], 0, "°C"),
    ):
        if any(v is not None for v in values):
            both = "/".join(number(v, digits, stale=stale) for v in values)
            title.append(f"  {both} {unit}", DIM if stale else "")
    return title


def arm_split(arm: ArmView, stale: bool = False, room: int = 99) -> Text:
    """`49.1 N  42 : 58 %  ideal 45 : 55`, upper : lower; without the thrust where `room` is short."""
    total = f"{number(arm.thrust_N, stale=stale)} N"
    if arm.lower is None:
        return Text(total, DIM if stale else "")
    if arm.upper_share is None:
        return Text(f"{total}  split {NONE}", DIM)
    pair = _pair(arm.upper_share, stale)
    words = Text.assemble(f"{total}  ", pair, " %")
    if arm.ideal_share is not None:
        words.append_text(Text.assemble(("  ideal ", DIM), _pair(arm.ideal_share, stale, plain=True)))
    if stale:
        words.stylize(DIM)
    return words if words.cell_len <= room else words[len(total) + 2 :]


def _pair(share: float, stale: bool, *, plain: bool = False) -> Text:
    """`42 : 58`, which is 100 together."""
    top = round(100.0 * share)
    texts = [number(float(v), 0, stale=stale) for v in (top, 100 - top)]
    styles = ("", "") if stale or plain else (f"bold {UPPER}", f"bold {LOWER}")
    between = ":" if stale else " : "  # the marks of old numbers take the room
    return Text.assemble((texts[0], styles[0]), between, (texts[1], styles[1]))


def balance(view: Moment) -> Text:
    """Thrust, torques and moments: by the model, as the table means them, and the difference."""
    b, old = view.balance, speeds_old(view)
    style = DIM if old else ""
    lines = [Text(f"{'':<8}{'model':>7}{b.basis:>7}{'error':>7}", DIM)]
    for k, (axis, unit, digits) in enumerate(
        (("thrust", "N", 1), ("roll", "Nm", 2), ("pitch", "Nm", 2), ("yaw", "Nm", 2))
    ):
        cells = [number(w[k] if w else None, digits, signed=k > 0, stale=old) for w in (b.wrench, b.intended)]
        cells.append(number(b.error[k] if b.error else None, digits, signed=True, stale=old))
        lines.append(
            Text.assemble(
                (f"{axis:<5}{unit:>3}" if k else f"{axis} {unit}", DIM),
                (f"{cells[0]:>7}{cells[1]:>7}", style),
                (f"{cells[2]:>7}", style or (WARN if b.error else "")),
            )
        )
    lines.append(
        Text.assemble(
            ("torque ", DIM),
            (number(b.upper_torque_Nm, 2, stale=old), style or UPPER),
            (" up ", DIM),
            (number(b.lower_torque_Nm, 2, stale=old), style or LOWER),
            (" low N m", DIM),
        )
    )
    return Text("\n").join(lines)


def weight_and_split(view: Moment) -> Text:
    """`1.01 of weight  42 : 58 %` of the whole vehicle."""
    b, old = view.balance, speeds_old(view)
    if b.of_weight is None:
        return Text()
    words = Text(f"{number(b.of_weight, 2, stale=old)} of weight")
    if b.upper_share is not None:
        words = Text.assemble(words, "  ", _pair(b.upper_share, old), " %")
    if old:
        words.stylize(DIM)
    return words


def vehicle(view: Moment) -> Text:
    """Battery, attitude and height."""
    v, lost = view.vehicle, view.link.state == "lost"
    if v is None:
        return Text(NONE, DIM)
    pack, turned, high = v.battery_stale or lost, v.attitude_stale or lost, v.height_stale or lost
    volts, amps = number(v.voltage_V, stale=pack), number(v.current_A, 0, stale=pack)
    lines = [Text(f"{volts} V {amps} A {percent(v.remaining, stale=pack)}", DIM if pack else "")]
    lines.append(battery_words(view))
    for name, angle, digits, signed in (
        ("roll  ", v.roll_rad, 1, True),
        ("pitch ", v.pitch_rad, 1, True),
        ("yaw   ", v.yaw_rad, 0, False),
    ):
        degrees = None if angle is None else math.degrees(angle)
        shown = number(degrees, digits, signed, stale=turned)
        lines.append(Text(f"{name}{shown}°", DIM if turned else ""))
    where = f" {v.height_source}" if v.height_source and not high else ""  # no room beside the mark
    lines.append(Text(f"height {number(v.height_m, 2, stale=high)} m{where}", DIM if high else ""))
    return Text("\n").join(lines)


def battery_words(view: Moment) -> Text:
    """`ok, 12 min left`: how the battery is, in a word."""
    v = view.vehicle
    if v is None or not v.battery_word:
        return Text("charge not reported", DIM)
    old = v.battery_stale or view.link.state == "lost"
    mark = STALE if old else ""
    words = Text(v.battery_word.upper() if v.battery_word not in ("ok", "charging") else v.battery_word)
    words.append(mark)
    if v.battery_minutes is None:
        words = Text.assemble("battery ", words)
    else:
        words.append(f", {number(v.battery_minutes, 0, stale=old)} min left")
    words.stylize(DIM if old else _BATTERY.get(v.battery_word, f"bold {BAD}"))
    return words


def speeds_source(view: Moment) -> Text:
    """Whose speeds these are."""
    old = speeds_old(view)
    text = (view.speeds.source or "no speeds yet") + (STALE if old and view.speeds.source else "")
    return Text(text, DIM if old else "" if view.speeds.source else WARN)


def speeds_old(view: Moment) -> bool:
    """Whether speeds, and all that follows from them, are no longer of the present."""
    return view.speeds_stale or view.link.state == "lost"


def board(view: Moment) -> Text:
    """The table on board; on a lost link nobody knows whether it still is."""
    b, lost = view.board, view.link.state == "lost"
    states = {"unread": "not read yet", "partial": "being read", "invalid": "no valid table"}
    first = Text(states.get(b.state, b.kind), GOOD if b.state == "read" else WARN)
    if b.of_model:
        first.append(" (model's)", DIM)

    def value(what: float | None, digits: int) -> str:
        return number(what, digits, stale=lost)

    rows: list[tuple[str, str]] = []
    if b.digest:
        rows.append(("hash ", b.digest + (STALE if lost else "")))
    if b.upper_ct is not None:
        rows.append(("CT ", f"{value(b.upper_ct, 1)} / {value(b.lower_ct, 1)}"))
    if b.thr_mdl_fac is not None:
        rows.append(("THR_MDL_FAC ", value(b.thr_mdl_fac, 3)))
    if b.frame_class is not None:
        rows.append(("FRAME_CLASS ", value(float(b.frame_class), 0)))
    if b.thst_expo is not None:
        rows.append(("THST_EXPO ", value(b.thst_expo, 3)))
    elif b.rotors:
        rows.append(("rotors ", value(float(b.rotors), 0)))
    texts = (Text.assemble((name, DIM), (text, DIM if lost else "")) for name, text in rows)
    return Text("\n").join((first, *texts))


def head(view: Moment, width: int, paused: bool = False, replay: Text | None = None) -> Text:
    """One line: firmware, mode, armed on the left; the link on the right, or where a replay is."""
    v, link = view.vehicle, view.link
    left = Text.assemble(("coaxlink ", "bold"))
    if v is not None:
        firmware = f"{v.firmware} {v.version}".strip()
        left.append(f"{firmware}  ", DIM)
        left.append(f"{v.mode}  " if v.mode else "", "bold")
        mark = STALE if link.state == "lost" else ""
        left.append(f"{'ARMED' if v.armed else 'disarmed'}{mark}", f"bold {BAD}" if v.armed else GOOD)
    if paused:
        left.append("  PAUSED", f"bold {WARN}")
    right = link_words(view) if replay is None else replay
    if replay is None and width and left.cell_len + right.cell_len + 2 > width:
        right = link_words(view, short=True)
    if width >= 110 and replay is None:
        right.append(f"  {link.address}", DIM)
    gap = max(width - left.cell_len - right.cell_len, 2)
    return Text.assemble(left, " " * gap, right)


def replay_words(player: Player) -> Text:
    """`▶ flight.tlog 1:02.0 / 4:10.0 x2`."""
    name = player.recording.name
    shown = name if len(name) <= 20 else f"{name[:8]}…{name[-11:]}"
    words = Text(f"{'▶' if player.playing else '■ stopped'} ", GOOD if player.playing else WARN)
    words.append(f"{shown} ", DIM)
    where = f"{clock(player.position_s)} / {clock(player.recording.length_s)}"
    return words.append(f"{where} x{player.speed:g}")


def link_words(view: Moment, *, short: bool = False) -> Text:
    """`● live 131/s loss 0.0 % age 0.1 s`; `short` leaves out the rate, and the age while it is young."""
    link = view.link
    if link.state == "waiting":
        return Text(f"○ waiting for {link.detail}", WARN)
    colour = GOOD if link.state == "live" else BAD
    words = Text(f"● {link.state}", colour)
    if not short:
        words.append(f" {link.rate_hz:.0f}/s", "")
    words.append("  loss ", DIM)
    words.append(percent(link.loss, 1), WARN if (link.loss or 0.0) > 0.02 else "")
    if short and link.state == "live":
        return words
    words.append("  age ", DIM)
    words.append(seconds(link.age_s or 0.0), "" if link.state == "live" else BAD)
    return words


def notes(view: Moment) -> Text:
    """What a reader must know to trust the numbers, a line each; empty when there is nothing."""
    lines = []
    if view.link.state == "lost":
        gone = seconds(view.link.age_s or 0.0)
        lines.append(Text(f"LINK LOST {gone} ago: the last values are shown, marked {STALE}", f"bold {BAD}"))
    if view.vehicle is not None and view.vehicle.text:
        lines.append(Text(f"autopilot: {view.vehicle.text}"))
    if view.link.state == "live" and view.speeds_stale:
        lines.append(Text(f"speeds{STALE} are {seconds(view.speeds_age_s or 0.0)} old", WARN))
    lines += health_notes(view)
    lines += [Text(note, WARN) for note in view.notes]
    lines += [Text(f"table: {note}", WARN) for note in view.board.notes]
    if view.balance.error_note and view.speeds.source:
        lines.append(Text(f"no allocation error: {view.balance.error_note}", DIM))
    return Text("\n").join(lines)


def reported(view: Moment, now: datetime | None) -> Text:
    """The autopilot's messages, newest first: the vehicle's clock, the time of day (unless None), words."""
    lines = [Text(view.unheard, WARN)] if view.unheard else []
    if not view.texts:
        return Text("\n").join(lines or [Text("no message yet", DIM)])
    for text in reversed(view.texts):
        when = clock(text.clock_s)
        day = "" if now is None else f"{now - timedelta(seconds=view.now_s - text.received_s):%H:%M:%S}  "
        style = BAD if text.severity <= 3 else WARN if text.severity == 4 else ""
        lines.append(
            Text.assemble(
                (f"{when:>9}  {day}", DIM), (f"{text.word:<9} ", f"bold {style}".strip()), text.text
            )
        )
    return Text("\n").join(lines)


def summary(view: Moment, replay: Text | None = None) -> Text:
    """The whole view in lines, for `--once`."""
    lines = [head(view, 0, replay=replay)]
    width = 60
    old = speeds_old(view)
    for arm in view.arms:
        title = Text.assemble(arm_title(arm, view.escs_stale or old), ": ", arm_split(arm, old))
        lines += [title, arm_body(arm, width, old)]
    b = view.balance
    share = "" if b.upper_share is None else f", upper {percent(b.upper_share)}"
    lines.append(Text(f"thrust {number(b.thrust_N)} N, {number(b.of_weight, 2)} of the weight{share}"))
    lines += [balance(view), Text.assemble("speeds by ", speeds_source(view)), vehicle(view)]
    lines.append(Text.assemble("table on board: ", Text(", ").join(board(view).split("\n"))))
    lines.append(health_words(view))
    words = notes(view)
    return Text("\n").join([*lines, words] if words.plain else lines)


# -- rotors' health ----------------------------------------------------------------------------------------


def health_words(view: Moment) -> Text:
    """`rotors: sound (...)`, or why there is no word."""
    h = view.health
    if h.reasons:
        return Text(f"rotors: {h.why}", WARN)
    if h.word == "sound":
        return Text("rotors: sound (no loss set in while watched)")
    if h.calls:
        return Text("rotors: flagged")
    return Text(f"rotors: {h.word}" if h.word else f"rotors: not judged ({h.why})", "" if h.word else DIM)


def health_notes(view: Moment) -> list[Text]:
    """Rotors that lost thrust, and one that may have."""
    lines = []
    for c in view.health.calls:
        size = f"{100 * c.loss:.1f} +/- {196 * c.loss_sd:.1f} % of its thrust at the commanded speed"
        words = (
            f"rotor {c.rotor} (x) lost {size}, at {clock(c.time_s)}, probability {c.probability:.2f}: land"
        )
        lines.append(Text(words, f"bold {BAD}"))
    lines += [Text(reason.line(), WARN) for reason in view.health.reasons]
    if view.health.word == "watch":
        s = view.health.suspicions[0]
        words = f"rotor {s.rotor} (?) may have lost {100 * s.loss:.0f} % of its thrust"
        lines.append(Text(f"{words}, probability {s.probability:.2f}", WARN))
    return lines


def rotor_table(view: Moment, *, stale: bool) -> Text:
    """A line a rotor: arm, verdict, speed and where they are sent current and temperature."""
    heads = f"{'':<{_LABEL}}{'arm':<{_ARM}}{'thrust lost':<{_WORD}}{'chance':<{_CHANCE}}"
    lines = [Text(f"{heads}{'rpm':>6}{'A':>6}{'°C':>5}", DIM)]
    for arm in view.arms:
        lines += [_rotor(arm, r, view, stale) for r in (arm.upper, arm.lower) if r is not None]
    return Text("\n").join(lines)


def _rotor(arm: ArmView, rotor: RotorView, view: Moment, stale: bool) -> Text:
    lower = rotor.level == "lower"
    old = stale or view.link.state == "lost"
    label = f"{'▼' if lower else '▲'}{rotor.number}{rotor.health}"
    word, chance, style = _verdict(view.health, rotor)
    word += STALE if view.link.state == "lost" and view.health.word else ""
    values = (
        f"{number(rotor.rpm, 0, stale=old):>6}"
        f"{number(rotor.current_A, 1, stale=view.escs_stale or old):>6}"
        f"{number(rotor.temperature_C, 0, stale=view.escs_stale or old):>5}"
    )
    return Text.assemble(
        (f"{label:<{_LABEL}}", f"bold {LOWER if lower else UPPER}"),
        f"{arm.name[: _ARM - 1]:<{_ARM}}",
        (f"{word:<{_WORD}}{chance:<{_CHANCE}}", style),
        (values, DIM if old else ""),
    )


def _verdict(health: RotorsInAir, rotor: RotorView) -> tuple[str, str, str]:
    """What is believed of one rotor, how probable it is, and in what style."""
    call: Call | None = next((c for c in health.calls if c.rotor == rotor.number), None)
    if call is not None:
        size = f"{100 * call.loss:.1f} +/- {196 * call.loss_sd:.1f} %"
        return size, f"{call.probability:.2f}", f"bold {BAD}"
    if not health.word or health.reasons:
        return "not judged", "", DIM
    if rotor.health:
        s = health.suspicions[0]
        return f"{100 * s.loss:.0f} %?", f"{s.probability:.2f}", WARN
    return "sound", "", GOOD
