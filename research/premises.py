"""Every verb that judges, against every premise: what it says, and its exit code.

    python research/premises.py [--small] [--json F]
    python research/premises.py --damages 200 [--verb health|refine] [LOG.ulg...]
    python research/premises.py --columns 300 [--first N] [--verb health|refine|identify] [LOG...]
    python research/premises.py --undamaged 200 [--first N]

One flight of the example X8 in the compiled plant, sound, and one in which rotor 3 lost a fifth in mid
flight, each written as the tlog that a ground station keeps. The premise is then taken away: the vehicle's
file says that a number was guessed (and guesses wrong by 1.6), weighs a fifth less, is another vehicle's; the
outputs are exchanged; a bit of the file is flipped; no parameter says which output is which motor. WRONG: a
sound rotor is named, or a weak one, or another vehicle's flight, passes for sound.

With `--damages` the two flights, and logs of the example X8 that are named, are flipped, cut and holed: the
answer is that of the whole log, or it says that the log is damaged, or ends in the air. SILENT: neither.

With `--columns` one column of the two flights, of one whose payload slides, and of logs that are named is
exchanged, reversed, scaled, shifted, frozen, held, made late or coarse, and rows are dropped
(`damaged_columns`); what is drawn is drawn by the number of the case. A doubt counts where it names the
damaged column, its sensor or a premise that it enters; ELSEWHERE: other doubts only. The undamaged ones must
be said without a doubt. A log's vehicle is the only `*airframe*.toml` or `x8*.toml` beside it, the one of
`../airframes/airframe_LOG.toml`, or the example's. Untold: nothing in the log can tell, and why.

With `--undamaged` sound flights of drawn plans, tables, effects and resolutions are asked for columns that
are no readings: 1 in 100 at most may have one.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import random
import re
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
WEAK, LOSS, SECONDS = 3, 0.2, 50.0
SHIFT_M = 0.01  # along x
SHORT_S = 30.0  # of a flight that is damaged often
Flight = dict[str, np.ndarray]
IMU = ("accel_{}_m_s2", "gyro_{}_rad_s")


def flown(*, weak: bool, seconds: float = SECONDS, shifted: bool = False) -> Flight:
    """Columns at 50 Hz; the loss, or the payload's slide, sets in at half time."""
    from coaxlink.tables.px4 import report_px4
    from coaxlink.vehicle import load_vehicle
    from sim.effects import HiddenEffect
    from sim.physics.rotors import read_pair
    from sim.quick.flight import FlightWorld, fly_quick, make_design
    from sim.vehicle import read_vehicle

    frame, rotors = EXAMPLES / "x8_demo.toml", EXAMPLES / "rotor_paper.toml"
    design = make_design(
        read_vehicle(frame), read_pair(rotors), report_px4(load_vehicle(frame, rotors), "fitted").params
    )
    lost = (HiddenEffect("degraded_rotor", LOSS, 0.5 * seconds, {"rotor": float(WEAK)}),) if weak else ()
    lost += (HiddenEffect("cg_offset", SHIFT_M, 0.5 * seconds),) if shifted else ()
    return fly_quick(design, FlightWorld(lost, 3, "wander", seconds), 8)[1]


def grounded(log: Flight) -> Flight:
    """The flight with three seconds on the ground before and after it."""
    step = float(np.median(np.diff(log["time_s"])))
    rows = round(3.0 / step)
    still = {n: np.zeros(rows) for n in log} | {"accel_z_m_s2": np.full(rows, -9.81)}
    out = {n: np.concatenate([still[n], c, still[n]]) for n, c in log.items()}
    out["time_s"] = log["time_s"][0] + step * np.arange(len(out["time_s"]))
    return out


