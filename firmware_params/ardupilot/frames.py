"""ArduCopter's own coaxial frames: where each motor sits, which way it turns, which one is on top.

From AP_MotorsMatrix.cpp (setup_octaquad_matrix, setup_y6_matrix, setup_dodecahexa_matrix; 4.6 and master of
2026): angle from the nose, clockwise, in degrees; yaw factor +1 for counter-clockwise. On top or below as its
comments and the frame pictures of ArduPilot's documentation say; where neither does, the layer is "".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

OCTAQUAD, Y6, DODECAHEXA = 4, 5, 12
TOP, BOTTOM, UNSAID = "upper", "lower", ""
_CCW, _CW = 1.0, -1.0
_FOUR_ON_TOP = (TOP,) * 4 + (BOTTOM,) * 4


@dataclass(frozen=True)
class Motor:
    """One motor of a frame."""

    angle_deg: float  # from the nose, clockwise
    yaw: float  # yaw factor; > 0 for a counter-clockwise rotor
    layer: str  # TOP, BOTTOM or UNSAID
    raw: tuple[float, float] | None = None  # roll and pitch factor where the source states these

    @property
    def factors(self) -> tuple[float, float, float, float]:
        """Roll, pitch, yaw and throttle before ArduPilot scales them."""
        angle = math.radians(self.angle_deg)
        roll, pitch = self.raw or (math.cos(angle + math.pi / 2), math.cos(angle))
        return roll, pitch, self.yaw, 1.0


def _ring(angles: tuple[float, ...], yaws: tuple[float, ...], layers: tuple[str, ...]) -> tuple[Motor, ...]:
    return tuple(Motor(a, y, layer) for a, y, layer in zip(angles, yaws, layers, strict=True))


def _y6(rows: tuple[tuple[int, float, str], ...], front: float, rear: float) -> tuple[Motor, ...]:
    """Arms at 60, 180 and -60 degrees; the factors are stated as numbers, not by these angles."""
    raw = {60: (-1.0, front), 180: (0.0, rear), -60: (1.0, front)}
    return tuple(Motor(float(angle), yaw, layer, raw[angle]) for angle, yaw, layer in rows)


_X, _PLUS = (45, -45, -135, 135, -45, 45, 135, -135), (0, -90, 180, 90, -90, 0, 90, 180)
_ALTERNATE = (_CCW, _CW) * 4
_SIX = (_CCW, _CW, _CW, _CCW) * 3
_IN_TURN = (TOP, BOTTOM) * 6

FRAMES: dict[tuple[int, int], tuple[Motor, ...]] = {  # (FRAME_CLASS, FRAME_TYPE): motors 1, 2, ...
    (OCTAQUAD, 0): _ring(_PLUS, _ALTERNATE, _FOUR_ON_TOP),
    (OCTAQUAD, 1): _ring(_X, _ALTERNATE, _FOUR_ON_TOP),
    (OCTAQUAD, 2): _ring(_X, (0.7981, -0.7981, 1.0, -1.0, 0.7981, -0.7981, 1.0, -1.0), _FOUR_ON_TOP),
    (OCTAQUAD, 3): _ring(_X, (_CW, _CCW) * 4, _FOUR_ON_TOP),
    (OCTAQUAD, 14): _ring(
        (45, 45, 135, 135, -135, -135, -45, -45), (_CCW, _CW, _CW, _CCW) * 2, (TOP, BOTTOM) * 4
    ),
    (Y6, 1): _y6(
        (
            (60, _CCW, UNSAID),
            (-60, _CW, UNSAID),
            (-60, _CCW, UNSAID),
            (180, _CW, UNSAID),
            (60, _CW, UNSAID),
            (180, _CCW, UNSAID),
        ),
        0.666,
        -1.333,
    ),
    (Y6, 10): _y6(
        (
            (60, _CW, TOP),
            (60, _CCW, BOTTOM),
            (180, _CW, TOP),
            (180, _CCW, BOTTOM),
            (-60, _CW, TOP),
            (-60, _CCW, BOTTOM),
        ),
        0.5,
        -1.0,
    ),
    (DODECAHEXA, 0): _ring((0, 0, 60, 60, 120, 120, 180, 180, -120, -120, -60, -60), _SIX, _IN_TURN),
    (DODECAHEXA, 1): _ring((30, 30, 90, 90, 150, 150, -150, -150, -90, -90, -30, -30), _SIX, _IN_TURN),
}

# place of motor 1, 2, ... in the test order of MAV_CMD_DO_MOTOR_TEST
_OCTAQUAD_PLACES = (1, 7, 5, 3, 8, 2, 4, 6)
TEST_PLACES: dict[tuple[int, int], tuple[int, ...]] = {
    **{(OCTAQUAD, kind): _OCTAQUAD_PLACES for kind in (0, 1, 2, 3)},
    (OCTAQUAD, 14): (1, 2, 3, 4, 5, 6, 7, 8),
    (Y6, 1): (2, 5, 6, 4, 1, 3),
    (Y6, 10): (1, 2, 3, 4, 5, 6),
    (Y6, 11): (3, 1, 5, 4, 2, 6),
    **{(DODECAHEXA, kind): tuple(range(1, 13)) for kind in (0, 1)},
}
