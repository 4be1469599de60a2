"""ArduPilot's packed parameter file, `@PARAM/param.pck`: all parameters in a few kilobytes, read by MAVFTP.

Header: magic, parameters in the file, parameters in all (uint16 each; on upload the third is the file's
length). Then one entry a parameter: type and flags (4 bits each), length of the name's start that the last
entry shares and length of the rest minus one (4 bits each), the rest of the name, the value. Zero bytes
between entries are padding.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

from firmware_params.ardupilot.parameters import FLOAT, INT8, INT16, INT32
from firmware_params.errors import TableError
from firmware_params.plain import is_parameter_name

PATH = "@PARAM/param.pck"
MAGIC, MAGIC_DEFAULTS = 0x671B, 0x671C
_TYPES = {1: (INT8, "<b"), 2: (INT16, "<h"), 3: (INT32, "<i"), 4: (FLOAT, "<f")}
_CODES = {kind: (code, form) for code, (kind, form) in _TYPES.items()}


def unpack(data: bytes) -> dict[str, tuple[float, int]]:
    """{name: (value, MAV_PARAM_TYPE)} of a whole file. Raises TableError when it is none or was cut."""
    if len(data) < 6:
        raise TableError("a packed parameter file has at least 6 bytes")
    magic, count, _ = struct.unpack_from("<HHH", data)
    if magic not in (MAGIC, MAGIC_DEFAULTS):
        raise TableError(f"not a packed parameter file (magic {magic:04x})")
    found: dict[str, tuple[float, int]] = {}
    at, name = 6, b""
    while at < len(data) and len(found) < count:
        if data[at] == 0:
            at += 1
            continue
        kind, flags = data[at] & 15, data[at] >> 4
        if kind not in _TYPES or at + 1 >= len(data):
            raise TableError(f"byte {at} of the packed parameters is no entry")
        shared, rest = data[at + 1] & 15, (data[at + 1] >> 4) + 1
        name = name[:shared] + data[at + 2 : at + 2 + rest]
        at += 2 + rest
        mav_type, form = _TYPES[kind]
        size = struct.calcsize(form)
        if at + size > len(data):
            raise TableError("the packed parameters were cut")
        text = name.decode("ascii", "replace")
        if not is_parameter_name(text):
            raise TableError(f"byte {at} of the packed parameters: '{text}' is no name of a parameter")
        found[text] = (float(struct.unpack_from(form, data, at)[0]), mav_type)
        at += size * (2 if flags & 1 else 1)  # a default follows
    if len(found) != count:
        raise TableError(f"{count} packed parameters are expected, found {len(found)}")
    return found


def pack(params: Mapping[str, tuple[float, int]]) -> bytes:
    """A file to upload: {name: (value, MAV_PARAM_TYPE)}, names in order."""
    body, last = b"", b""
    for name, (value, kind) in sorted(params.items()):
        code, form = _CODES[kind]
        text = name.encode("ascii")
        shared = 0
        while shared < min(len(text) - 1, len(last), 15) and text[shared] == last[shared]:
            shared += 1
        rest = text[shared:]
        number = value if kind == FLOAT else int(value)
        body += bytes([code, shared | (len(rest) - 1) << 4]) + rest + struct.pack(form, number)
        last = text
    return struct.pack("<HHH", MAGIC, len(params), len(body) + 6) + body
