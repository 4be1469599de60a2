"""Connections as users of other programs type them: understood, or answered with the spelling of ours.

Spellings after: pymavlink mavutil.mavlink_connection, MAVProxy --master, MAVSDK 2 and 3 add_any_connection,
mavros fcu_url (libmavconn), QGC's link settings.
"""

import os
import subprocess
import sys
import time

import pytest
import serial
from case_table import case_table

from coaxlink.errors import InputError, LinkError
from coaxlink.mavlink.address import parse_address
from coaxlink.mavlink.locks import lock, unlock
from coaxlink.mavlink.port_holder import holder_of_line
from coaxlink.mavlink.transport import open_transport

UNDERSTOOD = {
    "pymavlink, MAVProxy": {
        "udpin:0.0.0.0:14550": ("udpin", "0.0.0.0", 14550),
        "udp:127.0.0.1:14550": ("udpin", "127.0.0.1", 14550),
        "udp:0.0.0.0:14552": ("udpin", "0.0.0.0", 14552),
        "udpin:14550": ("udpin", "0.0.0.0", 14550),
        "udpin:localhost:14550": ("udpin", "localhost", 14550),
        "udpout:127.0.0.1:14540": ("udpout", "127.0.0.1", 14540),
        "tcp:127.0.0.1:5760": ("tcp", "127.0.0.1", 5760),
        "tcpin:127.0.0.1:5760": ("tcpin", "127.0.0.1", 5760),
        "/dev/ttyACM0": ("serial", "/dev/ttyACM0", 57600),
        "/dev/ttyACM0,115200": ("serial", "/dev/ttyACM0", 115200),
        "com14,57600": ("serial", "com14", 57600),
    },
    "MAVSDK": {
        "udp://:14540": ("udpin", "0.0.0.0", 14540),
        "udp://0.0.0.0:14540": ("udpin", "0.0.0.0", 14540),
        "udpin://127.0.0.1:14540": ("udpin", "127.0.0.1", 14540),
        "udpin://[::]:14540": ("udpin", "::", 14540),
        "udpout://[::1]:14540": ("udpout", "::1", 14540),
        "tcpout://localhost:5760": ("tcp", "localhost", 5760),
        "tcpin://0.0.0.0:5760": ("tcpin", "0.0.0.0", 5760),
        "serial:///dev/ttyUSB0:921600": ("serial", "/dev/ttyUSB0", 921600),
    },
    "mavros": {
        "/dev/ttyACM0:57600": ("serial", "/dev/ttyACM0", 57600),
        "udp://:14540@": ("udpin", "0.0.0.0", 14540),
        "udp://@": ("udpin", "0.0.0.0", 14555),
        "udp://127.0.0.1:14540@:14557": ("udpin", "127.0.0.1", 14540),
        "udp://:14540@127.0.0.1:14557": ("udpout", "127.0.0.1", 14557),
        "udp://@nexus7": ("udpout", "nexus7", 14550),
        "tcp://localhost:5760/": ("tcp", "localhost", 5760),
        "tcp-l://:5760": ("tcpin", "0.0.0.0", 5760),
    },
    "others": {
        "serial:/dev/ttyUSB0:115200": ("serial", "/dev/ttyUSB0", 115200),
        "/dev/serial/by-id/usb-PX4_FMU_v5.x_0-if00:115200": (
            "serial", "/dev/serial/by-id/usb-PX4_FMU_v5.x_0-if00", 115200,
        ),
        "/dev/serial/by-path/pci-0:2.3:1.0,57600": ("serial", "/dev/serial/by-path/pci-0:2.3:1.0", 57600),
        " UDP:0.0.0.0:14550 ": ("udpin", "0.0.0.0", 14550),
        "'udp://:14540'": ("udpin", "0.0.0.0", 14540),
    },
}  # fmt: skip
ANSWERED = {  # what stands in the answer
    "udp://192.168.2.2:14550": "udpout:192.168.2.2:14550",
    "udp://127.0.0.1:14540": "udpin:0.0.0.0:14540",
    "udp://:192.168.2.2:14550": "udpout:192.168.2.2:14550",
    "udp://": "udpin:0.0.0.0:14550",
    "udp:host": "udpin:host:14550",
    "udp://:14540@10.0.0.2:14557/?ids=1,240": "udp://:14540@10.0.0.2:14557 is",
    "udp-b://:14555@:14550": "udpin:0.0.0.0:14555",
    "udpbcast:192.168.1.255:14550": "udpout:192.168.1.255:14550",
    "udpout:0.0.0.0:14550": "udpin:0.0.0.0:14550",
    "udpout::14550": "udpout:127.0.0.1:14550",
    "udpout://10.0.0.2": "udpout:10.0.0.2:14550",
    "udpin:0.0.0.0:0": "udpin:0.0.0.0:14550",
    "upd://:14540": "udpin:0.0.0.0:14540",
    "mcast:": "udpin:0.0.0.0:14550",
    "tcp://": "tcp:127.0.0.1:5760",
    "tcp://localhost": "tcp:localhost:5760",
    "tcp:5760": "tcp:127.0.0.1:5760",
    "tcp:host,5760": "tcp:host:5760",
    "tcp:a:99999": "tcp:a:5760",
    "tcp-l://": "tcpin:0.0.0.0:5760",
    "127.0.0.1:5760": "tcp:127.0.0.1:5760",
    "192.168.4.1:14550": "udpin:0.0.0.0:14550",
    ":14550": "udpin:0.0.0.0:14550",
    "14550": "udpin:0.0.0.0:14550",
    "--master=udp:127.0.0.1:14551": "udpin:0.0.0.0:14551",
    "--master=/dev/ttyACM0,115200": "/dev/ttyACM0,115200",
    "ttyACM0": "/dev/ttyACM0,57600",
    "serial://ttyUSB0:921600": "/dev/ttyUSB0,921600",
    "serial:///dev/ttyUSB0:57600?ids=1,1": "serial:///dev/ttyUSB0:57600 is",
    "serial-hwfc:///dev/ttyUSB0:57600": "/dev/ttyUSB0,57600",
    "serial_flowcontrol:///dev/ttyS0:4000000": "/dev/ttyS0,4000000",
    "/dev/ttyACM0 115200": "/dev/ttyACM0,115200",
    "/dev/x,fast": "/dev/ttyACM0,57600",
    "ws://localhost:8080": "tcp:localhost:8080",
    "http://a:80": "tcp:a:80",
    "": "udpin:0.0.0.0:14550",
    "nonsense": "udpin:0.0.0.0:14550",
}


