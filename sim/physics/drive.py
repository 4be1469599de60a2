# mypy: disallow-untyped-defs=False
"""What lies between a command and a rotor's speed: pack, ESC, winding, lag; compiled."""

from __future__ import annotations

import math

from sim.physics import layout as at
from sim.physics.compile_cache import inlined
from sim.physics.forces import looked_up

COPPER_1_K = 0.00393


@inlined
def open_circuit(cells, charge):
    """Open-circuit voltage (V) of a lithium pack at state of charge 0..1: a slope and a knee at the end."""
    return cells * (3.55 + 0.60 * charge - 0.35 * math.exp(-charge / 0.06))


@inlined
def shepherd(cells, charge, current, capacity):
    """Voltage (V) before its resistance by Shepherd 1965: polarisation grows as the charge goes."""
    spent = 1.0 - charge
    left = max(charge, 0.02)
    drawn = current * 360.0 / capacity  # filtered current, over a tenth of an hour's
    return cells * (3.80 - 0.012 * (spent + 0.1 * drawn) / left + 0.36 * math.exp(-4.0 * spent))


@inlined
def supply(state, w, p, geo, h, pairs, poly):
    """Current, charge, voltage and every winding's heat (K over the air) `h` seconds on, in place."""
    power = lost = 0.0
    for i in range(w.shape[1]):
        torque, heat = w[at.W_TORQUE, i], w[at.W_HEAT, i]
        power += torque * w[at.W_U, i]
        current = torque / p[at.MOTOR_KT]
        cold = current * current * p[at.WINDING]
        warm = cold * heat * COPPER_1_K
        lost += warm
        w[at.W_HEAT, i] = heat + (cold + warm) * (h / p[at.HEAT_CAPACITY]) - heat * (h * p[at.COOLING])
    power = max(power, 0.0) * p[at.TOP_RATE] / p[at.EFFICIENCY]  # cold losses are in the efficiency
    if poly.shape[2] == at.TABLES:
        power = tabled_power(w, p, geo, pairs, poly)
    if p[at.HEAT_SHARE] != 0.0:
        power += lost
    drawn = 1.0 + power / max(state[at.VOLTAGE], 1.0)
    state[at.CURRENT] = drawn
    state[at.CHARGE] = max(state[at.CHARGE] - drawn * h / p[at.CAPACITY], 0.0)
    drop = p[at.RESISTANCE] * drawn
    slow, slower = at.RELAXED, at.RELAXED + 1
    if p[at.PACK_LAW] == 0.0:
        rest = open_circuit(p[at.CELLS], state[at.CHARGE]) - drop
    elif p[at.PACK_LAW] == 1.0:  # half at once, the rest by two RC pairs of 3 s and 40 s
        state[slow] += (0.25 * drop - state[slow]) * min(h / 3.0, 1.0)
        state[slower] += (0.25 * drop - state[slower]) * min(h / 40.0, 1.0)
        rest = open_circuit(p[at.CELLS], state[at.CHARGE]) - 0.5 * drop - state[slow] - state[slower]
    else:
        state[slow] += (drawn - state[slow]) * min(h / 10.0, 1.0)
        rest = shepherd(p[at.CELLS], state[at.CHARGE], state[slow], p[at.CAPACITY]) - drop
    state[at.VOLTAGE] += (rest - state[at.VOLTAGE]) * min(h / 0.02, 1.0)


@inlined
def loaded_speed(share, volts, resistance):
    """Speed over speed at the reference: (1 - r) y + r R y^2 = V, r the resistive share of the voltage."""
    r = min(max(share, 1e-6), 0.9)
    back = 1.0 - r
    return (math.sqrt(back * back + r * resistance * (4.0 * volts)) - back) / (r * resistance * 2.0)


