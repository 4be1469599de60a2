# mypy: disallow-untyped-defs=False
"""The live loop itself, compiled: receive, answer, and again, until something comes that Python has to see.

Source for `hot_build` alone: `recvfrom`, `sendto` and `clock_gettime` are the C library's, called by
address; in plain Python this does not run. What an answer waits for is here; accounts are kept in the ring
and read by `hot.HotLoop` when this returns, at the latest after UNTIL_NS.
"""

from __future__ import annotations

from typing import Any

from coaxlink.live.hot_kernel import (
    ANSWERED,
    COMMANDS,
    COUNT,
    DEADLINE_NS,
    DEMAND_ID,
    DROPPED,
    ERROR,
    FD,
    FOREIGN,
    FOREIGN_EVERY_NS,
    FOREIGN_NS,
    GIVEN_UP,
    HELD,
    INVERSE,
    LAST_NS,
    LAST_US,
    LATENCY,
    LEFT,
    MOST_LEFT,
    MOTORS,
    NOT_ALONE,
    NOTHING,
    OTHERS,
    OWN_COMPONENT,
    OWN_SYSTEM,
    PAUSE_NS,
    PEER,
    QUIET_NS,
    RING,
    SPEEDS,
    SUPERSEDED,
    SYSTEM,
    TIME,
    TRIPLES,
    UNTIL_NS,
    WHOLE,
    acceptable,
    ask,
    command,
    find_demand,
    pack,
    same_sender,
    stamp_of,
    unpack,
)
from coaxlink.live.hot_kernel import COMPONENT as VEHICLE_COMPONENT
from coaxlink.mixer.exact.kernel import optimum
from coaxlink.mixer.exact.loads import MISS

CHUNK = 65536  # the longest datagram; `data` holds two
PEER_SIZE = 32  # of a sender's address
SLOT = 64  # bytes a frame has in `frames`; the last one is its length
DONT_WAIT = 0x40  # Linux's MSG_DONTWAIT
MONOTONIC = 1  # Linux's CLOCK_MONOTONIC
STEPS = 6  # as ExactLaw
FIRST_DT_S, MOST_DT_S = 0.004, 0.05  # between answers, for the lead

# the C library's, put in by hot_build
recvfrom: Any = None
sendto: Any = None
clock_gettime: Any = None


def nanoseconds(clock, clock_at):
    """Of the monotonic clock, Python's time.monotonic."""
    clock_gettime(MONOTONIC, clock_at)
    return clock[0] * 1_000_000_000 + clock[1]


def receive(ints, data, data_at, lengths, lengths_at, peers, peers_at, peer, clock, clock_at):
    """Take in what waits, or wait for the first. Returns (datagrams, frame to answer or below 0, time).

    From other senders than the vehicle one now and then is handed on, whole; the others are only counted.
    What the vehicle's line brings of other systems alone is nobody's here.
    """
    got = at = flags = 0
    found, now, came = NOTHING, 0, 0
    turn = min(ints[DEADLINE_NS] - ints[QUIET_NS] + ints[PAUSE_NS], ints[UNTIL_NS])
    while got < MOST_LEFT and at <= CHUNK:
        lengths[got] = 28
        n = recvfrom(ints[FD], data_at + at, CHUNK, flags, peers_at + PEER_SIZE * got, lengths_at + 4 * got)
        if n <= 0:
            break
        foreign = not same_sender(peers, PEER_SIZE * got, peer, ints[PEER])
        if foreign or got == 0:
            came = nanoseconds(clock, clock_at)
            if foreign and came < ints[FOREIGN_NS]:
                if n > 9 and data[at] == 0xFD and data[at + 5] == ints[SYSTEM]:
                    ints[FOREIGN] += 1
                if came >= turn:
                    break
                continue
            if got == 0:
                now = came
        seen = NOTHING
        if not foreign:
            seen = find_demand(data, at, at + n, ints[SYSTEM], ints[VEHICLE_COMPONENT])
            if seen == OTHERS:
                if came >= turn:
                    break
                continue
        place = TRIPLES + 3 * got
        ints[place], ints[place + 1], ints[place + 2] = at, at + n, lengths[got] + 256 * got
        got += 1
        if foreign:
            ints[place + 2] += WHOLE
            ints[FOREIGN_NS] = came + FOREIGN_EVERY_NS
            at += n
            flags = DONT_WAIT
            continue
        if seen == NOT_ALONE:
            return got, seen, now
        if seen >= 0:
            found = seen
        at += n
        flags = DONT_WAIT
    return got, found, now