def messages(log: Flight, order: tuple[int, ...], *, mapped: bool) -> Iterator[tuple[float, Any]]:
    """What a PX4 would have sent; output n drives motor order[n - 1]."""
    if mapped:
        for n in range(1, 9):
            value = struct.unpack("<f", struct.pack("<i", 100 + n))[0]
            yield 0.0, mavlink.MAVLink_param_value_message(b"PWM_MAIN_FUNC%d" % n, value, 6, 8, n)
    for k, t in enumerate(log["time_s"].tolist()):
        ms, us = round(1e3 * t) + 5000, round(1e6 * t) + 5_000_000
        if k % 50 == 0:
            yield t, mavlink.MAVLink_heartbeat_message(14, 12, 128, 0, 4, 3)
            yield t, mavlink.MAVLink_extended_sys_state_message(0, 2 if log["motor1"][k] > 0.0 else 1)
            yield t, mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 25000, -1, 95, 0, 0, 0, 0, 0, 0)
        pulses = [round(1000 + 1000 * float(log[f"motor{n}"][k])) for n in order] + [0] * 8
        yield t, mavlink.MAVLink_servo_output_raw_message(us, 0, *pulses)
        accel, gyro = ([float(log[c.format(a)][k]) for a in "xyz"] for c in IMU)
        yield t, mavlink.MAVLink_highres_imu_message(us, *accel, *gyro, *[0.0] * 7, 0x3F, 0)
        angles = [float(log[f"{a}_rad"][k]) for a in ("roll", "pitch", "yaw")]
        yield t, mavlink.MAVLink_attitude_message(ms, *angles, *gyro)
        speeds = [float(log[f"vel_{a}_m_s"][k]) for a in "ned"]
        yield t, mavlink.MAVLink_local_position_ned_message(ms, 0, 0, -float(log["height_m"][k]), *speeds)


def write_tlog(path: Path, sent: Iterator[tuple[float, Any]]) -> None:
    """Eight bytes of the recorder's clock before each frame."""
    packer = mavlink.MAVLink(None, 1, 1)
    with path.open("wb") as file:
        for t, message in sent:
            frame = message.pack(packer)
            packer.seq = (packer.seq + 1) % 256
            file.write(struct.pack(">Q", 1_700_000_000_000_000 + round(1e6 * t)) + frame)


def airframe(change: Callable[[str], str]) -> str:
    """The example's file, changed, in a folder with its rotors."""
    return change((EXAMPLES / "x8_demo.toml").read_text())


def scaled(text: str, key: str, factor: float) -> str:
    """With a number, or each of a list, times `factor`."""
    line = next(row for row in text.splitlines() if row.startswith(f"{key} ="))
    value = np.atleast_1d(np.array(json.loads(line.partition("=")[2].partition("#")[0])))
    many = [round(factor * float(v), 9) for v in value]
    return text.replace(line, f"{key} = {many if len(many) > 1 else many[0]}")


def sourced(text: str, **sources: str) -> str:
    """With a table of sources."""
    return text + "\n[sources]\n" + "".join(f'{key} = "{value}"\n' for key, value in sources.items())


ORDER = tuple(range(1, 9))
PREMISES: dict[str, tuple[Callable[[str], str], tuple[int, ...], bool, bool]] = {
    # what is taken away: the file's change, the outputs' order, whether the map is known, whether a bit flips
    "nothing": (lambda t: t, ORDER, True, False),
    "inertia guessed": (
        lambda t: sourced(scaled(t, "inertia_kg_m2", 1.6), inertia_kg_m2="estimated"), ORDER, True, False,
    ),
    "lag guessed": (
        lambda t: sourced(scaled(t, "motor_lag_s", 0.0), motor_lag_s="default"), ORDER, True, False,
    ),
    "mass 20 % less": (lambda t: scaled(t, "mass_kg", 0.8), ORDER, True, False),
    "mass 20 % more": (lambda t: scaled(t, "mass_kg", 1.2), ORDER, True, False),
    "outputs exchanged": (lambda t: t, (6, 2, 3, 4, 5, 1, 7, 8), True, False),
    "other vehicle": (lambda _: (EXAMPLES / "y6.toml").read_text(), ORDER, True, False),
    "damaged file": (lambda t: t, ORDER, True, True),
    "no map": (lambda t: t, ORDER, False, False),
}  # fmt: skip


def reported(*arguments: object) -> tuple[int, str]:
    """Exit code and all that a verb says."""
    from coaxlink.cli import main

    out, code = io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            main([str(a) for a in arguments])
        except SystemExit as ended:
            code = int(ended.code or 0)
    return code, out.getvalue()


