"""Fly the cells of a campaign in the simulated world; runs in workers, on this machine or another."""

from __future__ import annotations

import hashlib
import math
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from coaxlink.errors import CheckFailed, InputError, SafetyRefusal
from coaxlink.studies.campaign.rows import NUMBER, TEXT, WHOLE
from coaxlink.studies.campaign.spec import Cell, KnownEffect, Spec, cell
from coaxlink.studies.engine import Row
from firmware_params.bounded import parse_toml

if TYPE_CHECKING:
    from coaxlink.vehicle import Vehicle
    from sim.effects import HiddenEffect
    from sim.quick.flight import FlightDesign, FlightWorld

KEPT = 64  # designs (a vehicle under a law) that a worker remembers
SHARES = ("mass_share", "inertia_share", "arm_share", "lag_s")
LOG_HZ = 100  # of a replayed flight's log
_LOCK = threading.Lock()  # a Dask worker of many threads flies one at a time: laws keep their memory


@dataclass(frozen=True)
class Payload:
    """What a worker is given: the campaign, and the code that it must be."""

    spec: Spec
    code: str


def known_effects() -> dict[str, KnownEffect]:
    """What the world knows and these flights can hold."""
    from sim.effects import FORMS
    from sim.quick.flight import NOT_FLOWN

    return {n: KnownEffect(f.extra, f.laws, f.size) for n, f in FORMS.items() if n not in NOT_FLOWN}


def columns(spec: Spec) -> dict[str, str]:
    """Names and kinds of a row, the cell first."""
    from sim.quick.flight import FIGURES

    found = {"cell": WHOLE, "draw": WHOLE, "law": TEXT, "seed": WHOLE}
    for name, q in spec.quantities.items():
        if not name.endswith(".chance"):
            found[name] = TEXT if q.text else NUMBER
    return found | dict.fromkeys(FIGURES, NUMBER) | {"failsafe": TEXT, "problem": TEXT}


