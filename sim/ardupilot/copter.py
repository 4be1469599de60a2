"""The stand-in's ArduCopter: modes, arming checks and scripts of its own around the world's flight code."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_params.ardupilot.parameters import MOTOR_FUNCTIONS, servo_function
from sim.ardupilot.files import Card
from sim.ardupilot.mixer import SCRIPTED, ArduPilotMixer
from sim.ardupilot.own_values import OwnValues
from sim.ardupilot.scripts import Scripts
from sim.ardupilot.store import ArduPilotStore
from sim.physics.plant import FOOT_Z_M
from sim.px4.autopilot import RATE_HZ, AttitudeGoal, Autopilot, Goal, Mode, Refused, SensorReading
from sim.px4.cascade import LoopDemand, Three
from sim.px4.tuning import tune

STABILIZE, ALT_HOLD, AUTO, GUIDED, LOITER, RTL, LAND, POSHOLD, BRAKE = 0, 2, 3, 4, 5, 6, 9, 16, 17
MODES = {STABILIZE, ALT_HOLD, AUTO, GUIDED, LOITER, RTL, LAND, POSHOLD, BRAKE}
# FS_GCS_ENABLE to a mode: smart RTL (3, 4) has no path here; 0 is off, and what it does not know is RTL
STATION_LOST = {0: None, 4: LAND, 5: LAND, 7: BRAKE}
AUTOPILOT = {AUTO, GUIDED, RTL, LAND}  # the others are a pilot's
IN_AUTO, LANDING, PILOT = 1 << 1, 1 << 3, 1 << 4  # FS_OPTIONS: go on, whatever FS_GCS_ENABLE says
# MAV_CMD_DO_MOTOR_TEST counts clockwise from the front right, upper before lower: motors from 0
OCTAQUAD_X_ORDER = (0, 5, 3, 6, 2, 7, 1, 4)
SLOWEST_M_S = 0.01  # a wanted climb below it is none: the path to a height ends without a last step
NOT_ARMABLE = {AUTO: "AUTO", RTL: "RTL", LAND: "LAND", BRAKE: "BRAKE"}

# the loops' settings by PX4's names: ArduPilot's parameter and a factor, or a number
_RATES = {
    f"MC_{px4}RATE_{letter}": (f"ATC_RAT_{ap}_{letter}", 1.0)
    for px4, ap in (("ROLL", "RLL"), ("PITCH", "PIT"), ("YAW", "YAW"))
    for letter in ("P", "I", "D", "FF")
}
_LIMITS = {f"MC_{a}RATE_{k}": v for a in ("ROLL", "PITCH", "YAW") for k, v in (("K", 1.0), ("MAX", 220.0))}
SETTINGS: dict[str, tuple[str, float] | float] = {
    **_RATES,
    **_LIMITS,
    "MC_RR_INT_LIM": ("ATC_RAT_RLL_IMAX", 1.0),
    "MC_PR_INT_LIM": ("ATC_RAT_PIT_IMAX", 1.0),
    "MC_YR_INT_LIM": ("ATC_RAT_YAW_IMAX", 1.0),
    "MC_ROLL_P": ("ATC_ANG_RLL_P", 1.0),
    "MC_PITCH_P": ("ATC_ANG_PIT_P", 1.0),
    "MC_YAW_P": ("ATC_ANG_YAW_P", 0.6),
    "MC_YAW_WEIGHT": 0.4,
    "MPC_XY_P": ("PSC_POSXY_P", 1.0),
    "MPC_Z_P": ("PSC_POSZ_P", 1.0),
    "MPC_XY_VEL_P_ACC": ("PSC_VELXY_P", 1.0),
    "MPC_XY_VEL_I_ACC": ("PSC_VELXY_I", 0.4),
    "MPC_XY_VEL_D_ACC": ("PSC_VELXY_D", 1.0),
    "MPC_Z_VEL_P_ACC": ("PSC_VELZ_P", 1.0),
    "MPC_Z_VEL_I_ACC": ("PSC_ACCZ_I", 2.0),
    "MPC_Z_VEL_D_ACC": 0.0,
    "MPC_VELD_LP": 5.0,
    "MPC_XY_VEL_MAX": ("WPNAV_SPEED", 0.01),
    "MPC_XY_CRUISE": ("WPNAV_SPEED", 0.01),
    "MPC_Z_V_AUTO_UP": ("WPNAV_SPEED_UP", 0.01),
    "MPC_Z_V_AUTO_DN": ("WPNAV_SPEED_DN", 0.01),
    "MPC_Z_VEL_MAX_UP": 5.0,
    "MPC_Z_VEL_MAX_DN": 3.0,
    "MPC_TILTMAX_AIR": ("ANGLE_MAX", 0.01),
    "MPC_THR_MIN": 0.1,
    "MPC_THR_MAX": 1.0,
    "MPC_THR_HOVER": ("MOT_THST_HOVER", 1.0),
    "MPC_USE_HTE": 1.0,
    "HTE_THR_RANGE": 0.25,
    "IMU_GYRO_CUTOFF": ("INS_GYRO_FILTER", 1.0),
    "IMU_DGYRO_CUTOFF": ("ATC_RAT_RLL_FLTD", 1.5),
    "MPC_TKO_RAMP_T": ("TKOFF_SLEW_TIME", 1.0),
    "MPC_TKO_SPEED": ("WPNAV_SPEED_UP", 0.01),
    "MPC_LAND_SPEED": ("LAND_SPEED", 0.01),
    "MPC_LAND_ALT1": ("LAND_ALT_LOW", 0.0115),  # it has slowed down where LAND_ALT_LOW is
    "MPC_LAND_ALT2": ("LAND_ALT_LOW", 0.01),
    "MIS_TAKEOFF_ALT": 2.5,
    "NAV_ACC_RAD": ("WPNAV_RADIUS", 0.01),
    "NAV_MC_ALT_RAD": ("WPNAV_RADIUS", 0.01),
    "COM_OF_LOSS_T": ("GUID_TIMEOUT", 1.0),
    "COM_OBL_RC_ACT": 5,
    "COM_DL_LOSS_T": ("FS_GCS_TIMEOUT", 1.0),
    "NAV_DLL_ACT": 0,
    "COM_DISARM_LAND": 0.3,
    "COM_DISARM_PRFLT": ("DISARM_DELAY", 1.0),
}
CHECKSUM = 0x7FFFFF  # of SCR_LD_CHECKSUM; -1 asks for none
SHORTEST_S = 0.1  # of GUID_TIMEOUT
SWING_DAMPING = 0.2  # of its critical one: 2.4 times as far as asked, at the resonance


class Translated:
    """ArduPilot's parameters under the names the loops know."""

    def __init__(self, store: ArduPilotStore) -> None:
        self._store = store

    def __getitem__(self, name: str) -> float:
        found = SETTINGS[name]
        value = self._store[found[0]] * found[1] if isinstance(found, tuple) else found
        return max(value, SHORTEST_S) if name == "COM_OF_LOSS_T" else value

    def listen(self, callback: Callable[[str], None]) -> None:
        """Any of ArduPilot's may be any of the loops'."""

        def heard(name: str) -> None:
            for prefix in ("MPC_", "MC_"):
                callback(prefix)

        self._store.listen(heard)