def test_what_other_programs_write_is_understood():
    with case_table() as case:
        for tool, spellings in UNDERSTOOD.items():
            for text, meant in spellings.items():
                with case(f"{tool}: {text}"):
                    a = parse_address(text)
                    found = (a.kind, a.device, a.baud) if a.kind == "serial" else (a.kind, a.host, a.port)
                    assert found == meant
    assert parse_address("udp://:14556@hil-host:14551").local == ("0.0.0.0", 14556)


def test_what_may_mean_two_things_or_none_is_answered_with_the_spelling():
    with case_table() as case:
        for text, meant in ANSWERED.items():
            with case(text), pytest.raises(InputError, match="is expected") as caught:
                parse_address(text)
            with case(f"{text}: {meant}"):
                assert meant in str(caught.value).removeprefix(text) and "\n" not in str(caught.value)


def test_listening_on_an_address_of_another_machine_is_no_lost_link():
    with pytest.raises(InputError, match=r"no address of this machine: udpout:192\.0\.2\.1:14550"):
        open_transport(parse_address("udp:192.0.2.1:14550"), 0.1)


@pytest.mark.skipif(os.name == "nt", reason="Windows itself refuses a second one")
def test_who_holds_a_serial_line_is_named(tmp_path):
    line = tmp_path / "ttyACM0"
    line.touch()
    hold = "import sys; held = open(sys.argv[1], 'rb'); print(flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", hold, str(line), "evil\x1b[2J", "a\nb\r", "x" * 500]
    with line.open("rb"):  # our own is no other's
        assert holder_of_line(str(line)) == ""
        other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        try:
            other.stdout.readline()
            named = holder_of_line(str(line))
        finally:
            other.communicate()
    assert named.startswith(f"process {other.pid} ({sys.executable} -c import sys")
    assert named.isprintable() and named.endswith("...)") and len(named) < 160
    assert holder_of_line(str(line)) == "" == holder_of_line(str(tmp_path / "none"))


def test_what_is_no_serial_line_is_said(tmp_path):
    (tmp_path / "file").touch()
    cases = {str(tmp_path / "file"): "not a serial line", str(tmp_path / "none"): "cannot be opened"}
    for device, reported in cases.items():
        with pytest.raises(LinkError, match=reported) as caught:
            open_transport(parse_address(f"{device},57600"), 0.1)
        assert "\n" not in str(caught.value)


def test_what_windows_says_of_a_port_is_one_line(monkeypatch):
    """In the words of pyserial's serialwin32.py, `could not open port {!r}: {!r}` of ctypes.WinError()."""
    cases = {
        "FileNotFoundError(2, 'The system cannot find the file specified.', None, 2)":
            "COM3,57600: cannot be opened (The system cannot find the file specified.)",
        "PermissionError(13, 'Access is denied.', None, 5)":
            "COM3,57600: the line is in use by another program, or not yours to open",
    }  # fmt: skip
    for raised, reported in cases.items():

        def refuse(*_, raised=raised, **__):
            raise serial.SerialException(f"could not open port 'COM3': {raised}")

        monkeypatch.setattr(serial, "Serial", refuse)
        with pytest.raises(LinkError) as caught:
            open_transport(parse_address("COM3,57600"), 0.1)
        assert str(caught.value) == reported


@pytest.mark.skipif(os.name == "nt", reason="no pseudo terminals there")
def test_a_serial_line_reads_what_is_there_and_is_nobody_elses():
    import pty

    far, near = pty.openpty()
    address = parse_address(f"{os.ttyname(near)},57600")
    line = open_transport(address, 0.1)
    try:
        assert line.read(0.01)[0] == b"" == line.read(0.0)[0]
        os.write(far, bytes(range(256)))  # no byte is a terminal's to change
        time.sleep(0.05)
        assert line.read(0.5)[0] == bytes(range(256))
        line.write(b"\r\n\x03\x04")
        assert os.read(far, 64) == b"\r\n\x03\x04"
        with pytest.raises(LinkError, match="in use"):
            open_transport(address, 0.1)
        os.close(far)
        with pytest.raises(LinkError, match="the line is gone"):
            line.read(0.5)
    finally:
        line.close()
        os.close(near)


def test_a_shared_lock_is_let_go_of_before_it_is_taken_alone(tmp_path):
    def opened():
        return os.open(tmp_path / "x.lock", os.O_RDWR | os.O_CREAT)

    first, second = opened(), opened()
    lock(first, shared=True)
    lock(second, shared=True)
    unlock(first)
    with pytest.raises(BlockingIOError):
        lock(first, wait=False)
    os.close(second)
    lock(first, wait=False)
    os.close(first)
