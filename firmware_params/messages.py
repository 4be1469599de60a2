"""MAVLink messages that pymavlink's `common` dialect does not have, made of their public definition.

What pymavlink's generator writes out for a message follows from its fields: the order on the wire (largest
first), the struct format and the CRC seed (https://mavlink.io/en/guide/serialization.html).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import common
from pymavlink.generator.mavcrc import x25crc

_FORMATS = {
    "uint8_t": "B", "uint16_t": "H", "int16_t": "h", "uint32_t": "I", "int32_t": "i", "float": "f",
    "uint64_t": "Q",
}  # fmt: skip
_FIELD = re.compile(r"(\w+) (\w+)(?:\[(\d+)\])?")


def message(
    number: int,
    name: str,
    fields: str,
    *,
    units: Mapping[str, str] | None = None,
    instance: str | None = None,
) -> Any:
    """A message class, registered in `common`; `fields` as XML has them: "uint8_t index, float rpm[4]".

    `instance` is the field that tells several of one message apart.
    """
    declared = [(kind, field, int(count or 0)) for kind, field, count in _FIELD.findall(fields)]
    size = {kind: struct.calcsize(f"<{form}") for kind, form in _FORMATS.items()}
    wire = sorted(declared, key=lambda row: -size[row[0]])
    names = [field for _, field, _ in declared]
    on_wire = [field for _, field, _ in wire]
    before = on_wire.index(instance) if instance else 0
    crc = x25crc(f"{name} ".encode())
    for kind, field, count in wire:
        crc.accumulate(f"{kind} {field} ".encode() + bytes([count] if count else []))

    def start(self: Any, *values: Any, **named: Any) -> None:
        common.MAVLink_message.__init__(self, number, name)
        self._fieldnames = names
        self._instance_field, self._instance_offset = self.instance_field, self.instance_offset
        for field, value in {**dict(zip(names, values, strict=False)), **named}.items():
            setattr(self, field, value)

    def pack(self: Any, mav: Any, force_mavlink1: bool = False) -> bytes:
        flat: list[Any] = []
        for field in on_wire:
            value = getattr(self, field)
            flat.extend(value) if isinstance(value, list | tuple) else flat.append(value)
        payload = self.unpacker.pack(*flat)
        return bytes(self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1))

    made = type(
        f"MAVLink_{name.lower()}_message",
        (common.MAVLink_message,),
        {
            "id": number, "msgname": name, "name": name,
            "fieldnames": names, "ordered_fieldnames": on_wire, "fieldtypes": [row[0] for row in declared],
            "fielddisplays_by_name": {}, "fieldenums_by_name": {}, "fieldunits_by_name": dict(units or {}),
            "native_format": bytearray("<" + "".join(_FORMATS[kind] for kind, _, _ in wire), "ascii"),
            "orders": [on_wire.index(field) for field in names],
            "lengths": [count or 1 for _, _, count in wire], "array_lengths": [row[2] for row in wire],
            "crc_extra": (crc.crc & 0xFF) ^ (crc.crc >> 8),
            "unpacker": struct.Struct("<" + "".join(f"{n or ''}{_FORMATS[kind]}" for kind, _, n in wire)),
            "instance_field": instance,
            "instance_offset": sum(size[k] * (n or 1) for k, _, n in wire[:before]) if instance else -1,
            "__init__": start, "pack": pack,
        },
    )  # fmt: skip
    common.mavlink_map.setdefault(number, made)  # one that pymavlink knows stays
    return made
