"""Connection addresses, as users of pymavlink, MAVProxy, MAVSDK, mavros and QGC type them.

udpin:0.0.0.0:14550     listen (also udp:HOST:PORT, udp://:PORT, udpin://HOST:PORT, udp://:PORT@)
udpout:127.0.0.1:14540  send first (also udpout://HOST:PORT; udp://:PORT@HOST:PORT sends from its own port)
tcp:127.0.0.1:5760      connect (also tcp://, tcpout:, tcpout://)
tcpin:127.0.0.1:5760    listen (also tcpin://, tcp-l://)
/dev/ttyACM0,57600      serial (also /dev/ttyACM0:57600, serial:/dev/ttyACM0:57600, serial:///dev/ttyACM0:57600)

What means one thing in one of these programs and another in the next is not guessed: the error says which
spellings there are. Sources: pymavlink `mavutil.mavlink_connection`, MAVSDK `cli_arg.cpp` of 2 and 3, mavros
`libmavconn/src/interface.cpp`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from coaxlink.errors import InputError

_KINDS = {
    "udp": "udpin",
    "udpin": "udpin",
    "udpout": "udpout",
    "tcp": "tcp",
    "tcpout": "tcp",
    "tcpin": "tcpin",
    "tcp-l": "tcpin",
}
_UNSPOKEN = {  # schemes of those programs that are no line of ours, and why not
    **dict.fromkeys(("udpbcast", "udp-b", "udp-pb"), "nothing is sent to a whole network"),
    "mcast": "multicast is not read",
    **dict.fromkeys(("ws", "wss", "wsserver", "http", "https"), "web sockets are not spoken"),
    **dict.fromkeys(("uds", "unix"), "Unix sockets are not spoken"),
    **dict.fromkeys(("serial-hwfc", "serial_flowcontrol"), "flow control is left as the device has it"),
}
_EXPECTED = (
    "udpin:0.0.0.0:14550, udpout:127.0.0.1:14540, udp://:14540, tcp:127.0.0.1:5760 or /dev/ttyACM0,57600"
)
DEFAULT_BAUD = 57600
EVERYWHERE = "0.0.0.0"
USUAL_PORTS = {"udp": 14550, "tcp": 5760}
MAVROS_BIND, MAVROS_REMOTE = 14555, 14550  # of udp://BIND@REMOTE where one names no port
_SERIAL = re.compile(r"(/dev/serial/by-\w+/[^,?\s]+?|/[^,:?@;\s]+|COM\d+)(?:[,:](\d{3,8}))?", re.IGNORECASE)
_TTY = re.compile(r"\b(tty(?:ACM|USB|AMA|THS|S|\.usb)\w+|COM\d+|serial\d)\b(?:\W+(\d{4,8}))?", re.IGNORECASE)
_HOST_PORT = re.compile(r"(?:(\[[^\[\]\s]+\]|[^:\[\]/@?,\s]*):)?(\d*)")
_ANY_HOST_PORT = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9][\w.-]*)?[:,](\d{2,5})(?![\d.])")


@dataclass(frozen=True)
class Address:
    """A parsed address; `text` is what the user typed."""

    text: str
    kind: str  # udpin, udpout, tcp, tcpin, serial
    host: str = ""
    port: int = 0
    device: str = ""
    baud: int = 0
    local: tuple[str, int] | None = None  # what udpout sends from, where it is not any port


def parse_address(text: str) -> Address:
    """Parse an address. Raises InputError with the spellings that may be meant."""
    typed = text.strip().strip("'\"")
    scheme, separator, rest = typed.partition(":")
    scheme = scheme.casefold()
    bare, queried, _ = rest.partition("?")
    if queried and scheme in (*_KINDS, "serial"):
        raise _not_so(text, "ids are no part of a connection here", f"{scheme}:{bare.rstrip('/')}")
    if scheme in _UNSPOKEN and separator:
        raise _not_so(text, _UNSPOKEN[scheme], _meant(rest, "udpin" if scheme[0] in "um" else ""))
    if scheme in _KINDS and separator:
        return _network(text, scheme, rest)
    if scheme == "serial" and separator:
        return _serial(text, rest.removeprefix("//"))
    if typed.startswith("/") or re.match(r"COM\d", typed, re.IGNORECASE):
        return _serial(text, typed)
    raise _not_so(text or "`url`", "not a connection", _meant(typed))


def both_ways(host: str, port: int) -> str:
    """The two things that an address of UDP may mean, spelled."""
    return f"udpout:{host}:{port} (sends there) or udpin:0.0.0.0:{port} (listens here)"


def _network(text: str, scheme: str, rest: str) -> Address:
    kind, as_url = _KINDS[scheme], rest.startswith("//")
    pair = rest.removeprefix("//").rstrip("/")
    bind, at, remote = pair.partition("@")
    if at and scheme == "udp":  # of mavros
        local, peer = _pair(text, kind, bind, MAVROS_BIND), _pair(text, kind, remote, MAVROS_REMOTE)
        if not peer[0]:
            return Address(text, "udpin", local[0] or EVERYWHERE, local[1])
        return Address(text, "udpout", *peer, local=(local[0] or EVERYWHERE, local[1]))
    host, port = _pair(text, kind, pair)
    if not host and kind in ("udpout", "tcp"):
        raise _not_so(text, "a host is missing", f"{kind}:127.0.0.1:{port}")
    if kind == "udpout" and host == EVERYWHERE:
        raise _not_so(text, "nobody can be sent to there", f"udpin:{host}:{port}")
    if scheme == "udp" and as_url and host not in ("", EVERYWHERE, "::"):
        raise _not_so(text, "sends in one program and listens in another", both_ways(host, port))
    return Address(text, kind, host or EVERYWHERE, port)


def _pair(text: str, kind: str, pair: str, port: int = 0) -> tuple[str, int]:
    """Host ("" where there is none) and port. Raises InputError."""
    found = _HOST_PORT.fullmatch(pair)
    host, number = (found[1] or "", found[2]) if found else ("", "")
    if found is None and (named := _HOST_PORT.fullmatch(f"{pair}:")):
        host, number = named[1], ""  # a host alone
    elif found is None:
        raise _not_so(text, "HOST:PORT is not to be read from it", _meant(pair, kind))
    port = int(number) if number else port
    if not 1 <= port <= 65535:
        usual = USUAL_PORTS[kind[:3]]
        shown = host or (EVERYWHERE if kind in ("udpin", "tcpin") else "127.0.0.1")
        raise _not_so(text, "a port between 1 and 65535 is missing", f"{kind}:{shown}:{usual}")
    return host.strip("[]"), port


def _serial(text: str, device: str) -> Address:
    found = _SERIAL.fullmatch(device)
    if found is None:
        raise _not_so(text, "DEVICE,BAUD is not to be read from it", _meant(device))
    return Address(text, "serial", device=found[1], baud=int(found[2] or DEFAULT_BAUD))


def _meant(text: str, kind: str = "") -> str:
    """The spellings of ours that somebody may have meant, those of `kind` where that much is known."""
    if tty := _TTY.search(text):
        device = tty[1] if tty[1].upper().startswith("COM") else f"/dev/{tty[1]}"
        return f"{device},{tty[2] or DEFAULT_BAUD}"
    text = text.removeprefix("//")
    if text.startswith("/") and not kind:
        return "/dev/ttyACM0,57600"
    if text.count(":") > 2 and (sixth := re.fullmatch(r"([0-9A-Fa-f:]+):(\d+)", text)):
        text = f"[{sixth[1]}]:{sixth[2]}"
    pair = _ANY_HOST_PORT.search(f":{text}" if text.isdecimal() else text)
    if pair is None:
        return _EXPECTED
    host, port = pair[1] or EVERYWHERE, int(pair[2])
    if kind and kind != "udpin":
        return f"{kind}:{host}:{port}"
    if host == EVERYWHERE:
        return f"udpin:{host}:{port}"
    return both_ways(host, port) if kind else f"tcp:{host}:{port}, {both_ways(host, port)}"


def _not_so(text: str, problem: str, meant: str) -> InputError:
    return InputError(text, "", f"{problem}: {meant} is expected")
