"""A lower rotor from a single one: blade elements and annular momentum theory in the contracted wake.

Each annulus balances blade loading against momentum with the upper rotor's wake for an upstream (Leishman and
Ananthan 2006, *Aerodynamic optimization of a coaxial proprotor*, AHS Forum 62; Leishman 2006, *Principles of
Helicopter Aerodynamics*, section 3.4 and 2.15). All in units of the tip speed and the radius R:

    lambda = sqrt((sigma a / 16 - w / 2)^2 + sigma a theta r / 8) - (sigma a / 16 - w / 2)

w is the wake's axial velocity at the lower rotor, 0 outside of it. At a distance z below, a cylinder of
vortices has accelerated it to w = v (1 + z / sqrt(z^2 + R^2)) (McCormick 1967, *Aerodynamics of V/STOL
Flight*, ch. 4). The wake's radius follows from the flow through the upper disc, which must pass the lower
one at the velocity that both rotors give it there: a lower rotor that works hard draws the wake narrow. The
wake's swirl runs against the lower rotor. The profile drag is QPROP's polar, cd = cd0 + cd2 (cl - 0.5)^2
(Drela 2007, QPROP user guide), its cd0 from the single rotor's own torque.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HUB = 0.1  # of the radius: no blade inside
ANNULI = 40  # of the disc
DESIGN_LIFT = 0.5  # cl of least drag: QPROP's example propellers
SOLIDITY = (0.005, 0.6)  # searched: beyond, no propeller
HALVINGS = 40  # of an interval: to rounding
SETTLED = 16  # passes in which the wake's radius finds its place

_EDGE = np.linspace(HUB, 1.0, ANNULI + 1)
_R, _DR = (_EDGE[1:] + _EDGE[:-1]) / 2, np.diff(_EDGE)
_AREA = _R * _DR / np.sum(_R * _DR)


@dataclass(frozen=True)
class Blades:
    """What a data sheet does not print, for S guesses at once; each (S,)."""

    pitch_ratio: Array  # pitch over diameter
    zero_lift_rad: Array  # angle of the blade's zero-lift line above its printed pitch
    lift_slope: Array  # 1/rad
    tip_loss: Array  # induced power over that of the annuli: what finite blades lose
    drag_rise: Array  # cd2
    upwash: Array  # share of the lower rotor's draught that reaches the upper disc, 0..1

    def twist(self) -> Array:
        """(S, N) angle of the zero-lift line at each annulus, rad."""
        return np.arctan(self.pitch_ratio[:, None] / (np.pi * _R)) + self.zero_lift_rad[:, None]


@dataclass(frozen=True)
class Calibrated:
    """Blades whose solidity and drag give one rotor's thrust and torque."""

    blades: Blades
    solidity: Array  # (S,)
    cd0: Array  # (S,)


def calibrated(blades: Blades, thrust: Array, torque: Array) -> Calibrated:
    """Solidity and least drag that give thrust and torque coefficients (S,) of a rotor alone.

    Coefficients over density, disc area and tip speed squared (and radius). No bound is put on what comes
    out: a solidity at the end of SOLIDITY or a drag below 0 says that such blades cannot be.
    """
    low, high = (np.full(len(thrust), s) for s in SOLIDITY)
    none = np.zeros((1, ANNULI))
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        less = _loads(Calibrated(blades, middle, 0 * middle), none, none)[0] < thrust
        low, high = np.where(less, middle, low), np.where(less, high, middle)
    lifting = Calibrated(blades, low, 0 * low)
    left = torque - _loads(lifting, none, none)[1]
    return Calibrated(blades, low, left / (0.5 * low * np.sum(_R**3 * _DR)))