def verbs(log: Path, frame: Path, sent: list[tuple[float, Any]]) -> Iterator[tuple[str, int, str]]:
    """Each verb, its exit code, and its line that counts."""
    determined = frame.with_suffix(".json")
    for name, *arguments in (
        ("health", log, "--airframe", frame, "--json", determined),
        ("refine", log, "--airframe", frame, "--json", determined),
        (
            "identify",
            log,
            "--airframe",
            frame,
            "--rotor",
            EXAMPLES / "rotor_paper.toml",
            "--json",
            determined,
        ),
        (
            "monitor",
            "--replay",
            log,
            "--airframe",
            frame,
            "--start",
            SECONDS - 1,
            "--once",
            "--json",
            determined,
        ),
    ):
        determined.unlink(missing_ok=True)
        code, text = reported(name, *arguments)
        found = json.loads(determined.read_text()) if determined.is_file() else {}
        yield name, code, words(name, found, text)
    yield "mix", 0, alarm(frame, sent)


def words(verb: str, found: dict[str, Any], text: str) -> str:
    """The verdict and what it names."""
    if verb == "monitor":
        found = found.get("health", {})
        found["verdict"] = found.get("verdict", found.get("word"))
        found["suspects"] = [{"rotor": c["rotor"]} for c in found.get("calls", [])]
    reasons = [f"measure {r['premise']}" for r in found.get("cannot_judge") or []]
    reasons += [r["check"] for r in found.get("not_this_vehicle") or []]
    named = [e["name"] for e in found.get("effects") or []]
    if found.get("verdict") != "sound":
        named += [str(s["rotor"]) for s in (found.get("suspects") or [])[:1]]
    verdict = found.get("verdict") or (text.strip().splitlines() or [""])[-1][:80]
    if verb == "identify" and "terms" in found and not reasons:
        verdict = "a model"
    return f"{verdict}: {', '.join(reasons or named)}" if reasons or named else str(verdict)


def alarm(frame: Path, sent: list[tuple[float, Any]]) -> str:
    """What `mix` says while it flies, the last of it."""
    from coaxlink.live.guard import LIVE
    from coaxlink.live.health_watch import HealthWatch
    from coaxlink.vehicle import load_vehicle

    vehicle = load_vehicle(frame, EXAMPLES / "rotor_paper.toml")
    lines: list[str] = []
    listeners: list[Callable[[Any], None]] = []
    session = SimpleNamespace(send=lambda _: None, subscribe=lambda f: listeners.append(f) or (lambda: None))
    core = SimpleNamespace(vehicle=vehicle, count=len(vehicle.airframe.rotors), last_us=None, sent=[0.0] * 8)
    live = SimpleNamespace(session=session, core=core, guard=SimpleNamespace(state=LIVE), dry_run=False)
    watch = HealthWatch(live, lines.append)  # type: ignore[arg-type]
    watch.listen()
    for _, message in sent:
        if message.get_type() == "SERVO_OUTPUT_RAW":
            core.last_us = message.time_usec
            core.sent = [(getattr(message, f"servo{n}_raw") - 1000) / 1000 for n in ORDER]
        listeners[0](message)
        watch.work()
    return lines[-1][:90] if lines else watch.account()["word"] or "nothing"


def flip(data: bytearray, dice: random.Random) -> bytearray:
    """One bit, or twenty bytes."""
    if dice.random() < 0.5:
        data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
    else:
        for _ in range(20):
            data[dice.randrange(len(data))] = dice.randrange(256)
    return data


