"""An answer held against a log's truth, and rates by author and kind."""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from worlds.sets import KINDS, Log, Truth

NATS = 100.0  # an oracle's: more must not be answered by silence
Answer = dict[str, Any]


@dataclass(frozen=True)
class Score:
    """How an answer compares with the truth."""

    log: Log
    right: float
    wrong: frozenset[str]  # names that are not there
    silent: bool
    over: float  # error after over the true noise, of the worst channel
    seconds: float
    reported: str
    names: tuple[str, ...] = ()

    @property
    def missed(self) -> bool:
        """Silent where the author's oracle found more than 100 nats."""
        return self.silent and float(self.log.truth.get("llr_null") or 0.0) > NATS


def names_of(answer: Answer) -> frozenset[str]:
    """That are claimed."""
    return frozenset(e["name"] for e in answer.get("effects", []))


def accepted(truth: Truth) -> list[frozenset[str]]:
    """Sets of names that are right, without words for other answers."""
    words = {"unexplained", "suspect_data", "suspect", "ambiguous", "nothing"}
    sets = [truth["effects"], *(truth.get("accept") or [])]
    return [frozenset(s) - words for s in sets if not isinstance(s, str)]


def score(log: Log, answer: Answer, reference: Answer | None = None) -> Score:
    """The answer held against the truth, as `../shared/worlds/grade.py` does."""
    t, nan = log.truth, float("nan")
    if "failed" in answer:
        last = answer["failed"].strip().splitlines()[-1][:100]
        return Score(log, 0.0, frozenset(), False, nan, nan, f"FAILED {last}")
    found = names_of(answer)
    groups = [frozenset(n.split(" of ")[0] for n in a["names"]) for a in answer["ambiguous"]]
    open_ends, suspects = answer["unexplained"], answer["suspect_data"]
    if reference is not None and "failed" not in reference:
        found = found - (names_of(reference) - set(t["effects"]))
        had = {(u["channel"], tuple(u["depends_on"])) for u in reference["unexplained"]}
        open_ends = [u for u in open_ends if (u["channel"], tuple(u["depends_on"])) not in had]
        lies = {(s["column"], s["why"]) for s in reference["suspect_data"]}
        suspects = [s for s in suspects if (s["column"], s["why"]) not in lies]
    silent = not (found or groups or open_ends or suspects or answer.get("cannot_judge"))
    silent = silent and not answer.get("not_this_vehicle") and log.sort != "clean"
    right, wrong = _verdict(log, found, groups, bool(open_ends), bool(suspects))
    over, noise = nan, t.get("noise")
    if isinstance(noise, dict):
        ratios = [
            answer["channels"][c]["rmse_after"] / s for c, s in noise.items() if c in answer["channels"] and s
        ]
        over = max(ratios, default=nan)
    reported = " + ".join(sorted(found)) or "nothing"
    reported += "".join(f" ({' / '.join(sorted(g))})" for g in groups)
    reported += "".join(
        f"; unexplained {u['channel']} over {', '.join(u['depends_on'])}" for u in open_ends[:1]
    )
    reported += "".join(f"; suspect {s['column']}" for s in suspects[:1])
    reported += "; cannot judge" if answer.get("cannot_judge") or answer.get("not_this_vehicle") else ""
    return Score(log, right, wrong, silent, over, answer["seconds"], reported, tuple(sorted(found)))


def _verdict(
    log: Log, found: frozenset[str], groups: list[frozenset[str]], is_open: bool, suspect: bool
) -> tuple[float, frozenset[str]]:
    t, sets = log.truth, accepted(log.truth)
    truth = frozenset(t["effects"])
    if log.sort == "real":
        wrong, together = found - truth - frozenset(t.get("accept") or []), found.union(*groups)
        if truth:
            right = 1.0 if truth <= found else 0.5 * (truth <= together)
        else:
            right = float(suspect if t.get("suspect") else is_open if t.get("unexplained") else True)
        return (0.0 if wrong else right), wrong
    words = {w for a in t.get("accept") or [] for w in a}
    wrong = found - frozenset().union(*sets)
    if log.sort == "clean":
        right = float(not (found or groups or suspect or is_open))
    elif log.sort == "odd":
        right = float((not found and is_open) or (bool(found) and found in sets[1:]))
    elif log.sort == "fault":
        right = float(not found and (suspect or ("unexplained" in words and is_open) or "nothing" in words))
    elif log.sort == "ambiguous":
        right = float(
            (any(truth <= g for g in groups) and not wrong) or (len(sets) > 1 and found in sets[1:])
        )
    else:
        right = float(found in sets) if found else float("unexplained" in words and is_open)
        if not right and any(truth & g for g in groups) and found <= truth.union(*groups):
            right = 0.5
    return right, wrong


def table(scores: Sequence[Score]) -> str:
    """A row an author, rates by kind."""
    by: dict[str, list[Score]] = defaultdict(list)
    for s in scores:
        by[s.log.author].append(s)
    lines = [
        f"{'author':18s}"
        + "".join(f"{k:>12s}" for k in KINDS)
        + "   right  false silent >100  after   s (95 %)"
    ]
    for author, mine in [*sorted(by.items()), *([("all", list(scores))] if len(by) > 1 else [])]:
        cells = []
        for kind in KINDS:
            own = [s.right for s in mine if s.log.sort == kind]
            cells.append(f"{sum(own):g}/{len(own)}" if own else "")
        overs = sorted(s.over for s in mine if s.over == s.over)
        seconds = sorted(s.seconds for s in mine if s.seconds == s.seconds) or [float("nan")]
        lines.append(
            f"{author:18s}"
            + "".join(f"{c:>12s}" for c in cells)
            + f"{100 * sum(s.right for s in mine) / len(mine):7.1f}%{sum(bool(s.wrong) for s in mine):7d}"
            + f"{sum(s.silent for s in mine):7d}{sum(s.missed for s in mine):5d}"
            + (f"{statistics.median(overs):7.2f}" if overs else "       ")
            + f"{statistics.median(seconds):6.1f} ({seconds[int(0.95 * (len(seconds) - 1))]:.0f})"
        )
    return "\n".join(lines)
