"""What `import coaxlink as cx` offers beside the rooms' own names: logs, tables, flights in a call each."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.data import Samples
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.vehicle import Vehicle, vehicle_of
from firmware_params import FIRMWARES

if TYPE_CHECKING:
    from coaxlink.health.judge import Health
    from coaxlink.live.mixer import LiveMixer
    from coaxlink.mavlink import Session
    from coaxlink.residual import Refinement
    from coaxlink.rotor import Identification, RotorModel
    from coaxlink.uploading.outcome import Outcome
    from firmware_params.errors import Finding

Log = str | Path | Samples


def read_log(path: str | Path, *, columns: str | Path | None = None, upper: str | None = None) -> Samples:
    """A stand or flight log, by its content, as columns in SI units: `log["upper_thrust_N"]` is (rows,).

    `columns` maps a foreign stand file's headings, `upper` says which rotor is on top (docs/stand.md).
    Raises InputError naming the file and the place.

    >>> from coaxlink.files import example
    >>> read_log(example("stand_eq17.csv")).rows
    121
    """
    from coaxlink.data import is_flight_log, read_flight_log, read_stand_log

    path = Path(path)
    if columns is None and upper is None and is_flight_log(path):
        return read_flight_log(path)
    return read_stand_log(path, Path(columns) if columns else None, upper=upper)


def identify(log: Log, form: str = "auto", *, speed_max_rpm: float | None = None) -> Identification:
    """A rotor model from a stand log: `.model`, terms with intervals, errors on held-out blocks.

    `form` is auto, crm, rcrm, cpcm or srm; `speed_max_rpm` is what u = 1 means, if not the log's highest.
    Raises InputError.

    >>> from coaxlink.files import example
    >>> identify(example("stand_eq17.csv"), "crm").model.form
    'crm'
    """
    from coaxlink.rotor import identify as run

    return run(_read(log), form, speed_max_rpm=speed_max_rpm)


@dataclass(frozen=True)
class Table:
    """A mixing law as an autopilot's own parameters and files, and what that firmware will make of it."""

    firmware: str  # px4 or ardupilot
    law: str
    parameters: Mapping[str, float | int]
    files: Mapping[str, str]  # name (may hold one folder) -> text
    findings: tuple[Finding, ...]  # what its author may not expect; an error forbids flying with it
    mix: Mapping[str, NDArray[np.float64]]  # of each axis (N,): what the firmware mixes by
    _speeds: Callable[[float, float, float, float], NDArray[np.float64]]

    def speeds(self, roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        """(N,) commands 0..1 that the firmware makes of demands: -1..1 for the turns, 0..1 of thrust up."""
        return self._speeds(roll, pitch, yaw, thrust)

    def write(self, folder: str | Path) -> list[Path]:
        """Write the files, all of them or none; their paths. Raises InputError."""
        from coaxlink.files import write_together

        write_together({Path(folder) / name: text for name, text in self.files.items()})
        return [Path(folder) / name for name in self.files]

    def __str__(self) -> str:
        """What stands in it: the mix, a row a rotor, what is not a rotor's own, findings."""
        lines = [repr(self), "rotor" + "".join(f"{name:>10s}" for name in self.mix)]
        for n, row in enumerate(zip(*self.mix.values(), strict=True)):
            lines.append(f"{n + 1:<5d}" + "".join(f"{value:10.4f}" for value in row))
        whole = {k: v for k, v in self.parameters.items() if not any(c.isdigit() for c in k)}
        lines.append(", ".join(f"{name} {value:.8g}" for name, value in whole.items()))
        return "\n".join([*lines, *(f"{f.severity}: {f}" for f in self.findings)])

    def __repr__(self) -> str:
        wrong = sum(f.severity == "error" for f in self.findings)
        files = "1 file" if len(self.files) == 1 else f"{len(self.files)} files"
        size = f"{len(self.parameters)} parameters, {files}"
        return f"Table({self.firmware}, {self.law} law, {size}, {wrong} findings that forbid it)"


def make_table(
    vehicle: Vehicle | str | Path,
    firmware: str = "px4",
    law: str = "fitted",
    *,
    around_weak_rotor: bool = False,
) -> Table:
    """The table of a law (fitted, balanced, reduced, standard, curved) for a vehicle; nothing is written.

    Raises InputError for a vehicle that the firmware cannot hold, SafetyRefusal for a rotor file that says
    that a rotor is weak, without `around_weak_rotor`.

    >>> from coaxlink.files import example
    >>> from coaxlink.vehicle import load_vehicle
    >>> make_table(load_vehicle(example("x8_paper.toml")), law="standard")
    Table(px4, standard law, 69 parameters, 1 file, 0 findings that forbid it)
    """
    from coaxlink.tables import files as table_files

    vehicle = vehicle_of(vehicle)
    if "degraded_rotor" in vehicle.compensated and not around_weak_rotor:
        raise SafetyRefusal("a rotor is weak: ground it (around_weak_rotor: a table around it)")
    made_from = f"{vehicle.rotors.form}, {len(vehicle.rotors.effects)} effects"
    if firmware == "px4":
        from coaxlink.tables.px4 import px4_commands, report_px4

        report = report_px4(vehicle, law)
        texts = table_files.table_files(vehicle.airframe, report, made_from)
        roll, pitch, yaw, _, _, thrust = report.mix.mix.T
        entries = report.table.rotors
        mix = {
            "CT N": np.array([entry.ct for entry in entries]),
            "KM m": np.array([entry.km for entry in entries]),
            **{"roll": roll, "pitch": pitch, "yaw": yaw, "thrust": -thrust},
        }
        return Table(firmware, law, report.params, texts, report.findings, mix, px4_commands(report.mix))
    if firmware == "ardupilot":
        from coaxlink.tables.ardupilot import ap_commands, report_ap

        made = report_ap(vehicle, law)
        texts = table_files.table_files(vehicle.airframe, made, made_from)
        axes = dict(zip(("roll", "pitch", "yaw", "throttle"), made.mix.factors.T, strict=True))
        return Table(firmware, law, made.params, texts, made.findings, axes, ap_commands(made.mix))
    raise InputError("firmware", firmware, f"one of {', '.join(FIRMWARES)} is expected")


def refine(
    logs: Log | Sequence[Log],
    vehicle: Vehicle | str | Path | None = None,
    *,
    rotors: RotorModel | str | Path | None = None,
) -> Refinement:
    """Measured data against a model: residual, the effect it traces to, error before and after.

    Flight logs are held against `vehicle`; stand logs against `rotors`, or without them against a model
    fitted to themselves. `.effects`, `.unexplained`, `.ambiguous` and `.suspect_data` say what was found,
    `.model` is the rotor model with the effects added. Raises InputError.
    """
    from coaxlink.residual import refine as run
    from coaxlink.residual import refine_stand
    from coaxlink.rotor import load_rotor_model

    read = [one for log in _several(logs) for one in _flights(log)]
    if any(log.has("motor1") for log in read):
        if vehicle is None:
            raise InputError("vehicle", "", "flight logs are held against a Vehicle; none is given")
        vehicle = vehicle_of(vehicle)
        return run(read, vehicle.declared, vehicle.rotors)
    return refine_stand(read, load_rotor_model(Path(rotors)) if isinstance(rotors, (str, Path)) else rotors)


def check_health(logs: Log | Sequence[Log], vehicle: Vehicle | str | Path) -> Health:
    """Every rotor of a vehicle over its flights, oldest first: `.verdict`, `.suspects`, `.detects`.

    Raises InputError, also for a log that is no flight.
    """
    from coaxlink.health.premises import judged

    read = [one for log in _several(logs) for one in _flights(log)]
    for log in read:
        if not log.has("motor1"):
            raise InputError(log.source, "", "a flight log is expected, found a stand's: identify takes it")
    return judged(read, [Path(log.source).name for log in read], vehicle_of(vehicle))


def write_report(
    logs: str | Path | Sequence[str | Path], page: str | Path, vehicle: Vehicle | str | Path | None = None
) -> Path:
    """Draw one flight log, or two beside one another, as one self-contained page; its path.

    With a vehicle also thrust, split and wrench. Raises InputError.
    """
    from coaxlink.files import write_atomic
    from coaxlink.report.flight_charts import flight_charts
    from coaxlink.report.flight_page import flight_page
    from coaxlink.report.made import Made

    paths = [Path(logs)] if isinstance(logs, (str, Path)) else [Path(log) for log in logs]
    if not 1 <= len(paths) <= 2:
        raise InputError("report", "logs", f"one log or two are expected, found {len(paths)}")
    flown = None if vehicle is None else vehicle_of(vehicle)
    flights = [flight for path in paths for flight in flight_charts(path, flown)]
    write_atomic(Path(page), flight_page(flights, Made.now(paths, flown.airframe.name if flown else "")))
    return Path(page)


def upload(
    session: Session,
    table: Table | str | Path,
    *,
    backup_folder: str | Path = "backups",
    confirm: Callable[[], bool] = lambda: True,
    dry_run: bool = False,
) -> Outcome:
    """Put a table on board: difference, backup, write, read back, compare; all or nothing.

    `confirm` is asked before the first write. The outcome's `result` says how it ended, its `error` why not
    (also refusals: armed, another vehicle). Raises InputError for files that are none.
    """
    from coaxlink.uploading.outcome import Talk
    from coaxlink.uploading.plan import load_plan
    from coaxlink.uploading.worker import Uploader

    worker = Uploader(session, backup_folder=Path(backup_folder), talk=Talk(confirm=confirm))
    if not isinstance(table, Table):
        return worker.upload(load_plan(Path(table)), dry_run=dry_run)
    with tempfile.TemporaryDirectory() as folder:
        table.write(folder)
        return worker.upload(load_plan(Path(folder)), dry_run=dry_run)


@contextmanager
def mix(
    session: Session, vehicle: Vehicle | str | Path, law: str = "exact", **options: Any
) -> Iterator[LiveMixer]:
    """Live mixing for the length of a block: every demand the vehicle sends is answered with motor commands.

    A vehicle made with `measured_live=True` has its effects compensated from telemetry. `options` are
    LiveMixer's own (rate_hz, dry_run, own_curve, ...). Raises SafetyRefusal where the autopilot cannot be
    mixed.
    """
    from coaxlink.live.mixer import LiveMixer

    with LiveMixer(session, vehicle_of(vehicle), law, **options) as live:
        yield live


def _several(logs: Log | Sequence[Log]) -> list[Log]:
    return [logs] if isinstance(logs, (str, Path, Samples)) else list(logs)


def _flights(log: Log) -> list[Samples]:
    """Of a flight log all its flights, else the log."""
    from coaxlink.data import is_flight_log, read_flights

    flown = not isinstance(log, Samples) and is_flight_log(Path(log))
    return read_flights(Path(log)) if flown else [_read(log)]  # type: ignore[arg-type]


def _read(log: Log) -> Samples:
    return log if isinstance(log, Samples) else read_log(log)
