"""What a flight holds beyond the set that is said: free forms of one channel over what was recorded.

A form is judged beside what it leaves: were noise what no effect explains, an oddity would be noise. In sound
flights too some form explains what does not come again, so rows that the fit did not see have to be better
with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.stats import chi2, ttest_1samp
from scipy.stats import f as fisher

from coaxlink.effects.tracing import Array
from coaxlink.evidence.blocks import FORM_LENGTHS, Block, in_channel, products, waves
from coaxlink.evidence.held_out import Index, Regression
from coaxlink.evidence.likelihood import JITTER
from coaxlink.evidence.noise import autocorrelation_time, white
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.flight_search import Flown
from coaxlink.residual.diagnosis.hypotheses import ODDS, Hypothesis, Scorer

FORM_SIZES = (0.005, 0.02)  # of the reference load, judgement: a row's noise in calm air, a gust's
LEAST = 0.003  # of the reference load, judgement: what is smaller is no pilot's concern
ANGLE = "yaw_rad"  # what begins anew after a turn
STRAIGHT = 2  # functions of a variable that are level or nearly straight
PLACE = ("north_m", "east_m")
TIME = "time_s"
LOADS = ("thrust", "torque")
PATHS = (TIME, "voltage_V", *PLACE, " & ".join(PLACE))  # what a vehicle seldom comes back to
# of forms that are nothing, those that are better on rows that no fit saw; log evidence, judgement: what has
# more is shown though it came once, of which blocks say nothing
BY_CHANCE, OVERWHELMING = 0.05, 100.0
# cycles of a period in a log, judgement: fewer are a trend; frequencies to either side that a line stands out
# from
CYCLES, BESIDE = 3, 16


@dataclass(frozen=True)
class Form:
    """A free form of one channel, and how far the rows bear it out."""

    shown: Hypothesis
    log_evidence: float
    size: float  # of the reference load


@dataclass(frozen=True)
class Line:
    """What comes and goes in a channel with one period."""

    channel: str
    period_s: float
    rms: float
    log_evidence: float  # against noise that has as much there by chance
    size: float  # of the reference load


@dataclass(frozen=True)
class Strain:
    """Corrections of one kind that together lie further out than the vehicle's premises have them."""

    load: str  # thrust or torque
    channel: str  # where they add most
    motor: str  # of the rotor that is furthest out
    share: float  # of its load
    believed: float  # of its load, one standard deviation
    rms: float
    log_evidence: float  # against corrections that lie so far out by chance
    size: float  # of the reference load


