"""One line after a verb: what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from coaxlink.residual import Refinement

LIKELY = 0.5  # that something is there, where nothing is reported to be: more likely than not
WEAK = "ground it, change its propeller or motor, fly the check again"
_WARM = (
    "the same points after a rest and after minutes at full load, doors open, motor_temperature_C and "
    "voltage_V recorded: the room's air, warm motors or the supply"
)
_OPTIONS = {
    "battery_voltage": "--voltage V",
    "ground_effect": "--height M",
    "axial_inflow": "--climb M/S",
    "air_density": "--density KG/M3",
}


def after_refine(result: Refinement, out: Path | None, flight: bool, airframe: Path | None = None) -> str:
    """What a refinement calls for: a table, the loops, a run that tells more, or an instrument to mend.

    `airframe` is the file that the user named, None if none.
    """
    from coaxlink.report.refine import above_floor
    from coaxlink.residual.result import POWER_OF

    names = [effect.name for effect in result.effects]
    for doubt in result.ambiguous:
        if doubt.names[0].startswith("degraded_rotor"):
            return f"next: {doubt.separate_by}"
    if names:
        return _after_effects(names, out, airframe)
    if result.suspect_data:
        columns = ", ".join(dict.fromkeys(s.column for s in result.suspect_data))
        return f"next: mend or leave out {columns}, then refine again; no model was changed"
    if result.ambiguous:
        names = list(result.ambiguous[0].names)
        if result.ambiguous[0].experiment is not None:
            return f"next: --plan PLAN.toml writes the run that separates {' from '.join(names)}"
        return f"next: {result.ambiguous[0].separate_by or 'more data'}; no model was changed"
    if result.unexplained:
        first = result.unexplained[0]
        if any(name.startswith(POWER_OF) for name in first.depends_on):
            return f"next: {_WARM}; no model was changed"
        if first.depends_on == ("time_s",):
            return "next: record more of what acts: nothing in the log goes with it; no model was changed"
        more = "flights" if flight else "sweeps"
        return f"next: {more} that vary {', '.join(first.depends_on)} alone; no model was changed"
    if left := above_floor(result):
        calm = "a flight in calm air" if flight else "a slower run"
        return f"next: {calm} would show what is in {', '.join(left)}; no model was changed"
    if result.more is not None and result.more > LIKELY:
        again = "a longer flight" if flight else "a longer run"
        return f"next: {again} would show what may be there; no model was changed"
    if result.surface and not flight:
        return (
            "next: no effect to mend; what the surface holds the rotor model does not: coaxlink identify LOG "
            "says how much of it a model of this log does"
        )
    return "next: nothing to mend; the model explains these data to their noise"


def _after_effects(names: list[str], out: Path | None, airframe: Path | None) -> str:
    from coaxlink.effects import effect

    if "degraded_rotor" in names:  # no table mends a rotor
        return f"next: {WEAK}"
    known = {name: effect(name) for name in names}
    held = [name for name, e in known.items() if e and e.static]
    parts = []
    if held:
        options = " ".join(["", *(_OPTIONS[name] for name in held if name in _OPTIONS)])
        first = f"coaxlink table {airframe or 'AIRFRAME'} --rotor {out or 'ROTOR.toml'}{options}"
        parts.append(first if out else f"--out ROTOR.toml keeps the model, then {first}")
        if options.strip():
            parts.append("or coaxlink mix, which measures it in flight")
    for name, e in known.items():
        if name not in held:
            parts.append(f"no table can hold {name}: {e.no_static if e else 'not known to the mixers'}")
    return f"next: {'; '.join(parts)}"


def after_identify(out: Path | None, form: str) -> str:
    """What a rotor model calls for."""
    if out is None:
        return "next: --out ROTOR.toml writes the model that tables and mixing are made from"
    return (
        f"next: coaxlink compare AIRFRAME.toml --rotor {out} says what a table of this {form} model is worth "
        "(coaxlink init makes the airframe file)"
    )


def after_prior(out: Path | None) -> str:
    """What a model without a measurement calls for."""
    if out is None:
        return "next: --out ROTOR.toml writes the prior; a table made from it flies, and flights mend it"
    return (
        f"next: coaxlink table AIRFRAME.toml --rotor {out} makes a first table; fly it with care, then "
        f"coaxlink refine FLIGHT --airframe AIRFRAME.toml --rotor {out} says what flights add"
    )


def after_compare(airframe: Path, rotor: Path | None) -> str:
    """What a comparison calls for: a table of the same rotors."""
    rotors = f" --rotor {rotor}" if rotor else ""
    return f"next: coaxlink table {airframe}{rotors} --firmware px4|ardupilot --law LAW --out DIR"


def after_upload(source: Path, connect: str) -> str:
    """What a table on board calls for."""
    return (
        "next: props off, each motor once (coaxlink motors, or QGC's Actuators page), then tethered; "
        f"after flights coaxlink verify {source} --connect {connect}"
    )


def after_verify(same: bool, source: Path | None, connect: str) -> str:
    """What a check of the board calls for."""
    if same:
        return "next: fly; coaxlink refine LOG --airframe AIRFRAME.toml finds what the model lacks"
    again = f"coaxlink upload {source or 'DIR'} --connect {connect} writes it again"
    return f"next: {again}, coaxlink restore BACKUP undoes it"


def on_simulator(firmware: str, ports: str) -> str:
    """How to fly what was just started."""
    mixes = ", coaxlink mix mixes it" if firmware.startswith(("px4:1.13", "ardupilot")) else ""
    verbs = f"coaxlink monitor shows it, coaxlink upload writes its tables{mixes}"
    return f"fly it with QGroundControl, MAVProxy or MAVSDK on {ports}; {verbs}"


_WHY = {
    "not_finite": "with a number that is none",
    "absurd": "with a demand far beyond full",
    "late": "no newer than the one before",
    "stale": "that could be older than 20 ms",
    "clock_jumps": "stamped by another clock",
    "other_group": "of another control group",
    "superseded": "that a newer one had overtaken",
    "settling": "while three good ones in a row were waited for",
    "foreign": "from another sender than the vehicle",
    "refused_outputs": "whose outputs would have left their range",
    "failures": "in which the law failed",
}


def unanswered(counts: Mapping[str, int]) -> str:
    """Which demands got no motor command, and why, in words; empty where all did."""
    parts = [f"{count} {_WHY[why]}" for why, count in counts.items() if count]
    return f"not answered: {', '.join(parts)}" if parts else ""
