"""The judge of the blind benchmark: truth and answers side by side. Imports neither world nor guest."""

from __future__ import annotations

import json
import math
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FAULTS = {
    "lying_tachometer", "swapped_labels", "stuck_cell", "repeated_batch",
    "swapped_motors", "stuck_accel", "reversed_gyro", "repeated_stretch",
}  # fmt: skip
SMALL = 0.03


@dataclass(frozen=True)
class Case:
    """One hidden world."""

    kind: str  # stand, flight
    family: str  # other, same, law
    hidden: tuple[str, ...]
    seed: int

    @property
    def name(self) -> str:
        """Of its files."""
        return f"{self.kind}-{self.family}-{'+'.join(self.hidden) or 'clean'}-{self.seed}"

    @property
    def sort(self) -> str:
        """single, double, fault, strange or clean."""
        if not self.hidden:
            return "clean"
        if self.hidden[0].startswith("strange"):
            return "strange"
        if self.hidden[0] in FAULTS:
            return "fault"
        return "single" if len(self.hidden) == 1 else "double"


@dataclass(frozen=True)
class Verdict:
    """How one answer compares with the truth."""

    case: Case
    worth: float
    right: bool
    alarm: bool  # an effect that is not there
    said: str
    floor: float  # worst channel after over its noise floor, as reported
    together: float  # the same over all channels, root mean square
    noise: float  # worst load after over the noise that the world really put on it; nan if it is not known
    seconds: float
    world: str = ""  # what the judge knows of the rig or the flight


def judge(case: Case, truth: dict[str, Any], answer: dict[str, Any]) -> Verdict:
    """Exact means: these effects, no others, nothing left ambiguous, no instrument accused."""
    worth = float(truth.get("worth", 0.0))
    if "failed" in answer:
        last = answer["failed"].strip().splitlines()[-1][:90]
        return Verdict(case, worth, False, False, f"FAILED {last}", *4 * (math.nan,), _world(truth))
    found = tuple(sorted(e["name"] for e in answer["effects"]))
    doubts = ["/".join(a["names"]) for a in answer["ambiguous"]]
    suspects, open_ends = answer["suspect_data"], answer["unexplained"]
    right = {
        "clean": not (found or doubts or suspects),
        "strange": not found and not doubts and bool(open_ends) and not suspects,
        "fault": not found and bool(suspects),
    }.get(case.sort, found == tuple(sorted(case.hidden)) and not doubts and not suspects)
    said = "+".join(found) or "nothing"
    said += f" (ambiguous {', '.join(doubts)})" if doubts else ""
    said += f" ({len(suspects)} suspect: {suspects[0]['column']})" if suspects else ""
    said += " (unexplained)" if open_ends else ""
    channels = answer["channels"]
    over = [c["rmse_after"] / c["noise_floor"] for c in channels.values() if c["noise_floor"] > 0]
    sigma = truth.get("sigma", {})
    real = [
        channels[n.rsplit("_", 1)[0]]["rmse_after"] / s
        for n, s in sigma.items()
        if n.rsplit("_", 1)[0] in channels
    ]
    errors = max(over, default=math.nan), _rms(over), max(real, default=math.nan)
    alarm = bool(set(found) - set(case.hidden))
    return Verdict(case, worth, right, alarm, said, *errors, answer["seconds"], _world(truth))


def _rms(values: list[float]) -> float:
    return math.sqrt(sum(x * x for x in values) / len(values)) if values else math.nan


def _world(truth: dict[str, Any]) -> str:
    keys = ("style", "pair", "given", "drive", "noise", "airframe", "plan", "every", "rows", "sizes", "pick")
    text = ", ".join(f"{k} {truth[k]}" for k in keys if k in truth)
    return text + (" | " + " ".join(truth["told"].split()) if "told" in truth else "")


def failures(verdicts: list[Verdict]) -> str:
    """Every wrong answer with its world, for whoever mends the method."""
    return "\n".join(
        f"{v.case.name}: worth {100 * v.worth:.1f} %, said {v.said}; {v.world}"
        for v in verdicts
        if not v.right
    )


def wilson(good: int, count: int) -> tuple[float, float]:
    """95 % interval of a rate (Wilson 1927)."""
    if not count:
        return 0.0, 1.0
    z, p = 1.96, good / count
    middle, half = p + z * z / (2 * count), z * math.sqrt(p * (1 - p) / count + z * z / (4 * count * count))
    return (middle - half) / (1 + z * z / count), (middle + half) / (1 + z * z / count)


def rate(verdicts: list[Verdict]) -> str:
    """In words."""
    good = sum(v.right for v in verdicts)
    low, high = wilson(good, len(verdicts))
    share = 100 * good / max(len(verdicts), 1)
    return f"{share:5.1f} % ({100 * low:.1f} to {100 * high:.1f}) of {len(verdicts)}"


