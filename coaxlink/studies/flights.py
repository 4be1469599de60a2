"""Flights of one plan in the simulated world: by a table on board, or with the companion mixing live."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from coaxlink.errors import LinkError
from coaxlink.fly.commands import NotReached
from coaxlink.live.guard import Timing
from coaxlink.studies.flight import RecordedFlight, Tell, Watch, fly, silent
from coaxlink.studies.simulator import simulator

if TYPE_CHECKING:
    from coaxlink.airframe import Airframe
    from coaxlink.fly.trajectory import FlightPlan
    from coaxlink.mavlink import Session
    from coaxlink.mixer import Law
    from coaxlink.tables.px4 import TableReport
    from coaxlink.vehicle import Vehicle

T = TypeVar("T")

LIVE_LAW = "exact"
DEMAND_ID = 140  # ACTUATOR_CONTROL_TARGET
# the world waits for the companion, and the companion for the world: a machine that is busy elsewhere for
# seconds is no silence of the vehicle
PATIENT = Timing(
    fade_s=0.0, hold_after_s=20.0, ramp_after_s=40.0, oldest_s=math.inf, sync_s=0.0
)  # its time waits for us
# a busy machine reads slower than a fast simulator talks, and a full socket loses acknowledgements
SLOWER, UNBOUNDED = (3.0, 3.0), 30.0  # speed 0 has no bound; some 30 times real time is what it comes to
OWN_CURVE = 1.0  # THR_MDL_FAC that makes the own mixer's demand mean about what the law's does (docs/live.md)


@dataclass(frozen=True)
class Simulation:
    """Where is flown: arguments of `coaxlink sim`, times real time, the folder of files, who is told."""

    arguments: list[str]
    speed: float
    out: Path
    watch: Watch = silent
    tell: Tell = silent


@dataclass
class Demands:
    """The wrench demands that a companion was sent, recorded to compare with the wrench delivered."""

    time_s: list[float] = field(default_factory=list)
    controls: list[tuple[float, ...]] = field(default_factory=list)

    def hear(self, message: Any) -> None:
        """Session subscriber."""
        if message.get_type() == "ACTUATOR_CONTROL_TARGET" and message.group_mlx == 0:
            self.time_s.append(message.time_usec / 1e6)
            self.controls.append(tuple(message.controls[:4]))

    def now(self) -> float:
        """The vehicle's own time at the last of them (s)."""
        return self.time_s[-1] if self.time_s else 0.0

    def at(self, time_s: NDArray[np.float64], lag_s: float = 0.0) -> NDArray[np.float64]:
        """Controls (rows, 4) at the log's own times, after a first-order lag (each held to the next)."""
        stamps, columns = np.array(self.time_s), np.array(self.controls)
        if lag_s > 0.0:
            step = float(np.median(np.diff(stamps)))
            grid = np.arange(stamps[0], stamps[-1] + 0.5 * step, step)
            held = columns[np.maximum(np.searchsorted(stamps, grid + 0.25 * step) - 1, 0)]
            keep = float(np.exp(-step / lag_s))
            stamps = grid
            columns = lfilter([0.0, 1.0 - keep], [1.0, -keep], held, axis=0, zi=held[:1])[0]
        return np.stack([np.interp(time_s, stamps, column) for column in columns.T], axis=1)


def write_table(out: Path, airframe: Airframe, name: str, report: TableReport, rotor_file: Path) -> Path:
    """Write a PX4 table to OUT/tables/NAME and return that folder."""
    from coaxlink.tables import files as table_files

    folder = out / "tables" / name
    table_files.write_table(folder, airframe, rotor_file, report)
    return folder


def fly_tables(
    sim: Simulation, folders: Mapping[str, Path], plan: FlightPlan
) -> tuple[dict[str, RecordedFlight], dict[str, dict[str, Any]]]:
    """Upload each table to one stand-in and fly the plan with it: flights and upload results by name.

    Each flies on what the ones before left of the battery. Raises what uploads raise.
    """

    def flown(sim: Simulation) -> tuple[dict[str, RecordedFlight], dict[str, dict[str, Any]]]:
        flights, uploads = {}, {}
        with _simulator(sim, "px4") as address:
            for name, folder in folders.items():
                uploads[name] = _upload(address, folder, sim.out / "backups")
                log = sim.out / f"{name}.tlog"
                flights[name] = fly(name, address, plan, log, watch=sim.watch, tell=sim.tell)
        return flights, uploads

    return _slow_enough(sim, flown)


