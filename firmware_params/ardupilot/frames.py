"""ArduCopter's own frames: where each motor sits, which way it turns, which one is on top.

From AP_MotorsMatrix.cpp (setup_quad_matrix ... setup_deca_matrix; 4.6 and master of 2026): angle from the
nose, clockwise, in degrees; yaw factor +1 for counter-clockwise; the place in the order of the motor test. On
top or below as its comments, the frame pictures of ArduPilot's documentation and, for Betaflight's order,
Betaflight's own mixer (UNDER_REAR_R ...) say; where none does, the layer is "". The test then tells: it turns
the upper motor of an arm before the lower one in every frame whose layers are known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

QUAD, HEXA, OCTA, OCTAQUAD, Y6, DODECAHEXA, DECA = 1, 2, 3, 4, 5, 12, 14
TOP, BOTTOM, UNSTATED = "upper", "lower", ""
_CCW, _CW = 1.0, -1.0
CO_ROTATING = 0.9  # AP_MOTORS_FRAME_OCTAQUAD_COROTATING_SCALE_FACTOR: all factors of the upper layer
# FRAME_CLASS that no matrix of rotors stands behind, and what such a vehicle is
OTHER_CLASSES = {
    6: "a helicopter",
    7: "a tricopter: three rotors, and a servo that tilts the tail",
    8: "a single copter: one rotor, and four flaps that steer",
    9: "a CoaxCopter: two rotors on one axis, and four flaps that steer",
    10: "a bicopter or tailsitter: two rotors that tilt",
    11: "a helicopter with two rotors",
    13: "a heli-quad: four rotors of variable pitch",
    16: "a vehicle that thrusts along all axes, its factors in a script",
}
FRAME_NAMES = {
    QUAD: "quadcopter", HEXA: "hexacopter", OCTA: "octocopter", OCTAQUAD: "X8", Y6: "Y6",
    DODECAHEXA: "coaxial hexacopter", DECA: "decacopter",
}  # fmt: skip


@dataclass(frozen=True)
class Motor:
    """One motor of a frame."""

    angle_deg: float  # from the nose, clockwise
    yaw: float  # yaw factor; > 0 for a counter-clockwise rotor
    layer: str  # TOP, BOTTOM or UNSAID
    raw: tuple[float, float] | None = None  # roll and pitch factor where the source states these
    test_place: int = 0  # in the order of MAV_CMD_DO_MOTOR_TEST, from 1
    scale: float = 1.0  # of all its factors

    @property
    def factors(self) -> tuple[float, float, float, float]:
        """Roll, pitch, yaw and throttle before ArduPilot scales them."""
        angle = math.radians(self.angle_deg)
        roll, pitch = self.raw or (math.cos(angle + math.pi / 2), math.cos(angle))
        return self.scale * roll, self.scale * pitch, self.scale * self.yaw, self.scale

    @property
    def place(self) -> tuple[float, float]:
        """Forward and right, on the unit circle."""
        angle = math.radians(self.angle_deg)
        x, y = (0.0 if abs(share) < 1e-12 else share for share in (math.cos(angle), math.sin(angle)))
        return x, y


Frame = tuple[Motor, ...]


def _ring(
    angles: tuple[float, ...], spins: str, order: tuple[int, ...], layers: tuple[str, ...] = ()
) -> Frame:
    """Motors 1, 2, ... on a circle; `spins` has "+" for counter-clockwise."""
    layers = layers or (TOP, BOTTOM) * (len(angles) // 2)
    yaws = [_CCW if spin == "+" else _CW for spin in spins]
    rows = zip(angles, yaws, layers, order, strict=True)
    return tuple(Motor(a, y, layer, None, n) for a, y, layer, n in rows)


def _single(angles: tuple[float, ...], spins: str, order: tuple[int, ...]) -> Frame:
    """As `_ring`, no motor above another."""
    return _ring(angles, spins, order, (UNSTATED,) * len(angles))


def _y6(rows: tuple[tuple[int, float, str, int], ...], front: float, rear: float) -> Frame:
    """Arms at 60, 180 and -60 degrees; the factors are stated as numbers, not by these angles."""
    raw = {60: (-1.0, front), 180: (0.0, rear), -60: (1.0, front)}
    return tuple(Motor(float(angle), yaw, layer, raw[angle], n) for angle, yaw, layer, n in rows)


def _v(frame: Frame) -> Frame:
    """V frames yaw less by their front motors."""
    return tuple(replace(m, yaw=m.yaw * (0.7981 if abs(m.angle_deg) < 90 else 1.0)) for m in frame)


def _scaled(frame: Frame) -> Frame:
    """The upper layer of a co-rotating frame is scaled, against beats between the layers."""
    return tuple(replace(m, scale=CO_ROTATING if m.layer == TOP else 1.0) for m in frame)


_FOUR = (TOP,) * 4 + (BOTTOM,) * 4
_OLD = (1, 7, 5, 3, 8, 2, 4, 6)
_BETAFLIGHT = (3, 1, 5, 7, 4, 2, 6, 8)
_TURN_4, _TURN_8, _TURN_12 = (tuple(range(1, n + 1)) for n in (4, 8, 12))
_X, _PLUS = (45, -45, -135, 135, -45, 45, 135, -135), (0, -90, 180, 90, -90, 0, 90, 180)
_CW_X = (45, 45, 135, 135, -135, -135, -45, -45)
_BF_X = (135, 45, -135, -45, 135, 45, -135, -45)
_HEXA_CW, _OCTA_CW = (30, 90, 150, -150, -90, -30), (22.5, 67.5, 112.5, 157.5, -157.5, -112.5, -67.5, -22.5)
_OCTA_X = (22.5, -157.5, 67.5, 157.5, -22.5, -112.5, -67.5, 112.5)
_Y6A = _y6(
    (
        (60, _CCW, UNSTATED, 2),
        (-60, _CW, UNSTATED, 5),
        (-60, _CCW, UNSTATED, 6),
        (180, _CW, UNSTATED, 4),
        (60, _CW, UNSTATED, 1),
        (180, _CCW, UNSTATED, 3),
    ),
    0.666,
    -1.333,
)

FRAMES: dict[tuple[int, int], Frame] = {  # (FRAME_CLASS, FRAME_TYPE): motors 1, 2, ...
    (QUAD, 0): _single((90, -90, 0, 180), "++--", (2, 4, 1, 3)),
    (QUAD, 1): _single((45, -135, -45, 135), "++--", (1, 3, 4, 2)),
    (QUAD, 2): _v(_single((45, -135, -45, 135), "++--", (1, 3, 4, 2))),
    (QUAD, 3): _single((45, -135, -45, 135), "--++", (1, 3, 4, 2)),
    (QUAD, 6): _single((90, -90, 0, 180), "--++", (2, 4, 1, 3)),
    (QUAD, 12): _single((135, 45, -135, -45), "-++-", (2, 1, 3, 4)),
    (QUAD, 13): _single((45, -45, -135, 135), "+-+-", (1, 4, 3, 2)),
    (QUAD, 14): _single((45, 135, -135, -45), "+-+-", _TURN_4),
    (QUAD, 18): _single((135, 45, -135, -45), "+--+", (2, 1, 3, 4)),
    (QUAD, 19): (
        Motor(45, _CCW, UNSTATED, (-1.0, 1.0), 1),
        Motor(180, _CW, UNSTATED, (0.0, -1.0), 2),
        Motor(180, _CCW, UNSTATED, (0.0, -1.0), 3),
        Motor(-45, _CW, UNSTATED, (1.0, 1.0), 4),
    ),
    (HEXA, 0): _single((0, 180, -120, 60, -60, 120), "-+-++-", (1, 4, 5, 2, 6, 3)),
    (HEXA, 1): _single((90, -90, -30, 150, 30, -150), "-+-++-", (2, 5, 6, 3, 1, 4)),
    (HEXA, 13): _single((30, -30, -90, -150, 150, 90), "+-+-+-", (1, 6, 5, 4, 3, 2)),
    (HEXA, 14): _single(_HEXA_CW, "+-+-+-", (1, 2, 3, 4, 5, 6)),
    (OCTA, 0): _single((0, 180, 45, 135, -45, -135, -90, 90), "--++++--", (1, 5, 2, 4, 8, 6, 7, 3)),
    (OCTA, 1): _single(_OCTA_X, "--++++--", (1, 5, 2, 4, 8, 6, 7, 3)),
    (OCTA, 13): _single((*_OCTA_CW[:1], *_OCTA_CW[:0:-1]), "+-+-+-+-", (1, 8, 7, 6, 5, 4, 3, 2)),
    (OCTA, 14): _single(_OCTA_CW, "+-+-+-+-", _TURN_8),
    (OCTAQUAD, 0): _ring(_PLUS, "+-+-+-+-", _OLD, _FOUR),
    (OCTAQUAD, 1): _ring(_X, "+-+-+-+-", _OLD, _FOUR),
    (OCTAQUAD, 2): _v(_ring(_X, "+-+-+-+-", _OLD, _FOUR)),
    (OCTAQUAD, 3): _ring(_X, "-+-+-+-+", _OLD, _FOUR),
    (OCTAQUAD, 12): _ring(_BF_X, "-++-+--+", _BETAFLIGHT, _FOUR),
    (OCTAQUAD, 14): _ring(_CW_X, "+--++--+", _TURN_8),
    (OCTAQUAD, 18): _ring(_BF_X, "+--+-++-", _BETAFLIGHT, _FOUR),
    (OCTAQUAD, 20): _scaled(_ring(_X, "+-+--+-+", _OLD, _FOUR)),
    (OCTAQUAD, 21): _scaled(_ring(_CW_X, "++--++--", _TURN_8)),
    (Y6, 1): _Y6A,
    (Y6, 10): _y6(
        (
            (60, _CW, TOP, 1),
            (60, _CCW, BOTTOM, 2),
            (180, _CW, TOP, 3),
            (180, _CCW, BOTTOM, 4),
            (-60, _CW, TOP, 5),
            (-60, _CCW, BOTTOM, 6),
        ),
        0.5,
        -1.0,
    ),
    (Y6, 11): _y6(
        (
            (180, _CCW, UNSTATED, 3),
            (60, _CCW, UNSTATED, 1),
            (-60, _CCW, UNSTATED, 5),
            (180, _CW, UNSTATED, 4),
            (60, _CW, UNSTATED, 2),
            (-60, _CW, UNSTATED, 6),
        ),
        0.5,
        -1.0,
    ),
    (DODECAHEXA, 0): _ring((0, 0, 60, 60, 120, 120, 180, 180, -120, -120, -60, -60), "+--+" * 3, _TURN_12),
    (DODECAHEXA, 1): _ring((30, 30, 90, 90, 150, 150, -150, -150, -90, -90, -30, -30), "+--+" * 3, _TURN_12),
    (DECA, 0): _single((0, 36, 72, 108, 144, 180, -144, -108, -72, -36), "+-" * 5, tuple(range(1, 11))),
}
_DECA_X = _single((18, 54, 90, 126, 162, -162, -126, -90, -54, -18), "+-" * 5, tuple(range(1, 11)))
FRAMES |= {(DECA, kind): _DECA_X for kind in (1, 14)}


def frame_of(frame_class: int, frame_type: int) -> Frame | None:
    """Motors 1, 2, ... of a frame, None for one that is not known here.

    A Y6 of any type that is not its own is Y6A: setup_y6_matrix has no type that it refuses.

    >>> [motor.angle_deg for motor in frame_of(4, 1)][:2], frame_of(5, 0) == frame_of(5, 1)
    ([45, -45], True)
    """
    return FRAMES.get((frame_class, frame_type)) or (_Y6A if frame_class == Y6 else None)