class Copter(Autopilot):
    """An ArduCopter. Its own mode numbers are `ap_mode`; flying, it does what the modes of `Mode` do."""

    ap_mode = STABILIZE
    id_parameter = "MAV_SYSID"
    scripts_start_s = 0.0  # MAVLink is served during the start, scripts run after it (AP_Vehicle::setup)
    swings_hz = 0.0  # resonance of its position loops in GUIDED; 0 for none
    _way: tuple[float, float, float, float] | None = None  # that it makes itself there: place and speed

    def _fit_out(self) -> None:
        store = ArduPilotStore(self.plant.vehicle)
        self.store: Any = store
        self.settings = Translated(store)
        self.files = Card(store)
        self.own = OwnValues(store)
        mixer = ArduPilotMixer(store, self.rotors)
        self.mixer: Any = mixer
        tuned = tune(mixer, self.plant)
        store.preset("MOT_THST_HOVER", min(max(tuned.hover, 0.125), 0.6875))
        for axis, gains in zip(("RLL", "PIT", "YAW"), tuned.gains, strict=True):
            for letter, gain in zip("PID", gains, strict=True):
                store.preset(f"ATC_RAT_{axis}_{letter}", gain)
        self.scripts = Scripts(self, store, self.files, mixer)
        self.send_raw: Callable[[int, int, bytes], None] = lambda link, number, payload: None
        self._pwm = [1000] * self.rotors

    def boot(self) -> None:
        """Scripts start anew, files and parameters stay."""
        super().boot()
        self.ap_mode = STABILIZE
        self.store.reboot()
        self.own.boot(self.plant.time_s)
        self.mixer.boot()
        self.scripts = Scripts(self, self.store, self.files, self.mixer)
        self._scripts_at_s = self.plant.time_s + self.scripts_start_s
        if not self.scripts_start_s:
            self._start_scripts()

    def _start_scripts(self) -> None:
        self._scripts_at_s = math.inf
        self.scripts.boot()

    def restart_scripts(self) -> None:
        """MAV_CMD_SCRIPTING 3: new scripts, but a matrix once taken stays."""
        self._scripts_at_s = math.inf
        factors = self.mixer.factors
        self.scripts = Scripts(self, self.store, self.files, self.mixer)
        if self.mixer.frame_class == SCRIPTED and factors:
            self.scripts._initialised = len(factors)
        self.scripts.boot()

    # -- what others ask of it -----------------------------------------------------------------

    def prearm(self) -> str:
        """Why it would not arm, or nothing."""
        if self.mixer.mix is None:
            return "PreArm: Motors: Check frame class and type"
        if self.scripts.failed:
            return "PreArm: Scripting: errors, see messages"
        wanted = int(self.store["SCR_LD_CHECKSUM"])
        if wanted != -1 and self.store["SCR_ENABLE"] == 1 and wanted & CHECKSUM != self.scripts.checksum:
            return f"PreArm: Scripting: loaded CRC incorrect want: 0x{self.scripts.checksum:x}"
        motors = len(self.mixer.mix.factors)
        have = {int(self.store[f"SERVO{n}_FUNCTION"]) for n in range(1, 17)}
        missing = [n for n in range(1, motors + 1) if servo_function(n) not in have]
        if missing:
            return f"PreArm: Motors: no SERVOx_FUNCTION set to Motor{missing[0]}"
        return ""

    def arm(self) -> None:
        """Raises Refused."""
        options = int(self.store["AUTO_OPTIONS"])
        if self.ap_mode in NOT_ARMABLE and not (self.ap_mode == AUTO and options & 1) and not self.armed:
            raise Refused(f"Arm: {NOT_ARMABLE[self.ap_mode]} mode not armable")
        reason = self.prearm()
        if reason and not self.armed:
            raise Refused(reason)
        was = self.armed
        super().arm()
        if not was:
            self.own.arm(self.plant.time_s)

    def set_ap_mode(self, number: int) -> None:
        """By ArduCopter's numbers. Raises Refused."""
        if number not in MODES or (number == AUTO and self.armed):  # there is no mission to fly
            raise Refused(f"Mode change to {number} failed")
        self.ap_mode = number
        self._enter({RTL: Mode.RTL, LAND: Mode.LAND}.get(number, Mode.HOLD))

    def test_motor(self, test_number: int, kind: int, value: float, seconds: float) -> bool:
        """Turn the motor at a place of the test order (from 1): percent (kind 0) or microseconds (1)."""
        low, high = self.store["MOT_PWM_MIN"], self.store["MOT_PWM_MAX"]
        builtin = self.mixer.frame_class == 4 and self.rotors == 8
        order = OCTAQUAD_X_ORDER if builtin else tuple(range(self.rotors))
        if self.armed or not self.landed or not 1 <= test_number <= len(order) or kind not in (0, 1):
            return False
        command = value / 100.0 if kind == 0 else (value - low) / max(high - low, 1.0)
        return self.motor_test.turn(order[test_number - 1], command, seconds, self.plant.time_s, 600.0)

    def take_off(self, altitude_m: float) -> None:
        """Only in GUIDED and armed. Raises Refused."""
        if self.ap_mode != GUIDED or not self.armed:
            raise Refused("Takeoff: GUIDED and armed is required")
        super().take_off(altitude_m)

    def offboard(self, goal: Goal | AttitudeGoal) -> None:
        """GUIDED follows what it is told; on the ground that ends a take-off, and waits for the next."""
        if self.ap_mode != GUIDED or not self.armed:
            return
        if self.mode == Mode.TAKEOFF and self.reading.height < FOOT_Z_M + 0.06:
            self.landed = True  # mode_guided.cpp: another submode, which does not leave the ground
            self._enter(Mode.HOLD)
        if self.landed:
            return
        super().offboard(goal)
        if self.mode in (Mode.HOLD, Mode.TAKEOFF):
            self.mode = Mode.OFFBOARD

    def _move_goal(self, position: Three) -> None:
        """In GUIDED by a way of its own, where its position loops swing: asked for a swing of 2 m with 4 s a
        cycle the real one (4.8, stock loops, 20 kg) went 4.8 m."""
        super()._move_goal(position)
        if self.swings_hz == 0.0 or self.mode != Mode.OFFBOARD or math.isnan(self.goal.position[0]):
            self._way = None
            return
        if self._way is None:
            self._way = (*position[:2], 0.0, 0.0)
        w, dt, aim = 2.0 * math.pi * self.swings_hz, 1.0 / RATE_HZ, self.goal
        n, e, vn, ve = self._way
        an = w * w * (aim.position[0] - n) - 2.0 * SWING_DAMPING * w * vn
        ae = w * w * (aim.position[1] - e) - 2.0 * SWING_DAMPING * w * ve
        vn, ve = vn + an * dt, ve + ae * dt
        self._way = n, e, vn, ve = n + vn * dt, e + ve * dt, vn, ve
        self.goal = replace(
            aim,
            position=(n, e, aim.position[2]),
            velocity=(vn, ve, aim.velocity[2]),
            acceleration=(an, ae, aim.acceleration[2]),
        )

    @property
    def offboard_fresh(self) -> bool:
        """A position stays; a speed or an attitude times out."""
        position_held = self.attitude_goal is None and not math.isnan(self._offboard_goal.position[2])
        return position_held or super().offboard_fresh

    @property
    def takes_live(self) -> bool:
        """Only through a script."""
        return False

    @property
    def bridged(self) -> bool:
        """Whether a script drives outputs, so that a companion's answers are worth waiting for."""
        return any(self.scripts.held(n) is not None for n in range(self.rotors))

    def _stop(self, why: str) -> None:
        super()._stop("Disarming motors")

    def _flight_over(self) -> None:
        self.own.disarm(self.plant.time_s)

    def _goes_up(self, position: Three) -> bool:
        return False

    def station_lost(self) -> None:
        """By FS_GCS_ENABLE, and FS_OPTIONS before it."""
        mode = STATION_LOST.get(int(self.store["FS_GCS_ENABLE"]), RTL)
        options, going_on = int(self.store["FS_OPTIONS"]), ""
        if mode is None:
            return
        if options & LANDING and self.mode == Mode.LAND:
            going_on = " - Continuing Landing"
        elif options & IN_AUTO and self.ap_mode == AUTO:
            going_on = " - Continuing Auto Mode"
        elif options & PILOT and self.ap_mode not in AUTOPILOT:
            going_on = " - Continuing Pilot Control"
        self.say(4, f"GCS Failsafe{going_on}")
        if not going_on and self.ap_mode != mode:
            self.set_ap_mode(mode)

    # -- one step ------------------------------------------------------------------------------

    def step(self) -> SensorReading:
        """As any; a flight that landed in LAND or RTL is over."""
        now = self.plant.time_s
        if now >= self._scripts_at_s:
            self._start_scripts()
        self.scripts.step()
        reading = super().step()
        self.own.step(now)
        if self.armed and not self.landed:
            climbing = abs(self.goal.velocity[2]) > SLOWEST_M_S  # NaN: it holds its height
            self.own.hover(self.demand.thrust, reading, climbing, 1.0 / RATE_HZ)
        return reading

    def _outputs(self, d: LoopDemand) -> NDArray[np.float64]:
        low, high = self.store["MOT_PWM_MIN"], self.store["MOT_PWM_MAX"]
        spool = "SHUT_DOWN" if not self.armed else "GROUND_IDLE" if self.landed else "THROTTLE_UNLIMITED"
        motors = self.mixer.pwm(d.roll, d.pitch, d.yaw, d.thrust, spool)
        self._pwm = [int(low)] * self.rotors
        tested = [] if self.armed else self.motor_test.commands(self.plant.time_s).tolist()
        motors = [
            round(low + (high - low) * u) if u else p for u, p in zip(tested, motors, strict=False)
        ] or motors
        for n in range(self.rotors):
            function = int(self.store[f"SERVO{n + 1}_FUNCTION"])
            motor = MOTOR_FUNCTIONS.get(function, 0) - 1
            if 0 <= motor < len(motors):
                self._pwm[n] = motors[motor]
            held = self.scripts.held(n)
            if held is not None:
                self._pwm[n] = held
        return np.clip((np.array(self._pwm, float) - low) / max(high - low, 1.0), 0.0, 1.0)

    @property
    def outputs_us(self) -> list[float]:
        """Pulse width of every output."""
        return [float(p) for p in self._pwm]
