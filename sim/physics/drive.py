"""What lies between a command and a rotor's speed: pack, ESC, winding, lag; compiled."""

from __future__ import annotations

import math

from sim.physics.blades import inlined, plain
from sim.physics.layout import (
    CAPACITY,
    CELLS,
    CHARGE,
    COOLING,
    CURRENT,
    EFFICIENCY,
    HEAT_CAPACITY,
    HEAT_LAW,
    HEAT_SHARE,
    LAG,
    LAG_LAW,
    LAG_RATIO,
    MOTOR_KT,
    PACK_LAW,
    RELAXED,
    RESISTANCE,
    TOP_RATE,
    VOLT_LAW,
    VOLT_POWER,
    VOLT_REF,
    VOLT_SHARE,
    VOLTAGE,
    WINDING,
)
from sim.physics.simd import above, below, rising, root, total

COPPER_1_K = 0.00393


@plain
def open_circuit(cells, charge):  # type: ignore[no-untyped-def]
    """Open-circuit voltage (V) of a lithium pack at state of charge 0..1: a slope and a knee at the end."""
    return cells * (3.55 + 0.60 * charge - 0.35 * math.exp(-charge / 0.06))


@plain
def shepherd(cells, charge, current, capacity):  # type: ignore[no-untyped-def]
    """Voltage (V) before its resistance by Shepherd 1965: polarisation grows as the charge goes."""
    spent = 1.0 - charge
    left = max(charge, 0.02)
    drawn = current * 360.0 / capacity  # filtered current, over a tenth of an hour's
    return cells * (3.80 - 0.012 * (spent + 0.1 * drawn) / left + 0.36 * math.exp(-4.0 * spent))


@plain
def supply(state, u, torque, heat, p, h):  # type: ignore[no-untyped-def]
    """Current, charge and voltage `h` seconds on, in place; every winding's heat (K over the air) then."""
    current = torque * (1.0 / p[MOTOR_KT])
    cold = current * current * p[WINDING]
    warm = cold * heat * COPPER_1_K
    heat = heat + (cold + warm) * (h / p[HEAT_CAPACITY]) - heat * (h * p[COOLING])
    volts = max(state[VOLTAGE], 1.0)
    power = max(total(torque * u), 0.0) * p[TOP_RATE] / p[EFFICIENCY]  # cold losses are in the efficiency
    if p[HEAT_SHARE] != 0.0:
        power += total(warm)
    drawn = 1.0 + power / volts
    state[CURRENT] = drawn
    state[CHARGE] = max(state[CHARGE] - drawn * h / p[CAPACITY], 0.0)
    drop = p[RESISTANCE] * drawn
    if p[PACK_LAW] == 0.0:
        rest = open_circuit(p[CELLS], state[CHARGE]) - drop
    elif p[PACK_LAW] == 1.0:  # half at once, the rest by two RC pairs of 3 s and 40 s
        state[RELAXED] += (0.25 * drop - state[RELAXED]) * min(h / 3.0, 1.0)
        state[RELAXED + 1] += (0.25 * drop - state[RELAXED + 1]) * min(h / 40.0, 1.0)
        rest = open_circuit(p[CELLS], state[CHARGE]) - 0.5 * drop - state[RELAXED] - state[RELAXED + 1]
    else:
        state[RELAXED] += (drawn - state[RELAXED]) * min(h / 10.0, 1.0)
        rest = shepherd(p[CELLS], state[CHARGE], state[RELAXED], p[CAPACITY]) - drop
    state[VOLTAGE] += (rest - state[VOLTAGE]) * min(h / 0.02, 1.0)
    return heat


@inlined
def loaded(share, volts, resistance):  # type: ignore[no-untyped-def]
    """Speed over speed at the reference: (1 - r) y + r R y^2 = V, r the resistive share of the voltage."""
    r = below(above(share, 1e-6), 0.9)
    back = 1.0 - r
    return (root(back * back + r * resistance * (4.0 * volts)) - back) / (r * resistance * 2.0)


@plain
def retarget(command, heat, volts, p):  # type: ignore[no-untyped-def]
    """Speeds that commands mean at the supply's voltage and the windings' heat."""
    v, heating = volts / p[VOLT_REF], p[HEAT_SHARE]
    if p[VOLT_LAW] == 0.0:
        target = command * v ** p[VOLT_POWER]
    elif p[VOLT_LAW] == 1.0:  # back-EMF and resistance under this load
        gain = loaded(command * p[VOLT_SHARE], v, command * 0.0 + 1.0)
        target = command * ((gain - 1.0) * p[VOLT_POWER] + 1.0)
    else:
        target = command * (1.0 + p[VOLT_POWER] * (v - 1.0))
    if heating != 0.0:
        if p[HEAT_LAW] == 0.0:  # copper's resistance grows: its share of the voltage with it
            share = heating / max(100.0 * COPPER_1_K - heating, 1e-3)
            target = target * loaded(command * (share / 0.7), 1.0, heat * COPPER_1_K + 1.0)
        else:
            target = target - target * heat * (heating / 100.0)
    return target


@plain
def lag_of(p, h):  # type: ignore[no-untyped-def]
    """Of speeds that follow their targets: (second order?, factors) of half a step and of a step.

    Factors: what is kept of a difference speeding up and slowing down, h / time constant, rates of both.
    """
    up = down = p[LAG]
    second = p[LAG_LAW] == 1.0
    if second:  # two of half the time, one after the other
        up = down = 0.5 * p[LAG]
    elif p[LAG_LAW] == 2.0:  # slower down than up, the mean as it was
        up, down = 2.0 * p[LAG] / (1.0 + p[LAG_RATIO]), 2.0 * p[LAG] * p[LAG_RATIO] / (1.0 + p[LAG_RATIO])
    if up <= 0.0 or down <= 0.0:
        return False, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0
    half = (math.exp(-0.5 * h / up), math.exp(-0.5 * h / down), 0.5 * h / up if second else 0.0)
    full = (math.exp(-h / up), math.exp(-h / down), h / up if second else 0.0)
    return second, half, full, 1.0 / up, 1.0 / down


@inlined
def follow(u, led, target, factors):  # type: ignore[no-untyped-def]
    """Speeds and what they follow, later: the lag's own solution for a constant target."""
    up, down, order = factors
    keep = rising(target - u, up, down)
    return target + (u - target + (led - target) * order) * keep, target + (led - target) * keep


@inlined
def rates(u, led, lag):  # type: ignore[no-untyped-def]
    """Normalised speed per second."""
    _, _, _, up, down = lag
    way = led - u
    return way * rising(way, up, down)
