"""What a mixer table, or the exact law on board, is worth on a real autopilot: each through the same flight.

    PX4_SITL=.../bin/px4 python research/table_worth_real.py [--repeats 3] [--ways standard fitted ...]
        [--airframe X8.toml [--rotor MAP.csv]] [--module BINARY] [--stock] [--json F]
    ARDUCOPTER_SITL=.../arducopter python research/table_worth_real.py --firmware ardupilot ...

The firmware's own SITL flies our plant over the lock-step bridge (`coaxlink sim --bridge`, here with a
recorder at the plant). One flight a table and repeat: take-off with a quarter of the mass too much, the load
dropped in hover, hover at the own mass, the paper's circle, 90 degrees of yaw there and back, then a load
that grows by a tenth of the mass a second until it falls: the ceiling is the most thrust of half a second.
Power, height, place and yaw are the plant's truth; attitude error and thrust demand are its ATTITUDE_TARGET.
PX4's tables are tuned alike (the vertical gains divided by the table's own); `--stock` leaves them as PX4
ships them. ArduCopter gets each by `coaxlink table` and `upload`, with the gains and spin range it has.
Differences are paired by repeat, whose number is the seed of the sensors' noise (PX4's). About a minute a
flight on a free core.

`module` and `companion` are the exact law in the module that `coaxlink bridge --firmware px4` writes
(PX4_MODULE_SITL or --module names the binary it was built into), alone and answered by `LiveMixer` over
MAVLink. The companion's flights are at real time and in the real-time class.

With `--rotor` the world interpolates the raw rows of a stand map; `--airframe` is what coaxlink made of it.
Under the figures stands what `compare` prints of the vehicle (for ArduCopter the same sum over the mix of
each table: its least spin moves the split), what the rotor model says at the speeds that were flown, and what
is saved by the map's rows and by the model with nothing flown, over weights about the vehicle's own: where a
flight is off the print, these say whether flight and table differ, or model and rows. `--at-rest` flies
nothing.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as m
from real_pairs import coaxlink

from coaxlink.airframe import load_airframe
from coaxlink.errors import CoaxlinkError
from coaxlink.fly.trajectory import Circle, FlightPlan, Hold, Move, Segment
from coaxlink.live.mixer import LiveMixer
from coaxlink.live.onboard.description import board_law
from coaxlink.mavlink import connect
from coaxlink.mixer import make_law
from coaxlink.mixer.demands import Commands, law_commands
from coaxlink.mixer.worth import TableOnRotors, solve, weigh
from coaxlink.rotor.model import load_rotor_model
from coaxlink.tables.ardupilot import ap_commands, report_ap
from coaxlink.tables.px4 import px4_commands, px4_table
from coaxlink.vehicle import Vehicle, battery_watts, load_vehicle, shaft_watts
from firmware_params import px4
from sim.bridge.ardupilot_json import ArduPilotBridge
from sim.bridge.px4_hil import Px4Bridge
from sim.effects import FORMS, HiddenEffect
from sim.physics.plant import GRAVITY, Plant
from sim.physics.rotors import read_pair
from sim.px4.autopilot import Autopilot
from sim.px4.cascade import euler
from sim.px4.tuning import tuned_settings
from sim.truth import Truth
from sim.vehicle import LOWER, read_vehicle

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "real"))
from real_autopilots import Px4, arducopter, free_instance, real_time, take_off, upload  # noqa: E402
from test_real_ardupilot import FACTORY  # noqa: E402

TABLES, ON_BOARD = ("standard", "curved", "fitted"), ("module", "companion")
LOAD, GROWS_1_S = 0.25, 0.1  # of the mass
LATE_S = 0.5  # a flight whose set-points were further apart is flown again
HERE, RIM, HEADING = (0.0, 0.0, -3.0), (2.0, 0.0, -3.0), 0.5 * math.pi
FLIGHT: tuple[Segment, ...] = (
    Hold("loaded", HERE, 8.0),
    Hold("drop", HERE, 8.0),
    Hold("hover", HERE, 12.0),
    Move("to the circle", HERE, RIM, 3.0),
    Circle("circle", 2.0, -3.0, 8.0, 2),
    Move("back", RIM, HERE, 3.0),
    Hold("calm", HERE, 4.0),
    Hold("yaw", HERE, 5.0, HEADING),
    Hold("yaw back", HERE, 5.0),
    Hold("ceiling", HERE, 30.0),
)
NAMES = [segment.name for segment in FLIGHT]
BEFORE_S = 2.0  # an estimator's height wanders by decimetres: a disturbance is judged from just before it
# quantity: (unit, digits)
FIGURES = {
    "power in hover": ("W at the shafts", 1), "battery power in hover": ("W of the rotors", 1),
    "upper rotors in hover": ("rpm", 0), "lower rotors in hover": ("rpm", 0), "share from above": ("", 4),
    "power in the circle": ("W at the shafts", 1),
    "thrust demand in hover": ("", 4),
    "ceiling": ("kg", 1), "place in the circle, rms": ("m", 3),
    "yaw acceleration in yaw steps, most of 0.1 s": ("rad/s2", 2),
    "height in hover, rms": ("m", 3), "height in the circle, rms": ("m", 3),
    "height after the drop, most": ("m", 3), "height in yaw steps, most": ("m", 3),
    "attitude in hover, rms": ("deg", 3), "attitude in the circle, rms": ("deg", 3),
    "attitude in yaw steps, rms": ("deg", 3), "yaw in yaw steps, rms": ("deg", 2),
}  # fmt: skip


class Watched(Truth):
    """A truth that drops its load when told, and keeps a row of the plant every 4 ms."""

    def __init__(self, now: Any, mass_kg: float) -> None:
        super().__init__((HiddenEffect("mass_change", LOAD * mass_kg),))
        self.mass_kg = mass_kg
        self.now, self.loaded, self.grown_s = now, True, 0.0
        # segment, s, down m, yaw rad, W, north m, east m, rad/s2, N, W of the battery, upper and lower rpm,
        # N of the upper rotors
        self.rows: list[tuple[float, ...]] = []

    def act(self, plant: Plant) -> None:
        super().act(plant)
        segment = self.now.value
        if segment < 0:
            return
        if self.loaded and NAMES[segment] == "drop":
            FORMS["mass_change"].apply(plant, HiddenEffect("mass_change", -LOAD * self.mass_kg))
            self.loaded = False
        if NAMES[segment] == "ceiling":
            since, self.grown_s = plant.time_s - (self.grown_s or plant.time_s), plant.time_s
            FORMS["mass_change"].apply(plant, HiddenEffect("mass_change", GROWS_1_S * self.mass_kg * since))
        shaft = float(plant.torque @ plant.speeds) * plant.pair.speed_max_rpm * math.pi / 30.0
        w, x, y, z = plant.quaternion.tolist()
        north, east, down = plant.position.tolist()
        turning, thrust = plant.out[plant.index.O_ALPHA + 2], plant.thrust.sum()
        yaw, drawn = euler((w, x, y, z))[2], float(plant.rotor_watts().sum())
        upper = np.asarray(plant.vehicle.level) != LOWER
        turn = [plant.speeds[rotors].mean() * plant.pair.speed_max_rpm for rotors in (upper, ~upper)]
        mine = (segment, plant.time_s, down, yaw, shaft, north, east, turning, thrust, drawn)
        self.rows.append((*mine, *turn, plant.thrust[upper].sum()))


def world(
    airframe: Path, rotor: Path | None, port: int, seed: int, speed: float, now: Any, over: Any, pipe: Any
) -> None:
    """The plant's process: serve PX4 on `port`, ArduPilot where it is 0, until `over`; then give the rows."""
    vehicle = read_vehicle(airframe)
    assert vehicle.rotor_file is not None
    plant, truth = Plant(vehicle, read_pair(rotor or vehicle.rotor_file)), Watched(now, vehicle.mass_kg)
    bridge: Any
    if port:
        bridge = Px4Bridge(plant, truth, port=port, seed=seed, speed=speed)
    else:
        bridge = ArduPilotBridge(plant, truth, port=0)
    pipe.send(int(bridge.name.rpartition(":")[2]))
    try:
        bridge.run(over.is_set)
    finally:
        bridge.close()
    pipe.send((np.array(truth.rows), bridge.status()))


