"""Words of a log or a file in a picture."""

from __future__ import annotations

import functools

from coaxlink.load import Load
from firmware_params.plain import plain

CHANNELS = {
    "force_x": "forward force",
    "force_y": "rightward force",
    "force_z": "downward force",
    "torque_x": "roll torque",
    "torque_y": "pitch torque",
    "torque_z": "yaw torque",
    **{load.channel: f"{load.quantity} of the {load.side} rotor" for load in Load},
    "upper_speed": "speed of the upper rotor",
    "lower_speed": "speed of the lower rotor",
    "coaxial_thrust": "thrust of the pair",
    "coaxial_torque": "torque of the pair",
}
CAUSES = {  # what an effect depends on: a column's name in words, with its unit
    "vel_x_body_m_s": "speed forward, m/s",
    "vel_y_body_m_s": "speed to the right, m/s",
    "climb_m_s": "speed along the rotor axis, m/s",
    "rate_x_rad_s": "roll rate, rad/s",
    "rate_y_rad_s": "pitch rate, rad/s",
    "yaw_rate_rad_s": "yaw rate, rad/s",
    "voltage_V": "voltage of the battery, V",
    "total_thrust_N": "thrust of all rotors, N",
    "height_m": "height above the ground, m",
    "time_s": "time, s",
    "command_rate_1_s": "change of the motor commands, 1/s",
    "yaw_speed_rate_1_s": "change of the rotor speeds, sum by spin, 1/s",
    "rotor_spacing_m": "distance between the rotors, m",
    "motor_temperature_C": "temperature of the motor, C",
    "throttle_rate_1_s": "change of the throttle, 1/s",
    "speed_rate_1_s": "change of the rotor's speed, 1/s",
    "u_u": "speed of the upper rotor, share of full",
    "u_l": "speed of the lower rotor, share of full",
}
LONGEST = 120  # characters that a figure has room for


def label(text: str, longest: int = LONGEST) -> str:
    """Text that matplotlib draws as it stands: no formulas, no character that its font lacks."""
    shown = "".join(c if _drawn(c) else "?" for c in plain(text, longest))
    return shown.replace("$", r"\$")


def channel_words(name: str) -> str:
    """A channel in words, its name where there are none better."""
    return CHANNELS.get(name, name.replace("_", " "))


def cause_words(name: str) -> str:
    """What an effect depends on, in words and with its unit, as far as they are known."""
    return CAUSES.get(name, name)


@functools.lru_cache(maxsize=1024)
def _drawn(character: str) -> bool:
    from matplotlib.font_manager import findfont, get_font

    return bool(get_font(findfont("DejaVu Sans")).get_char_index(ord(character)))
