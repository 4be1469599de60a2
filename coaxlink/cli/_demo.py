"""The demo's steps, each a function of what came before; `demo.py` shows them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.cli._flights import Flight, fly
from coaxlink.cli._simulator import simulator
from coaxlink.link.trajectory import Plan
from coaxlink.report.demo import FlightErrors
from coaxlink.residual.delivered import delivered
from coaxlink.residual.signals import lagged
from coaxlink.rotor import RotorModel

if TYPE_CHECKING:
    from collections.abc import Iterator

    from coaxlink.link import Session

TABLES = ("standard", "reduced", "fitted")
LIVE_LAW = "coaxial"
LIVE = f"live {LIVE_LAW}"
LIVE_SPEED = 4.0  # a companion's answer takes wall time: a faster world would turn it into latency
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

    def at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Controls (rows, 4) at the log's own times."""
        columns = np.array(self.controls)
        return np.stack([np.interp(time_s, self.time_s, column) for column in columns.T], axis=1)


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
    with simulator(["--firmware", "px4", "--speed", str(speed), *world]) as address:
        for name, folder in folders.items():
            uploads[name] = upload(address, folder)
            flights[name] = fly(name, address, plan, out / f"{name}.tlog", watch=watch)
    return flights, uploads


def fly_live(
    world: list[str],
    speed: float,
    airframe: Airframe,
    model: RotorModel,
    plan: Plan,
    out: Path,
    watch: Watch,
    law: str = LIVE_LAW,
    *,
    name: str | None = None,
    effects: bool = False,
) -> tuple[Flight, Demands, dict[str, Any]]:
    """Fly the plan with the companion mixing: the flight, the demands answered, the mixer's account.

    `effects` compensates those of the model from telemetry; `name` is the log's, if not the law's.
    """
    from coaxlink.link.live_effects import LiveEffects
    from coaxlink.link.mixing import LiveMixer
    from coaxlink.mixer import make_law

    demands = Demands()
    account: dict[str, Any] = {}

    @contextmanager
    def mixing(session: Session) -> Iterator[None]:
        forget = session.subscribe(demands.hear)
        extra = LiveEffects(session, airframe, model) if effects and model.effects else None
        live = LiveMixer(session, airframe, make_law(law, airframe, model), model, compensation=extra)
        with live:
            yield
        forget()
        account.update(live.summary())

    companion: Callable[[Session], AbstractContextManager[object]] = mixing
    with simulator(["--firmware", "px4:1.13", "--speed", str(min(speed, LIVE_SPEED)), *world]) as address:
        log = out / f"{name or f'live_{law}'}.tlog"
        flight = fly(name or f"live {law}", address, plan, log, watch=watch, mixing=companion)
    return flight, demands, account


def errors_of_table(
    flight: Flight,
    airframe: Airframe,
    model: RotorModel,
    parameters: Mapping[str, float | int],
    *,
    whole: bool = False,
) -> FlightErrors:
    """A flight against what the table on board believes its motor commands deliver.

    `whole`: of all the plan instead of the paper's hover and circle, and after the declared motor lag.
    """
    from coaxlink.mixer.intent import intended_wrench

    return _errors(flight, airframe, model, lambda _, motor: intended_wrench(parameters, motor), whole)


def errors_of_live(
    flight: Flight,
    airframe: Airframe,
    model: RotorModel,
    demands: Demands,
    *,
    whole: bool = False,
) -> FlightErrors:
    """A flight against the demands that the companion was handed.

    `whole` as above.
    """
    from coaxlink.link.mixing import DemandScale
    from coaxlink.mixer import standard_coefficients

    scale = DemandScale(airframe, standard_coefficients(model)).matrix

    def meant(time_s: NDArray[np.float64], _: NDArray[np.float64]) -> NDArray[np.float64]:
        wrench = demands.at(time_s) @ scale.T
        return lagged(wrench, float(np.median(np.diff(time_s))), airframe.motor_lag_s) if whole else wrench

    return _errors(flight, airframe, model, meant, whole)


def _errors(
    flight: Flight,
    airframe: Airframe,
    model: RotorModel,
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
        delivered(samples.take(inside), airframe, model, meant, lagged=whole),
        (float(miss[0]), float(miss[1]), float(miss[2])),
    )
