"""A vehicle of one's own without a file: four pairs in X, and the yaw that is left in hover."""

import math

import coaxlink as cx
from coaxlink.airframe import Rotor
from coaxlink.files import example

ARM, HALF_GAP = 0.45, 0.08
angles = (45, -45, -135, 135)  # from the nose, clockwise, degrees
rotors = []
for level, z, first in (("upper", -HALF_GAP, 1), ("lower", HALF_GAP, -1)):
    for n, angle in enumerate(angles):
        x, y = ARM * math.cos(math.radians(angle)), ARM * math.sin(math.radians(angle))
        number = len(rotors) + 1
        other = number + 4 if level == "upper" else number - 4
        spin = first * (1 if n % 2 == 0 else -1)  # +1 counter-clockwise, seen from above
        rotors.append(Rotor(number, (x, y, z), (0.0, 0.0, -1.0), spin, level, other))
airframe = cx.Airframe("own-x8", 14.0, (0.8, 0.8, 1.4), tuple(rotors))
vehicle = cx.Vehicle(airframe, cx.load_rotor_model(example("rotor_paper.toml")))
law = cx.make_law("exact", vehicle)
for yaw in (0.0, 2.0, 4.0, 8.0):
    answer = cx.allocate(law, vehicle, [14.0 * 9.80665, 0.0, 0.0, yaw])
    lost = ", ".join(answer.dropped) or "nothing"
    print(
        f"yaw {yaw:.0f} N m: speeds {answer.speeds.min():.2f} to {answer.speeds.max():.2f}, given up: {lost}"
    )