class OnBoard:
    """The module's law to tune for: a demand is a wrench."""

    def __init__(self, table: Any, vehicle: Vehicle) -> None:
        self._table, self._law, self._wrench = table, make_law("exact", vehicle), board_law(vehicle).wrench

    def command(self, *demand: float) -> NDArray[np.float64]:
        """See Mixing."""
        return self._law.speeds(self._wrench @ demand)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._table, name)


def settings(airframe: Path, law: str, stock: bool) -> dict[str, float]:
    """PX4's parameters of a table, its outputs, and the gains its owner would tune for it."""
    frame = load_airframe(airframe)
    assert frame.rotor_model is not None
    on = "standard" if law in ON_BOARD else law  # the table only says where the rotors are
    table = px4.table_to_params(px4_table(Vehicle(frame, load_rotor_model(frame.rotor_model)), on))
    vehicle = read_vehicle(airframe)
    assert vehicle.rotor_file is not None
    owner = Autopilot(Plant(vehicle, read_pair(vehicle.rotor_file)), Truth())
    if law in ON_BOARD:
        owner.mixer = OnBoard(owner.mixer, Vehicle(frame, load_rotor_model(frame.rotor_model)))
    owner.store.recall(table)
    outputs = {f"PWM_MAIN_FUNC{n}": 100.0 + n for n in range(1, vehicle.rotors + 1)}
    # a busy machine sends late: waited for, not answered by PX4's failsafe in the middle of a trial
    ours = {"SIM_BAT_MIN_PCT": 100.0, "COM_OF_LOSS_T": 60.0}
    return {**table, **outputs, **tuned_settings(owner, lift=not stock), **ours}


