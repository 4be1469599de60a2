"""One quick flight: a design (vehicle, rotors, mixer, its owner's gains) in a world of effects, by a plan.

It starts in the air over its first place with its rotors at hover speed, settles, and is judged from then
on, by the plant's truth. Loops, sensors and mix are those of the stand-in.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sim.effects import FORMS, HiddenEffect
from sim.errors import SimulationError
from sim.flight_log import columns
from sim.physics.pair import Pair
from sim.physics.plant import FOOT_Z_M, STEP_S, Plant
from sim.physics.sensing import R_SPEEDS
from sim.physics.sensors import Sensors
from sim.physics.wind import rise
from sim.px4 import loops
from sim.px4.autopilot import Autopilot
from sim.px4.cascade import read_gains
from sim.px4.tuning import INTEGRALS, Mixing, steady, tuned_settings
from sim.quick.plans import PLANS
from sim.truth import Truth, gusts_of
from sim.vehicle import SimVehicle

Array = NDArray[np.float64]
RATE_HZ = 400
CHUNK = 4096  # turns whose noise and goals are in memory at once
THIN_S = 0.02  # between two rows of what was demanded and what came
NOT_FLOWN = ("battery_swap", "strange")  # a pack is swapped on the ground; what no physics explains pushes
EMPTY = 0.07  # of charge: PX4's BAT_CRIT_THR, at which it comes down
ENDS = ("", "attitude", "ground")  # by `kernel.FLEW`, TIPPED, GROUND


class NativeMixing(Mixing, Protocol):
    """A mixing law that someone compiled: see `mix`."""

    address: int

    def book(self) -> NDArray[np.int64]:
        """What the C function is handed, as new; the law keeps alive what it points to."""
        ...


@dataclass(frozen=True)
class FlightDesign:
    """What stays the same from flight to flight; `make_design` fills it."""

    vehicle: SimVehicle
    pair: Pair
    gains: Array  # by `px4.loops`
    hover: float  # thrust setpoint
    hover_command: Array  # (N,)
    columns: NDArray[np.float32]  # (6, N) PX4's normalised mix
    curve: float  # THR_MDL_FAC
    law: NativeMixing | None


@dataclass(frozen=True)
class FlightFigures:
    """One flight, from the end of settling on. Axes of four are thrust, roll, pitch, yaw."""

    seconds: float  # judged
    north_rms_m: float
    east_rms_m: float
    height_rms_m: float
    height_max_m: float
    level_rms_m: float
    level_max_m: float
    sunk_m: float  # deepest below the lowest height that was asked for
    tilt_rms_deg: float  # body z from where the loops wanted it
    yaw_rms_deg: float
    yaw_max_deg: float
    roll_rate_rms_deg_s: float
    pitch_rate_rms_deg_s: float
    yaw_rate_rms_deg_s: float
    thrust_error_N: float  # rms of delivered less the best gain times the demand, sound steady rotors
    roll_error_Nm: float
    pitch_error_Nm: float
    yaw_error_Nm: float
    saturated: float  # share of time with a motor at 0 or 1
    shaft_W: float  # mean
    pack_W: float  # mean, electrical
    energy_Wh: float  # of the pack
    charge: float  # left, 0..1
    failsafe: str  # "", attitude (60 degrees), ground, battery


FIGURES = tuple(f.name for f in fields(FlightFigures) if f.name != "failsafe")


def _flown(figures: Sequence[float], failsafe: str) -> FlightFigures:
    named: dict[str, Any] = {n: float(x) for n, x in zip(FIGURES, figures, strict=True)}
    return FlightFigures(failsafe=failsafe, **named)


@dataclass(frozen=True)
class FlightWorld:
    """Where and how long; `rate_hz` of the loops."""

    effects: tuple[HiddenEffect, ...] = ()
    seed: int = 0
    plan: str | Callable[[Array, int], Array] = "wander"  # of times and the seed: goals, as `plans` has them
    seconds: float = 60.0
    settle_s: float = 5.0
    charge: float = 0.95
    rate_hz: int = RATE_HZ


def make_design(
    vehicle: SimVehicle,
    pair: Pair,
    mixer: Mapping[str, float] | NativeMixing,
    *,
    lift: bool = True,
    integrals: float = 1.0,
    hover_estimate: bool = True,
) -> FlightDesign:
    """PX4's parameters of a table (on top of its defaults), or a law; tuned as its owner would tune it.

    `lift`: vertical gains over the mixer's own slope in hover, too; `integrals`: times the tuned ones;
    `hover_estimate`: MPC_USE_HTE. Raises WorldError where PX4 can make nothing of the table.
    """
    a = Autopilot(Plant(vehicle, pair), Truth())
    law: NativeMixing | None = None
    columns, curve = np.zeros((6, vehicle.rotors), np.float32), 0.0
    if isinstance(mixer, Mapping):
        a.store.recall(mixer)
        mix = a.mixer.mix
        if mix is None:
            raise SimulationError("table", "", "PX4 can make no mix of it")
        if mix.method == 0 or mix.airmode:
            raise SimulationError(
                "table", "CA_METHOD, MC_AIRMODE", "only desaturation without airmode flies here"
            )
        columns, curve = np.ascontiguousarray(mix.mix.T, np.float32), mix.thr_mdl_fac
    else:
        a.mixer = law = mixer
    settings = tuned_settings(a, lift=lift)
    a.store.recall(settings | {"MPC_USE_HTE": float(hover_estimate)})
    a.store.recall({name: float(a.store[name]) * integrals for name in INTEGRALS})
    hover = settings["MPC_THR_HOVER"]
    command = np.array(a.mixer.command(0.0, 0.0, 0.0, hover))
    return FlightDesign(vehicle, pair, read_gains(a.store), hover, command, columns, float(curve), law)


def fly_quick(
    design: FlightDesign, simulation: FlightWorld, log_every: int = 0
) -> tuple[FlightFigures, dict[str, Array]]:
    """The flight's figures and, every `log_every` turns, the contract's flight log (columns by name).

    The same design and world give the same bytes on the same machine. Raises WorldError.
    """
    return _BatchFlight(design, simulation, log_every).run()


class _BatchFlight:
    """The arrays of one flight."""

    def __init__(self, design: FlightDesign, simulation: FlightWorld, log_every: int) -> None:
        from sim.quick import kernel  # numba takes its time

        for e in simulation.effects:
            if e.name in NOT_FLOWN:
                raise SimulationError("effects", e.name, "is not for these flights; coaxlink sim has it")
        if isinstance(simulation.plan, str) and simulation.plan not in PLANS:
            raise SimulationError("plan", simulation.plan, f"one of {', '.join(PLANS)} is expected")
        self.k, self.design, self.simulation = kernel, design, simulation
        self.plant = plant = Plant(design.vehicle, design.pair)
        self.sensors = Sensors(plant, simulation.seed, read_s=1.0 / simulation.rate_hz)
        self.total = round((simulation.settle_s + simulation.seconds) * simulation.rate_hz)
        self.judged = round(simulation.settle_s * simulation.rate_hz)
        self.steps = max(math.ceil(1.0 / (simulation.rate_hz * STEP_S) - 1e-9), 1)  # of the plant, a turn
        self.waiting = sorted(simulation.effects, key=lambda e: e.onset_s)
        n = design.vehicle.rotors
        self.memory = np.zeros(loops.MEMORY)
        self.memory[loops.M_HOVER] = design.hover
        self.gusts, self.gust_noise = gusts_of(simulation.effects), np.random.default_rng(simulation.seed)
        self.demand, self.command, sums = np.zeros(loops.DEMAND), np.zeros(n), np.zeros(kernel.SUMS)
        sums[[kernel.A_LOWEST, kernel.A_WANTED]] = -np.inf
        thin_every = max(round(THIN_S * simulation.rate_hz), 1)
        thin = np.zeros((-(-(self.total - self.judged) // thin_every), 4 + n))
        log = np.zeros((-(-self.total // log_every) if log_every else 0, 15 + 2 * n))
        self.kept = kernel.Kept(sums, thin, thin_every, log, log_every)

    def _start(self) -> None:
        """At the goal, with its rotors at hover speed; the sensors were read once, as at boot."""
        d, p = self.design, self.plant
        n, at = d.vehicle.rotors, p.index
        self.sensors.read()
        p.state[at.POS : at.POS + 3] = self._goals(0, 1)[0, :3]
        p.swap_battery(self.simulation.charge)
        speeds = p.steady_speeds(d.hover_command)
        p.state[at.SPEED : at.SPEED + 2 * n] = [*speeds, *speeds]

    def _goals(self, first: int, last: int) -> Array:
        w = self.simulation
        plan = PLANS[w.plan] if isinstance(w.plan, str) else w.plan
        return plan(np.arange(first, last) / w.rate_hz - w.settle_s, w.seed)

    def run(self) -> tuple[FlightFigures, dict[str, Array]]:
        """All turns; effects set in between the compiled stretches."""
        k, w, d, p = self.k, self.simulation, self.design, self.plant
        self._start()
        book = d.law.book() if d.law is not None else np.zeros(1, np.int64)
        address = d.law.address if d.law is not None else 0
        top = p.pair.speed_max_rpm * math.pi / 30.0
        body = k.Body(p.state, p.parameters, p.geometry, *p.compiled, p.out, self.gusts, top, FOOT_Z_M)
        steering = k.Loops(d.gains, self.memory, self.demand)
        scratch = np.zeros(len(self.command), np.float32)
        mix = k.Mix(d.columns, d.curve, address, book, scratch, self.command)
        ring = None
        turn, ended = 0, 0
        while turn < self.total and not ended:
            self._set_in(turn)
            late = math.ceil(p.sensing.delay_s * w.rate_hz - 1e-9)
            if ring is None or len(ring) != late + 1:
                ring = np.zeros((late + 1, R_SPEEDS + d.vehicle.rotors))
                ring[:] = self._now()
            self.sensors.take_shaking()
            last = min(turn + CHUNK, self.total, *(self._turn_of(e) for e in self.waiting))
            noise = self.sensors.rows(last - turn)
            kicks = self.gust_noise.standard_normal((last - turn, 3))
            turns = k.Turns(turn, last, self.judged, w.rate_hz, self.steps)
            rows = k.Rows(self._goals(turn, last), noise, kicks)
            senses = k.Senses(ring, self.sensors.memory, self.sensors.turns)
            turn, ended = k.fly(turns, body, rows, senses, steering, mix, self.kept)
        return self._judge(turn, ended), self._columns(turn)

    def _now(self) -> Array:
        """A reading without noise, for a ring that is not yet full."""
        p = self.plant
        parts = (
            p.specific_force,
            p.rates,
            p.quaternion,
            p.position,
            p.velocity,
            [p.height, p.voltage],
            p.speeds,
        )
        return np.concatenate(parts)

    def _turn_of(self, e: HiddenEffect) -> int:
        return math.ceil(e.onset_s * self.simulation.rate_hz - 1e-9)

    def _set_in(self, turn: int) -> None:
        """Switch on what has come due."""
        p = self.plant
        while self.waiting and self._turn_of(self.waiting[0]) <= turn:
            effect = self.waiting.pop(0)
            FORMS[effect.name].apply(p, effect)
            if effect.name == "wind":
                rise(self.gusts, p.parameters)

    def _judge(self, turns: int, ended: int) -> FlightFigures:
        k, a, rate = self.k, self.kept.sums, self.simulation.rate_hz
        count = a[k.A_TURNS]
        if count == 0.0:
            return _flown([0.0, *[math.nan] * (len(FIGURES) - 2), self.plant.charge], ENDS[ended])
        rms = np.sqrt(np.maximum(a, 0.0) / count)
        rows = self.kept.thin[: -(-int(count) // self.kept.thin_every)]
        off = shape_error(rows[:, :4], steady(self.plant, rows[:, 4:]))
        degrees = np.degrees([rms[k.A_TILT], rms[k.A_YAW], a[k.A_YAW_MAX]])
        rates = np.degrees(rms[k.A_ROLL_RATE : k.A_ROLL_RATE + 3])
        failsafe = ENDS[ended] or ("battery" if self.plant.charge < EMPTY else "")
        pack = float(a[k.A_PACK] / count)
        figures = (
            rms[k.A_NORTH], rms[k.A_EAST], rms[k.A_DOWN], a[k.A_DOWN_MAX],
            math.hypot(rms[k.A_NORTH], rms[k.A_EAST]), a[k.A_LEVEL_MAX],
            max(a[k.A_LOWEST] - a[k.A_WANTED], 0.0), *degrees, *rates, *off, a[k.A_BOUND] / count,
            a[k.A_SHAFT] / count, pack, pack * count / rate / 3600.0, self.plant.charge,
        )  # fmt: skip
        return _flown([count / rate, *figures], failsafe)

    def _columns(self, turns: int) -> dict[str, Array]:
        every = self.kept.log_every
        if not every:
            return {}
        rows = self.kept.log[: -(-turns // every)]
        return dict(zip(columns(self.design.vehicle.rotors), rows.T, strict=True))


def shape_error(demands: Array, delivered: Array) -> Array:
    """(4,) rms of delivered (rows, 4; thrust N, moments N m) less the best constant gain times the demand.

    What an integrator cannot take off: the best gain of each axis is that of least squares.
    """
    square = (demands * demands).sum(axis=0)
    gain = (demands * delivered).sum(axis=0) / np.where(square > 0.0, square, 1.0)
    return np.asarray(np.sqrt(np.mean((delivered - gain * demands) ** 2, axis=0)))
