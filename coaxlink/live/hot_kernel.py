# mypy: disallow-untyped-defs=False
"""The live loop's hot path as plain loops over numbers: a datagram in, checks, law, a frame out.

The same functions run in plain Python (on bytearrays and lists, in tests) and compiled (`hot_build`, which
adds the system calls); nothing is written twice. Only what is beyond doubt is answered here: whole unsigned
frames, one clean demand or several, of group 0, in range, newer than the last by less than a second, from the
autopilot, while the law flies alone. Everything else, motor commands of others above all, is left as it came
for the loop in Python (`mixing`), which knows what to do with it and counts it.

Arrays, so that one block of each kind is handed over:
    ints    the places named below; then LEFT triples (start, stop, size of the sender's address + 256 which,
            + WHOLE for one from another address than the vehicle's)
    floats  scale (16), law's units (4), extra wrench (4), speed per command, motors' lag, lag wanted (s)
    motors  (8,) the speeds the motors are taken to have, for the lead
    ring    rows (ROW) of what was answered; stamps (RING) beside it
"""

from __future__ import annotations

from math import exp, isfinite

# ints
FD, SYSTEM, COMPONENT, OWN_SYSTEM, OWN_COMPONENT = 0, 1, 2, 3, 4
LAST_US, QUIET_NS, DEADLINE_NS, UNTIL_NS, COUNT = 5, 6, 7, 8, 9
ANSWERED, LEFT, SUPERSEDED, DROPPED, LAST_NS, PEER = 10, 11, 12, 13, 14, 15
FOREIGN, FOREIGN_NS = 16, 17  # datagrams of other senders that were dropped, and when one is handed on again
PAUSE_NS = (
    18  # so long without a demand, and a flood of others' words does not keep the interpreter from its turn
)
TRIPLES, MOST_LEFT = 19, 16
INTS = TRIPLES + 3 * MOST_LEFT
# floats
SCALE, INVERSE, EXTRA, FACTOR, LAG_S, QUICK_S, FLOATS = 0, 16, 20, 24, 25, 26, 27
# a row of the ring: time (s), demand (4), commands (8), speeds (8), error (4), latency (s)
TIME, HELD, COMMANDS, SPEEDS, ERROR, LATENCY, ROW = 0, 1, 5, 13, 21, 25, 26
RING = 256

MOTORS = 8
DEMAND_ID, DEMAND_SEED, DEMAND_SIZE = 140, 181, 41
ANSWER_ID, ANSWER_SEED, ANSWER_SIZE = 139, 168, 43
JUMP_US = 1_000_000
FAR = 4.0  # of the vehicle's authority, as in ExactLaw
GIVEN_UP = 1e-8
WHOLE = 1 << 16  # in a triple: as it came, whatever is in it
FOREIGN_EVERY_NS = 100_000_000  # a flood from elsewhere must not call the interpreter for every datagram
OTHERS, NOT_ALONE, NOTHING = -3, -2, -1


def checksum(data, start, stop, seed):
    """CRC-16/MCRF4XX of data[start:stop] and the message's seed byte."""
    crc = 0xFFFF
    for at in range(start, stop + 1):
        x = (data[at] if at < stop else seed) ^ (crc & 0xFF)
        x = (x ^ (x << 4)) & 0xFF
        crc = (crc >> 8) ^ (x << 8) ^ (x << 3) ^ (x >> 4)
    return crc & 0xFFFF


def find_demand(data, start, stop, system, component):
    """Where the newest demand of a datagram begins.

    NOTHING when it is made of whole frames and none is a demand, OTHERS when all of them are other systems';
    NOT_ALONE when there is anything in it that is not to be answered without a second look.
    """
    found, at, ours = NOTHING, start, False
    while at < stop:
        if at + 12 > stop or data[at] != 0xFD or data[at + 2]:
            return NOT_ALONE
        size = data[at + 1]
        end = at + 12 + size
        if end > stop:
            return NOT_ALONE
        number = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
        if number == ANSWER_ID:
            return NOT_ALONE
        if number == DEMAND_ID:
            total = data[end - 2] | data[end - 1] << 8
            if (
                data[at + 5] != system
                or data[at + 6] != component
                or checksum(data, at + 1, end - 2, DEMAND_SEED) != total
            ):
                return NOT_ALONE
            found = at
        ours = ours or data[at + 5] == system
        at = end
    return found if ours else OTHERS


def same_sender(peers, at, peer, size):
    """Whether the address at `at` is the vehicle's: family, port, host and scope, not IPv6's flow label."""
    for k in range(size):
        if peers[at + k] != peer[k] and not (4 <= k < 8 if size > 16 else k >= 8):
            return False
    return True


def unpack(data, at, body):
    """Put the payload of the frame at `at` into `body` (DEMAND_SIZE), its cut zeros back in their place."""
    size = data[at + 1]
    for k in range(DEMAND_SIZE):
        body[k] = data[at + 10 + k] if k < size else 0


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


def ask(held, floats, order, mu):
    """The wrench of a demand, less what the effects add, in the law's own units into `mu`."""
    for j in range(4):
        row = SCALE + 4 * order[j]
        total = -floats[EXTRA + order[j]]
        for k in range(4):
            total += floats[row + k] * held[k]
        mu[j] = min(max(total * floats[INVERSE + j], -FAR), FAR)


def lead(speed, motor, dt, lag, quick):
    """The speed to ask for so that a motor of first-order lag `lag` follows `speed` with the lag `quick`.

    `motor` is the speed it is taken to have, dt (s) how long the command will stand: what remains of a
    difference after dt is exp(-dt / lag) with the command left alone, and shall be exp(-dt / quick).
    """
    if lag <= 0.0 or dt <= 0.0:
        return speed
    wanted = 1.0 - exp(-dt / quick) if quick > 0.0 else 1.0
    return motor + (speed - motor) * wanted / (1.0 - exp(-dt / lag))


def follow(motor, told, dt, lag):
    """The speed a motor of lag `lag` has after being told `told` for dt (s)."""
    if lag <= 0.0:
        return told
    return motor + (told - motor) * (1.0 - exp(-dt / lag))


def command(speeds, motors, told, count, dt, floats):
    """Commands of the law's speeds into `told`, which holds the last ones; False when one is no number.

    dt (s) is how long the last ones stood; the motors followed them meanwhile.
    """
    factor, lag, quick = floats[FACTOR], floats[LAG_S], floats[QUICK_S]
    for n in range(count):
        motors[n] = follow(motors[n], told[n] * factor, dt, lag)
    for n in range(count):
        if not 0.0 <= speeds[n] <= 1.0:  # also for NaN
            return False
        if not isfinite(lead(speeds[n], motors[n], dt, lag, quick) / factor):
            return False
    for n in range(count):
        told[n] = min(max(lead(speeds[n], motors[n], dt, lag, quick) / factor, 0.0), 1.0)
    for n in range(count, MOTORS):
        told[n] = 0.0
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
