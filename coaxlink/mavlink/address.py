"""Connection addresses, as pymavlink and MAVSDK users type them.

udpin:0.0.0.0:14550     listen (also udp:HOST:PORT, udp://:PORT, udpin://HOST:PORT)
udpout:127.0.0.1:14540  send first (also udpout://HOST:PORT)
tcp:127.0.0.1:5760      connect (also tcp://, tcpout:, tcpout://)
tcpin:127.0.0.1:5760    listen (also tcpin://)
/dev/ttyACM0,57600      serial (also serial:/dev/ttyACM0:57600, serial:///dev/ttyACM0:57600)
"""

from __future__ import annotations

from dataclasses import dataclass

from coaxlink.errors import InputError

_KINDS = {
    "udp": "udpin",
    "udpin": "udpin",
    "udpout": "udpout",
    "tcp": "tcp",
    "tcpout": "tcp",
    "tcpin": "tcpin",
}
_EXPECTED = (
    "udpin:0.0.0.0:14550, udpout:127.0.0.1:14540, udp://:14540, tcp:127.0.0.1:5760 or /dev/ttyACM0,57600"
)
DEFAULT_BAUD = 57600


@dataclass(frozen=True)
class Address:
    """A parsed address; `text` is what the user typed."""

    text: str
    kind: str  # udpin, udpout, tcp, tcpin, serial
    host: str = ""
    port: int = 0
    device: str = ""
    baud: int = 0


def parse_address(text: str) -> Address:
    """Parse an address. Raises InputError naming what is expected."""
    scheme, separator, rest = text.partition(":")
    if scheme in _KINDS and separator:
        return _network(text, _KINDS[scheme], rest.removeprefix("//"))
    if scheme == "serial" and separator:
        device, _, baud = rest.removeprefix("//").rpartition(":")
        return _serial(text, device or baud, baud if device else "")
    if "," in text or text.startswith(("/", "COM")):
        device, _, baud = text.partition(",")
        return _serial(text, device, baud)
    raise InputError(text or "`url`", "", f"not a connection: {_EXPECTED} is expected")


def _network(text: str, kind: str, host_port: str) -> Address:
    host, separator, port = host_port.rpartition(":")
    if not separator:
        host, port = ("", host_port) if host_port.isdigit() else (host_port, "")
    listens = kind in ("udpin", "tcpin")
    if not port.isdigit() or not 1 <= int(port) <= 65535:
        raise InputError(text, "", f"a port between 1 and 65535 is expected: {_EXPECTED}")
    if not host and not listens:
        raise InputError(text, "", "a host is expected before the port")
    return Address(text, kind, host.strip("[]") or "0.0.0.0", int(port))


def _serial(text: str, device: str, baud: str) -> Address:
    if not device or (baud and not baud.isdigit()):
        raise InputError(text, "", "DEVICE,BAUD is expected, such as /dev/ttyACM0,57600")
    return Address(text, "serial", device=device, baud=int(baud) if baud else DEFAULT_BAUD)