@contextmanager
def served(
    airframe: Path, rotor: Path | None, port: int, seed: int, speed: float
) -> Iterator[tuple[Any, Any, int]]:
    """The world as a process; yields where the segment is written, how to get its rows, its port."""
    context = multiprocessing.get_context("spawn")
    now, over = context.Value("i", -1), context.Event()
    ours, theirs = context.Pipe()
    process = context.Process(
        target=world, args=(airframe, rotor, port, seed, speed, now, over, theirs), daemon=True
    )
    process.start()
    bound = ours.recv()

    def rows() -> Any:
        now.value = -1
        over.set()
        return ours.recv()

    try:
        yield now, rows, bound
    finally:
        over.set()
        process.join(10.0)


def fly(
    binary: Path,
    airframe: Path,
    rotor: Path | None,
    law: str,
    params: dict[str, float],
    seed: int,
    speed: float,
) -> tuple[dict[str, float], float, str]:
    """One flight's figures, the longest time between set-points, and what the lock-step says of it."""
    instance, live = free_instance(), law == "companion"
    with (
        real_time() if live else nullcontext(),
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        served(airframe, rotor, 4560 + instance, seed, 1.0 if live else speed) as (now, rows, _),
    ):
        board = Px4(binary, Path(folder), instance)
        with board.boot(params, cut=True) as url, connect(url, timeout_s=60.0) as session:
            if law in ON_BOARD:
                board.start_module(params["MPC_THR_HOVER"])
            return follow(session, now, rows, load_vehicle(airframe) if live else None)


def fly_copter(
    binary: Path, airframe: Path, rotor: Path | None, law: str, seed: int, speed: float
) -> tuple[dict[str, float], float, str]:
    """As `fly`, of an ArduCopter with the table that `coaxlink table` and `upload` put there."""
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        served(airframe, rotor, 0, seed, 0.0) as (now, rows, port),
        arducopter(binary, Path(folder), FACTORY, speed=speed or 3.0, world=nullcontext(port)) as url,
    ):
        tables = Path(folder) / "tables"
        coaxlink("table", airframe, "--firmware", "ardupilot", "--law", law, "--out", tables)
        upload(url, tables, Path(folder))
        with connect(url, timeout_s=60.0) as session:
            return follow(session, now, rows, None)


def follow(session: Any, now: Any, rows: Any, mixed: Vehicle | None) -> tuple[dict[str, float], float, str]:
    """The flight, with a companion for the vehicle `mixed`."""
    for kind in (m.MAVLINK_MSG_ID_ATTITUDE_TARGET, m.MAVLINK_MSG_ID_ATTITUDE_QUATERNION):
        assert session.request_stream(kind, 50.0)
    vehicle = take_off(session)
    mixing = LiveMixer(session, mixed, "exact") if mixed else None
    if mixing:
        mixing.start()

    def mark(segment: str, t: float) -> None:
        now.value = NAMES.index(segment)

    with session.listen(("ATTITUDE_TARGET", "ATTITUDE_QUATERNION")) as inbox:
        track = vehicle.follow(FlightPlan(FLIGHT), mark)
        if mixing:
            mixing.stop()
        own_rows, status = rows()
        heard = []
        while (message := session.take(inbox, 0.0)) is not None:
            heard.append(message)
    starts = {name: t for t, name in reversed(list(zip(track.time_s, track.segment, strict=True)))}
    late = float(np.diff(track.time_s).max())
    if mixing:
        reported = mixing.summary()
        board_s = {k: reported["board"][k] for k in ("taken", "stale", "handed_back")}
        status += f"; {reported['cycles']} answers, {board_s}"
    return figures(own_rows, heard, starts), late, f"{status}; set-points at most {late:.2f} s apart"