class Left:
    """What there is beside a set: free forms, what comes and goes in time, corrections that are strained."""

    def __init__(self, found: Flown, lead: Hypothesis) -> None:
        self.channels = replace(found.channels, forms=_forms(found.channels))
        self._scorer, self._lead = Scorer(self.channels, white(found.channels.count)), lead
        self.without = self._about()

    @cached_property
    def forms(self) -> tuple[Form, ...]:
        """Of every channel the likeliest of what is large enough and comes again, the odds of a form paid.

        Over a path in time and over all else one each is weighed: whatever goes with something goes with
        time as well.
        """
        ranked = sorted(((self._gain(name), name) for name in self.channels.forms), reverse=True)
        out = []
        for channel in self.channels.names:
            mine = [name for _, name in ranked if name.split("|")[1] == channel]
            best = [next((n for n in mine if (_over(n) in PATHS) == late), "") for late in (False, True)]
            forms = [self._form(self._about(name), channel) for name in best if name]
            large = [f for f in forms if f.size >= LEAST and f.log_evidence > 0.0]
            shown = [f for f in large if f.log_evidence > OVERWHELMING or self._recurs(f.shown, channel)]
            out += sorted(shown, key=lambda f: -f.log_evidence)[:1]
        return tuple(out)

    @cached_property
    def lines(self) -> tuple[Line, ...]:
        """The strongest of every channel, of what is large enough."""
        ch, out = self.channels, []
        row = float(np.median(np.diff(ch.frame.time_s[ch.frame.keep])))
        for c, channel in enumerate(ch.names):
            if (found := period_of(self.without.left[:, c])) is not None:
                period, rms, log_evidence = found
                out.append(Line(channel, period * row, rms, log_evidence, rms / float(ch.reference[c])))
        return tuple(line for line in out if line.size >= LEAST)

    def strains(self, h: Hypothesis) -> tuple[Strain, ...]:
        """Rotors' own shares of thrust and of torque beside a set, of what is large enough, the odds of an
        explanation paid.

        A constant moment that no name took is spread over all rotors, each a little further out than
        propellers of one mould differ: together they tell. Of the others, gusts that the loops answer strain
        what goes with speed or is late, and `mass_or_thrust` tells of the lift.
        """
        return tuple(s for load in LOADS if (s := self._strain(h, load)) is not None and s.size >= LEAST)

    def _strain(self, h: Hypothesis, load: str) -> Strain | None:
        """Posterior means (K,) of corrections that are what their priors say have variances of prior less
        posterior: as many squares, in prior deviations, as the log has told of them (MacKay 1992, the count
        of well determined parameters).
        """
        ch, fit = self.channels, h.fit
        of = [k for k, block in enumerate(ch.nuisance) if block.name.endswith(f"_{load}_share")]
        if not of:
            return None
        at = np.cumsum([0, *(block.width for block in ch.nuisance)])[of]
        out = fit.values[at] / fit.deviation[at]
        determined = float(np.sum(1.0 - np.diagonal(fit.covariance)[at] / fit.deviation[at] ** 2))
        added = np.concatenate([ch.nuisance[k].columns for k in of], axis=-1) @ fit.values[at]
        rms = np.sqrt(np.mean(added**2, axis=0))
        c, most = int(np.argmax(rms / ch.reference)), int(np.argmax(np.abs(out)))
        chance = (
            float(chi2.logsf(np.sum(out**2), determined)) + np.log(len(LOADS)) if determined > 0.0 else 0.0
        )
        return Strain(
            load=load,
            channel=ch.names[c],
            motor=ch.nuisance[of[most]].name.split("_")[0].replace("rotor", "motor"),
            share=float(fit.values[at[most]]),
            believed=float(fit.deviation[at[most]]),
            rms=float(rms[c]),
            log_evidence=max(float(ODDS) - chance, 0.0),
            size=float(rms[c] / ch.reference[c]),
        )

    def _about(self, *forms: str) -> Hypothesis:
        lead = self._lead
        return self._scorer.linearised(lead.members, forms, lead.fit.noise, share=lead.share)[0]

    def _gain(self, name: str) -> float:
        """Log evidence that a form would add, at the noise that is."""
        block, fit = self.channels.forms[name](), self.without.fit
        c = self.channels.names.index(name.split("|")[1])
        mine = block.columns[:, c] * (block.deviation / fit.noise[c])
        half = fit.half(self.without.whitened(c).T @ mine / fit.noise[c])
        own = mine.T @ mine
        rounding = 1.0 + JITTER * max(float(np.trace(own)), 1.0)
        low = np.linalg.cholesky(rounding * np.eye(block.width) + own - half.T @ half)
        z = np.linalg.solve(low, mine.T @ (self.without.left[:, c] / fit.noise[c]))
        return float(0.5 * z @ z - np.sum(np.log(np.diag(low))))

    def _recurs(self, h: Hypothesis, channel: str) -> bool:
        """Whether a channel's rows are better with a form that was fitted to others: a t test over blocks."""
        if np.ptp(self.channels.block) == 0:  # a log so short that nothing can be held out
            return False
        c = self.channels.names.index(channel)
        squares = [_held_out(x, self.channels.block)[:, c] ** 2 for x in (self.without, h)]
        better = np.bincount(self.channels.block, squares[0] - squares[1])
        return bool(ttest_1samp(better, 0.0, alternative="greater").pvalue < BY_CHANCE)

    def _form(self, h: Hypothesis, channel: str) -> Form:
        """Nats are tempered by how long what the form leaves hangs together; of a path in time, by how long
        that does which the form explains: so does a gust. Its size is what it adds once corrections gave way.
        """
        c = self.channels.names.index(channel)
        over = self.without if _over(h.forms[0]) in PATHS else h
        time = autocorrelation_time(over.left, self.channels.block)[c]
        ahead = h.fit.log_evidence - self.without.fit.log_evidence
        moved = self.without.left[:, c] - h.left[:, c]
        size = float(np.sqrt(np.mean(moved**2)) / self.channels.reference[c])
        return Form(h, float(ahead / time + h.log_prior - self.without.log_prior), size)


