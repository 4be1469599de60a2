"""The thread that keeps a session alive and fills what is heard: it connects, listens, connects again.

It asks for streams that do not come by themselves, or too slowly, and again for those that stop (an
ArduPilot forgets them when it restarts), and keeps the mixer table as it is on board (`table_reader`).
Nothing is written.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import InputError, LinkError
from coaxlink.live.health_watch import JUDGED_HZ
from coaxlink.mavlink import Session, connect
from coaxlink.mavlink.address import parse_address
from coaxlink.mavlink.clock import SYSTEM, Clock
from coaxlink.mavlink.station import hear_words, unheard
from coaxlink.mavlink.transport import open_transport
from coaxlink.monitor.incoming.heard import Heard
from coaxlink.monitor.incoming.table_reader import TableReader

# beside another coaxlink session (component 191) the monitor is a companion of its own
COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER2
SETTLE_S = 1.2  # how long to listen before asking for what is missing
REFRESH_S = 3.0  # between looks at the table and at what does not come
ENOUGH = 0.5  # of the rate that was asked for: a stream that comes more slowly is requested again
GONE_S = 10.0  # silent for so long, a session is made anew: another vehicle may have come
TRIES = 3  # of a stream that was promised and does not come: there is none, or the line is too slow
_COMMON = {
    "SERVO_OUTPUT_RAW": (mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, JUDGED_HZ),
    "LOCAL_POSITION_NED": (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 5.0),
    "BATTERY_STATUS": (mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 1.0),
    "SYS_STATUS": (mavlink.MAVLINK_MSG_ID_SYS_STATUS, 1.0),
    "EXTENDED_SYS_STATE": (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 1.0),
}
# an autopilot is asked only for what it knows: ArduPilot answers a request for ESC_STATUS with a text to
# every ground station; its ESC_TELEMETRY_* come all together for the first one
_PX4 = {
    "HIGHRES_IMU": (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, JUDGED_HZ),
    "ATTITUDE": (mavlink.MAVLINK_MSG_ID_ATTITUDE, 10.0),
    "ESC_STATUS": (291, 10.0),
}
_ARDUPILOT = {
    "ATTITUDE": (mavlink.MAVLINK_MSG_ID_ATTITUDE, JUDGED_HZ),
    "RAW_IMU": (mavlink.MAVLINK_MSG_ID_RAW_IMU, JUDGED_HZ),
    "ESC_TELEMETRY_1_TO_4": (11030, 10.0),
}
# only a legacy mixer's demand can be turned into newtons
_LEGACY = {"ACTUATOR_CONTROL_TARGET": (mavlink.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET, 10.0)}


def check_address(url: str) -> None:
    """Raises InputError when `url` is no address, LinkError when its port or device cannot be had."""
    address = parse_address(url)
    if address.kind != "tcp":  # a server that is not up yet is worth waiting for
        open_transport(address, 0.5).close()


def connect_to(url: str, patience_s: float, system: int | None = None) -> Session:
    """A session as the monitor's own companion. Raises LinkError, InputError, SafetyRefusal."""
    return connect(
        url, timeout_s=patience_s, target_system=system, source_component=COMPONENT, listen_only=True
    )


def begin(heard: Heard, session: Session) -> None:
    """Let the session fill `heard`, from what it has heard already on."""
    identity = session.identity
    heard.follow(identity.system, identity.component)
    heard.waiting = ""
    heard.line = lambda: line_notes(session)
    heard.unheard = lambda: unheard(session)
    for name in ("HEARTBEAT", "AUTOPILOT_VERSION"):
        message = session.latest(name)
        if message is not None:
            heard.take(message, counted=False)
    session.subscribe(heard.take, whole_system=True)


def line_notes(session: Session) -> list[str]:
    """Who else is on the line, and whether the vehicle's words could be checked."""
    reported = session.bound.standing()
    if others := session.autopilots.beside(session.identity.system):
        reported.append(f"shown is system {session.identity.system}; also on the line: {', '.join(others)}")
    if session.bound.signs and not session.signed:
        reported.append("the vehicle signs its messages: they are shown unchecked")
    return reported


class Streams:
    """Asks one vehicle for the messages the screen lives on; what it refuses is not requested again."""

    def __init__(self, heard: Heard, session: Session) -> None:
        self._heard, self._session = heard, session
        identity = session.identity
        self._wanted = _COMMON | (_PX4 if identity.is_px4 else _ARDUPILOT)
        if identity.is_px4 and (identity.version or (99,)) < (1, 14):
            self._wanted |= _LEGACY
        self._left = dict.fromkeys(self._wanted, TRIES)
        self._came: Counter[str] = Counter()
        self._since_s = heard.now()
        session.subscribe(lambda message: self._came.update([message.get_type()]))

    def request_missing(self) -> None:
        """Ask for what did not come since the last time, or more slowly than it should."""
        now = self._heard.now()
        came, self._came, span = self._came, Counter(), now - self._since_s
        self._since_s = now
        for name, (message_id, rate_hz) in self._wanted.items():
            if came[name] >= max(ENOUGH * rate_hz * span, 1.0):
                self._left[name] = TRIES
            elif self._left[name]:
                self._left[name] -= 1
                try:
                    if not self._session.request_stream(message_id, rate_hz):
                        self._left[name] = 0
                except LinkError:
                    return  # nobody acknowledges here: do not keep asking


class LinkThread:
    """Runs until `stop`; `failure` is what ended it otherwise."""

    def __init__(
        self,
        heard: Heard,
        url: str,
        *,
        patience_s: float = 3.0,
        clock: Clock = SYSTEM,
        open_session: Callable[[str, float], Session] = connect_to,
    ) -> None:
        self.heard, self.url = heard, url
        self.failure: BaseException | None = None
        self._patience_s, self._clock, self._open = patience_s, clock, open_session
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self.run, name="coaxlink-monitor", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Ask the thread to end and wait a moment for it; it is a daemon and cannot hold up the exit."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(1.0)

    def run(self) -> None:
        """What the thread does."""
        try:
            while not self._stopping.is_set():
                self._once()
        except BaseException as error:
            self.failure = error

    def _once(self) -> None:
        try:
            with self._open(self.url, self._patience_s) as session:
                self._follow(session)
        except LinkError as error:
            silent = error.problem.startswith("no autopilot")
            self.heard.waiting = "" if silent else f"{self.url} ({error.problem})"
            self._clock.wait(self._stopping, 0.2 if silent else 1.0)
        except InputError as error:
            # the address was good at the start: a host name that went away, a device pulled out
            self.heard.waiting = str(error)
            self._clock.wait(self._stopping, 1.0)

    def _follow(self, session: Session) -> None:
        begin(self.heard, session)
        self._listen(session, SETTLE_S)
        hear_words(session)
        streams, table = Streams(self.heard, session), TableReader(self.heard, session)
        while not self._stopping.is_set() and session.silence_s < GONE_S:
            if session.silence_s < 2.0:
                streams.request_missing()
                table.refresh()
            self._listen(session, REFRESH_S)

    def _listen(self, session: Session, duration_s: float) -> None:
        """Wait while the session's thread receives. Raises LinkError when the line broke."""
        end = self._clock.monotonic() + duration_s
        while not self._stopping.is_set() and self._clock.monotonic() < end:
            session.wait((), 0.2)