def cut(data: bytearray, dice: random.Random) -> bytearray:
    """Its end, or its beginning behind the head."""
    at = dice.randrange(len(data) // 4, len(data))
    return data[:at] if dice.random() < 0.7 else data[: len(data) // 20] + data[at - len(data) // 5 :]


def hole(data: bytearray, dice: random.Random) -> bytearray:
    """Something missing within, or zeros in its place, as of a sector that was not written."""
    size = int(10 ** dice.uniform(1, 5))
    at = dice.randrange(len(data))
    return data[:at] + (bytes(size) if dice.random() < 0.5 else b"") + data[at + size :]


def answered(verb: str, log: Path, frame: Path) -> tuple[str, tuple[str, ...]]:
    """(the answer; what it grants or doubts).

    A log that is read as damaged is judged by nothing (tests/premises holds it): no time is spent on that.
    """
    from coaxlink.data import read_flight_log
    from coaxlink.data.samples import DAMAGED, PREMISES
    from coaxlink.errors import InputError

    with contextlib.suppress(InputError):
        if DAMAGED in read_flight_log(log).premises:
            return "cannot judge: damaged", (PREMISES[DAMAGED],)
    determined = frame.with_suffix(".json")
    determined.unlink(missing_ok=True)
    code, text = reported(verb, log, "--airframe", frame, "--json", determined)
    found = json.loads(determined.read_text()) if determined.is_file() else {}
    if not found:
        return f"refused ({code})", (text.strip().splitlines()[-1],)
    lacks = [r for key in ("cannot_judge", "not_this_vehicle", "suspect_data") for r in found.get(key) or ()]
    granted = found.get("premises", found.get("notes", ()))
    return words(verb, found, text), (*granted, *(str(r["why"]) for r in lacks))


def damages(count: int, verb: str, named: list[Path]) -> int:
    """Print a row a way and a log; the number of answers that changed in silence."""
    found: Counter[tuple[str, str, str]] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        frame, path = Path(folder) / "vehicle.toml", Path(folder) / "flight"
        frame.write_text(airframe(lambda text: text))
        (Path(folder) / "rotor_paper.toml").write_text((EXAMPLES / "rotor_paper.toml").read_text())
        whole = {}
        for weak in (False, True):
            write_tlog(path, messages(grounded(flown(weak=weak, seconds=SHORT_S)), ORDER, mapped=True))
            whole["weak.tlog" if weak else "sound.tlog"] = path.read_bytes()
        whole |= {f"{p.parent.name}/{p.name}": p.read_bytes() for p in named}
        right = {}
        for name, data in whole.items():
            path.write_bytes(data)
            right[name] = answered(verb, path, frame)
            print(f"{name}, whole: {right[name][0]}", flush=True)
        for n in range(count):
            dice = random.Random(n)
            name, way = list(whole)[n % len(whole)], (flip, cut, hole)[n // len(whole) % 3]
            path.write_bytes(way(bytearray(whole[name]), dice))
            answer, doubts = answered(verb, path, frame)
            said_so = set(doubts) - set(right[name][1])
            same = answer == right[name][0]
            how = "the same" if same else "with doubt" if said_so else "SILENT"
            found[name, way.__name__, how] += 1
            print(f"\r{n + 1}", end="", file=sys.stderr, flush=True)
            if how == "SILENT" or (not same and not re.match("cannot|refused|not this", answer)):
                print(f"{n}: {name}, {way.__name__}: {answer}; {how}: {'; '.join(said_so)}", flush=True)
    print("| log | way | the same | with doubt | SILENT |\n|---|---|---:|---:|---:|")
    for name, way in dict.fromkeys((a, b) for a, b, _ in sorted(found)):
        cells = " | ".join(str(found[name, way, how]) for how in ("the same", "with doubt", "SILENT"))
        print(f"| {name} | {way} | {cells} |")
    return sum(number for (_, _, how), number in found.items() if how == "SILENT")


def vehicle_of(log: Path) -> tuple[Path, Path | None]:
    """The airframe file and the rotor file of a log that is named."""
    stem = log.name.partition(".")[0]
    worlds = log.parent.parent / "airframes" / f"airframe_{stem}.toml"
    if worlds.is_file():
        return worlds, log.parent.parent / "models" / f"model_{stem}.toml"
    beside = sorted({*log.parent.glob("*airframe*.toml"), *log.parent.glob("x8*.toml")})
    return (beside[0] if len(beside) == 1 else EXAMPLES / "x8_demo.toml"), None


def weighed(verb: str, log: Any, vehicle: Any) -> tuple[str, tuple[str, ...], Any]:
    """(the answer, what it grants or doubts, the loads in hover of `identify`) of columns that were read."""
    from coaxlink.errors import InputError
    from coaxlink.health.premises import judged
    from coaxlink.instruments.flight.inputs import checked
    from coaxlink.premises.answer import as_json
    from coaxlink.residual import refine
    from coaxlink.rotor_update.coefficients import coefficients_from_flights
    from coaxlink.rotor_update.premises import flown_by, update_hangs_on

    loads = None
    try:
        if verb == "health":
            found = judged([log], ["log"], vehicle).as_json()
        elif verb == "refine":
            found = refine(log, vehicle.declared, vehicle.rotors).to_json()
        else:
            inputs = checked([log], vehicle.declared)
            if not (reasons := flown_by(inputs, vehicle)):
                update = coefficients_from_flights(inputs.logs, vehicle.declared, vehicle.rotors)
                reasons, loads = update_hangs_on(update, inputs.logs, vehicle), update.loads
            determined = [{"column": s.column, "why": s.why} for s in inputs.suspects]
            determined += [{"why": note} for note in update.notes] if loads else []
            found = as_json(reasons) | {"terms": {}, "suspect_data": determined}
    except InputError as error:
        return f"refused: {error}"[:120], (str(error),), None
    lacks = [r for key in ("cannot_judge", "not_this_vehicle", "suspect_data") for r in found.get(key) or ()]
    granted = found.get("premises", found.get("notes", ()))
    return words(verb, found, "a model"), (*granted, *map(doubt, lacks)), loads


def doubt(reason: dict[str, Any]) -> str:
    """With the column, premise or check that it is about."""
    about = " ".join(str(reason[key]) for key in ("column", "premise", "check") if key in reason)
    return f"{about}: {reason['why']}"


def news(doubts: tuple[str, ...], before: tuple[str, ...]) -> list[str]:
    """Doubts that the whole log does not have, whatever their figures; rows left out are no doubt."""
    known = {re.sub(r"[\d.]+", "#", d) for d in before}
    return [d for d in doubts if re.sub(r"[\d.]+", "#", d) not in known and "s not judged: " not in d]


def told_of(log: Any, vehicle: Any) -> set[tuple[str, str]]:
    """What `health`, `refine` and `identify` say of columns before they infer anything (`faults.inputs`)."""
    from coaxlink.instruments.flight.inputs import checked

    return {(s.column, s.why) for s in checked([log], vehicle.declared).suspects}


def alike(now: Any, then: Any) -> bool:
    """Whether loads in hover (prior, its sd, value, its sd) lie within each other's 95 %."""
    if now is None or then is None:
        return now is then
    return all(abs(now[n][2] - then[n][2]) <= 1.96 * np.hypot(now[n][3], then[n][3]) for n in then)


def columns_damaged(count: int, verbs: tuple[str, ...], named: list[Path], first: int = 0) -> int:
    """Print a row a way and a verb; the number of answers that changed in silence, and of doubts for none."""
    from damaged_columns import WAYS, columns_of, concerns, moments, untold

    from coaxlink.data import Samples, read_flight_log
    from coaxlink.vehicle import load_vehicle

    own = load_vehicle(EXAMPLES / "x8_demo.toml", EXAMPLES / "rotor_paper.toml")
    whole = [
        (name, Samples(flown(weak=weak, shifted=shifted, seconds=SHORT_S), name), own)
        for name, weak, shifted in (("sound", False, False), ("weak", True, False), ("shifted", False, True))
    ]
    whole += [(p.name, read_flight_log(p), load_vehicle(*vehicle_of(p))) for p in named]
    right, doubted = {}, 0
    for name, log, vehicle in whole:
        for verb in verbs:
            answer, doubts, loads = right[name, verb] = weighed(verb, log, vehicle)
            odd = [d for d in doubts if "repeats exactly" in d or "fits the other" in d or "suspect" in d]
            doubted += bool(odd)
            print(f"{name}, whole: {verb}: {answer} {'; '.join(odd)}", flush=True)
    found: Counter[tuple[str, str, str]] = Counter()
    for n in range(first, first + count):
        dice = random.Random(n)
        name, log, vehicle = whole[n % len(whole)]
        way = list(WAYS)[n // len(whole) % len(WAYS)]
        column = dice.choice(columns_of(log))
        rows = moments(log, dice)
        damaged, what = WAYS[way](log, column, rows, dice)
        if damaged is log:
            continue
        print(f"\r{n + 1}", end="", file=sys.stderr, flush=True)
        hurt = f"{column}, {what}" if way == "exchange" else what if way == "dead ESC" else column
        given = told_of(damaged, vehicle) - told_of(log, vehicle)
        if any(
            concerns(f"{c}: {why}", way, hurt) for c, why in given
        ):  # every verb says it: no time for that
            found.update((way, verb, "with doubt") for verb in verbs)
            continue
        for verb in verbs:
            answer, doubts, loads = weighed(verb, damaged, vehicle)
            before, granted, then = right[name, verb]
            same = answer == before and alike(loads, then)
            new = news(doubts, granted)
            told_it = any(concerns(d, way, hurt) for d in new)
            how = "the same" if same else "with doubt" if told_it else "ELSEWHERE" if new else "SILENT"
            unsaid = how in ("SILENT", "ELSEWHERE")
            why = untold(way, column, log, damaged) if unsaid else ""
            how = "untold" if why else how
            found[way, verb, how] += 1
            if how in ("SILENT", "untold", "ELSEWHERE"):
                print(f"{n}: {name}, {way} {column} {what}: {verb}: {answer}; {how} {why}", flush=True)
                print("".join(f"    {d}\n" for d in sorted(new)), end="", flush=True)
    hows = ("the same", "with doubt", "untold", "ELSEWHERE", "SILENT")
    print(f"| way | verb | {' | '.join(hows)} |\n|---|---|{len(hows) * '---:|'}")
    for way, verb in dict.fromkeys((a, b) for a, b, _ in sorted(found)):
        print(f"| {way} | {verb} | {' | '.join(str(found[way, verb, how]) for how in hows)} |")
    return doubted + sum(number for (_, _, how), number in found.items() if how in ("SILENT", "ELSEWHERE"))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--damages", type=int, metavar="N")
    parser.add_argument("--flight", choices=("sound", "weak"), help="by default both")
    parser.add_argument("--premise", choices=tuple(PREMISES), action="append", help="by default all")
    parser.add_argument("--columns", type=int, metavar="N")
    parser.add_argument("--undamaged", type=int, metavar="N")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="first case: its seed")
    parser.add_argument("--verb", choices=("health", "refine", "identify"))
    parser.add_argument("logs", nargs="*", type=Path)
    parser.add_argument("--small", action="store_true", help="one flight, one premise, for CI")
    parser.add_argument("--json", type=Path)
    o = parser.parse_args()
    if o.damages:
        sys.exit(1 if damages(o.damages, o.verb or "health", o.logs) else 0)
    if o.columns:
        verbs_ = (o.verb,) if o.verb else ("health", "refine", "identify")
        sys.exit(1 if columns_damaged(o.columns, verbs_, o.logs, o.first) else 0)
    if o.undamaged:
        from damaged_columns import undamaged

        sys.exit(1 if undamaged(o.undamaged, EXAMPLES, o.first) > o.undamaged / 100 else 0)
    chosen = ("outputs exchanged",) if o.small else tuple(o.premise or PREMISES)
    rows, wrong = [], 0
    print("| flight | premise | verb | says | exit | |\n|---|---|---|---|---:|---|")
    for flight in ("weak",) if o.small else (o.flight,) if o.flight else ("sound", "weak"):
        log = flown(weak=flight == "weak")
        for premise in chosen:
            change, order, mapped, flips = PREMISES[premise]
            sent = list(messages(log, order, mapped=mapped))
            with tempfile.TemporaryDirectory() as folder:
                path, frame = Path(folder) / "flight.tlog", Path(folder) / "vehicle.toml"
                frame.write_text(airframe(change))
                (Path(folder) / "rotor_paper.toml").write_text((EXAMPLES / "rotor_paper.toml").read_text())
                write_tlog(path, iter(sent))
                if flips:
                    data = bytearray(path.read_bytes())
                    data[2 * len(data) // 3] ^= 64
                    path.write_bytes(data)
                for verb, code, answer in verbs(path, frame, sent):
                    bad = is_wrong(flight, premise, answer)
                    wrong += bad
                    rows.append([flight, premise, verb, answer, code, bad])
                    mark = "WRONG" if bad else ""
                    print(f"| {flight} | {premise} | {verb} | {answer} | {code} | {mark} |", flush=True)
    if o.small:
        wrong += columns_damaged(6, ("health",), [])
    if o.json:
        o.json.write_text(json.dumps(rows))
    sys.exit(1 if wrong else 0)


def is_wrong(flight: str, premise: str, answer: str) -> bool:
    """A rotor that is sound is named, or a weak one, or another vehicle's, passes for sound."""
    found = re.match(r"(?:ground it: |called: |rotor )(\d)", answer)
    named = [found[1]] if found else []
    if flight == "weak" and named not in ([], [str(WEAK)]):
        return True
    if flight == "sound" and named:
        return True
    if premise == "damaged file" and answer in ("sound", f"rotor {WEAK}"):
        return False  # mix reads no file
    quiet = any(answer.startswith(w) for w in ("sound", "nothing to mend"))
    return quiet and (flight == "weak" or premise in ("outputs exchanged", "other vehicle", "damaged file"))


if __name__ == "__main__":
    main()
