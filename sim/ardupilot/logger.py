"""ArduPilot's flight log: DataFlash on the card, one file a boot, written while armed (LOG_DISARMED: always).

Messages, fields and rates are a stock ArduCopter's; motors come as RCOU, at 10 Hz only.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from sim.line.logger import Logger
from sim.physics.escs import reported_escs
from sim.px4.cascade import euler

FOLDER = "logs"
SIZES = {
    "Q": "Q",
    "B": "B",
    "f": "f",
    "H": "H",
    "c": "h",
    "C": "H",
    "N": "16s",
    "Z": "64s",
    "I": "I",
    "e": "i",
    "M": "B",
    "n": "4s",
}
PERSISTS_S = 15.0  # it goes on so long after disarming (HAL_LOGGER_ARM_PERSIST)
LOGS_DISARMED = (1, 2, 3)  # 2: but on USB, where nobody is; 3 gives up a log without arming at the next boot
ARMED, DISARMED, LANDED, AIRBORNE = 10, 11, 18, 28


@dataclass(frozen=True)
class Kind:
    """One kind of message: its number, format letters, columns, rows at each writing, Hz."""

    number: int
    form: str
    columns: str
    rows: Callable[[Any, int], list[tuple[Any, ...]]]
    hz: float

    @property
    def layout(self) -> struct.Struct:
        """Of its payload."""
        return struct.Struct("<" + "".join(SIZES[letter] for letter in self.form))


def _degrees(a: Any) -> list[float]:
    return [math.degrees(v) for v in euler(tuple(a.reading.quaternion.tolist()))]


def _imu(a: Any, t: int) -> list[tuple[Any, ...]]:
    r = a.reading
    return [(t, 0, *r.rates.tolist(), *r.accel.tolist(), 0, 0, 35.0, 1, 1, 1000, 1000)]


def _ekf1(a: Any, t: int) -> list[tuple[Any, ...]]:
    r = a.reading
    roll, pitch, yaw = (round(100 * v) for v in _degrees(a))
    p = r.position.tolist()
    speeds = r.velocity.tolist()
    return [(t, 0, roll, pitch, yaw % 36000, *speeds, speeds[2], *p, 0, 0, 0, 0)]


def _att(a: Any, t: int) -> list[tuple[Any, ...]]:
    roll, pitch, yaw = (round(100 * v) for v in _degrees(a))
    return [(t, 0, roll, 0, pitch, 0, yaw % 36000, 3)]


def _outputs(a: Any, t: int) -> list[tuple[Any, ...]]:
    us = [round(v) for v in a.outputs_us][:14]
    return [(t, *us, *[0] * (14 - len(us)))]


def _battery(a: Any, t: int) -> list[tuple[Any, ...]]:
    r = a.reading
    used = max((0.95 - a.plant.charge) * a.plant.battery.capacity_Ah * 1000.0, 0.0)
    return [(t, 0, r.voltage, r.voltage, r.current, used, 0.0, 0, 0.025, round(100 * a.plant.charge))]


def _escs(a: Any, t: int) -> list[tuple[Any, ...]]:
    escs = reported_escs(a)
    if escs is None:
        return []
    every = zip(escs.rpm, escs.volts, escs.amps, strict=True)
    return [(t, k, rpm, rpm, volts, amps, 3000, 0.0, 0, 0.0) for k, (rpm, volts, amps) in enumerate(every)]


KINDS: dict[str, Kind] = {
    "IMU": Kind(
        129, "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz", _imu, 25.0
    ),
    "XKF1": Kind(
        130, "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH", _ekf1, 25.0
    ),
    "XKF2": Kind(131, "QBccc", "TimeUS,C,AX,AY,AZ", lambda a, t: [(t, 0, 0, 0, 0)], 10.0),
    "ATT": Kind(132, "QccccCCB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF", _att, 10.0),
    "RCOU": Kind(133, "Q" + "H" * 14, "TimeUS," + ",".join(f"C{n}" for n in range(1, 15)), _outputs, 10.0),
    "BAT": Kind(
        134, "QBfffffcfB", "TimeUS,Inst,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res,RemPct", _battery, 10.0
    ),
    "RFND": Kind(
        135, "QBfBB", "TimeUS,Instance,Dist,Stat,Orient", lambda a, t: [(t, 0, a.reading.height, 4, 25)], 10.0
    ),
    "ESC": Kind(136, "QBffffcfcf", "TimeUS,Instance,RPM,RawRPM,Volt,Curr,Temp,CTot,MotTemp,Err", _escs, 10.0),
    "RATE": Kind(
        137,
        "Qfffffff",
        "TimeUS,RDes,ROut,PDes,POut,YDes,YOut,AOut",
        lambda a, t: [
            (
                t,
                *(v for k in range(3) for v in (math.degrees(a.demand.rates[k]), a.demand[k])),
                a.demand.thrust,
            )
        ],
        10.0,
    ),
}
FMT, PARM, EV, MSG, MODE = 128, 64, 65, 66, 67
PLAIN = {  # name: (number, format, columns)
    "FMT": (FMT, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "PARM": (PARM, "QNff", "TimeUS,Name,Value,Default"),
    "EV": (EV, "QB", "TimeUS,Id"),
    "MSG": (MSG, "QZ", "TimeUS,Message"),
    "MODE": (MODE, "QMBB", "TimeUS,Mode,ModeNum,Rsn"),
}
HEAD = b"\xa3\x95"


def message(number: int, body: bytes) -> bytes:
    """One DataFlash message."""
    return HEAD + bytes([number]) + body


class DataFlashLogger(Logger):
    """Writes `logs/NNNNNNNN.BIN`, and the number of the last one to LASTLOG.TXT."""

    suffix = ".BIN"

    def __init__(self, autopilot: Any) -> None:
        self._layouts = {name: kind.layout for name, kind in KINDS.items()}
        self._now = 0
        self._boot_log: bytearray | None = None
        self._armed_s = -math.inf
        self._state: tuple[Any, ...] = ()
        super().__init__(autopilot)
        autopilot.files.folders.add(FOLDER)

    def booted(self) -> None:
        """Every boot has a log of its own."""
        self.close()
        self._boot_log, self._armed_s = None, -math.inf

    def wanted(self) -> bool:
        store, now = self.autopilot.store, self.autopilot.plant.time_s
        if self.autopilot.armed:
            self._armed_s = now
        flown = now - self._armed_s < PERSISTS_S
        return bool(int(store["LOG_BACKEND_TYPE"]) & 1 and (flown or store["LOG_DISARMED"] in LOGS_DISARMED))

    def record(self, now_us: int) -> None:
        self._now = now_us
        if self._log is not None and not self.wanted():
            self._log += self._events()  # its disarming is the last that it tells
        if self._log is None and self._boot_log is not None and self.wanted():
            self._log = self._boot_log  # the same boot flies again: the same log
        super().record(now_us)
        self._boot_log = self._log if self._log is not None else self._boot_log

    def path(self) -> str:
        files = self.autopilot.files
        number = int(files.files.get(f"{FOLDER}/LASTLOG.TXT", b"0")) + 1
        files.files[f"{FOLDER}/LASTLOG.TXT"] = f"{number}\n".encode()
        return f"{FOLDER}/{number:08d}.BIN"

    def begin(self) -> bytes:
        self._state = ()
        out = b""
        plain = [(name, *entry) for name, entry in PLAIN.items()]
        kinds = [(name, k.number, k.form, k.columns) for name, k in KINDS.items()]
        for name, number, form, columns in plain + kinds:
            length = 3 + struct.calcsize("<" + "".join(SIZES[letter] for letter in form))
            body = struct.pack("<BB4s16s64s", number, length, name.encode(), form.encode(), columns.encode())
            out += message(FMT, body)
        out += self.text(6, "ArduCopter V4.8.0-dev (stand-in)")
        return out + self.parameters(self.autopilot.store.names)

    def parameters(self, names: list[str]) -> bytes:
        store = self.autopilot.store
        rows = [(name, store[name]) for name in names if name in store]
        return b"".join(
            message(PARM, struct.pack("<Q16sff", self._now, name.encode(), value, value))
            for name, value in rows
        )

    def text(self, severity: int, text: str) -> bytes:
        return message(MSG, struct.pack("<Q64s", self._now, text.encode()))

    def _events(self) -> bytes:
        """Arming, flying and modes, as they change."""
        a, out = self.autopilot, b""
        state = (a.armed, a.landed, a.ap_mode)
        before = self._state or (not a.armed, True, -1)
        self._state = state
        for now, last, on, off in (
            (state[0], before[0], ARMED, DISARMED),
            (state[1], before[1], LANDED, AIRBORNE),
        ):
            if now != last:
                out += message(EV, struct.pack("<QB", self._now, on if now else off))
        if state[2] != before[2]:
            out += message(MODE, struct.pack("<QBBB", self._now, a.ap_mode, a.ap_mode, 1))
        return out

    def rows(self, now_us: int) -> bytes:
        out = self._events()
        for name, kind in KINDS.items():
            if self.due(name, now_us, kind.hz):
                layout = self._layouts[name]
                out += b"".join(
                    message(kind.number, layout.pack(*row)) for row in kind.rows(self.autopilot, now_us)
                )
        return out
