"""A rotor model and its file (`rotor_paper.toml` is the format's example).

Upper and lower thrust (N) and torque (N m) of one coaxial pair as polynomials of the normalised speeds
u = rpm / speed_max_rpm (Berra, Trujillo and Heredia 2024, eq. 1-3, 17). A rotor without a pair is an
upper rotor with u_l = 0. Effects found in measured data travel with the model as `effects`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from coaxlink import files
from coaxlink.errors import InputError
from coaxlink.load import LOADS as LOADS
from coaxlink.load import Load
from coaxlink.notebook import Shown
from coaxlink.rotor.drive import TURNS, BatteryPower, Drive, SideDrive, SpeedTable, of_curves
from coaxlink.rotor.polynomial import Polynomial
from firmware_params.keys import is_near, problem_of
from firmware_params.plain import name_problem, plain

if TYPE_CHECKING:
    from coaxlink.data import Samples

# where a number is from: an instrument read it; somebody says so; the autopilot holds it; computed from
# other numbers; nobody gave it
NEAR = 0.02  # of full speed, judgement: as far from a measured speed as that is measured
Source = Literal["measured", "declared", "board", "estimated", "default"]


COUNTER_ROTATING, CO_ROTATING = "counter-rotating", "co-rotating"


@dataclass(frozen=True)
class EffectEntry:
    """An effect as a rotor file has it: what it is called, its numbers, the columns it reads."""

    name: str
    parameters: Mapping[str, float]
    columns: tuple[str, ...] = ()


@dataclass(frozen=True)
class PairLoads:
    """Loads of a coaxial pair, each of the broadcast shape of the speeds."""

    upper_thrust: NDArray[np.float64]  # N
    upper_torque: NDArray[np.float64]  # N m
    lower_thrust: NDArray[np.float64]  # N
    lower_torque: NDArray[np.float64]  # N m

    def __getitem__(self, load: Load) -> NDArray[np.float64]:
        """One of them."""
        return np.asarray(getattr(self, load.channel))


def _errors_of(load: Load) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return ("errors", load.channel, "rmse"), ("noise_floor", load.channel)


def _number(table: Any, *keys: str) -> float:
    """What stands there, 0 where none does: of an identification a file by hand may say anything."""
    for key in keys:
        table = table.get(key) if isinstance(table, Mapping) else None
    known = isinstance(table, (int, float)) and np.isfinite(table) and table > 0.0
    return float(table) if known else 0.0


@dataclass(frozen=True)
class RotorModel(Shown):
    """One coaxial pair: four polynomials over speeds, what commands turn, and where they come from."""

    form: str  # crm, rcrm, srm, cpcm
    speed_max_rpm: float
    upper_thrust: Polynomial
    upper_torque: Polynomial
    lower_thrust: Polynomial
    lower_torque: Polynomial
    effects: tuple[EffectEntry, ...] = ()
    identified: Mapping[str, Any] = field(default_factory=dict)  # file, hash, rows, method, errors, intervals
    sources: Mapping[str, Source] = field(default_factory=dict)  # key of the file -> where it is from
    rotation: str = COUNTER_ROTATING  # of the pair whose loads these are
    drive: Drive | None = None  # None: a command is the normalised speed
    battery_power: Mapping[str, BatteryPower] = field(default_factory=dict)  # by side; empty: not measured

    def __repr__(self) -> str:
        terms = sum(len(self.surface(load).coefficients) for load in Load)
        effects = f", effects: {', '.join(e.name for e in self.effects)}" if self.effects else ""
        return f"RotorModel({self.form}, {terms} terms, u = 1 at {self.speed_max_rpm:g} rpm{effects})"

    def __str__(self) -> str:
        """The model as equations with their units."""
        lines = [f"{self.form}: u_u, u_l = rpm of the upper, lower rotor / {self.speed_max_rpm:g}"]
        for load in Load:
            name = load.channel.replace("_", " ")
            lines.append(f"{name} = {self.surface(load)} {load.unit}")
        lines += [
            f"effect {e.name}: {', '.join(f'{k} {v:.4g}' for k, v in e.parameters.items())}"
            for e in self.effects
        ]
        return "\n".join(lines)

    @property
    def slowest(self) -> float:
        """Least normalised speed of an upper rotor on its stand; 0 where the file says nothing of it.

        Below, the loads are an extrapolation, and a pair whose upper rotor stands may look cheap.
        """
        measured = self.identified.get("measured")
        ends = measured.get("upper") if isinstance(measured, Mapping) else None
        return _number({"slowest": ends[0]}, "slowest") if isinstance(ends, (list, tuple)) and ends else 0.0

    def measured_at(self, u: ArrayLike) -> NDArray[np.bool_]:
        """(rows, 2) whether each rotor's stand ran it at these normalised speeds (rows, 2), 2 % of full speed
        either way; everywhere, where the file says nothing of it. Elsewhere the loads are an extrapolation.
        """
        speeds = np.asarray(u, float)
        out = np.ones(speeds.shape, bool)
        known = self.identified.get("measured")
        rested = known.get("rested") if isinstance(known, Mapping) else None
        for k, side in enumerate(("upper", "lower")):
            ends = known.get(side) if isinstance(known, Mapping) else None
            if not isinstance(ends, (list, tuple)) or len(ends) != 2:
                continue
            turns = speeds[:, k] > TURNS
            inside = (speeds[:, k] > ends[0] - NEAR) & (speeds[:, k] < ends[1] + NEAR)
            out[:, k] = np.where(turns, inside, rested is None or side in rested)
        return out

    @property
    def missed(self) -> dict[Load, float]:
        """What the model left of its stand log's loads beyond their noise, on held-out blocks, N and N m.

        Without the loads of which the file says nothing, or no more than noise.
        """
        out = {}
        for load in Load:
            error, floor = (_number(self.identified, *keys) for keys in _errors_of(load))
            if error > floor:
                out[load] = float(np.sqrt(error**2 - floor**2))
        return out

    def predict(self, u: ArrayLike) -> NDArray[np.float64]:
        """(rows, 4) thrust (N) and torque (N m) of the upper, then of the lower rotor, effects left out.

        `u` is (rows, 2): normalised speeds of the upper and the lower rotor. Raises InputError.

        >>> from coaxlink.files import example
        >>> load_rotor_model(example("rotor_paper.toml")).predict([[0.5, 0.5]]).round(2).tolist()
        [[25.21, 0.67, 13.34, 0.52]]
        """
        speeds = np.asarray(u, float)
        if speeds.ndim != 2 or speeds.shape[1] != 2:
            raise InputError("u", "", f"(rows, 2) normalised speeds are expected, found shape {speeds.shape}")
        loads = self.loads(speeds[:, 0], speeds[:, 1])
        return np.stack([loads[load] for load in Load], axis=1)

    def score(self, log: Samples | str | Path) -> float:
        """R^2 of the model on a stand log, the mean of the loads it measured: 1 is perfect, 0 no better than
        the loads' means. Raises InputError for a log without both rotors' speeds or without loads."""
        from coaxlink.data import read_stand_log
        from coaxlink.rotor.stand_data import stand_data

        samples = read_stand_log(Path(log)) if isinstance(log, (str, Path)) else log
        data = stand_data(samples, self.speed_max_rpm)
        predicted = self.predict(np.stack([data.speeds.upper, data.speeds.lower], axis=1))
        shares = []
        for load in map(Load.of, data.measured):
            y = data.loads[load.key]
            known = np.isfinite(y)
            left = y[known] - predicted[known, load]
            shares.append(
                1.0 - float(left @ left) / max(float(np.sum((y[known] - y[known].mean()) ** 2)), 1e-300)
            )
        return float(np.mean(shares))

    def loads(self, u_upper: ArrayLike, u_lower: ArrayLike) -> PairLoads:
        """Thrusts and torques at normalised speeds (broadcast), without the effects."""
        return PairLoads(
            self.upper_thrust(u_upper, u_lower),
            self.upper_torque(u_upper, u_lower),
            self.lower_thrust(u_upper, u_lower),
            self.lower_torque(u_upper, u_lower),
        )

    def terms(self) -> dict[str, dict[str, float]]:
        """{"upper.thrust_N": {"u_u^2": 55.9, ...}, ...}, as `identify --json` reports it."""
        return {load.key: self.surface(load).terms() for load in Load}

    def surface(self, load: Load) -> Polynomial:
        """One of the four polynomials."""
        polynomial: Polynomial = getattr(self, load.channel)
        return polynomial

    def turned(
        self, upper: ArrayLike, lower: ArrayLike, voltage_V: ArrayLike | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Normalised speeds of both rotors (...) at commands (...), at a supply (...) where that is known.

        A rotor alone has 0 for its partner's command.
        """
        if self.drive is None:
            u, v = np.broadcast_arrays(np.asarray(upper, float), np.asarray(lower, float))
            return u, v
        supply = self.drive.supply(voltage_V)
        return self._speeds(np.asarray(upper, float) * supply, np.asarray(lower, float) * supply)

    def commands(
        self, u_upper: ArrayLike, u_lower: ArrayLike, voltage_V: ArrayLike | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Commands of both rotors (...) that hold normalised speeds (...): the inverse of `turned`."""
        if self.drive is None:
            u, v = np.broadcast_arrays(np.asarray(u_upper, float), np.asarray(u_lower, float))
            return u, v
        upper, lower = self.drive.commands(u_upper, u_lower, self._torque)
        supply = self.drive.supply(voltage_V)
        return upper / supply, lower / supply

    def by_speed(self) -> RotorModel:
        """The model for commands that are speeds already."""
        return replace(self, drive=None)

    @cached_property
    def _speeds(self) -> SpeedTable:
        assert self.drive is not None
        return self.drive.table(self._torque)

    def _torque(
        self, side: int, upper: NDArray[np.float64], lower: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """N m."""
        return (self.lower_torque if side else self.upper_torque)(upper, lower)

    def having(self, terms: Mapping[str, Mapping[str, float]]) -> RotorModel:
        """The same pair with other terms, `terms()` of it."""
        return replace(self, **{load.channel: Polynomial.from_terms(terms[load.key]) for load in Load})  # type: ignore[arg-type]

    @classmethod
    def from_terms(
        cls, form: str, speed_max_rpm: float, terms: Mapping[str, Mapping[str, float]], **rest: Any
    ) -> RotorModel:
        """The inverse of `terms`. Raises ValueError on a name that is no term, KeyError on a missing load."""
        surfaces: dict[str, Any] = {load.channel: Polynomial.from_terms(terms[load.key]) for load in Load}
        return cls(form, speed_max_rpm, **surfaces, **rest)


# no rotor pushes a million newtons: such a number is a slip that would only surface as nonsense later
Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]


def plain_name(text: str) -> str:
    """A name that is only a name. Raises ValueError, which pydantic reports with its key."""
    if problem := name_problem(text):
        raise ValueError(problem)
    return text


Name = Annotated[str, AfterValidator(plain_name)]


TERMS = 'a factor in {} for each product of powers of the speeds, "u_u^2 u_l"; u = rpm / speed_max_rpm.'


class _Loads(BaseModel):
    model_config = ConfigDict(extra="forbid")
    thrust_N: dict[str, Finite] = Field(description=f"Thrust: {TERMS.format('N')}")
    torque_Nm: dict[str, Finite] = Field(description=f"Torque: {TERMS.format('N m')}")


class _Effect(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: Name = Field(description="Which effect (docs/effects.md).")
    parameters: dict[str, Finite] = Field(
        default_factory=dict, description="Its numbers, units in the names."
    )
    columns: list[str] = Field(default_factory=list, description="Columns of a log that it reads.")


class _Sources(BaseModel):
    model_config = ConfigDict(extra="forbid")
    speed_max_rpm: Source | None = Field(None, description="Of the speed that u = 1 means.")
    upper: Source | None = Field(None, description="Of the upper rotor's loads.")
    lower: Source | None = Field(None, description="Of the lower rotor's loads.")
    effects: Source | None = Field(None, description="Of the effects' numbers.")


class _SideDrive(BaseModel):
    model_config = ConfigDict(extra="forbid")
    command: tuple[Finite, ...] = Field(
        min_length=2, max_length=6,
        description="c_0, c_1, ...: command = c_0 + c_1 u + c_2 u^2 + ... + torque_per_Nm Q at `voltage_V`.",
    )  # fmt: skip
    torque_per_Nm: Finite = Field(0.0, description="Command per N m of torque, at rest.")
    torque_speed_per_Nm: Finite = Field(0.0, description="What u adds to that.")
    range: tuple[Finite, Finite] = Field((0.0, 1.0), description="Commands that were measured.")
    error: Annotated[Finite, Field(ge=0)] = Field(0.0, description="Standard error of the command.")


class _Drive(BaseModel):
    model_config = ConfigDict(extra="forbid")
    voltage_V: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = Field(
        None, description="Supply at which it holds; absent: not known."
    )
    upper: _SideDrive | None = Field(None, description="The upper rotor's; absent: as the lower one's.")
    lower: _SideDrive | None = Field(None, description="The lower rotor's; absent: as the upper one's.")


class _BatteryPower(BaseModel):
    model_config = ConfigDict(extra="forbid")
    constant: Finite = Field(0.0, description="W, idle.")
    per_rad_s: Finite = Field(0.0, description="W per rad/s (hysteresis of the iron).")
    per_rad_s2: Finite = Field(0.0, description="W per (rad/s)^2 (eddy currents, bearings).")
    per_Nm2: Finite = Field(0.0, description="W per (N m)^2 (copper).")
    shaft: Finite = Field(1.0, description="W per watt at the shaft.")
    error: Annotated[Finite, Field(ge=0)] = Field(0.0, description="W, on held-out blocks.")


class _BothPowers(BaseModel):
    model_config = ConfigDict(extra="forbid")
    upper: _BatteryPower | None = Field(None, description="The upper rotor's; absent: as the lower one's.")
    lower: _BatteryPower | None = Field(None, description="The lower rotor's; absent: as the upper one's.")


class _Curves(BaseModel):
    model_config = ConfigDict(extra="forbid")
    upper: tuple[Finite, Finite, Finite] | None = Field(
        None, description="b_0, b_1, b_2 of b_0 + b_1 t + b_2 t^2."
    )
    lower: tuple[Finite, Finite, Finite] | None = Field(None, description="The lower rotor's.")


class _Measured(BaseModel):
    model_config = ConfigDict(extra="forbid")
    upper: tuple[Finite, Finite] | None = Field(None, description="Least and greatest u_u of the log.")
    lower: tuple[Finite, Finite] | None = Field(None, description="Least and greatest u_l of the log.")
    rested: list[Literal["upper", "lower"]] | None = Field(
        None, description="Rotors that stood while the other one turned; none: not known."
    )
    ratio_least: Finite | None = Field(None, description="Smallest u_l / u_u that was measured.")
    windmilling: Finite | None = Field(
        None, description="u_l / u_u up to which the wake turned the lower rotor; 0: never seen."
    )


class _Identified(BaseModel):
    model_config = ConfigDict(extra="allow")
    measured: Annotated[
        _Measured | None, Field(description="Where the rows were: beyond, the model is extrapolated.")
    ] = None
    rpm_over_throttle: Annotated[
        _Curves | None, Field(description="rpm over throttle t, 0..1, of older files: read as a drive.")
    ] = None
    throttle_to: Annotated[
        Finite | None, Field(description="How far throttles went: u = 1 is not full throttle.")
    ] = None
    watts_crosstalk: Annotated[
        dict[Literal["upper", "lower"], Finite] | None,
        Field(
            description="Watts a side's reading lacked for each of the other's; put right in battery_power."
        ),
    ] = None


class _RotorFile(BaseModel):
    model_config = ConfigDict(title="coaxlink rotor model", extra="forbid")
    form: Name = Field(description="crm, rcrm, srm or cpcm: how rich the polynomials are.")
    speed_max_rpm: Annotated[float, Field(gt=0, allow_inf_nan=False)] = Field(
        description="The speed that u = 1 means, rpm."
    )
    rotation: Literal["counter-rotating", "co-rotating"] = Field(
        "counter-rotating", description="How the rotors of that pair turn against each other."
    )
    upper: _Loads = Field(description="The upper rotor's loads.")
    lower: _Loads = Field(description="The lower rotor's loads, in the upper one's wake.")
    drive: _Drive | None = Field(
        None, description="What commands turn; absent: a command is the normalised speed."
    )
    battery_power: _BothPowers | None = Field(None, description="What each side draws, W.")
    effects: list[_Effect] = Field(default_factory=list, description="What refine added to the polynomials.")
    identified: _Identified = Field(
        default_factory=_Identified,
        description="From what: file, hash, rows, held-out errors, intervals.",
    )
    sources: _Sources | None = Field(
        None, description="Where the numbers are from; what it does not name is declared."
    )


def rotor_schema() -> dict[str, Any]:
    """The JSON schema of a rotor file, for editors (taplo, VS Code)."""
    return {"$schema": "http://json-schema.org/draft-07/schema#", **_RotorFile.model_json_schema()}


def load_rotor_model(path: Path) -> RotorModel:
    """Read a rotor file. Raises InputError naming the file and the key."""
    document = files.read_toml(path)
    if "rotors" in document and not document.keys() & {"form", "upper", "lower"}:
        raise InputError(path, "", "an airframe file; a rotor file (coaxlink identify) is expected")
    try:
        parsed = _RotorFile.model_validate(document)
    except ValidationError as error:
        raise input_error(path, error, _RotorFile) from error
    sides = {"upper": parsed.upper, "lower": parsed.lower}
    terms = {}
    for load in LOADS:
        side, quantity = load.split(".")
        terms[load] = getattr(sides[side], quantity)
        try:
            Polynomial.from_terms(terms[load])
        except ValueError as error:
            raise InputError(path, load, str(error)) from error
    effects = tuple(EffectEntry(e.name, e.parameters, tuple(e.columns)) for e in parsed.effects)
    identified = parsed.identified.model_dump(exclude_none=True)
    curves = identified.pop("rpm_over_throttle", None)
    drive = _drive(path, parsed.drive)
    if drive is None and curves:
        drive = of_curves(curves, parsed.speed_max_rpm)
    return RotorModel.from_terms(
        parsed.form, parsed.speed_max_rpm, terms, effects=effects, identified=identified,
        sources=parsed.sources.model_dump(exclude_none=True) if parsed.sources else {},
        rotation=parsed.rotation, drive=drive, battery_power=_battery_power(parsed.battery_power),
    )  # fmt: skip


def _drive(path: Path, given: _Drive | None) -> Drive | None:
    if given is None:
        return None
    sides = [SideDrive(**s.model_dump()) if s else None for s in (given.upper, given.lower)]
    upper, lower = sides[0] or sides[1], sides[1] or sides[0]
    if upper is None or lower is None:
        raise InputError(path, "drive", "upper or lower is missing")
    for name, side in (("upper", upper), ("lower", lower)):
        if not 0.0 <= side.range[0] < side.range[1] <= 1.0:
            raise InputError(
                path, f"drive.{name}.range", f"0 <= low < high <= 1 expected, found {side.range}"
            )
        if problem := side.problem:
            raise InputError(path, f"drive.{name}.command", problem)
    return Drive(upper, lower, given.voltage_V)


def _battery_power(given: _BothPowers | None) -> dict[str, BatteryPower]:
    if given is None or not (given.upper or given.lower):
        return {}
    sides = {"upper": given.upper or given.lower, "lower": given.lower or given.upper}
    return {name: BatteryPower(**side.model_dump()) for name, side in sides.items() if side}


def save_rotor_model(path: Path, model: RotorModel) -> None:
    """Write a rotor file atomically; `load_rotor_model` gives the same model back."""
    terms = model.terms()
    document: dict[str, Any] = {"form": model.form, "speed_max_rpm": model.speed_max_rpm}
    if model.rotation != COUNTER_ROTATING:
        document["rotation"] = model.rotation
    if model.sources:
        document["sources"] = dict(model.sources)
    if model.identified:
        document["identified"] = dict(model.identified)
    for side in ("upper", "lower"):
        document[side] = {q: terms[f"{side}.{q}"] for q in ("thrust_N", "torque_Nm")}
    if model.drive:
        sides = {side: _plain(getattr(model.drive, side)) for side in ("upper", "lower")}
        volts = {"voltage_V": model.drive.voltage_V} if model.drive.voltage_V else {}
        document["drive"] = volts | sides
    if model.battery_power:
        document["battery_power"] = {side: asdict(p) for side, p in model.battery_power.items()}
    if model.effects:
        document["effects"] = [
            {"name": e.name, "parameters": dict(e.parameters), "columns": list(e.columns)}
            for e in model.effects
        ]
    files.write_toml(path, document)


def _plain(side: SideDrive) -> dict[str, Any]:
    return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(side).items()}


def input_error(path: Path, error: ValidationError, document: type[BaseModel]) -> InputError:
    """Our one-line error for the first thing pydantic refuses in a file of this form.

    An unknown key goes before a missing one that it may be, misspelt; a missing one before the others, since
    it tells a file of another kind.
    """
    found = error.errors()
    unknown = next((e for e in found if e["type"] == "extra_forbidden"), None)
    missing = [str(e["loc"][-1]) for e in found if e["type"] == "missing"]
    if unknown and (not missing or is_near(str(unknown["loc"][-1]), missing)):
        loc = unknown["loc"]
        known = _table_at(document, loc[:-1]).model_fields
        return InputError(path, _key(loc), problem_of(str(loc[-1]), known))
    first = next((e for e in found if e["type"] == "missing"), found[0])
    key = _key(first["loc"])
    value = first.get("input")
    if first["type"] == "missing":
        return InputError(path, key, "missing")
    shown = f" (found {plain(repr(value), 80)})" if not isinstance(value, (dict, list)) else ""
    return InputError(path, key, f"{first['msg'].removeprefix('Value error, ')}{shown}")


def _table_at(document: type[BaseModel], loc: tuple[int | str, ...]) -> type[BaseModel]:
    """The form of the table that stands at `loc` of a document."""
    table = document
    for part in loc:
        if isinstance(part, str):
            waiting: list[Any] = [table.model_fields[part].annotation]
            while waiting:  # list[Table], Table | None
                found = waiting.pop()
                if isinstance(found, type) and issubclass(found, BaseModel):
                    table = found
                waiting += get_args(found)
    return table


def _key(loc: tuple[int | str, ...]) -> str:
    """rotors[3].spin: where a key stands, tables of an array counted from 1 as our other lines do."""
    return "".join(f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in loc).removeprefix(".")