def _held_out(h: Hypothesis, block: Index) -> Array:
    """(rows, C) residual of every row under the set that did not see its block."""
    columns = np.concatenate(h.white, axis=-1)
    none = np.zeros(columns.shape[-1])
    target = h.left + columns @ h.fit.values
    return Regression(columns, target, none, h.fit.deviation, h.fit.noise, block).held_out


def _over(form: str) -> str:
    """The variable of a form."""
    return form.split("|")[0]


def _forms(ch: Channels) -> dict[str, Callable[[], Block]]:
    """Free forms of one channel over one variable, over the heading, and over the place."""
    over: dict[str, Callable[[], tuple[Array, Array]]] = {
        f"{name}|{{}}|{length}": partial(_functions, name, values, length)
        for name, values in ch.variables.items()
        for length in FORM_LENGTHS
    }
    if set(PLACE) <= set(ch.variables):
        both, length = [ch.variables[name] for name in PLACE], min(FORM_LENGTHS)
        over[f"{' & '.join(PLACE)}|{{}}|{length}"] = lambda: products(*(waves(x, length) for x in both))

    def form(functions: Callable[[], tuple[Array, Array]], size: float, c: int) -> Block:
        values, deviations = functions()
        return in_channel("", (values, deviations * size), ch.weights[:, c], c, ch.count)

    return {
        f"{name.format(channel)}|{size}": partial(form, functions, size, c)
        for name, functions in over.items()
        for c, channel in enumerate(ch.names)
        for size in FORM_SIZES
    }


def _functions(name: str, values: Array, length: float) -> tuple[Array, Array]:
    """(rows, K) functions of a variable and (K,) deviations; of speeds those that bend: a gust goes straight
    with them, since the motors answer it.
    """
    if name == ANGLE:
        return _turns(values, length)
    functions, deviations = waves(values, length)
    bends = STRAIGHT if name.startswith("motor") or name.endswith("_speeds") else 0
    return functions[:, bends:], deviations[bends:]


def _turns(angle: Array, length: float) -> tuple[Array, Array]:
    """(rows, K) functions of an angle that begin anew after a turn, and (K,) deviations, of unit variance."""
    number = np.arange(1, round(0.5 / length) + 1)
    functions = [f(angle[:, None] * number) for f in (np.sin, np.cos)]
    return np.concatenate(functions, axis=1), np.full(2 * len(number), np.sqrt(1.0 / len(number)))


def period_of(values: Array) -> tuple[float, float, float] | None:
    """Of values (rows,) at equal distances the period in rows, and the rms, of the strongest line; and the
    nats that speak against noise, which holds as much in some line by chance.

    A line stands out from its neighbours in the spectrum, as ringing does not (each frequency's power is
    exponential about its mean: an F test). None where the strongest is a trend, or has no neighbours.

    >>> turns = np.sin(np.arange(500) * np.pi / 8.0) + 0.1 * np.random.default_rng(0).normal(size=500)
    >>> [round(x, 2) for x in period_of(turns)[:2]]
    [16.13, 0.69]
    """
    power = np.abs(np.fft.rfft(values - np.mean(values))) ** 2
    k = int(np.argmax(power))
    near = np.r_[power[max(1, k - BESIDE) : max(k - 1, 1)], power[k + 2 : k + 1 + BESIDE]]
    if k < CYCLES or len(near) < BESIDE:
        return None
    line = float(np.sum(power[k - 1 : k + 2]))
    chance = float(fisher.logsf(power[k] / np.mean(near), 2, 2 * len(near)) + np.log(len(power)))
    return len(values) / k, float(np.sqrt(2.0 * line)) / len(values), max(-chance, 0.0)