def lower_shares(rotor: Calibrated, spacing: float, ratios: Array) -> tuple[Array, Array]:
    """(S, X) thrust and torque of a lower rotor as shares of what it gives alone at its speed.

    `ratios` (X,): upper over lower speed. `spacing` is z over the diameter.
    """
    none = np.zeros((1, ANNULI))
    thrust, torque, inflow = _loads(rotor, none, none)
    grown = 2 * spacing / np.hypot(1.0, 2 * spacing)  # z / sqrt(z^2 + R^2)
    through = inflow @ _AREA  # (S,) mean velocity of the flow through the upper disc
    shares = [_at(rotor, inflow, through, grown, float(x)) for x in ratios]
    return (
        np.stack([t / thrust for t, _ in shares], axis=1),
        np.stack([q / torque for _, q in shares], axis=1),
    )


def upper_loss(rotor: Calibrated, spacing: float) -> Array:
    """(S,) share of its thrust that an upper rotor loses at equal speeds if the lower one's draught is whole.

    What a cylinder of vortices induces at z above its end: v (1 - z / sqrt(z^2 + R^2)).
    """
    none = np.zeros((1, ANNULI))
    thrust, _, inflow = _loads(rotor, none, none)
    draught = (1 - 2 * spacing / np.hypot(1.0, 2 * spacing)) * 0.7 * (inflow @ _AREA)
    return np.asarray(1 - _loads(rotor, np.repeat(draught[:, None], ANNULI, 1), none)[0] / thrust)


def _at(rotor: Calibrated, inflow: Array, through: Array, grown: float, ratio: float) -> tuple[Array, Array]:
    """(S,) thrust and torque coefficients of the lower rotor at one ratio of the speeds."""
    upper = through * ratio
    draught = rotor.blades.upwash * (1 - grown)
    own = 0.7 * through
    for _ in range(SETTLED):
        with np.errstate(invalid="ignore", divide="ignore"):
            square = (upper + draught * own) / ((1 + grown) * upper + own)
        radius = np.sqrt(np.clip(np.nan_to_num(square, nan=0.25), 0.05, 1.0))[:, None]  # (S, 1)
        inside = np.clip((radius - _EDGE[:-1]) / _DR, 0.0, 1.0)  # (S, N) share of each annulus in the wake
        origin = np.minimum(_R / radius, 1.0)  # of each annulus' flow on the upper disc
        upstream = _interpolated(origin, inflow)
        wash = inside * upstream * (1 + grown) * ratio
        swirl = inside * 2 * upstream**2 / (origin * radius) * ratio  # angular momentum is kept
        thrust, torque, total = _loads(rotor, wash, swirl)
        area = inside * _AREA
        new = np.maximum(np.sum((total - wash) * area, 1) / np.maximum(np.sum(area, 1), 1e-9), 0.0)
        own = 0.5 * (own + new)
    return thrust, torque


def _interpolated(at: Array, values: Array) -> Array:
    """(S, N) values of each row, given on the annuli, at other radii (S, N)."""
    annulus = np.clip((at - _R[0]) / (_R[1] - _R[0]), 0.0, ANNULI - 1.0)
    low = np.minimum(annulus.astype(int), ANNULI - 2)
    share = annulus - low
    rows = np.arange(len(values))[:, None]
    return np.asarray(values[rows, low] * (1 - share) + values[rows, low + 1] * share)


def _loads(rotor: Calibrated, wash: Array, swirl: Array) -> tuple[Array, Array, Array]:
    """(S,) thrust and torque coefficients and (S, N) inflow of a rotor in a wake (S or 1, N)."""
    b, s = rotor.blades, rotor.solidity[:, None]
    slope, twist = b.lift_slope[:, None], b.twist()
    speed = _R + swirl
    k = s * slope * speed / _R / 16
    half = k - wash / 2
    inflow = np.sqrt(np.maximum(half**2 + 2 * k * twist * _R, 0.0)) - half
    lift = slope * (twist - inflow / speed)
    thrust = 0.5 * s * lift * speed**2 * _DR
    drag = rotor.cd0[:, None] + b.drag_rise[:, None] * (lift - DESIGN_LIFT) ** 2
    induced = (wash + b.tip_loss[:, None] * (inflow - wash)) * _R / speed
    torque = induced * thrust + 0.5 * s * drag * speed**2 * _R * _DR
    return thrust.sum(1), torque.sum(1), np.asarray(inflow)