def figures(own_rows: NDArray[np.float64], heard: list[Any], starts: dict[str, float]) -> dict[str, float]:
    """Of the plant's rows as `Watched` keeps them, and PX4's messages by its own clock."""
    at = {}
    for n, segment in enumerate(FLIGHT):  # after the last set-point PX4 does as it likes
        mine = own_rows[own_rows[:, 0] == n]
        at[segment.name] = mine[mine[:, 1] < mine[0, 1] + segment.duration_s]

    def off(name: str, before: str, *more: str) -> NDArray[np.float64]:
        """Down from where it was just before."""
        calm = at[before]
        rest = calm[calm[:, 1] > calm[-1, 1] - BEFORE_S, 2].mean()
        return np.asarray(np.concatenate([at[n][:, 2] for n in (name, *more)]) - rest)

    turned = np.concatenate([at["yaw"][:, 3] - HEADING, at["yaw back"][:, 3]])
    turned = np.remainder(turned + math.pi, 2 * math.pi) - math.pi
    circle, grown = at["circle"], at["ceiling"]
    wanted = [FLIGHT[NAMES.index("circle")].at(t - circle[0, 1]).position_m[:2] for t in circle[:, 1]]
    turning = np.abs(np.concatenate([at["yaw"][:, 7], at["yaw back"][:, 7]]))
    tilt = tilts(heard, starts)
    level = [a.thrust for a in targets(heard) if _within(a, "hover", starts)]
    return {
        "power in hover": float(at["hover"][:, 4].mean()),
        "battery power in hover": float(at["hover"][:, 9].mean()),
        "upper rotors in hover": float(at["hover"][:, 10].mean()),
        "lower rotors in hover": float(at["hover"][:, 11].mean()),
        "share from above": float(at["hover"][:, 12].sum() / at["hover"][:, 8].sum()),
        "power in the circle": float(at["circle"][:, 4].mean()),
        "thrust demand in hover": float(np.mean(level)),
        "ceiling": float(np.convolve(grown[:, 8], np.ones(125) / 125).max()) / GRAVITY,
        "place in the circle, rms": rms(np.linalg.norm(circle[:, 5:7] - np.array(wanted), axis=1)),
        "yaw acceleration in yaw steps, most of 0.1 s": float(np.convolve(turning, np.ones(25) / 25).max()),
        "height in hover, rms": rms(off("hover", "drop")),
        "height in the circle, rms": rms(off("circle", "hover")),
        "height after the drop, most": float(np.abs(off("drop", "loaded")).max()),
        "height in yaw steps, most": float(np.abs(off("yaw", "calm", "yaw back")).max()),
        "attitude in hover, rms": rms(tilt["hover"]),
        "attitude in the circle, rms": rms(tilt["circle"]),
        "attitude in yaw steps, rms": rms(np.concatenate([tilt["yaw"], tilt["yaw back"]])),
        "yaw in yaw steps, rms": math.degrees(rms(turned)),
    }


def targets(heard: list[Any]) -> list[Any]:
    """PX4's attitude set-points."""
    return [a for a in heard if a.get_type() == "ATTITUDE_TARGET"]


def tilts(heard: list[Any], starts: dict[str, float]) -> dict[str, NDArray[np.float64]]:
    """Degrees between the body z that PX4 wants and the one it estimates, by segment."""
    own = [a for a in heard if a.get_type() == "ATTITUDE_QUATERNION"]
    clock = np.array([a.time_boot_ms for a in own], float)
    down = np.array([_down((a.q1, a.q2, a.q3, a.q4)) for a in own])
    found: dict[str, list[float]] = {name: [] for name in NAMES}
    for a in targets(heard):
        there = np.array([np.interp(a.time_boot_ms, clock, column) for column in down.T])
        cosine = float(there @ _down(tuple(a.q)) / np.linalg.norm(there))
        for name in NAMES:
            if _within(a, name, starts):
                found[name].append(math.degrees(math.acos(min(cosine, 1.0))))
    return {name: np.array(values) for name, values in found.items()}


def _within(message: Any, name: str, starts: dict[str, float]) -> bool:
    since = message.time_boot_ms / 1e3 - starts[name]
    return bool(0.0 <= since < FLIGHT[NAMES.index(name)].duration_s)