def cut_demands(ints, data, got):
    """Take the demands out of the datagrams; returns how many datagrams have anything left."""
    left, demands = 0, 0
    for k in range(got):
        place = TRIPLES + 3 * k
        start, stop, whose = ints[place], ints[place + 1], ints[place + 2]
        to = at = stop if whose >= WHOLE else start
        while at < stop:
            size = data[at + 1] + 12
            if data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16 == DEMAND_ID:
                demands += 1
            else:
                for i in range(size):
                    data[to + i] = data[at + i]
                to += size
            at += size
        if to > start:
            place = TRIPLES + 3 * left
            ints[place], ints[place + 1], ints[place + 2] = start, to, whose
            left += 1
    ints[SUPERSEDED] += demands - 1
    return left


def serve(
    ints, floats, motors, ring, stamps, frames, data, body, singles, out, held, told, speeds, order, slots,
    lengths, clock, sequence, peers, peer, c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box,
    past, data_at, lengths_at, peers_at, clock_at, out_at, peer_at,
):  # fmt: skip
    """See the module. Returns how many answers were sent; what is left to Python is in `ints`."""
    count = ints[COUNT]
    ints[ANSWERED] = ints[LEFT] = ints[SUPERSEDED] = ints[DROPPED] = ints[FOREIGN] = 0
    while True:
        got, found, now = receive(
            ints, data, data_at, lengths, lengths_at, peers, peers_at, peer, clock, clock_at
        )
        if found < 0 or now > ints[DEADLINE_NS]:
            ints[LEFT] = got
            break
        unpack(data, found, body)
        stamp = stamp_of(body)
        for k in range(4):
            held[k] = singles[k]
        if not acceptable(stamp, ints[LAST_US], body[40], held):
            ints[LEFT] = got
            break
        ask(held, floats, order, mu)
        optimum(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box, past, STEPS)
        for n in range(count):
            speeds[n] = x[slots[n]]
        dt = FIRST_DT_S
        if ints[LAST_NS] > 0:
            dt = min((stamp - ints[LAST_US]) * 1e-6, MOST_DT_S)
        if not command(speeds, motors, told, count, dt, floats):
            ints[LEFT] = got
            break
        for n in range(MOTORS):
            singles[n] = told[n]
        size = pack(
            out, body, sequence[0], ints[OWN_SYSTEM], ints[OWN_COMPONENT], ints[SYSTEM],
            ints[VEHICLE_COMPONENT],
        )  # fmt: skip
        sendto(ints[FD], out_at, size, 0, peer_at, ints[PEER])
        sent = nanoseconds(clock, clock_at)
        sequence[0] = (sequence[0] + 1) & 255
        ints[LAST_US], ints[LAST_NS] = stamp, now
        ints[DEADLINE_NS] = now + ints[QUIET_NS]
        answered = ints[ANSWERED]
        row, frame = ring[answered], frames[answered]
        stamps[answered] = stamp
        row[TIME], row[LATENCY] = now * 1e-9, (sent - now) * 1e-9
        lost = 0
        for k in range(4):
            row[HELD + k] = held[k]
            row[ERROR + order[k]] = -sums[MISS + k] / floats[INVERSE + k]
            if abs(sums[MISS + k]) > GIVEN_UP:
                lost = 1
        ints[DROPPED] += lost
        for n in range(MOTORS):
            row[COMMANDS + n] = told[n]
            row[SPEEDS + n] = speeds[n] if n < count else 0.0
        long = data[found + 1] + 12
        for k in range(long):
            frame[k] = data[found + k]
        for k in range(size):
            frame[SLOT + k] = out[k]
        frame[SLOT - 1], frame[2 * SLOT - 1] = long, size
        ints[ANSWERED] = answered + 1
        left = cut_demands(ints, data, got)
        if left > 0 or answered + 1 == RING or sent >= ints[UNTIL_NS]:
            ints[LEFT] = left
            break
    return ints[ANSWERED]
