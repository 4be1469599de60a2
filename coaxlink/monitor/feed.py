"""The thread that keeps a session alive and fills the watch: it connects, listens, connects again.

It asks for streams that do not come by themselves, and again for those that stop (an ArduPilot forgets them
when it restarts), and keeps the mixer table as it is on board (`table_reader`).
"""

from __future__ import annotations

import threading
import time

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import InputError, LinkError
from coaxlink.mavlink import Session, connect
from coaxlink.mavlink.address import parse_address
from coaxlink.mavlink.transport import open_transport
from coaxlink.monitor.board.desk import Desk
from coaxlink.monitor.board.table_reader import TableReader
from coaxlink.monitor.telemetry.streams import Streams
from coaxlink.monitor.watch import Watch

# beside another coaxlink session (component 191) the monitor is a companion of its own: no ground station,
# whose heartbeat would hold off the vehicle's data-link failsafe
COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER2
SETTLE_S = 1.2  # how long to listen before asking for what is missing
TABLE_EVERY_S = 3.0  # between looks at the table and at what does not come
GONE_S = 10.0  # silent for so long, a session is made anew: another vehicle may have come


def check_address(url: str) -> None:
    """Raises InputError when `url` is no address, LinkError when its port or device cannot be had."""
    address = parse_address(url)
    if address.kind != "tcp":  # a server that is not up yet is worth waiting for
        open_transport(address, 0.5).close()


class Feed:
    """Runs until `stop`; `failure` is what ended it otherwise."""

    def __init__(self, watch: Watch, *, patience_s: float = 3.0, desk: Desk | None = None) -> None:
        self.watch, self.desk = watch, desk
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
            with connect(
                url, timeout_s=self._patience_s, source_component=COMPONENT, listen_only=True
            ) as session:
                self.watch.wait_for("")
                self._follow(session)
        except LinkError as error:
            silent = error.problem.startswith("no autopilot")
            self.watch.wait_for("" if silent else f"{url} ({error.problem})")
            if self.desk:
                self.desk.work(None)
            self._stopping.wait(0.2 if silent else 1.0)
        except InputError as error:
            # the address was good at the start: a host name that went away, a device pulled out
            self.watch.wait_for(str(error))
            self._stopping.wait(1.0)

    def _follow(self, session: Session) -> None:
        begin(self.watch, session)
        self._pause(session, SETTLE_S)
        streams, table = Streams(self.watch, session), TableReader(self.watch, session)
        while not self._stopping.is_set() and session.silence_s < GONE_S:
            if session.silence_s < 2.0:
                streams.request_missing()
                table.refresh()
            self._pause(session, TABLE_EVERY_S)

    def _pause(self, session: Session, duration_s: float) -> None:
        """Wait while the session's thread receives, and do what the desk has. Raises LinkError when the line
        broke."""
        end = time.monotonic() + duration_s
        while not self._stopping.is_set() and time.monotonic() < end:
            if self.desk:
                self.desk.work(session)
            session.wait((), 0.2)


def begin(watch: Watch, session: Session) -> None:
    """Let the session fill the watch, from what it has heard already on."""
    identity = session.identity
    watch.collector.follow(identity.system, identity.component)
    watch.line = lambda: line_notes(session)
    for name in ("HEARTBEAT", "AUTOPILOT_VERSION"):
        heard = session.latest(name)
        if heard is not None:
            watch.collector.take(heard, time.monotonic(), counted=False)
    session.subscribe(lambda message: watch.collector.take(message, time.monotonic()), whole_system=True)


def line_notes(session: Session) -> list[str]:
    """Who else is on the line, and whether the vehicle's words could be checked."""
    said = session.bound.standing()
    if session.bound.signs and not session.signed:
        said.append("the vehicle signs its messages: they are shown unchecked")
    return said
