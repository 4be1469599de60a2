"""The vehicle: where its rotors sit, which are pairs, which way they turn; speeds to wrench and back.

Body frame FRD (x forward, y right, z down), origin at the centre of mass. A wrench is
[total thrust (positive up), roll, pitch, yaw] in N and N m. Spin "ccw" is seen from above; its reaction
turns the body clockwise, +yaw in FRD (Berra, Trujillo and Heredia 2024, eq. 8 in FLU; PX4's KM > 0).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from coaxlink import files
from coaxlink.errors import InputError
from coaxlink.rotor import RotorModel
from coaxlink.rotor.model import Source, input_error, plain_name

AXES = ("thrust", "roll", "pitch", "yaw")
LEAST_ROTORS, MOST_ROTORS = 3, 32  # an ArduPilot drives 32, PX4 12


@dataclass(frozen=True)
class Rotor:
    """One rotor of the airframe; `number` is the airframe's own, counted from 1."""

    number: int
    position_m: tuple[float, float, float]  # FRD, from the centre of mass
    axis: tuple[float, float, float]  # unit vector of its thrust, FRD; straight up is (0, 0, -1)
    yaw_sign: int  # +1 for ccw (pushes the body to +yaw), -1 for cw
    level: str  # upper, lower or single
    pair: int | None  # number of the other rotor of the pair
    # what this one gives of the rotor model's loads; other than 1 only where measured data reported so
    thrust_gain: float = 1.0
    torque_gain: float = 1.0


