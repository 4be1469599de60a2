"""A campaign file: which quantities vary, over what, which laws fly each draw, and which flight a cell is.

    seed = 1
    flights = 1000                        # laws times draws, at most
    laws = ["standard", "fitted"]         # each draw is flown with each of them, on one seed
    airframe = ["x8_demo.toml", "y6.toml"]
    mass_share = { low = 0.9, high = 1.1 }

    [effects.wind]                        # what is true and no law knows
    size = { low = 0.0, high = 8.0 }      # m/s

A quantity is a value, a list to choose from, or a range `{ low, high }` (`log = true`: evenly in the
logarithm; `steps = N`: so many values in a grid).
"""

from __future__ import annotations

import hashlib
import json
import math
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coaxlink import files
from coaxlink.errors import InputError
from firmware_params.keys import unknown_key

LAWS = ("standard", "curved", "reduced", "fitted", "exact")
PLANS = ("hover", "circle", "wander", "steps")
MOST_FLIGHTS = 1_000_000  # flights of one campaign
ANY_ROTOR = "any"
# quantities that are numbers: least, most, what they are
NUMBERS: dict[str, tuple[float, float, str]] = {
    "mass_share": (0.2, 5.0, "of the airframe's mass"),
    "inertia_share": (0.2, 5.0, "of its moments of inertia"),
    "arm_share": (0.2, 5.0, "of its rotors' distances"),
    "lag_s": (0.0, 0.5, "motor lag, s"),
    "charge": (0.1, 1.0, "of the pack, to begin with"),
}
NAMES = ("airframe", "rotor", "believed", "plan")
PLAIN = {
    "name": str, "seed": int, "flights": int, "repeats": int, "seconds": float, "settle_s": float,
    "rate_hz": int, "judge": str, "draw": str, "laws": list, "effects": dict,
}  # fmt: skip


@dataclass(frozen=True)
class DrawnQuantity:
    """What one thing may be: some values, or a range."""

    values: tuple[float | str, ...] = ()
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    steps: int = 0

    @property
    def varies(self) -> bool:
        """Whether it can be more than one thing."""
        return len(self.values) > 1 or (not self.values and self.low != self.high)

    @property
    def text(self) -> bool:
        """Whether its values are names."""
        return bool(self.values) and isinstance(self.values[0], str) and self.values != (ANY_ROTOR,)

    def at(self, share: float) -> float | str:
        """The value at a share 0..1 of the way."""
        if self.values == (ANY_ROTOR,):
            return share
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        if self.log:
            return math.exp(math.log(self.low) + share * (math.log(self.high) - math.log(self.low)))
        return self.low + share * (self.high - self.low)

    def grid(self) -> tuple[float | str, ...]:
        """All values of a grid."""
        if self.values:
            return self.values
        return tuple(self.at(k / (self.steps - 1)) for k in range(self.steps))


@dataclass(frozen=True)
class KnownEffect:
    """What the world knows of an effect: further keys, its laws, what its size means."""

    keys: tuple[str, ...]
    laws: tuple[str, ...]
    size: str


