# mypy: disallow-untyped-defs=False
"""One demand, from the socket to the motors: datagram in, checks, law, datagram out. Plain numbers and loops.

`lead`, `follow` and `command` run in plain Python too. `exchange` is compiled by `live.compiled`; it answers
what is beyond doubt: a datagram that is one whole unsigned frame, a demand of group 0, in range, newer than
the last by less than a second, from the vehicle's address and ids, and nothing waiting behind it. All else
stays where it is, in the socket, for the loop in Python (`live.mixer`), which judges and counts it. It is
called while the law flies alone (`Guard.steady`), for 0.1 s at most. The books are Python's, after that: an
interpreter woken for every demand finds its caches cold and takes three times as long over them.
"""

from __future__ import annotations

from math import exp, isfinite
from typing import Any

from coaxlink.live.state import MOST_DT_S, MOTORS
from coaxlink.mixer.exact.kernel import optimum
from coaxlink.mixer.exact.law import FAR, GIVEN_UP, STEPS
from coaxlink.mixer.exact.loads import MISS

DEMAND_ID, DEMAND_SEED, DEMAND_SIZE = 140, 181, 41
ANSWER_ID, ANSWER_SEED, ANSWER_SIZE = 139, 168, 43
JUMP_US = 1_000_000
NOTHING, LEFT, ANSWERED = 0, -1, -2  # of `exchange`; above 0: bytes read and handed on

CHUNK = 65536  # the longest datagram
CLOCK, SIZE, SENDER, WORDS = 0, 2, 3, 7  # places in `words`
PEEK, DONT_WAIT, MONOTONIC = 0x02, 0x40, 1  # Linux's

# the C library's, by name; put in by live.compiled
recvfrom: Any = None
sendto: Any = None
clock_gettime: Any = None


def checksum(data, start, stop, seed):
    """CRC-16/MCRF4XX of data[start:stop] and the message's seed byte."""
    crc = 0xFFFF
    for at in range(start, stop + 1):
        x = (data[at] if at < stop else seed) ^ (crc & 0xFF)
        x = (x ^ (x << 4)) & 0xFF
        crc = (crc >> 8) ^ (x << 8) ^ (x << 3) ^ (x >> 4)
    return crc & 0xFFFF


def alone(data, size, system, component):
    """Whether a datagram is just one whole unsigned demand from there, of the size known here or cut."""
    if size < 13 or data[0] != 0xFD or data[1] + 12 != size or data[1] > DEMAND_SIZE or data[2]:
        return False
    if data[5] != system or data[6] != component or data[7] != DEMAND_ID or data[8] or data[9]:
        return False
    return checksum(data, 1, size - 2, DEMAND_SEED) == data[size - 2] | data[size - 1] << 8


def unpack(data, body):
    """Put a frame's payload into `body` (DEMAND_SIZE), its cut zeros back in their place."""
    size = data[1]
    for k in range(DEMAND_SIZE):
        body[k] = data[10 + k] if k < size else 0


def stamp_of(body):
    """Microseconds of a payload; -1 where they are beyond what a clock shows (2^62)."""
    if body[7] >= 64:
        return -1
    stamp = 0
    for k in range(7, -1, -1):
        stamp = stamp << 8 | body[k]
    return stamp


def acceptable(stamp, last_us, group, held):
    """Whether a demand may be answered as it stands."""
    if group != 0 or not 0 < stamp - last_us < JUMP_US:
        return False
    for k in range(3):
        if not -1.0 <= held[k] <= 1.0:  # also for NaN
            return False
    return 0.0 <= held[3] <= 1.0


def lead(speed, motor, dt, lag, quick):
    """The speed to ask for so that a motor of first-order lag `lag` follows `speed` with the lag `quick`.

    `motor` is the speed it is taken to have, dt (s) how long the command will stand: what remains of a
    difference after dt is exp(-dt / lag) with the command left alone, and shall be exp(-dt / quick).
    """
    if lag <= 0.0 or dt <= 0.0:
        return speed
    wanted = 1.0 - exp(-dt / quick) if quick > 0.0 else 1.0
    return motor + (speed - motor) * wanted / (1.0 - exp(-dt / lag))


def follow(motor, commanded, dt, lag):
    """The speed a motor of lag `lag` has after being commanded `commanded` for dt (s)."""
    if lag <= 0.0:
        return commanded
    return motor + (commanded - motor) * (1.0 - exp(-dt / lag))


def command(state, dt, speeds, slots):
    """Commands of the law's speeds into `state.commands`, which holds the last; False if one is no number.

    Motor n's speed is speeds[slots[n]]. dt (s) is how long the last commands stood; the motors followed them
    meanwhile. Whatever the speeds, commands stay finite and in 0..1.
    """
    count, motors, commands, law_speeds = state.count, state.motors, state.commands, state.speeds
    factor, lag, quick = state.factor, state.lag_s, state.quick_s
    for n in range(count):
        motors[n] = follow(motors[n], commands[n] * factor, dt, lag)
    for n in range(count):
        speed = speeds[slots[n]]
        if not 0.0 <= speed <= 1.0:  # also for NaN
            return False
        if not isfinite(lead(speed, motors[n], dt, lag, quick) / factor):
            return False
    for n in range(count):
        speed = speeds[slots[n]]
        law_speeds[n] = speed
        commands[n] = min(max(lead(speed, motors[n], dt, lag, quick) / factor, 0.0), 1.0)
    for n in range(count, MOTORS):
        commands[n] = 0.0
    return True


