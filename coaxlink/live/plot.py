"""What the live loop does, as messages a ground station plots: NAMED_VALUE_FLOAT and DEBUG_FLOAT_ARRAY.

NAMED_VALUE_FLOAT: cx_split (lower share of the pairs' thrust), cx_err_N, cx_err_Nm (largest axis), cx_lat_us
(p50), cx_state (index into live_guard.STATES). DEBUG_FLOAT_ARRAY "coaxlink": thrust of each rotor (N), from
place 8 the allocation error (N, 3 N m), then p50 and p99 of the latency (us).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.live.guard import STATES
from coaxlink.live.mixer_core import CONTROLS

if TYPE_CHECKING:
    from coaxlink.live.forward import Forwarder
    from coaxlink.live.mixer import LiveMixer

ARRAY_ID = 191
FLOATS = 58


class Plotter:
    """`send` as often as the plots should move."""

    def __init__(self, live: LiveMixer, forwarder: Forwarder | None = None) -> None:
        self._live, self._forwarder = live, forwarder

    def messages(self) -> list[Any]:
        """What `send` sends, stamped with the last demand's time."""
        live, core = self._live, self._live.core
        thrust = core.rotors.loads(core.speeds)[: core.count]
        lower, total = (sum(thrust[pair[k]] for pair in core.rotors.pairs) for k in (1, 0))
        total += lower
        error = core.error
        p50, p99 = (core.counters.latency.percentile(p) * 1e6 for p in (50, 99))
        stamp_us = core.last_us or 0
        values = {
            "cx_split": lower / total if total > 0 else 0.0,
            "cx_err_N": error[0],
            "cx_err_Nm": max(map(abs, error[1:])),
            "cx_lat_us": p50,
            "cx_state": float(STATES.index(live.state)),
        }
        stamp_ms = stamp_us // 1000 % 2**32
        array = [*thrust, *[0.0] * (CONTROLS - core.count), *error, p50, p99]
        array += [0.0] * (FLOATS - len(array))
        return [
            *(mavlink.MAVLink_named_value_float_message(stamp_ms, k.encode(), v) for k, v in values.items()),
            mavlink.MAVLink_debug_float_array_message(stamp_us, b"coaxlink", ARRAY_ID, array),
        ]

    def send(self) -> None:
        """Send all: to the vehicle, which may pass them on, and to the ground station on our own port."""
        for message in self.messages():
            self._live.session.send(message)
            if self._forwarder is not None:
                self._forwarder.send(message)