def _down(q: Any) -> tuple[float, float, float]:
    w, x, y, z = q
    return 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)


def rms(x: NDArray[np.float64]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(x * x)))


def show(flown: dict[str, list[dict[str, float]]]) -> None:
    """A row a figure: mean and standard deviation over repeats, differences to the first way by pairs."""
    first, *others = flown
    print(f"{'':46s}" + "".join(f"{law:>22s}" for law in (*flown, *(f"{o} - {first}" for o in others))))
    for name, (unit, digits) in FIGURES.items():
        x = {law: np.array([one[name] for one in flights]) for law, flights in flown.items()}
        columns = [*x.values(), *(x[law] - x[first] for law in others)]
        cells = (f"{c.mean():.{digits}f} +- {c.std(ddof=1):.{digits}f}" for c in columns)
        print(f"{name:46s}" + "".join(f"{cell:>22s}" for cell in cells) + f" {unit}")


def commands_of(vehicle: Vehicle, way: str, firmware: str) -> Commands:
    """Motor commands of a demand, as that firmware makes them of the way's table, or the law by itself."""
    if firmware == "ardupilot":
        return ap_commands(report_ap(vehicle, way).mix)
    if way in ON_BOARD:
        full = float(vehicle.airframe.wrench(*vehicle.airframe.loads(vehicle.model, vehicle.full))[0])
        return law_commands(make_law("exact", vehicle), vehicle, full)
    return px4_commands(px4.realise(px4_table(vehicle, way)))


class Still:
    """An X8's map at rest, no flight: what its rotors lift and take at commands, by its rows."""

    def __init__(self, vehicle: Vehicle, rotor: Path) -> None:
        self.pair, self.vehicle = read_pair(rotor), vehicle
        self.upper = np.array([rotor.level == "upper" for rotor in vehicle.airframe.rotors])

    def at(self, commands: NDArray[np.float64]) -> tuple[float, float, float]:
        """(thrust, shaft, battery watts) of four pairs whose uppers and lowers have one command each."""
        upper, lower = self.pair.turned(commands[self.upper][:1], commands[~self.upper][:1])
        up, q_up, low, q_low = (float(x[0]) for x in self.pair.loads(upper, lower))
        rate, watts = self.pair.speed_max_rpm * math.pi / 30.0, self.pair.watts(upper, lower)
        assert watts is not None
        shaft = rate * (q_up * float(upper[0]) + q_low * float(lower[0]))
        return 4.0 * (up + low), 4.0 * shaft, 4.0 * float(np.sum(watts))

    def watts(self, commands: Commands, weight_N: float) -> NDArray[np.float64]:
        """(4,) by the rows at shafts and battery, by the rotor model at shafts and battery."""
        model = TableOnRotors(self.vehicle, commands)
        rows = solve(lambda demand: self.at(commands(0.0, 0.0, 0.0, demand))[0], weight_N)
        own = solve(model.lift, weight_N)
        assert rows is not None and own is not None
        return np.array([*self.at(commands(0.0, 0.0, 0.0, rows))[1:], *model.power(own)])


