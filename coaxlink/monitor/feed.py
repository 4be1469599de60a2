"""The thread that keeps a session alive and fills the watch: it connects, listens, connects again.

It asks for streams that do not come by themselves, reads the mixer table once, and reads it again when
the vehicle's own parameter hash changes: an upload over another link is seen within a few seconds.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import CoaxlinkError, InputError, LinkError
from coaxlink.link import Session, connect
from coaxlink.link.address import parse_address
from coaxlink.link.parameters import HASH, Parameters
from coaxlink.link.transport import open_transport
from coaxlink.monitor.board import TABLE_NAMES, rotor_names
from coaxlink.monitor.watch import Watch

# beside another coaxlink session (component 191) the monitor is a companion of its own: no ground station,
# whose heartbeat would hold off the vehicle's data-link failsafe
COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER2
STREAMS_HZ = {
    "ESC_STATUS": (291, 10.0),
    "SERVO_OUTPUT_RAW": (mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, 10.0),
    "ATTITUDE": (mavlink.MAVLINK_MSG_ID_ATTITUDE, 10.0),
    "LOCAL_POSITION_NED": (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 5.0),
    "BATTERY_STATUS": (mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 1.0),
}
SETTLE_S = 1.2  # how long to listen before asking for what is missing
TABLE_EVERY_S = 3.0  # between looks at the parameter hash
GONE_S = 10.0  # silent for so long, a session is made anew: another vehicle may have come


def check_address(url: str) -> None:
    """Raises InputError when `url` is no address, LinkError when its port or device cannot be had."""
    address = parse_address(url)
    if address.kind != "tcp":  # a server that is not up yet is worth waiting for
        open_transport(address, 0.5).close()


class Feed:
    """Runs until `stop`; `failure` is what ended it otherwise."""

    def __init__(self, watch: Watch, *, patience_s: float = 3.0) -> None:
        self.watch = watch
        self.failure: BaseException | None = None
        self._patience_s = patience_s
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="coaxlink-monitor", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Ask the thread to end and wait a moment for it; it is a daemon and cannot hold up the exit."""
        self._stopping.set()
        self._thread.join(1.0)

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._once()
        except BaseException as error:
            self.failure = error

    def _once(self) -> None:
        url = self.watch.address
        try:
            with connect(url, timeout_s=self._patience_s, source_component=COMPONENT) as session:
                self.watch.wait_for("")
                self._follow(session)
        except LinkError as error:
            silent = error.problem.startswith("no autopilot")
            self.watch.wait_for("" if silent else f"{url} ({error.problem})")
            self._stopping.wait(0.2 if silent else 1.0)
        except InputError as error:
            # the address was good at the start: a host name that went away, a device pulled out
            self.watch.wait_for(str(error))
            self._stopping.wait(1.0)

    def _follow(self, session: Session) -> None:
        begin(self.watch, session)
        self._pause(session, SETTLE_S)
        request_missing_streams(self.watch, session)
        table = TableReader(self.watch, session)
        while not self._stopping.is_set() and session.silence_s < GONE_S:
            if session.silence_s < 2.0:
                table.refresh()
            self._pause(session, TABLE_EVERY_S)

    def _pause(self, session: Session, duration_s: float) -> None:
        """Wait while the session's thread receives. Raises LinkError when the line broke."""
        end = time.monotonic() + duration_s
        while not self._stopping.is_set() and time.monotonic() < end:
            session.wait((), 0.2)


def begin(watch: Watch, session: Session) -> None:
    """Let the session fill the watch, from what it has heard already on."""
    identity = session.identity
    watch.collector.follow(identity.system, identity.component)
    for name in ("HEARTBEAT", "AUTOPILOT_VERSION"):
        heard = session.latest(name)
        if heard is not None:
            watch.collector.take(heard, time.monotonic(), counted=False)
    session.subscribe(lambda message: watch.collector.take(message, time.monotonic()))


def request_missing_streams(watch: Watch, session: Session) -> None:
    """Ask for what has not come by itself; a vehicle that refuses is left alone."""
    heard = {key.partition("[")[0] for key in watch.collector.readings(time.monotonic()).latest}
    wanted = dict(STREAMS_HZ)
    if session.identity.is_px4 and (session.identity.version or (99,)) < (1, 14):
        # only a legacy mixer's demand can be turned into newtons
        wanted["ACTUATOR_CONTROL_TARGET"] = (mavlink.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET, 10.0)
    for name, (message_id, rate_hz) in wanted.items():
        if name in heard:
            continue
        try:
            session.request_stream(message_id, rate_hz)
        except LinkError:
            return  # nobody acknowledges here: do not keep asking


class TableReader:
    """Reads the mixer table of a PX4 when its parameter hash says that something changed."""

    def __init__(self, watch: Watch, session: Session) -> None:
        self._watch, self._session = watch, session
        self._parameters = Parameters(session)
        self._hash: float | None = None
        self._complete = False

    def refresh(self) -> None:
        """Read again if need be; silence is for another time."""
        if not self._session.identity.is_px4:
            return
        try:
            current = self._read((HASH,)).get(HASH)
            if self._complete and current is not None and current == self._hash:
                return
            table = self._read(TABLE_NAMES)
            count = table.get("CA_ROTOR_COUNT", 0.0)
            rotors = rotor_names(int(count)) if 0 < count <= 16 else ()
            table |= self._read(rotors)
            if (self._session.identity.version or (99,)) < (1, 14):
                self._watch.collector.put_parameters(self._read(("SYS_CTRL_ALLOC",)))
        except CoaxlinkError:
            return
        self._watch.collector.put_parameters(table, replace_prefix="CA_")
        self._complete = len(table) == len(TABLE_NAMES) + len(rotors)
        self._hash = current

    def _read(self, names: Iterable[str]) -> dict[str, float]:
        found = self._parameters.read_many(names, missing_ok=True)
        return {name: float(value.value) for name, value in found.items()}