@inlined
def meant(command, heat, volts, p):
    """The speed that a command means at the supply's voltage and the winding's heat."""
    v, heating = volts / p[at.VOLT_REF], p[at.HEAT_SHARE]
    if p[at.VOLT_LAW] == 0.0:
        target = command * v ** p[at.VOLT_POWER]
    elif p[at.VOLT_LAW] == 1.0:  # back-EMF and resistance under this load
        gain = loaded_speed(command * p[at.VOLT_SHARE], v, 1.0)
        target = command * ((gain - 1.0) * p[at.VOLT_POWER] + 1.0)
    else:
        target = command * (1.0 + p[at.VOLT_POWER] * (v - 1.0))
    if heating == 0.0:
        return target
    if p[at.HEAT_LAW] != 0.0:
        return target - target * heat * (heating / 100.0)
    share = heating / max(100.0 * COPPER_1_K - heating, 1e-3)  # copper's resistance grows: its share with it
    return target * loaded_speed(command * (share / 0.7), 1.0, heat * COPPER_1_K + 1.0)


@inlined
def turned(command, volts, geo, p, w, second, pairs, tables):
    """Set what speeds follow by the tables of both commands of a pair (`tabled_pair`)."""
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        above = meant(command[i], w[at.W_HEAT, i], volts, p)
        below = meant(command[j], w[at.W_HEAT, j], volts, p) if j >= 0 else 0.0
        upper, lower = looked_up(tables, 4, above, below)
        w[at.W_TARGET, i] = upper * geo[at.G_SPEED, i]
        w[at.W_LED, i] = w[at.W_LED, i] if second else w[at.W_TARGET, i]
        if j >= 0:
            w[at.W_TARGET, j] = lower * geo[at.G_SPEED, j]
            w[at.W_LED, j] = w[at.W_LED, j] if second else w[at.W_TARGET, j]


@inlined
def tabled_power(w, p, geo, pairs, tables):
    """Watts that all rotors draw by the tables; like torque by what is left of each, and this air."""
    total = 0.0
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        upper, lower = looked_up(tables, 6, w[at.W_U, i], w[at.W_U, j] if j >= 0 else 0.0)
        total += upper * geo[at.G_TORQUE, i] + (lower * geo[at.G_TORQUE, j] if j >= 0 else 0.0)
    return total * p[at.AIR]


@inlined
def retarget(command, volts, geo, p, w, second):
    """Set what speeds follow by the pack and the windings as they are."""
    for i in range(len(command)):
        w[at.W_TARGET, i] = meant(command[i] * geo[at.G_SPEED, i], w[at.W_HEAT, i], volts, p)
        w[at.W_LED, i] = w[at.W_LED, i] if second else w[at.W_TARGET, i]


@inlined
def lag_of(p):
    """Time constants speeding up and slowing down (s); whether the lag is of second order."""
    if p[at.LAG_LAW] == 1.0:  # two of half the time, one after the other
        return 0.5 * p[at.LAG], 0.5 * p[at.LAG], True
    if p[at.LAG_LAW] == 2.0:  # slower down than up, the mean as it was
        up = 2.0 * p[at.LAG] / (1.0 + p[at.LAG_RATIO])
        return up, up * p[at.LAG_RATIO], False
    return p[at.LAG], p[at.LAG], False


@inlined
def kept(lag, h):
    """What is left after h of a difference speeding up and slowing down, and h over a second-order's pole."""
    up, down, second = lag
    if up <= 0.0 or down <= 0.0:
        return 0.0, 0.0, 0.0
    return math.exp(-h / up), math.exp(-h / down), h / up if second else 0.0


@inlined
def follow(w, factors):
    """Speeds and what they follow, later: the lag's own solution for a constant target."""
    up, down, order = factors
    for i in range(w.shape[1]):
        u, led, target = w[at.W_U0, i], w[at.W_LED0, i], w[at.W_TARGET, i]
        keep = up if target > u else down
        w[at.W_U, i] = target + (u - target + (led - target) * order) * keep
        w[at.W_LED, i] = target + (led - target) * keep