def at_rest(vehicle: Vehicle, rotor: Path, ways: Sequence[str], firmware: str) -> None:
    """Savings against the first way, per cent, by the map's rows and by the rotor model, over weights."""
    still, weight = Still(vehicle, rotor), vehicle.airframe.mass_kg * GRAVITY
    loads = np.linspace(0.8, 1.2, 17)
    taken = {
        way: np.array([still.watts(commands_of(vehicle, way, firmware), weight * x) for x in loads])
        for way in ways
    }
    for way in ways[1:]:
        saved = 100.0 * (1.0 - taken[way] / taken[ways[0]])
        own, middle, spread = saved[len(loads) // 2], saved.mean(axis=0), saved.std(axis=0)
        print(f"at rest, {way} saves against {ways[0]}, % at shafts / of the battery:")
        for k, who in ((0, "rows"), (2, "rotor model")):
            print(
                f"    {who}: {own[k]:.2f} / {own[k + 1]:.2f} at its weight, {middle[k]:.2f} +- "
                f"{spread[k]:.2f} / {middle[k + 1]:.2f} +- {spread[k + 1]:.2f} at 0.8 to 1.2 of it"
            )


def printed(vehicle: Vehicle, flown: dict[str, list[dict[str, float]]], firmware: str) -> None:
    """Of each way: what is printed of it, and what the same rotor model says at the speeds flown."""
    uppers = np.array([rotor.level != "lower" for rotor in vehicle.airframe.rotors])
    for way, flights in flown.items():
        row = weigh(vehicle, commands_of(vehicle, way, firmware), way)
        print(f"printed, {way}: {row.hover_W:.1f} W at the shafts, {row.battery_W:.1f} W of the battery")
        upper, lower = (
            float(np.mean([one[f"{side} rotors in hover"] for one in flights])) for side in ("upper", "lower")
        )
        at = np.where(uppers, upper, lower) / vehicle.model.speed_max_rpm
        thrust = vehicle.airframe.loads(vehicle.model, at)[0]
        print(
            f"    rotor model at {upper:.0f} and {lower:.0f} rpm: {float(shaft_watts(vehicle, at)):.1f} W at "
            f"the shafts, {float(battery_watts(vehicle, at)):.1f} W of the battery, "
            f"{float(thrust.sum()):.2f} N, share {float(thrust[uppers].sum() / thrust.sum()):.4f}"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--firmware", choices=("px4", "ardupilot"), default="px4")
    parser.add_argument("--px4", type=Path, default=os.environ.get("PX4_SITL", ""), metavar="BINARY")
    parser.add_argument(
        "--module", type=Path, default=os.environ.get("PX4_MODULE_SITL", ""), metavar="BINARY"
    )
    parser.add_argument(
        "--arducopter", type=Path, default=os.environ.get("ARDUCOPTER_SITL", ""), metavar="BINARY"
    )
    parser.add_argument("--ways", nargs="+", choices=(*TABLES, *ON_BOARD), default=None)
    parser.add_argument("--airframe", type=Path, default=ROOT / "examples" / "x8_demo.toml")
    parser.add_argument("--rotor", type=Path, help="what the world's rotors are; else the airframe's")
    parser.add_argument("--speed", type=float, default=0.0, help="times real time; 0: what is possible")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--stock", action="store_true", help="vertical gains as PX4 ships them")
    parser.add_argument("--at-rest", action="store_true", help="what rows and model say, no flight")
    parser.add_argument("--json", type=Path)
    o = parser.parse_args()
    copter = o.firmware == "ardupilot"
    more = ON_BOARD if Path(o.module).is_file() and not copter else ()
    ways = o.ways or ((*TABLES[::2],) if copter else (*TABLES, *more))
    if copter and set(ways) & set(ON_BOARD):
        parser.error("--ways: ArduCopter has tables only")
    if o.at_rest:
        if o.rotor is None:
            parser.error("--at-rest: a map in --rotor is expected")
        at_rest(load_vehicle(o.airframe), o.rotor, ways, o.firmware)
        return 0
    binaries = {law: Path(o.arducopter if copter else o.module if law in ON_BOARD else o.px4) for law in ways}
    for law, binary in binaries.items():
        if not binary.is_file():
            named = "PX4_MODULE_SITL or --module" if law in ON_BOARD else "PX4_SITL or --px4"
            named, what = ("ARDUCOPTER_SITL or --arducopter", "") if copter else (named, " (bin/px4)")
            autopilot = "ArduCopter" if copter else "PX4"
            print(f"no {autopilot} to fly {law}: {named} names its SITL binary{what}", file=sys.stderr)
            return 2
    if o.repeats < 2:
        parser.error("--repeats: a spread needs two")
    start, flown = time.monotonic(), {law: [] for law in ways}  # type: dict[str, list[dict[str, float]]]
    params = {law: {} if copter else settings(o.airframe, law, o.stock) for law in ways}
    for seed in range(o.repeats):
        for law in ways:
            late = math.inf
            while late > LATE_S:
                try:
                    if copter:
                        words = (binaries[law], o.airframe, o.rotor, law, seed, o.speed)
                        one, late, status = fly_copter(*words)
                    else:
                        whole = (binaries[law], o.airframe, o.rotor, law, params[law], seed, o.speed)
                        one, late, status = fly(*whole)
                except CoaxlinkError as error:
                    print(f"{law}, repeat {seed}: {error}", file=sys.stderr)
                    return error.exit_code
                print(f"{law}, repeat {seed}: {status}", file=sys.stderr, flush=True)
            flown[law].append(one)
    show(flown)
    vehicle = load_vehicle(o.airframe)
    printed(vehicle, flown, o.firmware)
    if o.rotor and o.rotor.suffix == ".csv":
        at_rest(vehicle, o.rotor, ways, o.firmware)
    print(f"{o.repeats} repeats, {time.monotonic() - start:.0f} s")
    if o.json:
        o.json.write_text(json.dumps(flown, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
