"""ArduPilot's parameters on board: floats on the wire, integers truncated, tables added by scripts."""

from __future__ import annotations

import math
import struct
import tomllib
from collections.abc import Callable, Mapping
from importlib import resources

from firmware_params.ardupilot.parameters import FLOAT, INT8, INT16, INT32, as_stored, servo_function
from sim.ardupilot.frame import own_frame
from sim.line.store import ParameterStore
from sim.vehicle import SimVehicle

SECTIONS = {"int8": INT8, "int16": INT16, "int32": INT32, "float": FLOAT}
# how a packed parameter file numbers the types, and their layout
PACKED = {INT8: (1, "<b"), INT16: (2, "<h"), INT32: (3, "<i"), FLOAT: (4, "<f")}
MAGIC = 0x671B
SET_INTERNAL = 4  # of BRD_OPTIONS


class ArduPilotStore(ParameterStore):
    """Name -> value; what is written is what the board would keep."""

    def __init__(self, vehicle: SimVehicle) -> None:
        document = tomllib.loads((resources.files("sim.ardupilot") / "parameters.toml").read_text())
        super().__init__()
        for section, kind in SECTIONS.items():
            for name, value in document[section].items():
                self._types[name], self._values[name] = kind, as_stored(name, float(value), kind)
        self._internal = frozenset(document["internal"]["names"])
        self._unsaved: dict[str, float] = {}  # what storage holds where the value at work is another
        self.announce: Callable[[str], None] = lambda name: None  # a value that the firmware saved
        self._script_values: dict[str, float] = {}  # values of script tables, which outlive the script
        self._scripted: list[str] = []
        for n in range(1, vehicle.rotors + 1):
            self.preset(f"SERVO{n}_FUNCTION", float(servo_function(n)))
        for name, value in zip(("FRAME_CLASS", "FRAME_TYPE"), own_frame(vehicle) or (0, 1), strict=True):
            self.preset(name, float(value))
        self._list()

    def _list(self) -> None:
        """Names in order of their indices; while scripting is off, its other parameters are in no list."""
        off = self._values["SCR_ENABLE"] == 0
        hidden = {n for n in self._values if off and n.startswith("SCR_") and n != "SCR_ENABLE"}
        self.names = sorted(self._values.keys() - hidden)

    def preset(self, name: str, value: float) -> None:
        """Set without telling anyone; unknown names are left out."""
        if name in self._values:
            self._values[name] = as_stored(name, value, self._types[name])

    def memory(self) -> dict[str, float]:
        """What a power cut leaves: also the values of scripts that do not run now."""
        return self._script_values | self._values | self._unsaved

    def recall(self, values: Mapping[str, float]) -> None:
        """What was kept over a power cut; names that nobody knows belong to scripts."""
        for name, value in values.items():
            if name in self._values:
                self.preset(name, value)
            else:
                self._script_values[name] = value
        self._list()

    def refuses(self, name: str) -> bool:
        """Whether nobody but the firmware may set it (unless BRD_OPTIONS bit 2 lets them)."""
        return name in self._internal and not int(self._values["BRD_OPTIONS"]) & SET_INTERNAL

    def own(self, name: str, value: float) -> None:
        """The firmware sets and saves a value of its own, if it has it."""
        if name not in self._values:
            return
        stored = as_stored(name, value, self._types[name])
        if stored != self._values[name] or name in self._unsaved:
            self._values[name] = stored
            self._saved(name)

    def live(self, name: str, value: float) -> None:
        """The firmware sets a value without saving it: gone with the next start."""
        if name in self._values:
            self._unsaved.setdefault(name, self._values[name])
            self._values[name] = as_stored(name, value, self._types[name])

    def save(self, name: str) -> None:
        """The firmware saves a value that it set before."""
        if name in self._unsaved:
            self._saved(name)

    def _saved(self, name: str) -> None:
        self._unsaved.pop(name, None)
        self.tell(name)
        self.announce(name)

    def write(self, name: str, value: float) -> bool:
        """Keep a value as its type allows, unchecked; False for an unknown name or what is not finite."""
        if name not in self._values or not math.isfinite(value):
            return False
        stored = as_stored(name, value, self._types[name])
        changed = stored != self._values[name] or self._unsaved.pop(name, stored) != stored
        self._values[name] = stored
        if name in self._scripted:
            self._script_values[name] = stored
        if changed:
            if name == "SCR_ENABLE":
                self._list()
            self.tell(name)
        return True

    def add(self, name: str, default: float) -> bool:
        """A parameter of a script's own; it takes up the value it had before the reboot."""
        if name in self._values and name not in self._scripted:
            return False
        self._types[name] = FLOAT
        self._values[name] = self._script_values.get(name, as_stored(name, default, FLOAT))
        if name not in self._scripted:
            self._scripted.append(name)
        self._list()
        return True

    def reboot(self) -> None:
        """Scripts' tables are gone until their scripts add them again, and what was not saved is."""
        self._values |= self._unsaved
        self._unsaved = {}
        for name in self._scripted:
            self._script_values[name] = self._values.pop(name)
            del self._types[name]
        self._scripted = []
        self._list()

    def packed(self) -> bytes:
        """`@PARAM/param.pck`: names share what they can with the one before."""
        out, last = b"", ""
        for name in self.names:
            common = 0
            while common < min(len(last), len(name) - 1, 15) and last[common] == name[common]:
                common += 1
            kind, form = PACKED[self._types[name]]
            value = self._values[name]
            rest = name[common:]
            number = struct.pack(form, value if kind == 4 else int(value))
            out += bytes([kind, common | (len(rest) - 1) << 4]) + rest.encode() + number
            last = name
        return struct.pack("<HHH", MAGIC, len(self.names), len(self.names)) + out

    def unpack(self, data: bytes) -> bool:
        """Take a packed file that was uploaded (its third word is its length); all of it or nothing."""
        if len(data) < 6:
            return False
        magic, count, length = struct.unpack_from("<HHH", data)
        if magic != MAGIC or length != len(data):
            return False
        found, at, last = {}, 6, ""
        forms = dict(PACKED.values())
        try:
            for _ in range(count):
                while data[at] == 0:
                    at += 1
                form = forms[data[at] & 15]
                common, size = data[at + 1] & 15, (data[at + 1] >> 4) + 1
                last = last[:common] + data[at + 2 : at + 2 + size].decode()
                at += 2 + size
                found[last] = float(struct.unpack_from(form, data, at)[0])
                at += struct.calcsize(form)
        except (KeyError, IndexError, struct.error, UnicodeDecodeError):
            return False
        if not set(found) <= set(self._values):
            return False
        for name, value in found.items():
            if not self.refuses(name):  # passed over without a word
                self.write(name, value)
        return True