def table(cases: list[Case], folder: Path, answers: Path) -> tuple[str, dict[str, Any]]:
    """The report and its numbers, of whatever has been answered."""
    verdicts = []
    for case in cases:
        truth_file, said = folder / "truth" / f"{case.name}.json", answers / f"{case.name}.json"
        if said.exists():
            truth = json.loads(truth_file.read_text()) if truth_file.exists() else {}
            verdicts.append(judge(case, truth, json.loads(said.read_text())))
    lines = [f"{len(verdicts)} of {len(cases)} answered"]
    head = f"{'kind':6s} {'family':6s} {'hidden':46s} {'>= 3 %':>8s} {'< 3 %':>7s}"
    lines.append(f"{head} {'floor':>6s} {'noise':>6s} {'CPU s':>5s}  otherwise")
    groups: dict[tuple[str, str, str], list[Verdict]] = defaultdict(list)
    for v in verdicts:
        groups[v.case.kind, v.case.family, " + ".join(v.case.hidden) or "clean"].append(v)
    for (kind, family, hidden), mine in groups.items():
        lines.append(f"{kind:6s} {family:6s} {hidden:46s} {_row(mine)}")
    numbers: dict[str, Any] = {"rates": {}, "cases": [_plain(v) for v in verdicts]}
    for kind in ("stand", "flight"):
        for sort in ("single", "double", "fault", "strange", "clean"):
            for families in (("other",), ("law",), ("same",), ("other", "law"), ("other", "law", "same")):
                mine = [
                    v
                    for v in verdicts
                    if v.case.kind == kind and v.case.sort == sort and v.case.family in families
                ]
                if not mine or (len(families) > 1 and len({v.case.family for v in mine}) < 2):
                    continue
                name = f"{kind} {sort} {'+'.join(families) if len(families) < 3 else 'all'}"
                big = [v for v in mine if v.worth >= SMALL - 1e-9 or sort in ("clean", "fault")]
                small = [v for v in mine if v not in big]
                text = f"{name:24s} right {rate(big)}"
                if small:
                    text += f"; below 3 %: {rate(small)}"
                alarms = sum(v.alarm for v in mine)
                text += f"; an effect that is not there: {alarms}/{len(mine)}"
                lines.append(text)
                numbers["rates"][name] = {
                    "right": sum(v.right for v in big),
                    "of": len(big),
                    "small_right": sum(v.right for v in small),
                    "small_of": len(small),
                    "alarms": alarms,
                    "all": len(mine),
                }
    lines += _by_model(verdicts)
    lines += _floors(verdicts)
    numbers["failures"] = failures(verdicts)
    return "\n".join(lines), numbers


def _row(mine: list[Verdict]) -> str:
    big = [v for v in mine if v.worth >= SMALL - 1e-9 or not v.case.hidden]
    small = [v for v in mine if v not in big]
    other = Counter(v.said for v in big if not v.right)
    seeds = {said: [v.case.seed for v in big if v.said == said and not v.right][:4] for said in other}
    shown = "; ".join(f"{n} x {said} {seeds[said]}" for said, n in other.most_common(4))
    middle = [_median([getattr(v, k) for v in mine]) for k in ("floor", "noise", "seconds")]
    rates = f"{sum(v.right for v in big)}/{len(big)}", f"{sum(v.right for v in small)}/{len(small)}"
    return f"{rates[0]:>8s} {rates[1]:>7s} {middle[0]:6.2f} {middle[1]:6.2f} {middle[2]:5.1f}  {shown}"


def _by_model(verdicts: list[Verdict]) -> list[str]:
    """Of the stand written for this benchmark: rigs with a rotor model to hold against, and without one."""
    out = []
    for label, mark in (("rotor model given", "given True"), ("own fit", "given False")):
        for sorts in (("single",), ("double",), ("fault", "strange"), ("clean",)):
            mine = [v for v in verdicts if v.case.sort in sorts and f"{mark}," in v.world]
            mine = [v for v in mine if v.worth >= SMALL - 1e-9 or v.case.sort in ("clean", "fault")]
            if mine:
                alarms = sum(v.alarm for v in mine)
                out.append(
                    f"stand other, {label}, {' and '.join(sorts)}: right {rate(mine)}; "
                    f"an effect that is not there: {alarms}/{len(mine)}"
                )
    return out


def _floors(verdicts: list[Verdict]) -> list[str]:
    out = []
    for kind in ("stand", "flight"):
        named = [
            v for v in verdicts if v.case.kind == kind and v.right and v.case.sort in ("single", "double")
        ]
        mine = [v for v in named if "unexplained" not in v.said]  # else the error is known to be no noise
        if named:
            out.append(f"{kind}: of {len(named)} right answers {len(mine)} leave nothing unexplained")
        for label, key in (
            ("worst channel after over reported noise floor", "floor"),
            ("all channels after over reported noise floor", "together"),
            ("worst load after over true noise", "noise"),
        ):
            values = [x for v in mine if not math.isnan(x := getattr(v, key))]
            if values:
                within = sum(x <= 1.05 for x in values) / len(values)
                out.append(
                    f"{kind} explained, {label}: within 1.05 in "
                    f"{100 * within:.0f} % of {len(values)}, median {_median(values):.2f}"
                )
        seconds = [v.seconds for v in verdicts if v.case.kind == kind and not math.isnan(v.seconds)]
        if seconds:
            out.append(f"{kind} CPU time: median {_median(seconds):.1f} s, longest {max(seconds):.1f} s")
    return out


def _median(values: list[float]) -> float:
    good = sorted(v for v in values if not math.isnan(v))
    return good[len(good) // 2] if good else math.nan


def _plain(v: Verdict) -> dict[str, Any]:
    return {
        "case": v.case.name,
        "worth": v.worth,
        "right": v.right,
        "said": v.said,
        "floor": v.floor,
        "noise": v.noise,
        "seconds": v.seconds,
    }
