"""The stand-in's flight code: modes, arming, goals, failsafe, and one step of loops, mixer and plant.

It knows no MAVLink; `protocol.py` talks for it. Time is the plant's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.line.ftp import CardFiles
from sim.motor_test import MotorTest
from sim.physics.escs import MEASURED
from sim.physics.plant import FOOT_Z_M, Plant
from sim.physics.sensors import SensorReading, Sensors
from sim.place import HOME, Place
from sim.px4.cascade import IDLE, Cascade, Four, Goal, LoopDemand, Settings, Three
from sim.px4.coax_module import EXTRAS, SETPOINT_S, SHARE_NAMES, CoaxFirmware, CoaxModule
from sim.px4.guidance import RATE_HZ
from sim.px4.links import OFFBOARD_LOST, STATION_LOST, Links
from sim.px4.mixer import Px4Mixer
from sim.px4.modes import FLOWN, AttitudeGoal, Mode, Refused
from sim.px4.navigator import Navigator
from sim.px4.own_values import bounded_hover, disarmed
from sim.px4.store import Px4Store
from sim.px4.tuning import tune
from sim.truth import Truth

STEPS = 1000 // RATE_HZ
LIVE_TIMEOUT_S = 0.1
CHARGED = 0.95
STAND_IN_UID = int.from_bytes(b"coaxlink", "big") << 32 | 0x2001


class Autopilot(Navigator):
    """One vehicle with its plant. `step()` moves it on by 4 ms."""

    id_parameter = "MAV_SYS_ID"
    uid = STAND_IN_UID  # of the board, 96 bits as an STM32 has them
    escs = MEASURED  # what they tell
    firmware_module: CoaxFirmware | None = None  # built in; started by the card's extras.txt
    module: CoaxModule | None = None  # while it runs

    def __init__(
        self, plant: Plant, truth: Truth, *, version: tuple[int, int, int] = (1, 16, 1), seed: int = 0
    ) -> None:
        self.plant, self.truth, self.version = plant, truth, version
        self.sensors = Sensors(plant, seed)
        self.rotors = plant.vehicle.rotors
        self._wires: list[int] | None = None
        self.files = CardFiles("fs/microsd", protected=("etc/", "proc/", "dev/", "bin/"))
        self.logger: Any = None
        self.home: Place = HOME
        self.cruise = 0.0  # m/s that someone asked for; 0: as the parameters say
        self._fit_out()
        self.cascade = Cascade(self.settings, 1.0 / RATE_HZ)
        self.say: Callable[[int, str], None] = lambda severity, text: None
        self.exchange: Callable[[LoopDemand], None] = lambda demand: None
        self.keep: Callable[[], None] = lambda: None  # parameters, against a power cut
        self.command: NDArray[np.float64] = np.zeros(self.rotors)  # the last motor commands
        self.boots = 0
        self.boot()

    def _fit_out(self) -> None:
        """Parameters, mixer, and where the loops read their settings."""
        self.store: Any = Px4Store(self.version, self.plant.vehicle)
        self.settings: Settings = self.store
        self.mixer: Any = Px4Mixer(self.store, self.rotors)
        tuned = tune(self.mixer, self.plant)
        self.store.preset("MPC_THR_HOVER", tuned.hover)
        for axis, gains in zip(("ROLL", "PITCH", "YAW"), tuned.gains, strict=True):
            for letter, gain in zip("PID", gains, strict=True):
                self.store.preset(f"MC_{axis}RATE_{letter}", gain)
        self.store.listen(self._heard)

    def _heard(self, name: str) -> None:
        if name.startswith(("PWM_MAIN_FUNC", "SYS_CTRL_ALLOC")):
            self._wires = None
        elif name.startswith("MPC_THR_") and (text := bounded_hover(self.store)):
            self.say(2, text)

    def boot(self) -> None:
        """As after power-up: disarmed, in Hold, parameters kept."""
        self.armed, self.landed = False, True
        self.boots, self.booted_s = self.boots + 1, self.plant.time_s
        self.links = Links(self)
        self.motor_test = MotorTest(self.rotors)
        self.module = None
        if self.firmware_module is not None and b"coax_mixer start" in (self.files.read(EXTRAS) or b""):
            self.store.built_in(dict.fromkeys(SHARE_NAMES, 0.0))
            self.module = CoaxModule(self.firmware_module, self.rotors)
            self.module.begin(*(float(self.store[name]) for name in SHARE_NAMES))
        self.system = min(max(int(self.store[self.id_parameter]), 1), 250)  # MAVLink's system id
        self.demand: LoopDemand = IDLE
        self.reading: SensorReading = self.sensors.read()
        self._enter(Mode.HOLD)
        self._after_disarming = Mode.HOLD
        self._offboard_goal = self.goal
        self.attitude_goal: AttitudeGoal | None = None
        self._offboard_at = self._live_at = -math.inf
        self._live = np.zeros(self.rotors)
        self._armed_at = self._landed_at = self.plant.time_s
        self.cascade.reset()
        if self.logger is not None:
            self.logger.booted()

    # -- what others ask of it -----------------------------------------------------------------

    def arm(self) -> None:
        """Raises Refused."""
        if self.armed:
            return
        if self.preflight():
            raise Refused("Arming denied: Resolve system health failures first")
        if self.landed and self.plant.charge < 0.4:
            self.plant.state[self.plant.index.CHARGE] = CHARGED  # someone swapped the pack
        self.armed, self._armed_at = True, self.plant.time_s
        self.say(6, "Armed by external command")

    def preflight(self) -> list[str]:
        """What speaks against arming, as its pre-arm checks say when they are asked for, and only then."""
        found = []
        if self.mixer.mix is None:
            found.append("the control allocation has no valid rotors")
        if self.mode == Mode.OFFBOARD and not self.offboard_fresh:
            found.append("No offboard signal")
        if self.links.required and not self.links.there(self.plant.time_s):
            found.append("No connection to the ground control station")
        return [f"Preflight Fail: {text}" for text in found]

    def disarm(self, force: bool = False) -> None:
        """Raises Refused in the air unless forced."""
        if not self.armed:
            return
        if not self.landed and not force:
            raise Refused("Disarming denied: not landed")
        self._stop("Disarmed by external command")

    def _stop(self, why: str) -> None:
        self.armed = False
        self.cascade.reset()
        if self.mode != Mode.OFFBOARD:  # UserModeIntention.cpp: back to what was chosen before the landing
            self._enter(self._after_disarming)
        self.say(6, why)
        self._flight_over()

    def _flight_over(self) -> None:
        """The firmware's own values after a flight."""
        disarmed(self.store, self.plant.time_s - self._armed_at)

    def set_mode(self, mode: Mode) -> None:
        """Raises Refused."""
        if mode == Mode.OFFBOARD and not self.offboard_fresh:
            raise Refused("Switching to Offboard denied: no setpoints are streamed")
        if mode not in FLOWN:
            raise Refused(f"Switching to {mode.name.title()} denied: no manual control")
        if mode == Mode.MISSION:
            raise Refused("Switching to Mission denied: no valid mission available")
        if mode == Mode.TAKEOFF:
            self.take_off(math.nan)
            return
        self._enter(mode)
        if mode not in (Mode.LAND, Mode.RTL):
            self._after_disarming = Mode.OFFBOARD if mode == Mode.OFFBOARD else Mode.HOLD

    def take_off(self, altitude_m: float) -> None:
        """Climb to `altitude_m` above home (NaN: MIS_TAKEOFF_ALT)."""
        height = altitude_m if math.isfinite(altitude_m) else float(self.settings["MIS_TAKEOFF_ALT"])
        self._enter(Mode.TAKEOFF)
        self._after_disarming = Mode.HOLD
        n, e, _ = self._position()
        self._target = (n, e, -height)

    def go_to(self, position: Three, yaw: float) -> None:
        """Hold somewhere else (NaN keeps). Raises Refused on what is no place."""
        if any(map(math.isinf, (*position, yaw))):
            raise Refused("Reposition: not a position")
        self._enter(Mode.HOLD)
        here = self._position()
        n, e, d = (h if math.isnan(p) else p for p, h in zip(position, here, strict=True))
        self._target = (n, e, d)
        if not math.isnan(yaw):
            self._yaw = yaw

    def offboard(self, goal: Goal | AttitudeGoal) -> None:
        """A set-point arrived."""
        if isinstance(goal, AttitudeGoal):
            numbers = (*(goal.attitude or (1.0, 0.0, 0.0, 0.0)), *goal.rates, goal.thrust)
            if not all(map(math.isfinite, numbers)):
                return
            self.attitude_goal = goal
        else:
            figures = (*goal.position, *goal.velocity, *goal.acceleration, goal.yaw, goal.yaw_rate)
            if any(map(math.isinf, figures)) or math.isnan(goal.yaw):
                return
            self._offboard_goal, self.attitude_goal = goal, None
        self._offboard_at = self.plant.time_s

    @property
    def offboard_fresh(self) -> bool:
        """Whether set-points stream."""
        return self.plant.time_s - self._offboard_at < float(self.settings["COM_OF_LOSS_T"])

    @property
    def led(self) -> bool:
        """Whether it flies after set-points."""
        return self.armed and self.mode == Mode.OFFBOARD and self.offboard_fresh

    @property
    def takes_live(self) -> bool:
        """Whether SET_ACTUATOR_CONTROL_TARGET drives the motors: v1.13 with the old mixer."""
        return self.version < (1, 14, 0) and self.mixer.legacy

    @property
    def live(self) -> bool:
        """Whether a companion's motor commands are fresh."""
        if self.module is not None:
            return self.module.share > 0
        return self.plant.time_s - self._live_at <= LIVE_TIMEOUT_S

    def drive(self, commands: NDArray[np.float64]) -> None:
        """A companion's motor commands (N,)."""
        if self.takes_live and np.isfinite(commands).all():
            self._live, self._live_at = np.clip(commands[: self.rotors], 0.0, 1.0), self.plant.time_s

    @property
    def outputs_us(self) -> list[float]:
        """Pulse width of every output, 900 us when disarmed."""
        if not self.armed:
            return [1000.0 + 1000.0 * u if u > 0 else 900.0 for u in self.command.tolist()]
        return [1000.0 + 1000.0 * u for u in self.command.tolist()]

    def _wiring(self) -> list[int]:
        """The motor that each output carries; the rotor on output n is number n."""
        if self._wires is None:
            last = self.rotors  # a zero after the motors, for an output without one
            functions = [int(self.store[f"PWM_MAIN_FUNC{n}"]) - 101 for n in range(1, self.rotors + 1)]
            legacy = self.mixer.legacy
            self._wires = [n if legacy else f if 0 <= f < last else last for n, f in enumerate(functions)]
        return self._wires

    # -- one step ------------------------------------------------------------------------------

    def step(self) -> SensorReading:
        """Sense, decide, mix, and let 4 ms pass; returns the reading the decision rests on."""
        self.truth.act(self.plant)
        self.reading = self.sensors.read()
        self.demand = self._decide(self.reading) if self.armed else IDLE
        if self.module is not None:
            d, age_s = self.demand, self.plant.time_s - self._offboard_at
            alive = self.armed and self.mode == Mode.OFFBOARD and age_s < SETPOINT_S
            on_board, trial = (float(self.store[name]) for name in SHARE_NAMES)
            self.module.move_share(self.plant.time_s, on_board, trial, alive)
            self.module.mix(self.plant.time_s, d.roll, d.pitch, d.yaw, d.thrust)
        self.exchange(self.demand)
        self.command = self._outputs(self.demand)
        self.plant.advance(self.command, STEPS)
        return self.reading

    def _outputs(self, d: LoopDemand) -> NDArray[np.float64]:
        """(N,) commands of the ESCs, 0..1."""
        if not self.armed:
            return self._tested()
        if self.module is not None:
            command = np.append(self.module.outputs(self.plant.time_s), 0.0)[self._wiring()]
        elif self.live and not self.landed:
            command = self._live
        else:
            motors = self.mixer.command(d.roll, d.pitch, d.yaw, d.thrust)
            command = np.append(motors, 0.0)[self._wiring()]
        if not np.isfinite(command).all():
            command = np.nan_to_num(command)
        return np.asarray(command.round(3), np.float64)  # a PWM output has a thousand steps

    def _tested(self) -> NDArray[np.float64]:
        """(N,) what a motor test turns."""
        motors = np.append(self.motor_test.commands(self.plant.time_s), 0.0)
        return np.asarray(motors[self._wiring()], np.float64)

    def _decide(self, reading: SensorReading) -> LoopDemand:
        position: Three = tuple(reading.position.tolist())
        self._watch(reading, position)
        if self.mode == Mode.OFFBOARD and self.attitude_goal is not None:
            attitude: Four = tuple(reading.quaternion.tolist())
            return self._fly_attitude(self.attitude_goal, attitude, tuple(reading.rates.tolist()))
        self._move_goal(position)
        if self.landed:
            self.cascade.reset()
            return IDLE
        return self.cascade.track(self.goal, reading)

    def _fly_attitude(self, goal: AttitudeGoal, attitude: Four, rates: Three) -> LoopDemand:
        self.landed = self.landed and goal.thrust < 0.15
        if self.landed:
            return IDLE
        if goal.attitude is None:
            return self.cascade.hold_rates(goal.rates, goal.thrust, rates, attitude)
        return self.cascade.hold_attitude(goal.attitude, goal.thrust, attitude, rates, goal.rates[2])

    def _watch(self, reading: SensorReading, position: Three) -> None:
        """Failsafe, landing, disarming."""
        now = self.plant.time_s
        if self.mode == Mode.OFFBOARD and not self.offboard_fresh:
            self._offboard_lost()
        self.links.watch(now)
        if self.mode == Mode.LAND and not self.landed:
            still = abs(reading.velocity[2]) < 0.15 and reading.height < FOOT_Z_M + 0.06
            if not still:
                self._settled_since = None
            elif self._settled_since is None:
                self._settled_since = now
            elif now - self._settled_since > 0.5:
                self.landed, self._landed_at = True, now
                self.say(6, "Landing detected")
        if self.landed:
            flown = self._landed_at > self._armed_at
            wait = float(self.settings["COM_DISARM_LAND" if flown else "COM_DISARM_PRFLT"])
            if wait > 0 and now - max(self._landed_at, self._armed_at) > wait and self.mode != Mode.TAKEOFF:
                self._stop("Disarmed by landing" if flown else "Disarmed by auto preflight disarming")

    def _offboard_lost(self) -> None:
        """By COM_OBL_RC_ACT; what needs a pilot's sticks holds, for there are none."""
        action = OFFBOARD_LOST.get(int(self.settings["COM_OBL_RC_ACT"]), Mode.HOLD)
        doing: dict[Mode | None, str] = {
            Mode.HOLD: "holding position",
            Mode.LAND: "landing",
            Mode.RTL: "returning",
        }
        self.say(4, f"Offboard setpoints lost, {doing.get(action, 'motors off')}")
        self.fail_over(action)

    def fail_over(self, action: Mode | None) -> None:
        """Into a mode, or with the motors off."""
        if action is None:
            self._stop("Failsafe: motors off")
        elif self.mode != action:
            self._enter(action)

    def station_lost(self) -> None:
        """By NAV_DLL_ACT."""
        action = int(self.settings["NAV_DLL_ACT"])
        if action in STATION_LOST and self.mode not in (Mode.LAND, Mode.RTL):
            self.say(2, "Connection to ground station lost")
            self.fail_over(STATION_LOST[action])

    @property
    def station_timeout_s(self) -> float:
        """Silence of the ground station that counts."""
        return float(self.settings["COM_DL_LOSS_T"])
