"""PX4's parameters on board: int32 or float32, kept as PX4 keeps them, and the hash it announces."""

from __future__ import annotations

import math
import struct
import tomllib
import zlib
from collections.abc import Iterable, Mapping
from importlib import resources

from firmware_params.px4.parameters import FLOAT, INT32, PARAMETERS
from sim.line.store import ParameterStore
from sim.vehicle import SimVehicle

HASH_CHECK = "_HASH_CHECK"


class Px4Store(ParameterStore):
    """int32 and float32."""

    def __init__(self, version: tuple[int, int, int], vehicle: SimVehicle) -> None:
        document = tomllib.loads((resources.files("sim.px4") / "parameters.toml").read_text())
        super().__init__()
        for name, value in document["int"].items():
            self._add(name, INT32, value)
        for name, value in document["float"].items():
            self._add(name, FLOAT, value)
        for name, known in PARAMETERS.items():
            self._add(name, known.type, known.default)
        for n in range(1, 13):
            self._add(f"PWM_MAIN_FUNC{n}", INT32, 100 + n if n <= vehicle.rotors else 0)
        if version >= (1, 14, 0):
            self._drop(["SYS_CTRL_ALLOC"])
        else:
            self._drop([name for name in self._values if _rotor_of(name) >= 8])
        self.names = sorted(self._values)  # their places are their indices on the wire
        self._geometry(vehicle)

    def _geometry(self, vehicle: SimVehicle) -> None:
        """As its builder set it up in QGC: places and spin, PX4's own CT and KM for every rotor."""
        self.preset("CA_ROTOR_COUNT", vehicle.rotors)
        for n in range(vehicle.rotors):
            for k, axis in enumerate("XYZ"):
                self.preset(f"CA_ROTOR{n}_P{axis}", float(vehicle.position_m[n, k]))
                self.preset(f"CA_ROTOR{n}_A{axis}", float(vehicle.axis[n, k]))
            self.preset(f"CA_ROTOR{n}_KM", 0.05 * float(vehicle.spin[n]))

    def _add(self, name: str, kind: int, value: float) -> None:
        self._types[name] = kind
        self._values[name] = int(value) if kind == INT32 else single(float(value))

    def _drop(self, names: Iterable[str]) -> None:
        for name in list(names):
            del self._types[name], self._values[name]

    def built_in(self, values: Mapping[str, float]) -> None:
        """Parameters (float32) of a module that is in this firmware, where they are not there yet."""
        for name, value in values.items():
            if name not in self._values:
                self._add(name, FLOAT, value)
        self.names = sorted(self._values)

    def preset(self, name: str, value: float) -> None:
        """Set without telling anyone; unknown names are left out."""
        if name in self._values:
            self._add(name, self._types[name], value)

    def recall(self, values: Mapping[str, float]) -> None:
        """What was kept over a power cut."""
        for name, value in values.items():
            self.preset(name, value)
        for name in self.names:
            self.tell(name)

    def wire(self, name: str) -> float:
        """The value as the float field carries it: an int32 goes by its bytes."""
        value = self._values[name]
        if self._types[name] == INT32:
            return float(struct.unpack("<f", struct.pack("<i", int(value)))[0])
        return float(value)

    def write(self, name: str, kind: int, field: float) -> bool | None:
        """Take a PARAM_SET; True if the value changed, False if it was the same, None if it is not taken.

        Nothing but the name, the type and finiteness is checked: PX4 takes values out of range.
        """
        if self._types.get(name) != kind:
            return None
        if kind == INT32:
            value: int | float = struct.unpack("<i", struct.pack("<f", field))[0]
        elif math.isfinite(field):
            value = single(field)
        else:
            return None
        if value == self._values[name]:
            return False
        self._values[name] = value
        self.tell(name)
        return True

    def own(self, name: str, value: float) -> None:
        """The firmware sets a value of its own."""
        self.preset(name, value)
        self.tell(name)

    def hash(self) -> int:
        """CRC32 (no inversion) over names and value bytes, in order."""
        crc = 0
        for name in self.names:
            form = "<i" if self._types[name] == INT32 else "<f"
            data = name.encode() + struct.pack(form, self._values[name])
            crc = zlib.crc32(data, crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF
        return crc


def single(value: float) -> float:
    """`value` as a float32 keeps it."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def _rotor_of(name: str) -> int:
    head = name.removeprefix("CA_ROTOR").partition("_")[0]
    return int(head) if head.isdecimal() else -1