@cache
def code_hash() -> str:
    """SHA-256 of the source that decides a row: the world's, cells, laws."""
    import sim

    digest = hashlib.sha256()
    here, world = Path(__file__).parents[2], Path(str(sim.__file__)).parent
    parts = ("mixer", "tables", "vehicle", "rotor", "residual", "effects", "data")
    folders = (world, *(here / part for part in parts))
    sources = [path for folder in folders for path in sorted(folder.rglob("*.py"))]
    for path in (Path(__file__), Path(__file__).with_name("spec.py"), *sources):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def fly_cells(payload: Payload, cells: Sequence[int]) -> list[Row]:
    """Rows of these cells. Raises CheckFailed where this worker is of another version."""
    if payload.code != code_hash():
        raise CheckFailed("a worker has another version of coaxlink: install the same on both machines")
    rows = []
    for number in cells:
        with _LOCK:
            row = fly_cell(payload.spec, cell(payload.spec, number))
        rows.append({name: _finite(row.get(name)) for name in columns(payload.spec)})
    return rows


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def fly_cell(spec: Spec, one: Cell, log: Path | None = None, out: Path | None = None) -> dict[str, Any]:
    """One flight as a row; `log` keeps its flight log, `out` the files of the vehicle and the truth."""
    from sim.errors import SimError
    from sim.quick.flight import fly_quick

    row: dict[str, Any] = {
        "cell": one.number,
        "draw": one.draw,
        "law": one.law,
        "seed": one.seed,
        **one.values,
    }
    row |= {"failsafe": "", "problem": ""}
    try:
        with tempfile.TemporaryDirectory() as scratch:
            folder = out or Path(scratch)
            design = _design(spec, one, folder)
            world = world_of(spec, one, design.vehicle.rotors)
            for e in world.effects:
                if "rotor" in e.extra:
                    row[f"effects.{e.name}.rotor"] = e.extra["rotor"]
            every = 0 if log is None else max(spec.rate_hz // LOG_HZ, 1)
            flown, columns_ = fly_quick(design, world, every)
            row |= asdict(flown)
            if log is not None:
                from sim.flights import write_flight

                write_flight(log, columns_)
            if out is not None:
                from sim.truth import Truth, truth_text

                (out / "truth.toml").write_text(truth_text(Truth(world.effects)))
    except (InputError, SafetyRefusal, SimError) as error:
        row["problem"] = str(error).replace(str(Path(tempfile.gettempdir())), "")
    return row


def world_of(spec: Spec, one: Cell, rotors: int) -> FlightWorld:
    """What is true of a cell's flight."""
    from sim.effects import HiddenEffect
    from sim.quick.flight import FlightWorld

    effects: list[HiddenEffect] = []
    for name in spec.effects:
        parameters = {
            k.rpartition(".")[2]: v for k, v in one.values.items() if k.startswith(f"effects.{name}.")
        }
        size, onset = float(parameters.pop("size")), float(parameters.pop("onset_s", 0.0))
        law = str(parameters.pop("law", ""))
        if size == 0.0:
            continue
        extra = {k: float(v) for k, v in parameters.items()}
        if "rotor" in extra and spec.quantities[f"effects.{name}.rotor"].values == ("any",):
            extra["rotor"] = 1.0 + int(extra["rotor"] * rotors)
        effects.append(HiddenEffect(name, size, onset + (spec.settle_s if onset else 0.0), extra, law))
    charge = float(one.values.get("charge", 0.95))
    plan = str(one.values["plan"])
    return FlightWorld(tuple(effects), one.seed, plan, spec.seconds, spec.settle_s, charge, spec.rate_hz)


_DESIGNS: OrderedDict[tuple[Any, ...], FlightDesign] = OrderedDict()


def _design(spec: Spec, one: Cell, folder: Path) -> FlightDesign:
    """The vehicle as it flies under the cell's law. Raises InputError."""
    from coaxlink.vehicle import load_vehicle
    from sim.physics.rotors import read_pair
    from sim.quick.flight import make_design
    from sim.vehicle import read_vehicle

    names = tuple(one.values.get(key) for key in ("airframe", "rotor", "believed", *SHARES))
    key = (spec.digest, one.law, *names)
    frame, rotor, believed = write_vehicle(spec, one.values, folder)
    if key not in _DESIGNS:
        vehicle = load_vehicle(frame, believed)
        _DESIGNS[key] = make_design(read_vehicle(frame), read_pair(rotor), _mixer(vehicle, one.law))
        if len(_DESIGNS) > KEPT:
            _DESIGNS.popitem(last=False)
    _DESIGNS.move_to_end(key)
    return _DESIGNS[key]


def _mixer(vehicle: Vehicle, law: str) -> Any:
    """PX4's parameters of the law's table; the exact law as a companion without delay would mix it."""
    if law == "exact":
        from coaxlink.mixer.exact.native import NativeExact

        return NativeExact(vehicle)
    from coaxlink.tables.px4 import report_px4

    report = report_px4(vehicle, law)
    for finding in report.blocking:  # what `table` and `upload` refuse is not flown here either
        raise SafetyRefusal(f"{finding.id}: {finding.text}")
    return report.params


def write_vehicle(spec: Spec, values: Mapping[str, float | str], folder: Path) -> tuple[Path, Path, Path]:
    """The drawn airframe, the world's rotors and those that the laws are made of, as files."""
    document = parse_toml(spec.texts[str(values["airframe"])])
    rotor = str(values.get("rotor", document.get("rotor_model")))
    believed = str(values.get("believed", rotor))
    for name in {rotor, believed}:
        if name not in spec.texts:
            raise InputError(str(values["airframe"]), "rotor_model", "names no rotor file: give rotor = ...")
        (folder / Path(name).name).write_text(spec.texts[name])
    mass, inertia, arm = (float(values.get(name, 1.0)) for name in SHARES[:3])
    document["mass_kg"] *= mass
    document["inertia_kg_m2"] = [inertia * x for x in document["inertia_kg_m2"]]
    document["motor_lag_s"] = float(values.get("lag_s", document.get("motor_lag_s", 0.0)))
    document["rotor_model"] = Path(rotor).name
    for table in document["rotors"]:
        table["position_m"] = [arm * x for x in table["position_m"][:2]] + table["position_m"][2:]
    frame = folder / "airframe.toml"
    frame.write_text(tomli_w.dumps(document))
    return frame, folder / Path(rotor).name, folder / Path(believed).name
