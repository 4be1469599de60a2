"""A view in words and bars (rich Text), for the screen and for `--once`. Formats only."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.text import Text

from coaxlink.monitor.history import History
from coaxlink.monitor.plot import braille, nice_range
from coaxlink.monitor.state import ArmView, RotorView, View

UPPER, LOWER = "#5cc8ff", "#ffb454"
GOOD, BAD, WARN, DIM = "#7bd88f", "#ff6b6b", "#ffd866", "#8a8f98"
ARMS = ("#5cc8ff", "#ffb454", "#7bd88f", "#ff7eb6", "#c3a6ff", "#ffd866", "#6fe3d6", "#ff9e80")
_BLOCKS = " ▏▎▍▌▋▊▉"
NONE = "--"


def number(value: float | None, digits: int = 1, signed: bool = False) -> str:
    """A number, or `--`; never "-0.0", and short even when it is absurd."""
    if value is None or not math.isfinite(value):
        return NONE
    if abs(value) >= 1e5:
        return f"{value:.0e}"
    text = f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"
    return text.replace("-", "+" if signed else "", 1) if float(text) == 0.0 and text[0] == "-" else text


def percent(share: float | None, digits: int = 0) -> str:
    """A share of 0..1 as `51 %`."""
    return NONE if share is None else f"{number(100.0 * share, digits)} %"


def bar(fraction: float | None, width: int, style: str) -> Text:
    """A bar of `width` cells, in eighths of a cell; what is beyond 0..1 stops at the edge."""
    if fraction is None:
        return Text("·" * width, DIM)
    eighths = round(min(max(fraction, 0.0), 1.0) * 8 * width)
    full, part = divmod(eighths, 8)
    text = "█" * full + (_BLOCKS[part] if part else "")
    return Text.assemble((text, style), ("·" * (width - len(text)), f"{DIM} dim"))


def rotor_line(rotor: RotorView, width: int, stale: bool) -> Text:
    """`▲1 █████···· 24.9 N 2381 rpm 44 %`, and torque where there is room."""
    colour = LOWER if rotor.level == "lower" else UPPER
    style = DIM if stale else colour
    mark = "▼" if rotor.level == "lower" else "▲"
    if width >= 44:
        values = f"{number(rotor.thrust_N):>6} N {number(rotor.rpm, 0):>6} rpm {percent(rotor.throttle):>6}"
    else:
        values = f"{number(rotor.thrust_N):>5} N{number(rotor.rpm, 0):>6}rpm {percent(rotor.throttle):>5}"
    if width >= 54:
        values += f" {number(rotor.torque_Nm, 2):>6} N m"
    label = f"{mark}{rotor.number:<2} "
    fraction = None if rotor.thrust_N is None else rotor.thrust_N / max(rotor.full_N, 1e-9)
    room = max(width - len(label) - len(values), 3)
    return Text.assemble((label, f"bold {style}"), bar(fraction, room, style), (values, DIM if stale else ""))


def arm_body(arm: ArmView, width: int, stale: bool) -> Text:
    """The rotors of an arm, a line each."""
    rotors = [arm.upper] if arm.lower is None else [arm.upper, arm.lower]
    return Text("\n").join(rotor_line(r, width, stale) for r in rotors)


def arm_split(arm: ArmView, stale: bool = False) -> Text:
    """`49.1 N  51 : 49 %` of an arm."""
    total = f"{number(arm.thrust_N)} N"
    if arm.lower is None:
        return Text(total, DIM if stale else "")
    if arm.upper_share is None:
        return Text(f"{total}  split {NONE}", DIM)
    top, bottom = number(100 * arm.upper_share, 0), number(100 * (1 - arm.upper_share), 0)
    if stale:
        return Text(f"{total}  {top} : {bottom} %", DIM)
    return Text.assemble(f"{total}  ", (top, f"bold {UPPER}"), " : ", (bottom, f"bold {LOWER}"), " %")


def balance(view: View) -> Text:
    """Thrust, torques and moments: by the model, as the table means them, and the difference."""
    b, style = view.balance, DIM if view.speeds_stale else ""
    lines = [Text(f"{'':<8}{'model':>7}{b.basis:>7}{'error':>7}", DIM)]
    for k, (axis, unit, digits) in enumerate(
        (("thrust", "N", 1), ("roll", "Nm", 2), ("pitch", "Nm", 2), ("yaw", "Nm", 2))
    ):
        cells = [number(w[k] if w else None, digits, signed=k > 0) for w in (b.wrench, b.intended)] + [
            number(b.error[k] if b.error else None, digits, signed=True)
        ]
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
            (number(b.upper_torque_Nm, 2), style or UPPER),
            (" up ", DIM),
            (number(b.lower_torque_Nm, 2), style or LOWER),
            (" low N m", DIM),
        )
    )
    return Text("\n").join(lines)


def weight_and_split(view: View) -> Text:
    """`1.01 of weight  42 : 58 %` of the whole vehicle."""
    b = view.balance
    if b.of_weight is None:
        return Text()
    words = Text(f"{number(b.of_weight, 2)} of weight", DIM if view.speeds_stale else "")
    if b.upper_share is not None and not view.speeds_stale:
        top, bottom = number(100 * b.upper_share, 0), number(100 * (1 - b.upper_share), 0)
        words = Text.assemble(words, "  ", (top, f"bold {UPPER}"), " : ", (bottom, f"bold {LOWER}"), " %")
    return words


def vehicle(view: View) -> Text:
    """Battery, attitude, height, clock and whose speeds these are."""
    v = view.vehicle
    if v is None:
        return Text(NONE, DIM)
    battery = f"{number(v.voltage_V)} V {number(v.current_A, 0)} A {percent(v.remaining)}"
    roll, pitch, yaw = (
        number(None if a is None else math.degrees(a), d, signed=s)
        for a, d, s in ((v.roll_rad, 1, True), (v.pitch_rad, 1, True), (v.yaw_rad, 0, True))
    )
    source, where = view.speeds.source or "no speeds yet", f" {v.height_source}"
    return Text("\n").join(
        (
            _stale(battery, v.battery_stale),
            _stale(f"roll  {roll}°", v.attitude_stale),
            _stale(f"pitch {pitch}°", v.attitude_stale),
            _stale(f"yaw   {yaw}°", v.attitude_stale),
            _stale(f"height {number(v.height_m, 2)} m{'' if v.height_stale else where}", v.height_stale),
            _stale(source, view.speeds_stale, "" if view.speeds.source else WARN),
        )
    )


def board(view: View) -> Text:
    """The table on board."""
    b = view.board
    states = {"unread": "not read yet", "partial": "being read", "invalid": "no valid table"}
    first = Text(states.get(b.state, b.kind), GOOD if b.state == "read" else WARN)
    if b.of_model:
        first.append(" (model's)", DIM)
    lines = [first]
    if b.digest:
        lines.append(Text.assemble(("hash ", DIM), b.digest))
    if b.upper_ct is not None:
        lines.append(Text.assemble(("CT ", DIM), number(b.upper_ct), " / ", number(b.lower_ct)))
    if b.thr_mdl_fac is not None:
        lines.append(Text.assemble(("THR_MDL_FAC ", DIM), number(b.thr_mdl_fac, 3)))
    if b.frame_class is not None:
        lines.append(Text.assemble(("FRAME_CLASS ", DIM), str(b.frame_class)))
    if b.upper_factor is not None:
        lines.append(
            Text.assemble(("factor ", DIM), number(b.upper_factor, 2), " / ", number(b.lower_factor, 2))
        )
    if b.thst_expo is not None:
        lines.append(Text.assemble(("THST_EXPO ", DIM), number(b.thst_expo, 3)))
    elif b.rotors:
        lines.append(Text.assemble(("rotors ", DIM), str(b.rotors)))
    return Text("\n").join(lines)


def head(view: View, width: int, paused: bool = False) -> Text:
    """One line: firmware, mode, armed on the left; the link on the right."""
    v, link = view.vehicle, view.link
    left = Text.assemble(("coaxlink ", "bold"))
    if v is not None:
        firmware = f"{v.firmware} {v.version}".strip()
        left.append(f"{firmware}  ", DIM)
        left.append(f"{v.mode}  ", "bold")
        left.append("ARMED" if v.armed else "disarmed", f"bold {BAD}" if v.armed else GOOD)
    if paused:
        left.append("  PAUSED", f"bold {WARN}")
    right = link_words(view)
    if width and left.cell_len + right.cell_len + 2 > width:
        right = link_words(view, short=True)
    if width >= 110:
        right.append(f"  {link.address}", DIM)
    gap = max(width - left.cell_len - right.cell_len, 2)
    return Text.assemble(left, " " * gap, right)


def link_words(view: View, *, short: bool = False) -> Text:
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


def notes(view: View) -> Text:
    """What a reader must know to trust the numbers, a line each; empty when there is nothing."""
    lines = []
    if view.link.state == "lost":
        gone = seconds(view.link.age_s or 0.0)
        lines.append(Text(f"LINK LOST {gone} ago: the last values are shown", f"bold {BAD}"))
    if view.vehicle is not None and view.vehicle.text:
        lines.append(Text(f"autopilot: {view.vehicle.text}"))
    if view.link.state == "live" and view.speeds_stale:
        lines.append(Text(f"speeds are {seconds(view.speeds_age_s or 0.0)} old", WARN))
    lines += [Text(note, WARN) for note in view.notes]
    lines += [Text(f"table: {note}", WARN) for note in view.board.notes]
    if view.balance.error_note and view.speeds.source:
        lines.append(Text(f"no allocation error: {view.balance.error_note}", DIM))
    return Text("\n").join(lines)


def split_plot(history: History, width: int, height: int) -> Text:
    """Upper share of thrust per arm over the vehicle's time, newest at the right."""
    label = 5
    series = history.series()
    if not any(series) or width < label + 8 or height < 2:
        return Text("no split yet: the rotors stand still", DIM)
    values = [y for points in series for _, y in points]
    low, high = nice_range(values, 10.0, 5.0)
    cells = braille(
        series, width - label, height, (-history.span_s, 0.0), (low, high), gap=history.span_s / 20
    )
    rows = []
    for k, line in enumerate(cells):
        share = _tick(k, len(cells), low, high)
        row = Text(f"{share:3.0f}%▕" if share is not None else "    ▕", DIM)
        for character, index in line:
            row.append(character, ARMS[index % len(ARMS)] if index is not None else "")
        rows.append(row)
    return Text("\n").join(rows)