@dataclass(frozen=True)
class Airframe:
    """Rotors in the order of their numbers, and the body they carry."""

    name: str
    mass_kg: float
    inertia_kg_m2: tuple[float, float, float]
    rotors: tuple[Rotor, ...]  # (N,)
    motor_lag_s: float = 0.0
    rotor_model: Path | None = None
    source: Path | None = None
    battery_Wh: float | None = None  # what a flight may use of the pack
    sources: Mapping[str, Source] = field(default_factory=dict)  # key -> where its number is from
    connect: str = ""  # where it is called when no connection is named; no property of the body

    def source_of(self, key: str) -> Source:
        """Where a number is from; what the file says nothing of is declared."""
        return self.sources.get(key, "declared")

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """(upper, lower) indices into `rotors`, in the order of the upper rotors."""
        return tuple(
            (i, rotor.pair - 1)
            for i, rotor in enumerate(self.rotors)
            if rotor.level == "upper" and rotor.pair is not None
        )

    @property
    def co_rotating(self) -> tuple[tuple[int, int], ...]:
        """Those of `pairs` whose rotors turn the same way."""
        turn = [rotor.yaw_sign for rotor in self.rotors]
        return tuple((u, w) for u, w in self.pairs if turn[u] == turn[w])

    @cached_property
    def singles(self) -> tuple[int, ...]:
        """Indices of the rotors without a pair."""
        return tuple(i for i, rotor in enumerate(self.rotors) if rotor.level == "single")

    @property
    def gains(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(N,) thrust and (N,) torque of every rotor as a share of the rotor model's."""
        return np.array([r.thrust_gain for r in self.rotors]), np.array([r.torque_gain for r in self.rotors])

    def loads(self, model: RotorModel, speeds: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Thrust (..., N) in N and torque (..., N) in N m of every rotor at normalised speeds (..., N)."""
        u = np.asarray(speeds, float)
        thrust, torque = np.zeros(u.shape), np.zeros(u.shape)
        if self.pairs:
            upper, lower = map(list, zip(*self.pairs, strict=True))
            pair = model.loads(u[..., upper], u[..., lower])
            thrust[..., upper], torque[..., upper] = pair.upper_thrust, pair.upper_torque
            thrust[..., lower], torque[..., lower] = pair.lower_thrust, pair.lower_torque
        for i in self.singles:
            thrust[..., i] = model.upper_thrust(u[..., i], 0.0)
            torque[..., i] = model.upper_torque(u[..., i], 0.0)
        thrust_gain, torque_gain = self.gains
        return thrust * thrust_gain, torque * torque_gain

    def turned(
        self, model: RotorModel, commands: ArrayLike, voltage_V: ArrayLike | None = None
    ) -> NDArray[np.float64]:
        """Normalised speeds (..., N) that commands (..., N) give, at a supply (...) where that is known."""
        return self._each(model.turned, np.asarray(commands, float), voltage_V)

    def commanded(
        self, model: RotorModel, speeds: ArrayLike, voltage_V: ArrayLike | None = None
    ) -> NDArray[np.float64]:
        """Commands (..., N) that hold normalised speeds (..., N): the inverse of `turned`."""
        return self._each(model.commands, np.asarray(speeds, float), voltage_V)

    def _each(
        self, of_pair: Callable[..., tuple[NDArray[np.float64], NDArray[np.float64]]],
        given: NDArray[np.float64], voltage_V: ArrayLike | None,
    ) -> NDArray[np.float64]:  # fmt: skip
        """What `of_pair` makes of both numbers of every pair; a single rotor is an upper one alone."""
        volts = None if voltage_V is None else np.asarray(voltage_V, float)[..., None]
        out = np.empty(given.shape)
        if self.pairs:
            upper, lower = map(list, zip(*self.pairs, strict=True))
            out[..., upper], out[..., lower] = of_pair(given[..., upper], given[..., lower], volts)
        if self.singles:
            alone = list(self.singles)
            out[..., alone] = of_pair(given[..., alone], np.zeros(len(alone)), volts)[0]
        return out

    def body_loads(self, thrust: ArrayLike, torque: ArrayLike) -> NDArray[np.float64]:
        """Force and moment (..., 6) in FRD, [Fx, Fy, Fz, Mx, My, Mz], of rotor loads (..., N)."""
        f, q = np.asarray(thrust, float), np.asarray(torque, float)
        axis, lever, spin = self._arms
        # a rotor that turns ccw pushes the body about -axis: +z when its thrust points up
        return np.concatenate([f @ axis, f @ lever - (q * spin) @ axis], axis=-1)

    @cached_property
    def _arms(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """(N, 3) axes, (N, 3) moments of unit thrusts, (N,) spins."""
        position = np.array([r.position_m for r in self.rotors])
        axis = np.array([r.axis for r in self.rotors])
        return axis, np.cross(position, axis), np.array([r.yaw_sign for r in self.rotors], float)

    def wrench(self, thrust: ArrayLike, torque: ArrayLike) -> NDArray[np.float64]:
        """Wrench (..., 4), [thrust up, roll, pitch, yaw], of rotor loads (..., N)."""
        body = self.body_loads(thrust, torque)
        return np.concatenate([-body[..., 2:3], body[..., 3:6]], axis=-1)

    def effectiveness(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(4, N) wrench of each rotor's unit thrust, and (4, N) of its unit torque (eq. 8)."""
        unit = np.eye(len(self.rotors))
        none = np.zeros_like(unit)
        return self.wrench(unit, none).T, self.wrench(none, unit).T

    def lost_axes(self) -> tuple[str, ...]:
        """Those of roll, pitch and yaw that no thrusts make alone: on one point, on a line, all ccw."""
        thrust, torque = self.effectiveness()
        rows = thrust + TORQUE_M * torque
        lost = []
        for k, name in enumerate(AXES[1:], start=1):
            others = np.delete(rows, k, axis=0).T
            alone = rows[k] - others @ np.linalg.lstsq(others, rows[k], rcond=None)[0]
            if np.sqrt(np.mean(alone**2)) < LEAST_LEVER_M:
                lost.append(name)
        return tuple(lost)


TORQUE_M = 0.02  # N m of torque for a newton of thrust: 0.01 to 0.03 from toys to heavy lifters
LEAST_LEVER_M = 1e-3  # of the rotors about an axis, root mean square: no multirotor flies on less
FURTHEST_M = 1000.0  # no rotor is further from the centre of mass; a board's float32 holds no more than 3e38
Component = Annotated[float, Field(allow_inf_nan=False, ge=-FURTHEST_M, le=FURTHEST_M)]
Vector = tuple[Component, Component, Component]
Name = Annotated[str, AfterValidator(plain_name)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _RotorTable(BaseModel):
    model_config = ConfigDict(extra="forbid")
    number: Annotated[int, Field(ge=1, le=MOST_ROTORS, description="The autopilot's motor number, from 1.")]
    position_m: Annotated[
        Vector, Field(description="Forward, right, down from the centre of mass, m (body frame FRD).")
    ]
    spin: Annotated[Literal["ccw", "cw"], Field(description="Which way it turns, seen from above.")]
    level: Annotated[
        Literal["upper", "lower", "single"], Field(description="Its place in a coaxial pair, or single.")
    ]
    pair: Annotated[int | None, Field(description="Number of the other rotor; none for a single one.")] = None
    axis: Annotated[Vector, Field(description="Direction of its thrust, FRD; scaled to length 1.")] = (
        0.0,
        0.0,
        -1.0,
    )


class _Sources(BaseModel):
    model_config = ConfigDict(extra="forbid")
    mass_kg: Annotated[Source | None, Field(description="Of the mass.")] = None
    inertia_kg_m2: Annotated[Source | None, Field(description="Of the moments of inertia.")] = None
    motor_lag_s: Annotated[Source | None, Field(description="Of the motors' lag.")] = None
    battery_Wh: Annotated[Source | None, Field(description="Of the pack's energy.")] = None
    rotors: Annotated[Source | None, Field(description="Of the rotors' places, spins and levels.")] = None


class _Defaults(BaseModel):
    model_config = ConfigDict(extra="forbid")
    connect: Annotated[
        str | None, Field(description="Where the vehicle is called when no connection is named.")
    ] = None


class _AirframeFile(BaseModel):
    model_config = ConfigDict(title="coaxlink airframe", extra="forbid")
    name: Annotated[Name, Field(description="Names the vehicle in files and reports.")]
    mass_kg: Annotated[Positive, Field(description="All-up mass, kg.")]
    inertia_kg_m2: Annotated[
        tuple[Positive, Positive, Positive],
        Field(description="Moments of inertia about x, y, z through the centre of mass, kg m^2."),
    ]
    rotor_model: Annotated[
        str | None, Field(description="Rotor model file, beside this one, where no other is given.")
    ] = None
    motor_lag_s: Annotated[
        float, Field(ge=0, allow_inf_nan=False, description="First-order lag from command to speed, s.")
    ] = 0.0
    battery_Wh: Annotated[
        Positive | None, Field(description="Energy of the pack that a flight may use, Wh.")
    ] = None
    attitude_loop: Annotated[
        dict[str, Any] | None, Field(description="Read no more: gains of loops that live mixing once closed.")
    ] = None
    sources: Annotated[
        _Sources | None,
        Field(description="Where the numbers are from; what it does not name is declared."),
    ] = None
    defaults: Annotated[
        _Defaults | None, Field(description="What is the same at every call (docs/connections.md).")
    ] = None
    rotors: Annotated[
        list[_RotorTable],
        Field(min_length=LEAST_ROTORS, max_length=MOST_ROTORS, description="One table a rotor, any order."),
    ]


def airframe_schema() -> dict[str, Any]:
    """The JSON schema of an airframe file, for editors (taplo, VS Code)."""
    return {"$schema": "http://json-schema.org/draft-07/schema#", **_AirframeFile.model_json_schema()}


def load_airframe(path: str | Path) -> Airframe:
    """Read an airframe file. Raises InputError naming the file and the key."""
    path = Path(path)
    document = files.read_toml(path)
    if not document:
        raise InputError(path, "", "empty; an airframe file (coaxlink init makes one) is expected")
    if "rotors" not in document and document.keys() >= {"upper", "lower"}:
        raise InputError(path, "", "a rotor file; an airframe file (coaxlink init makes one) is expected")
    given = document.get("rotors")
    if isinstance(given, list) and not LEAST_ROTORS <= len(given) <= MOST_ROTORS:
        problem = f"coaxlink holds {LEAST_ROTORS} to {MOST_ROTORS} rotors, found {len(given)}"
        raise InputError(path, "rotors", problem)
    try:
        parsed = _AirframeFile.model_validate(document)
    except ValidationError as error:
        raise _by_number(input_error(path, error, _AirframeFile), document) from error
    tables = sorted(parsed.rotors, key=lambda r: r.number)
    if [t.number for t in tables] != list(range(1, len(tables) + 1)):
        raise InputError(path, "rotors.number", f"numbers must run from 1 to {len(tables)}, each once")
    _check_pairs(path, tables)
    rotors = tuple(_rotor(path, t) for t in tables)
    model = path.parent / parsed.rotor_model if parsed.rotor_model else None
    return Airframe(
        parsed.name, parsed.mass_kg, parsed.inertia_kg_m2, rotors, parsed.motor_lag_s, model, path,
        parsed.battery_Wh, parsed.sources.model_dump(exclude_none=True) if parsed.sources else {},
        (parsed.defaults and parsed.defaults.connect) or "",
    )  # fmt: skip


def _rotor(path: Path, t: _RotorTable) -> Rotor:
    norm = float(np.linalg.norm(t.axis))
    if norm < 1e-6:
        raise InputError(path, f"rotors[{t.number}].axis", "a direction is expected, found zero length")
    x, y, z = (float(a) / norm for a in t.axis)
    return Rotor(t.number, t.position_m, (x, y, z), 1 if t.spin == "ccw" else -1, t.level, t.pair)


def _by_number(error: InputError, document: dict[str, Any]) -> InputError:
    """The error with `rotors[n]` meaning rotor n, in whatever order the tables stand."""
    found = re.match(r"rotors\[(\d+)\]", error.where)
    table = document["rotors"][int(found[1]) - 1] if found else None
    number = table.get("number") if isinstance(table, dict) else None
    if found is None or not isinstance(number, int) or isinstance(number, bool):
        return error
    return InputError(error.source, f"rotors[{number}]{error.where[found.end() :]}", error.problem)


def _check_pairs(path: Path, tables: list[_RotorTable]) -> None:
    by_number = {t.number: t for t in tables}
    for t in tables:
        key = f"rotors[{t.number}].pair"
        if t.level == "single":
            if t.pair is not None:
                raise InputError(path, key, "a single rotor has no pair")
            continue
        other = by_number.get(t.pair) if t.pair is not None else None
        if other is None or other.pair != t.number or {t.level, other.level} != {"upper", "lower"}:
            partner = "lower" if t.level == "upper" else "upper"
            raise InputError(path, key, f"expected the {partner} rotor that names {t.number} as its pair")
