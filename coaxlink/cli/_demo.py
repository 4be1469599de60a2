"""The demo's steps, each a function of what came before; `demo.py` shows them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from coaxlink.cli._flights import Flight, fly
from coaxlink.cli._simulator import simulator
from coaxlink.fly.trajectory import Plan
from coaxlink.live.guard import Timing
from coaxlink.report.demo import FlightErrors
from coaxlink.residual.allocation_error import delivered

if TYPE_CHECKING:
    from collections.abc import Iterator

    from coaxlink.mavlink import Session
    from coaxlink.vehicle import Vehicle

FITTED, HIDDEN = "fitted", "hidden"
TABLES = ("standard", "reduced", FITTED)
LIVE_LAW = "exact"
LIVE = f"live {LIVE_LAW}"
DEMAND_ID = 140  # ACTUATOR_CONTROL_TARGET
# the world waits for the companion, and the companion for the world: a machine that is busy elsewhere for
# seconds is no silence of the vehicle
PATIENT = Timing(fade_s=0.0, hold_after_s=20.0, ramp_after_s=40.0)
OWN_CURVE = 1.0  # THR_MDL_FAC that makes the own mixer's demand mean about what the law's does (docs/live.md)
JUDGED = ("hover", "circle")  # the paper's own flight
Watch = Callable[[str, float], None]


@dataclass
class Demands:
    """The wrench demands that a companion was handed, kept to be held against what was delivered."""

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


def fly_tables(
    world: list[str],
    speed: float,
    folders: Mapping[str, Path],
    upload: Callable[[str, Path], dict[str, Any]],
    plan: Plan,
    out: Path,
    watch: Watch,
) -> tuple[dict[str, Flight], dict[str, dict[str, Any]]]:
    """Upload each table to one stand-in and fly the plan with it: flights and upload results by name."""
    flights, uploads = {}, {}
    with simulator(["--firmware", "px4", "--speed", str(speed), "--lockstep", *world]) as address:
        for name, folder in folders.items():
            uploads[name] = upload(address, folder)
            flights[name] = fly(name, address, plan, out / f"{name}.tlog", watch=watch)
    return flights, uploads


def fly_fresh(
    world: list[str],
    speed: float,
    folders: Mapping[str, Path],
    upload: Callable[[str, Path], dict[str, Any]],
    plan: Plan,
    out: Path,
    watch: Watch,
) -> tuple[dict[str, Flight], dict[str, dict[str, Any]]]:
    """As `fly_tables`, a stand-in for each table: none flies on what another left of the battery."""
    flights: dict[str, Flight] = {}
    uploads: dict[str, dict[str, Any]] = {}
    for name, folder in folders.items():
        flown, done = fly_tables(world, speed, {name: folder}, upload, plan, out, watch)
        flights |= flown
        uploads |= done
    return flights, uploads


def fly_live(
    world: list[str],
    speed: float,
    vehicle: Vehicle,
    plan: Plan,
    out: Path,
    watch: Watch,
    law: str = LIVE_LAW,
    *,
    name: str | None = None,
    lead_s: tuple[float, float] = (0.0, 0.0),
) -> tuple[Flight, Demands, dict[str, Any]]:
    """Fly the plan with the companion mixing: the flight, the demands answered, the mixer's account.

    `name` is the log's, if not the law's; `lead_s` is the motors' lag and the one wanted of them instead.
    """
    from coaxlink.live.effects import LiveEffects
    from coaxlink.live.mixer import LiveMixer
    from coaxlink.live.telemetry import Telemetry

    demands = Demands()
    account: dict[str, Any] = {}

    @contextmanager
    def mixing(session: Session) -> Iterator[None]:
        forget = session.subscribe(demands.hear)
        # what it hears is as old as the vehicle's own clock says, which is not this machine's
        extra = LiveEffects(session, vehicle, Telemetry(demands.now)) if vehicle.live_effects else None
        live = LiveMixer(
            session, vehicle, law, own_curve=OWN_CURVE, compensation=extra, timing=PATIENT, witness=False,
            lead_s=lead_s,
        )  # fmt: skip
        with live:
            yield
        session.request_stream(DEMAND_ID, -1.0)
        forget()
        account.update(live.summary())

    companion: Callable[[Session], AbstractContextManager[object]] = mixing
    arguments = ["--firmware", "px4:1.13", "--speed", str(speed), "--lockstep", *world]
    with simulator(arguments) as address:
        log = out / f"{name or f'live_{law}'}.tlog"
        flight = fly(
            name or f"live {law}",
            address,
            plan,
            log,
            watch=watch,
            mixing=companion,
            parameters={"THR_MDL_FAC": OWN_CURVE},
        )
    return flight, demands, account


def errors_of_table(
    flight: Flight,
    vehicle: Vehicle,
    parameters: Mapping[str, float | int],
    *,
    whole: bool = False,
) -> FlightErrors:
    """A flight against what the table on board believes its motor commands deliver.

    `whole`: of all the plan instead of the paper's hover and circle, and after the declared motor lag.
    """
    from coaxlink.mixer.intent import intended_wrench

    return _errors(flight, vehicle, lambda _, motor: intended_wrench(parameters, motor), whole)


def errors_of_live(
    flight: Flight,
    vehicle: Vehicle,
    demands: Demands,
    *,
    whole: bool = False,
) -> FlightErrors:
    """A flight against the demands that the companion was handed.

    `whole` as above.
    """
    from coaxlink.live.mixer import DemandScale
    from coaxlink.mixer import standard_coefficients

    scale = DemandScale(vehicle.airframe, standard_coefficients(vehicle.model)).matrix
    lag_s = vehicle.airframe.motor_lag_s if whole else 0.0

    def meant(time_s: NDArray[np.float64], _: NDArray[np.float64]) -> NDArray[np.float64]:
        return demands.at(time_s, lag_s) @ scale.T

    return _errors(flight, vehicle, meant, whole)


def _errors(
    flight: Flight,
    vehicle: Vehicle,
    meant: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
    whole: bool,
) -> FlightErrors:
    from coaxlink.data import read_flight_log

    judged = np.isin(flight.track.segment, sorted(set(flight.track.segment)) if whole else JUDGED)
    miss = np.abs(np.array(flight.track.wanted_m) - np.array(flight.track.flown_m))[judged].mean(axis=0)
    samples = read_flight_log(flight.log)
    stamps, time_s = np.array(flight.track.time_s)[judged], samples["time_s"]
    inside = (time_s >= stamps.min()) & (time_s <= stamps.max())
    return FlightErrors(
        delivered(samples.take(inside), vehicle, meant, lagged=whole),
        (float(miss[0]), float(miss[1]), float(miss[2])),
        flight.pack.mean(),
    )