def _tick(row: int, rows: int, low: float, high: float) -> float | None:
    """The share that stands beside a row: top, bottom, and every fifth row of a tall plot."""
    last = rows - 1
    if row in (0, last):
        return high if row == 0 else low
    near_end = last - row < 3
    return high - (high - low) * row / last if row % 5 == 0 and not near_end else None


def plot_legend(arms: Sequence[ArmView]) -> Text:
    """Names of the arms in the colours of their lines."""
    words = Text("upper share of thrust ")
    for k, arm in enumerate(a for a in arms):
        if arm.lower is not None:
            words.append(f" ━ {arm.name}", ARMS[k % len(ARMS)])
    return words


def seconds(value: float) -> str:
    """An age as a person says it."""
    if value < 10.0:
        return f"{value:.1f} s"
    return f"{value:.0f} s" if value < 120.0 else f"{value / 60.0:.0f} min"


def summary(view: View) -> Text:
    """The whole view in lines, for `--once`."""
    lines = [head(view, 0)]
    width = 60
    for arm in view.arms:
        title = Text.assemble((f"{arm.name}: ", "bold"), arm_split(arm, view.speeds_stale))
        lines += [title, arm_body(arm, width, view.speeds_stale)]
    b = view.balance
    share = "" if b.upper_share is None else f", upper {percent(b.upper_share)}"
    lines.append(Text(f"thrust {number(b.thrust_N)} N, {number(b.of_weight, 2)} of the weight{share}"))
    lines += [balance(view), vehicle(view)]
    lines.append(Text.assemble("table on board: ", Text(", ").join(board(view).split("\n"))))
    words = notes(view)
    return Text("\n").join([*lines, words] if words.plain else lines)


def _stale(text: str, stale: bool, style: str = "") -> Text:
    # first, as narrow panels cut off the end
    return Text(f"stale {text}", DIM) if stale else Text(text, style)
