"""What a live mixer did, as one plain object: what `coaxlink mix --json` writes."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from coaxlink.live import arrival as live_arrival

if TYPE_CHECKING:
    from coaxlink.live.mixer import LiveMixer


def account(live: LiveMixer) -> dict[str, Any]:
    """Counters, latency and allocation error so far."""
    started, stopped = live.span_s
    seconds = (stopped or time.monotonic()) - started if started else 0.0
    sync, last_us, stall, witness = live.timesync, live.core.last_us, live.stall, live.witness
    trip = sync.round_trip_s if sync else None
    age = sync.age_s(last_us, live.guard.last) if sync and last_us is not None else None
    arrival = live_arrival.of(live)
    vehicle, extra = live.core.vehicle, live.core.compensation
    done = dict(vehicle.compensated) | dict.fromkeys(extra.names if extra else (), "live, from telemetry")
    left_out = dict(vehicle.left_out) | (dict(extra.left_out) if extra else {})
    return {
        "law": live.core.law.name,
        "state": live.guard.state,
        "why": live.guard.why,
        "dry_run": live.dry_run,
        "round_trip_us": trip * 1e6 if trip is not None else None,
        "demand_age_us": age * 1e6 if age is not None else None,
        "stalls": {"count": stall.count, "longest_s": stall.longest_s},
        "not_believed": live.session.bound.strangers.datagrams,
        "outputs_confirmed": witness.confirmed if witness else None,
        "arrival": arrival.to_json() if arrival else None,
        **live.core.counters.account(seconds),
        "compensated": done,
        "not_compensated": left_out,
    }
