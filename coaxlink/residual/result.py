"""What `refine` found, as one plain object: renderers format it, nothing is computed there.

All errors are on held-out rows: blocks (a stretch of flight, a sweep or level of a stand) that the fit
they are judged by has not seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.instruments.findings import Suspect
from coaxlink.notebook import Shown
from coaxlink.premises.answer import CANNOT_JUDGE, NOT_THIS_VEHICLE, NotJudged, OtherVehicle, Reason, as_json
from coaxlink.rotor import RotorModel

if TYPE_CHECKING:
    from coaxlink.residual.experiments.stand_run import Experiment

Interval = tuple[float, float]


@dataclass(frozen=True)
class ChannelError:
    """Held-out error of one channel before and after the effects, with 95 % intervals over blocks."""

    unit: str
    noise_floor: float
    rmse_before: float
    rmse_after: float
    ci_before: Interval
    ci_after: Interval
    held_out_rows: int
    rmse_as_given: float  # the model as it came, without the small corrections that every candidate may use


@dataclass(frozen=True)
class ParameterValue:
    """One number of an effect with its 95 % interval."""

    name: str
    value: float
    ci: Interval
    unit: str

    def __str__(self) -> str:
        """Name, value, its interval where it has one, unit."""
        interval = f" ({self.ci[0]:.3g} .. {self.ci[1]:.3g})" if self.ci[0] < self.ci[1] else ""
        return f"{self.name} {self.value:.3g}{interval}{'' if self.unit == '1' else ' ' + self.unit}"


@dataclass(frozen=True)
class FoundEffect:
    """An effect that the data demand."""

    name: str
    channels: tuple[str, ...]
    parameters: tuple[ParameterValue, ...]
    rmse: Mapping[str, tuple[float, float]]  # channel -> held-out error without it and with it
    evidence: Mapping[str, Any]
    source: str
    needs: tuple[str, ...] = ()


AT = " of rotor "  # between the name of an effect and its place, where the place is what is ambiguous


@dataclass(frozen=True)
class Unexplained:
    """A residual that still depends on something, by no physics we know."""

    channel: str
    depends_on: tuple[str, ...]
    rmse: float
    where: str


@dataclass(frozen=True)
class Ambiguous:
    """Explanations that these data cannot tell apart, and the experiment that would."""

    names: tuple[str, ...]
    separate_by: str
    experiment: Experiment | None = None  # as a runnable schedule, where one was found
    probability: tuple[float, ...] = ()  # of each name, where the rivals were weighed


@dataclass(frozen=True)
class Rejected:
    """An effect that was tried, or could not be, and why it is not in the answer."""

    name: str
    why: str


@dataclass(frozen=True)
class SmoothSurface:
    """What a load is beyond the polynomials of a nuisance fitted to the log itself, over both speeds."""

    channel: str
    rms: float  # over the judged rows, in the channel's unit
    share: float  # of the channel's reference load
    unit: str


POWER_OF = "power_of_"  # begins the name of a variable: both rotors' power, u^3, remembered for so long
HIDDEN = 0.3  # of the reference load: no effect takes more, so a log that shows only that shows nothing of it


@dataclass(frozen=True)
class WouldShow:
    """The smallest size of an effect that this log would have shown: what "nothing" means."""

    name: str
    share: float  # of the channel's reference load
    channel: str
    not_told_from: tuple[str, ...] = ()  # effects that it would have passed for, the likest first


@dataclass(frozen=True)
class Step:
    """One thing the selection tried: `gain` is the drop of the held-out squared error, in noise variances."""

    number: int
    action: str  # add, swap, drop
    name: str
    gain: float
    p_value: float
    size: float  # 95th percentile of its contribution over the reference load
    kept: bool
    why: str


@dataclass(frozen=True)
class Series:
    """What the pictures need, thinned to at most a few thousand rows; residual rows are (rows, channels)."""

    time_s: NDArray[np.float64]  # (rows,)
    channels: tuple[str, ...]
    given: NDArray[np.float64]  # (rows, channels) residual of the model as it came
    before: NDArray[np.float64]  # (rows, channels) held-out residual of the nuisance model
    after: NDArray[np.float64]  # (rows, channels) held-out residual with the effects
    # (effect, channel) -> label and (rows,) of the variable it depends on there
    causes: Mapping[tuple[str, str], tuple[str, NDArray[np.float64]]]
    noise: Mapping[str, float]


@dataclass(frozen=True)
class Refinement(Shown):
    """The whole answer; `to_json` is the contract's object."""

    kind: str  # stand or flight
    channels: Mapping[str, ChannelError]
    effects: tuple[FoundEffect, ...]
    unexplained: tuple[Unexplained, ...]
    ambiguous: tuple[Ambiguous, ...]
    suspect_data: tuple[Suspect, ...]
    rejected: tuple[Rejected, ...]
    model: RotorModel | None
    corrections: Mapping[str, float] = field(default_factory=dict)  # small nuisance corrections, by name
    trace: tuple[Step, ...] = ()
    notes: tuple[str, ...] = ()
    surface: tuple[SmoothSurface, ...] = ()  # no effect: a nuisance model of its own form holds it
    series: Series | None = None
    source: str = ""
    cannot_judge: tuple[NotJudged, ...] = ()  # premises that the answer hangs on: nothing is claimed
    not_this_vehicle: tuple[OtherVehicle, ...] = ()  # likewise
    would_show: tuple[WouldShow, ...] = ()  # of effects that are not named; empty where it was not worked out
    next_run: Experiment | None = None  # where nothing is named: it tells two apart that this log could not
    more: float | None = None  # probability that more is there than is named; None where nothing was weighed
    weighed: tuple[
        Mapping[str, Any], ...
    ] = ()  # candidates, and the numbers that the decision judged them by

    def __repr__(self) -> str:
        names = ", ".join(e.name for e in self.effects) or "no effect"
        return f"Refinement({self.kind}, {self.verdict}: {names}, {len(self.channels)} channels)"

    def __str__(self) -> str:
        """The answer: what was found with its numbers, what stays open, and the errors before and after."""
        lines = [f"{self.source or self.kind}: {self.verdict}", *(reason.line() for reason in self.reasons)]
        for e in self.effects:
            lines.append(f"{e.name} in {', '.join(e.channels)}: {', '.join(map(str, e.parameters))}")
        lines += [f"{' or '.join(a.names)}: separated by {a.separate_by}" for a in self.ambiguous]
        lines += [f"{s.column} ({s.rows}): {s.why}" for s in self.suspect_data]
        lines += [f"{u.channel} still follows {', '.join(u.depends_on)}" for u in self.unexplained]
        lines += [
            f"{name}: {c.rmse_before:.3g} {c.unit} to {c.rmse_after:.3g}, noise {c.noise_floor:.2g}"
            for name, c in self.channels.items()
            if c.rmse_before > 0.0
        ]
        return "\n".join(lines)

    @property
    def names(self) -> frozenset[str]:
        """Of the effects that are there, also where nothing tells at which rotor."""
        placed = {name.split(AT)[0] for a in self.ambiguous for name in a.names if AT in name}
        return frozenset({e.name for e in self.effects} | placed)

    @property
    def at_floor(self) -> bool:
        """Whether nothing was left to explain: no effect, doubt or open dependence."""
        return self.verdict == "nothing to mend"

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why nothing is claimed."""
        return (*self.not_this_vehicle, *self.cannot_judge)

    @property
    def verdict(self) -> str:
        """In two or three words."""
        if self.not_this_vehicle:
            return NOT_THIS_VEHICLE
        if self.cannot_judge:
            return CANNOT_JUDGE
        if self.effects:
            return "found"
        return "open" if self.unexplained or self.ambiguous or self.suspect_data else "nothing to mend"

    def claiming_nothing(
        self, cannot_judge: Sequence[NotJudged] = (), not_this_vehicle: Sequence[OtherVehicle] = ()
    ) -> Refinement:
        """Without names and without a model, for these reasons; what the data contradict stays."""
        return replace(
            self,
            effects=(),
            ambiguous=(),
            model=None,
            would_show=(),
            more=None,
            cannot_judge=tuple(cannot_judge),
            not_this_vehicle=tuple(not_this_vehicle),
        )

    def unnamed(self, hangs_on: Sequence[NotJudged]) -> Refinement:
        """Without names, which hang on these premises. What they explain is there all the same: it stays,
        `unexplained`, each over its cause with its size.
        """
        premises = " and ".join(dict.fromkeys(r.premise for r in hangs_on))
        sizes = {e.name: e.rmse for e in self.effects}
        whole = {n: (c.rmse_before, c.rmse_after) for n, c in self.channels.items()}
        sizes |= {a.names[0].split(AT)[0]: whole for a in self.ambiguous}
        causes = self.series.causes if self.series else {}
        ends = list(self.unexplained)
        for name, rmse in sizes.items():
            shown = {
                c: (causes[name, c][0], float(np.sqrt(max(before**2 - after**2, 0.0))))
                for c, (before, after) in rmse.items()
                if (name, c) in causes
            }
            channel = max(shown, key=lambda c: shown[c][1] / self.channels[c].noise_floor, default="")
            if channel and channel not in {u.channel for u in ends}:
                label, size = shown[channel]
                unit = self.channels[channel].unit
                where = f"{label}: {size:.2g} {unit}, as {name} would have it; no name without {premises}"
                ends.append(Unexplained(channel, (label,), size, where))
        return replace(self.claiming_nothing(hangs_on), unexplained=tuple(ends))

    def to_json(self) -> dict[str, Any]:
        """The JSON object of `refine` in the contract (extra keys: corrections, trace, surface, notes,
        source).

        A number that could not be computed is null: JSON knows neither nan nor infinity.
        """
        return dict(_finite(self._object()))

    def _object(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "verdict": self.verdict,
            **as_json(self.reasons),
            "source": self.source,
            "channels": {
                name: {
                    "unit": c.unit,
                    "noise_floor": c.noise_floor,
                    "rmse_before": c.rmse_before,
                    "rmse_after": c.rmse_after,
                    "ci_before": list(c.ci_before),
                    "ci_after": list(c.ci_after),
                    "held_out_rows": c.held_out_rows,
                    "rmse_as_given": c.rmse_as_given,
                }
                for name, c in self.channels.items()
            },
            "effects": [
                {
                    "name": e.name,
                    "channels": list(e.channels),
                    "parameters": [
                        {"name": p.name, "value": p.value, "ci": list(p.ci), "unit": p.unit}
                        for p in e.parameters
                    ],
                    "rmse": {channel: list(pair) for channel, pair in e.rmse.items()},
                    "evidence": dict(e.evidence),
                    "source": e.source,
                }
                for e in self.effects
            ],
            "unexplained": [
                {"channel": u.channel, "depends_on": list(u.depends_on), "rmse": u.rmse, "where": u.where}
                for u in self.unexplained
            ],
            "ambiguous": [
                {"names": list(a.names), "separate_by": a.separate_by}
                | ({"probability": list(a.probability)} if a.probability else {})
                | ({"plan": a.experiment.document()} if a.experiment else {})
                for a in self.ambiguous
            ],
            "suspect_data": [{"column": s.column, "rows": s.rows, "why": s.why} for s in self.suspect_data],
            "rejected": [{"name": r.name, "why": r.why} for r in self.rejected],
            "corrections": dict(self.corrections),
            "trace": [
                {
                    "step": s.number,
                    "action": s.action,
                    "name": s.name,
                    "gain": s.gain,
                    "p_value": s.p_value,
                    "size": s.size,
                    "kept": s.kept,
                    "why": s.why,
                }
                for s in self.trace
            ],
            "surface": [
                {"channel": s.channel, "rms": s.rms, "share": s.share, "unit": s.unit} for s in self.surface
            ],
            "would_show": [
                {
                    "name": w.name,
                    "share": w.share,
                    "channel": w.channel,
                    "not_told_from": list(w.not_told_from),
                }
                for w in self.would_show
            ],
            "next_run": self.next_run and {**self.next_run.document(), "separate_by": self.next_run.text},
            "more": self.more,
            "weighed": [dict(w) for w in self.weighed],
            "notes": list(self.notes),
        }


def _finite(thing: Any) -> Any:
    """The same with None for numbers that are none."""
    if isinstance(thing, dict):
        return {key: _finite(value) for key, value in thing.items()}
    if isinstance(thing, list | tuple):
        return [_finite(value) for value in thing]
    if isinstance(thing, float | np.floating):
        return float(thing) if np.isfinite(thing) else None
    return thing
