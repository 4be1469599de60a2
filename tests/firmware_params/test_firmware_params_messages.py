"""Messages made of their definition against what pymavlink's own generator makes of their definition."""

import importlib.util
import io

import pytest
from pymavlink.dialects.v20 import common
from pymavlink.generator import mavgen

from firmware_params.ardupilot import messages as ardupilot_messages
from firmware_params.messages import message
from firmware_params.px4 import messages

FIELDS = {
    "ESC_INFO": "uint8_t index/uint64_t time_usec/uint16_t counter/uint8_t count/uint8_t connection_type/"
    "uint8_t info/uint16_t[4] failure_flags/uint32_t[4] error_count/int16_t[4] temperature",
    "ESC_STATUS": "uint8_t index/uint64_t time_usec/int32_t[4] rpm/float[4] voltage/float[4] current",
}
VALUES = {
    "ESC_INFO": (4, 2**40 + 7, 65000, 8, 3, 15, [1, 2, 3, 4], [2**31, 0, 5, 6], [-4000, 3210, 0, 1]),
    "ESC_STATUS": (4, 2**40 + 7, [-5, 4000, 2**30, 0], [16.5, 0.25, 1e9, -1.0], [0.5, 80.0, 3.0, 0.0]),
}


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dialect")
    text = "<mavlink><version>3</version><messages>"
    for number, (name, fields) in zip((290, 291), FIELDS.items(), strict=True):
        text += f'<message id="{number}" name="{name}"><description>d</description>'
        for field in fields.split("/"):
            kind, label = field.split()
            instance = ' instance="true"' if label == "index" else ""
            text += f'<field type="{kind}" name="{label}"{instance}>f</field>'
        text += "</message>"
    (folder / "esc.xml").write_text(f'<?xml version="1.0"?>\n{text}</messages></mavlink>')
    options = mavgen.Opts(str(folder / "esc_dialect.py"), wire_protocol="2.0", language="Python3")
    assert mavgen.mavgen(options, [str(folder / "esc.xml")])
    spec = importlib.util.spec_from_file_location("esc_dialect", folder / "esc_dialect.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


LAYOUT = [
    "id",
    "msgname",
    "fieldnames",
    "ordered_fieldnames",
    "fieldtypes",
    "native_format",
    "orders",
    "lengths",
    "array_lengths",
    "crc_extra",
    "instance_field",
    "instance_offset",
]


def _alike(number, theirs, values):
    """Layout, and frames read by the other side."""
    ours, other = common.mavlink_map[number], theirs.mavlink_map[number]
    assert ours is not other
    for name in LAYOUT:
        assert getattr(ours, name) == getattr(other, name), name
    assert ours.unpacker.format == other.unpacker.format
    for sender, receiver in ((common, theirs), (theirs, common)):
        frame = sender.mavlink_map[number](*values).pack(sender.MAVLink(io.BytesIO(), 1, 1))
        (read,) = receiver.MAVLink(None).parse_buffer(frame)
        assert [getattr(read, name) for name in read.fieldnames] == list(values)
        assert read.get_type() == ours.msgname


def test_esc_info_and_status_are_what_the_generator_makes(generated):
    for number in (messages.ESC_INFO, messages.ESC_STATUS):
        _alike(number, generated, VALUES[common.mavlink_map[number].msgname])


def test_esc_telemetry_is_ardupilotmega_s():
    """pymavlink generates ArduPilot's own dialect; what `common` is taught must read and write the same."""
    from pymavlink.dialects.v20 import ardupilotmega

    values = [30, 31, 0, 255], [2500] * 4, [9, 0, 65535, 1], [0, 1, 2, 3], [2700, 0, 3240, 65535], [7] * 4
    for number in ardupilot_messages.ESC_TELEMETRY:
        _alike(number, ardupilotmega, values)
        units = [d.mavlink_map[number].fieldunits_by_name for d in (common, ardupilotmega)]
        assert units[0] == units[1]


def test_a_message_that_the_dialect_knows_keeps_its_own():
    own = common.mavlink_map[0]
    assert message(0, "HEARTBEAT", "uint8_t type") is not own and common.mavlink_map[0] is own