@dataclass(frozen=True)
class Spec:
    """A campaign, checked; `document` is the file as it was read, `texts` the files it names."""

    name: str
    seed: int
    draws: int
    laws: tuple[str, ...]
    grid: bool
    repeats: int
    seconds: float
    settle_s: float
    rate_hz: int
    judge: str
    quantities: Mapping[
        str, DrawnQuantity
    ]  # airframe, mass_share, ..., effects.wind.size, effects.wind.chance
    texts: Mapping[str, str]  # contents of airframe and rotor files by the name the campaign uses

    @property
    def cells(self) -> int:
        """How many flights."""
        return self.draws * len(self.laws)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that may be true."""
        return tuple(dict.fromkeys(k.split(".")[1] for k in self.quantities if k.startswith("effects.")))

    @property
    def digest(self) -> str:
        """Of everything that decides a row."""
        content = [self.seed, self.laws, self.grid, self.repeats, self.seconds, self.settle_s, self.rate_hz]
        content += [self.draws, sorted(self.texts.items())]
        content += [
            [k, [q.values, q.low, q.high, q.log, q.steps]] for k, q in sorted(self.quantities.items())
        ]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()


@dataclass(frozen=True)
class Cell:
    """One flight: cell = draw x laws + place of its law."""

    number: int
    draw: int
    law: str
    seed: int  # of gusts, noise and plan: one for all laws of a draw
    values: Mapping[str, float | str]  # of every quantity; an effect that is not true has size 0


def cell(spec: Spec, number: int) -> Cell:
    """The cell of that number, from 0; it follows from the campaign and the number alone."""
    draw, law_index = divmod(number, len(spec.laws))
    values: dict[str, float | str] = {}
    rest = draw // spec.repeats
    for name, q in spec.quantities.items():
        if spec.grid:
            grid = q.grid()
            rest, at = divmod(rest, len(grid))
            values[name] = _share(spec.seed, draw, name) if grid[at] == ANY_ROTOR else grid[at]
        else:
            values[name] = q.at(_share(spec.seed, draw, name))
    for name in spec.effects:
        chance = values.pop(f"effects.{name}.chance", 1.0)
        if not _share(spec.seed, draw, f"effects.{name}") < float(chance):
            values[f"effects.{name}.size"] = 0.0
    seed = zlib.crc32(f"{spec.seed}/{draw}".encode()) >> 1
    return Cell(number, draw, spec.laws[law_index], seed, values)


def _share(seed: int, draw: int, name: str) -> float:
    """Evenly between 0 and 1, a stream of its own for every quantity: another one more moves none of them."""
    return float(np.random.default_rng([seed & 0xFFFFFFFF, draw, zlib.crc32(name.encode())]).random())


def read_spec(path: Path, known: Mapping[str, KnownEffect]) -> Spec:
    """Read a campaign file; `known` are the world's effects. Raises InputError naming the key."""
    document = files.read_toml(path)
    _refuse_unknown(path, "", document, (*PLAIN, *NAMES, *NUMBERS))
    for key, kind in PLAIN.items():
        if key in document and not _is(document[key], kind):
            raise InputError(path, key, f"{_kind(kind)} is expected, found {document[key]!r}")
    laws = tuple(document.get("laws", ("standard", "fitted")))
    for law in laws:
        if law not in LAWS:
            raise InputError(path, "laws", f"one of {', '.join(LAWS)} is expected, found {law!r}")
    if not laws or len(set(laws)) != len(laws):
        raise InputError(path, "laws", "some laws are expected, each once")
    quantities = {"airframe": DrawnQuantity(("x8_demo.toml",)), "plan": DrawnQuantity(("wander",))}
    for key in NAMES:
        if key in document:
            quantities[key] = _quantity(path, key, document[key], text=True)
    for key, (least, most, _) in NUMBERS.items():
        if key in document:
            quantities[key] = _quantity(path, key, document[key], least=least, most=most)
    for plan in quantities["plan"].values:
        if plan not in PLANS:
            raise InputError(path, "plan", f"one of {', '.join(PLANS)} is expected, found {plan!r}")
    _refuse_unknown(path, "effects.", document.get("effects", {}), known)
    for name, table in document.get("effects", {}).items():
        quantities |= _effect(path, name, table, known)
    grid, repeats = document.get("draw", "random") == "grid", document.get("repeats", 1)
    if document.get("draw", "random") not in ("random", "grid"):
        raise InputError(path, "draw", f"random or grid is expected, found {document['draw']!r}")
    draws = _draws(path, document, quantities, len(laws), grid, repeats)
    numbers = {"seconds": (60.0, 0.5, 3600.0), "settle_s": (5.0, 0.0, 60.0), "rate_hz": (400, 50, 1000)}
    found = {k: _within(path, k, document.get(k, usual), a, b) for k, (usual, a, b) in numbers.items()}
    texts: dict[str, str] = {}
    for key in ("airframe", "rotor", "believed"):
        for value in quantities[key].values if key in quantities else ():
            _take(path, key, str(value), texts)
    return Spec(
        document.get("name", path.stem), document.get("seed", 1), draws, laws, grid, repeats,
        float(found["seconds"]), float(found["settle_s"]), int(found["rate_hz"]),
        document.get("judge", "height_max_m"), quantities, texts,
    )  # fmt: skip


def _is(value: object, kind: type) -> bool:
    if isinstance(value, bool):
        return kind is bool
    return isinstance(value, (int, float)) if kind is float else isinstance(value, kind)


def _kind(kind: type) -> str:
    return {str: "a text", int: "a whole number", float: "a number", bool: "true or false", list: "a list",
            dict: "tables such as [effects.wind]"}[kind]  # fmt: skip


