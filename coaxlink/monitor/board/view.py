"""What the screen knows of the mixer table on board, whichever autopilot holds it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

NEAR = 0.02  # relative; QGC rounds CT to 0.1
# a vehicle stores whatever it is sent: 1e38 metres, or an infinite CT
ABSURD = (ArithmeticError, ValueError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Board:
    """The table on board, as far as it was heard."""

    state: str  # unread, partial, read, or invalid
    kind: str = ""  # standard, reduced, fitted, custom; "" unless read
    digest: str = ""  # first 8 hex digits of the SHA-256 over "NAME=value" lines, by name
    rotors: int = 0
    upper_ct: float | None = None  # mean CA_ROTORn_CT of the airframe's upper (and single) rotors
    lower_ct: float | None = None
    thr_mdl_fac: float | None = None
    of_model: bool = False  # its coefficients are those of the rotor model in use
    notes: tuple[str, ...] = ()
    # ArduPilot's
    frame_class: int | None = None
    upper_factor: float | None = None  # mean throttle factor of the upper (and single) motors
    lower_factor: float | None = None
    thst_expo: float | None = None  # MOT_THST_EXPO
    columns: tuple[tuple[float, ...], ...] = ()  # (N, 4) wrench (N, N m) of a unit of each motor's set-point
    curve: float | None = None  # set-point = curve u^2 + (1 - curve) u, of the law whose table it is


def digest_of(used: Mapping[str, float]) -> str:
    """The hash of a table's parameters."""
    text = "".join(f"{name}={value:.9g}\n" for name, value in sorted(used.items()))
    return hashlib.sha256(text.encode()).hexdigest()[:8]