def pack(out, body, sequence, own_system, own_component, system, component):
    """An answer into `out`: `body` holds stamp and commands as they go on the wire (40 bytes). Its length."""
    for k in range(40):
        out[10 + k] = body[k]
    out[50], out[51], out[52] = 0, system, component
    size = ANSWER_SIZE
    while size > 1 and out[9 + size] == 0:
        size -= 1
    out[0], out[1], out[2], out[3], out[4] = 0xFD, size, 0, 0, sequence
    out[5], out[6], out[7], out[8], out[9] = own_system, own_component, ANSWER_ID, 0, 0
    crc = checksum(out, 1, 10 + size, ANSWER_SEED)
    out[10 + size], out[11 + size] = crc & 0xFF, crc >> 8
    return size + 12


def same_sender(words, state):
    """Whether the datagram is the vehicle's: family, port, host and scope, not IPv6's flow label."""
    mask = 0xFFFFFFFF if state.peer_size > 16 else -1
    other = (words[SENDER] ^ state.peer[0]) & mask
    for k in range(1, 4):
        other |= words[SENDER + k] ^ state.peer[k]
    return other == 0


def nanoseconds(words):
    """Of the monotonic clock, Python's time.monotonic."""
    clock_gettime(MONOTONIC, words[CLOCK:].ctypes)
    return words[CLOCK] * 1_000_000_000 + words[CLOCK + 1]


def look(fd, words, data, size, flags):
    """recvfrom; the sender's address is in `words` then."""
    for k in range(SENDER, WORDS):
        words[k] = 0
    words[SIZE] = 28
    return recvfrom(fd, data.ctypes, size, flags, words[SENDER:].ctypes, words[SIZE:].ctypes)


def solve(state, stamp, law):
    """Commands for the demand held, of that stamp, by the exact law; False when one is no number."""
    c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box, past = law
    for j in range(4):
        axis = state.order[j]
        total = -state.extra[axis]
        for k in range(4):
            total += state.scale[axis, k] * state.held[k]
        mu[j] = min(max(total * state.inverse[j], -FAR), FAR)
    optimum(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box, past, STEPS)
    dt = min((stamp - state.last_us) * 1e-6, MOST_DT_S)
    if not command(state, dt, x, state.slots):
        return False
    state.dt_s, state.given_up = dt, 0
    for j in range(4):
        state.error[state.order[j]] = -sums[MISS + j] / state.inverse[j]
        if abs(sums[MISS + j]) > GIVEN_UP:
            state.given_up = 1
    return True


def exchange(fd, states, words, data, body, singles, out, sequence, log, law):
    """Wait for a datagram (as long as the socket does), answer it if it is one clean demand, and again.

    states (1,) `state.RECORD`; words (WORDS,) int64, data (CHUNK + 8), body (48), out (64) uint8: scratch;
    singles: body as float32; sequence (1,) uint8, the session's own; log (rows,) `state.LOG`, what was
    answered; law: `ExactLaw.arrays`. Returns why it ended, see NOTHING.
    """
    state = states[0]
    state.answers = 0
    while True:
        n = look(fd, words, data, CHUNK, PEEK)
        if n < 0:
            return NOTHING
        came = nanoseconds(words)
        if came > state.deadline_ns or not same_sender(words, state):
            return LEFT
        if not alone(data, n, state.system, state.component):
            return LEFT
        unpack(data, body)
        stamp = stamp_of(body)
        if not acceptable(stamp, state.last_us, body[40], singles[2:]):
            return LEFT
        look(fd, words, data, CHUNK, DONT_WAIT)
        if look(fd, words, data[CHUNK:], 1, PEEK | DONT_WAIT) >= 0:
            return n  # a newer one may wait behind it
        for j in range(4):
            state.held[j] = singles[2 + j]
        if not solve(state, stamp, law):
            return n
        for k in range(MOTORS):
            singles[2 + k] = state.commands[k]
        size = pack(
            out, body, sequence[0], state.own_system, state.own_component, state.system, state.component
        )
        sendto(fd, out.ctypes, size, 0, state.peer.ctypes, state.peer_size)
        sent = nanoseconds(words)
        sequence[0] = (sequence[0] + 1) & 255
        state.last_us = stamp
        row = log[state.answers]
        row.stamp_us, row.came_ns, row.sent_ns, row.given_up = stamp, came, sent, state.given_up
        for j in range(4):
            row.held[j], row.error[j] = state.held[j], state.error[j]
        for k in range(MOTORS):
            row.commands[k] = state.commands[k]
        for k in range(n):
            row.received[k] = data[k]
        for k in range(size):
            row.sent[k] = out[k]
        state.answers += 1
        state.deadline_ns = came + state.quiet_ns
        if state.answers == len(log) or sent >= state.until_ns:
            return ANSWERED