def _refuse_unknown(path: Path, where: str, table: Mapping[str, Any], known: Iterable[str]) -> None:
    if odd := unknown_key(table, known):
        raise InputError(path, f"{where}{odd[0]}", odd[1])


def _within(path: Path, key: str, value: Any, least: float, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not least <= value <= most:
        raise InputError(path, key, f"a number from {least:g} to {most:g} is expected, found {value!r}")
    return float(value)


def _quantity(
    path: Path, key: str, value: Any, *, least: float = -math.inf, most: float = math.inf, text: bool = False
) -> DrawnQuantity:
    if isinstance(value, dict) and not text:
        _refuse_unknown(path, f"{key}.", value, ("low", "high", "log", "steps"))
        if not {"low", "high"} <= set(value):
            raise InputError(path, key, "a range is { low, high } and perhaps log, steps")
        low, high = (_within(path, f"{key}.{end}", value[end], least, most) for end in ("low", "high"))
        log, steps = value.get("log", False), value.get("steps", 0)
        if low > high or (log and low <= 0.0) or not isinstance(log, bool):
            raise InputError(path, key, "low <= high is expected, above 0 where log = true")
        if isinstance(steps, bool) or not isinstance(steps, int) or steps < 0 or steps == 1:
            raise InputError(path, f"{key}.steps", f"2 or more is expected, found {steps!r}")
        return DrawnQuantity((), low, high, log, steps)
    values = value if isinstance(value, list) else [value]
    if not values:
        raise InputError(path, key, "a list to choose from is empty")
    for v in values:
        if text and not isinstance(v, str):
            raise InputError(path, key, f"a name, or a list of names, is expected, found {v!r}")
        if not text:
            _within(path, key, v, least, most)
    return DrawnQuantity(tuple(values if text else map(float, values)))


def _effect(path: Path, name: str, table: Any, known: Mapping[str, KnownEffect]) -> dict[str, DrawnQuantity]:
    where = f"effects.{name}"
    form = known[name]
    allowed = ("size", "chance", "onset_s", "law", *form.keys)
    if isinstance(table, dict):
        _refuse_unknown(path, f"{where}.", table, allowed)
    if not isinstance(table, dict) or "size" not in table:
        raise InputError(path, f"{where}.size", f"is missing: {form.size}")
    found = {}
    for key, value in table.items():
        full_key = f"{where}.{key}"
        if key == "law":
            found[full_key] = _quantity(path, full_key, value, text=True)
            for law in found[full_key].values:
                if law not in form.laws:
                    raise InputError(
                        path, full_key, f"one of {', '.join(form.laws)} is expected, found {law!r}"
                    )
        elif key == "rotor" and value == ANY_ROTOR:
            found[full_key] = DrawnQuantity((ANY_ROTOR,))
        else:
            least, most = {"chance": (0.0, 1.0), "onset_s": (0.0, 3600.0)}.get(key, (-math.inf, math.inf))
            found[full_key] = _quantity(path, full_key, value, least=least, most=most)
    return found


def _draws(
    path: Path,
    document: dict[str, Any],
    quantities: Mapping[str, DrawnQuantity],
    laws: int,
    grid: bool,
    repeats: int,
) -> int:
    if grid:
        if "flights" in document:
            raise InputError(
                path, "flights", "a grid has as many as its lists make; repeats = N flies each N times"
            )
        draws = repeats
        for key, q in quantities.items():
            if not q.values and not q.steps:
                raise InputError(path, key, "a range in a grid needs steps = N")
            draws *= len(q.values) or q.steps
    else:
        flights = document.get("flights")
        if flights is None:
            raise InputError(path, "flights", "is missing: how many are flown (laws times draws)")
        draws = flights // laws
    if not 1 <= draws * laws <= MOST_FLIGHTS or repeats < 1:
        raise InputError(
            path, "flights", f"{laws} to {MOST_FLIGHTS} flights are expected, found {draws * laws}"
        )
    return draws


def _take(path: Path, key: str, name: str, texts: dict[str, str]) -> None:
    """The contents of a file beside the campaign's, or a shipped one, and of the rotors an airframe names."""
    file = path.parent / name
    file = file if file.is_file() else files.example(name)
    texts[name] = files.read_text(file)
    if key == "airframe":
        rotor = files.read_toml(file).get("rotor_model")
        if isinstance(rotor, str) and rotor not in texts:
            texts[rotor] = files.read_text(file.parent / rotor)
