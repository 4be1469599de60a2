"""The one table of what stands write: quantities with their words, symbols and units; names of rotors.

Vocabulary: RCbenchmark and Tyto (1520, 1585, 1780, Flight Stand), the platform of Buzzatto and Liarokapis,
pyBEMT's data, spreadsheets in English and German. A unit is looked up without spaces, points, hyphens and
brackets: "N.m", "N m" and "N-m" are nm. Grams and kilograms of thrust are forces under standard gravity.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping
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


@dataclass(frozen=True)
class Quantity:
    """A quantity that a stand reads."""

    suffix: str  # our column name without the rotor
    words: frozenset[str]  # that name it in a heading
    symbols: str  # letters that name it, alone and with a unit of its own or none: "T (C)" is no thrust
    units: Mapping[str, Unit]  # by every spelling
    unwritten: str = ""  # the unit meant where none is written: nobody logs a battery in anything else


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


def _quantity(
    suffix: str, words: str, symbols: str, units: dict[str, float | Unit], unwritten: str = ""
) -> Quantity:
    """`units` by their spellings, the shown one first ("_" is a space in it)."""
    found: dict[str, Unit] = {}
    for spellings, scale in units.items():
        first, *others = spellings.split()
        unit = scale if isinstance(scale, Unit) else Unit(first.replace("_", " "), scale)
        found |= {word.replace("_", "").casefold(): unit for word in (first, *others)}
    return Quantity(suffix, _words(words), symbols, found, unwritten)


_PULSE_US = Unit("us", 1 / PWM_SPAN_US, -PWM_STOP_US / PWM_SPAN_US)
_PULSE_MS = Unit("ms", 1e3 / PWM_SPAN_US, -PWM_STOP_US / PWM_SPAN_US)
QUANTITIES = {  # our suffix, words, symbols, units by their spellings, unit where none is written
    "thrust": _quantity("thrust_N", "thrust force lift pull fz schub kraft schubkraft", "tf", {
        "N newton newtons": 1.0, "mN": 1e-3, "kN": 1e3, "gf g gram grams pond": G / 1e3, "kgf kg kp": G,
        "lbf lb lbs": LBF, "ozf oz": LBF / 16,
    }),
    "torque": _quantity("torque_Nm", "torque moment trq mz drehmoment", "q", {
        "N_m nm newtonmeter": 1.0, "N_cm cnm": 1e-2, "N_mm mnm": 1e-3, "kgf_m kgm": G, "kgf_cm kgcm": G / 100,
        "gf_cm gcm": G / 1e5, "lbf_in lbin inlbf inlb": LBF * INCH, "lbf_ft lbft ftlbf ftlb": LBF * 12 * INCH,
        "ozf_in ozin inozf inoz": LBF / 16 * INCH,
    }),
    "speed": _quantity("rpm", "speed rpm erpm omega rps drehzahl velocity", "n", {
        "rpm 1/min min1 min^1 u/min rev/min r/min tr/min umin": 1.0, "rad/s rad/sec rads radps": 30 / math.pi,
        "rev/s hz rps 1/s s1 s^1 r/s revs": 60.0, "krpm": 1e3, "deg/s °/s": 1 / 6,
        "erpm": Unit("erpm", 1.0, electrical=True),
    }),
    "throttle": _quantity("throttle", "throttle pwm esc duty gas", "", {
        "% pct percent": 0.01, "1 0..1 01 ratio fraction": 1.0, "us usec": _PULSE_US, "ms": _PULSE_MS,
    }),
    "voltage": _quantity("voltage_V", "voltage volt volts spannung", "uv", {
        "V volt volts": 1.0, "mV": 1e-3,
    }, "v"),
    "current": _quantity("current_A", "current amps amperage strom", "i", {
        "A amp amps ampere": 1.0, "mA": 1e-3,
    }, "a"),
    "power": _quantity("power_W", "power watts leistung", "p", {"W watt watts": 1.0, "kW": 1e3}, "w"),
    "time": _quantity("time_s", "time timestamp zeit", "t", {
        "s sec seconds": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0,
    }, "s"),
}  # fmt: skip
OF_A_ROTOR = ("thrust", "torque", "speed", "throttle")  # without a rotor's name these are no reading
LOADS_AND_SPEED = ("thrust", "torque", "speed")  # the quantities that a propeller ties together
QUANTITY_OF = {word: name for name, quantity in QUANTITIES.items() for word in quantity.words}

SIDES = ("upper", "lower")
UPPER = _words("upper top upr oben obere oberer oberes")
LOWER = _words("lower bottom lwr btm unten untere unterer unteres")
LABELS = _words("left right front rear back first second one two cw ccw")
LETTERS = _words("a b c d l r u")
ROTOR_NAMES = UPPER | LOWER | LABELS | LETTERS
PAIR = "pair"  # what reads both rotors together, thrusts added and torques against one another
SUMS = _words("total sum net combined both gesamt summe")
# sums and ratios of other columns of the same row, statistics: they can only mislead a fit
DERIVED = SUMS | _words(
    """efficiency centre center ratio coefficient coeff loading per std stdev min max error raw
    tare average settling"""
)
# what a pulse in microseconds may be called: nothing else on a stand is counted in them but stamps of time
PULSE = _words("signal pulse pulsewidth width input output motor powertrain rotor ppm")
SET_POINT = _words("target setpoint cmd command commanded desired")
ELSEWHERE = _words(
    """acc servo vibration temperature temp acceleration pressure humidity fx fy mx my air wind airspeed angle
    sound cell fuel flow message"""
)

OWN_COLUMNS = (
    "time_s",
    *(f"{side}_{QUANTITIES[q].suffix}" for side in SIDES for q in ("speed", "throttle", "thrust", "torque")),
    "voltage_V", "upper_voltage_V", "lower_voltage_V", "upper_current_A", "lower_current_A",
    "motor_temperature_C", "air_temperature_C", "air_pressure_Pa", "rotor_spacing_m",
    *(f"{PAIR}_{QUANTITIES[q].suffix}" for q in ("thrust", "torque")),
)  # fmt: skip


def plain(text: str) -> str:
    """Lower case, with the look-alike characters of stand software folded together (micro, dot, degree)."""
    folded = unicodedata.normalize("NFKC", text).casefold()
    return re.sub("[⋅·∙•]", "", folded.replace("μ", "u").replace("º", "°"))


def words_of(text: str) -> list[str]:
    """Words and numbers of a heading, in its order: M1_thrustUpper is m, 1, thrust, upper."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text.replace("eRPM", "erpm"))
    return re.findall(r"[^\W\d_]+|\d+", plain(parted))


def find_unit(quantity: str, written: str) -> Unit | None:
    """The unit of a quantity as somebody wrote it, or None."""
    word = re.sub(r"[\s.*\-_()\[\]]", "", plain(written)) or plain(written).strip()
    if quantity == "throttle" and plain(written).strip() in ("0..1", "0-1", "-"):
        word = "1"
    return QUANTITIES[quantity].units.get(word)


def unit_names(quantity: str) -> tuple[str, ...]:
    """The units of a quantity, each once, as they may be written."""
    return tuple(dict.fromkeys(unit.name for unit in QUANTITIES[quantity].units.values()))


def quantity_of(name: str) -> str | None:
    """The quantity of one of our column names (upper_thrust_N, voltage_V), or None."""
    rest = re.sub(r"^(upper|lower|pair)_", "", name)
    return next((q for q, about in QUANTITIES.items() if about.suffix == rest), None)
