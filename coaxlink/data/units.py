"""Units that stands write: for each quantity what one of them is in ours.

A unit is looked up without spaces, points, hyphens and brackets: "N.m", "N m" and "N-m" are nm.
Grams and kilograms of thrust are forces under standard gravity.
"""

from __future__ import annotations

import math
import re
import unicodedata
from dataclasses import dataclass

from coaxlink.constants import GRAVITY_M_S2

G = GRAVITY_M_S2
LBF = 0.45359237 * G  # N, the pound of 1959
INCH = 0.0254  # m
PWM_STOP_US, PWM_SPAN_US = 1000.0, 1000.0  # what ESCs and both firmwares take for 0 and 0..1


@dataclass(frozen=True)
class Unit:
    """ours = scale * theirs + offset; a speed may be counted in electrical turns."""

    name: str  # as it is shown and may be written in a map
    scale: float
    offset: float = 0.0
    electrical: bool = False

    def factor(self, poles: int | None) -> float:
        """The scale; electrical turns need the number of the motor's magnet poles."""
        return self.scale * (2.0 / poles if self.electrical and poles else 1.0)


def _units(**groups: tuple[float, str]) -> dict[str, Unit]:
    return {
        word: Unit(shown.split()[0].replace("_", " "), scale)
        for scale, shown in groups.values()
        for word in (w.replace("_", "").casefold() for w in shown.split())
    }


_LOAD = _units(
    n=(1.0, "N newton newtons"),
    mn=(1e-3, "mN"),
    kn=(1e3, "kN"),
    g=(G / 1e3, "gf g gram grams pond"),
    kg=(G, "kgf kg kp"),
    lb=(LBF, "lbf lb lbs"),
    oz=(LBF / 16, "ozf oz"),
)
_TORQUE = _units(
    nm=(1.0, "N_m nm newtonmeter"),
    ncm=(1e-2, "N_cm"),
    nmm=(1e-3, "N_mm mnm"),
    kgm=(G, "kgf_m kgm"),
    kgcm=(G / 100, "kgf_cm kgcm"),
    gcm=(G / 1e5, "gf_cm gcm"),
    lbin=(LBF * INCH, "lbf_in lbin inlbf inlb"),
    lbft=(LBF * 12 * INCH, "lbf_ft lbft ftlbf ftlb"),
    ozin=(LBF / 16 * INCH, "ozf_in ozin inozf inoz"),
)
_SPEED = _units(
    rpm=(1.0, "rpm 1/min min1 min^1 u/min rev/min r/min tr/min umin"),
    rad=(30 / math.pi, "rad/s rad/sec rads radps"),
    hz=(60.0, "rev/s hz rps 1/s s1 s^1 r/s revs"),
    krpm=(1e3, "krpm"),
    deg=(1 / 6, "deg/s °/s"),
) | {"erpm": Unit("erpm", 1.0, electrical=True)}
_THROTTLE = _units(pct=(0.01, "% pct percent"), one=(1.0, "1 0..1 01 ratio fraction")) | {
    "us": Unit("us", 1 / PWM_SPAN_US, -PWM_STOP_US / PWM_SPAN_US),
    "usec": Unit("us", 1 / PWM_SPAN_US, -PWM_STOP_US / PWM_SPAN_US),
    "ms": Unit("ms", 1e3 / PWM_SPAN_US, -PWM_STOP_US / PWM_SPAN_US),
}

# quantity: (suffix of our name, units)
QUANTITIES: dict[str, tuple[str, dict[str, Unit]]] = {
    "thrust": ("thrust_N", _LOAD),
    "torque": ("torque_Nm", _TORQUE),
    "speed": ("rpm", _SPEED),
    "throttle": ("throttle", _THROTTLE),
    "voltage": ("voltage_V", _units(v=(1.0, "V volt volts"), mv=(1e-3, "mV"))),
    "current": ("current_A", _units(a=(1.0, "A amp amps ampere"), ma=(1e-3, "mA"))),
    "power": ("power_W", _units(w=(1.0, "W watt watts"), kw=(1e3, "kW"))),
    "time": ("time_s", _units(s=(1.0, "s sec seconds"), ms=(1e-3, "ms"), us=(1e-6, "us"), min=(60.0, "min"))),
}
# what is meant where nothing is written: nobody logs a battery in anything else
UNWRITTEN = {"voltage": "v", "current": "a", "power": "w", "time": "s"}


def plain(text: str) -> str:
    """Lower case, with the look-alike characters of stand software folded together (micro, dot, degree)."""
    folded = unicodedata.normalize("NFKC", text).casefold()
    return re.sub("[⋅·∙•]", "", folded.replace("μ", "u").replace("º", "°"))


def find_unit(quantity: str, written: str) -> Unit | None:
    """The unit of a quantity as somebody wrote it, or None."""
    word = re.sub(r"[\s.*\-_()\[\]]", "", plain(written)) or plain(written).strip()
    if quantity == "throttle" and plain(written).strip() in ("0..1", "0-1", "-"):
        word = "1"
    return QUANTITIES[quantity][1].get(word)


def unit_names(quantity: str) -> tuple[str, ...]:
    """The units of a quantity, each once, as they may be written."""
    return tuple(dict.fromkeys(unit.name for unit in QUANTITIES[quantity][1].values()))


def quantity_of(name: str) -> str | None:
    """The quantity of one of our column names (upper_thrust_N, voltage_V), or None."""
    rest = re.sub(r"^(upper|lower)_", "", name)
    return next((q for q, (suffix, _) in QUANTITIES.items() if suffix == rest), None)