def fly_table(
    sim: Simulation, name: str, folder: Path, plan: FlightPlan
) -> tuple[RecordedFlight, dict[str, Any]]:
    """As `fly_tables`, one table on a stand-in of its own, its battery full."""
    flights, uploads = fly_tables(sim, {name: folder}, plan)
    return flights[name], uploads[name]


def _slow_enough(sim: Simulation, flown: Callable[[Simulation], T]) -> T:
    """What `flown` gives, in a simulator that this machine keeps up with: slower where the link was lost, or
    no height was reached (it disarms again where a command comes ten of its seconds late).
    """
    for slower in SLOWER:
        try:
            return flown(sim)
        except (LinkError, NotReached) as error:
            sim = replace(sim, speed=(sim.speed or UNBOUNDED) / slower)
            sim.tell(f"{error}; again at {sim.speed:.3g} times real time")
    return flown(sim)


def _simulator(sim: Simulation, firmware: str) -> AbstractContextManager[str]:
    return simulator(["--firmware", firmware, "--speed", str(sim.speed), "--lockstep", *sim.arguments])


def _upload(address: str, folder: Path, backups: Path) -> dict[str, Any]:
    """Upload with a backup. Raises unless the table is verified."""
    from coaxlink.errors import CheckFailed
    from coaxlink.mavlink import connect
    from coaxlink.uploading.journal import Journal
    from coaxlink.uploading.plan import load_plan
    from coaxlink.uploading.worker import Uploader

    # a simulated board is gone with its flight: nothing of it belongs into the user's own journal
    with tempfile.TemporaryDirectory() as scratch, connect(address, target_system=1) as session:
        journal = Journal(session.identity, Path(scratch))
        # it is this very vehicle: about a centre of mass that was found its rotors stand elsewhere
        outcome = Uploader(session, backup_folder=backups, journal=journal).upload(
            load_plan(folder), new_geometry=True, spin_from_table=True
        )
    if outcome.result != "verified":
        raise outcome.error or CheckFailed(f"upload of {folder}: {outcome.result} ({outcome.reason})")
    return outcome.to_json()


def fly_live(
    sim: Simulation,
    vehicle: Vehicle,
    plan: FlightPlan,
    law: str | Law = LIVE_LAW,
    *,
    name: str | None = None,
) -> tuple[RecordedFlight, Demands, dict[str, Any]]:
    """Fly the plan with the companion mixing: the flight, the demands answered, the mixer's account.

    `name` is the log's, if not the law's.
    """
    from coaxlink.live.effects import LiveEffects
    from coaxlink.live.mixer import LiveMixer
    from coaxlink.mavlink.telemetry import Telemetry

    called = law if isinstance(law, str) else law.name

    def flown(sim: Simulation) -> tuple[RecordedFlight, Demands, dict[str, Any]]:
        demands = Demands()
        account: dict[str, Any] = {}

        @contextmanager
        def mixing(session: Session) -> Iterator[None]:
            forget = session.subscribe(demands.hear)
            # what it hears is as old as the vehicle's own clock says, which is not this machine's
            extra = LiveEffects(session, vehicle, Telemetry(demands.now)) if vehicle.live_effects else None
            live = LiveMixer(
                session, vehicle, law, own_curve=OWN_CURVE, compensation=extra, timing=PATIENT, witness=False
            )
            with live:
                yield
            with suppress(LinkError):  # the flight is over, nobody listens any more
                session.request_stream(DEMAND_ID, -1.0)
            forget()
            account.update(live.summary())

        log = sim.out / f"{name or f'live_{called}'}.tlog"
        with _simulator(sim, "px4:1.13") as address:
            flight = fly(
                name or f"live {called}",
                address,
                plan,
                log,
                watch=sim.watch,
                tell=sim.tell,
                mixing=mixing,
                parameters={"THR_MDL_FAC": OWN_CURVE},
            )
        return flight, demands, account

    return _slow_enough(sim, flown)
