"""How each law shares hover among the rotors of a pair: numbers, and a picture (split.png, or argument 1)."""

import sys

from matplotlib.figure import Figure

import coaxlink as cx
from coaxlink.files import example

vehicle = cx.load_vehicle(example("x8_paper.toml"))
laws = ("standard", "reduced", "fitted", "exact")
hover = [vehicle.airframe.mass_kg * 9.80665, 0.0, 0.0, 0.0]  # thrust up N; roll, pitch, yaw N m (FRD)
flown = [cx.allocate(cx.make_law(name, vehicle), vehicle, hover) for name in laws]
upper, lower = vehicle.airframe.pairs[0]
for answer in flown:
    pair = f"{answer.thrust_N[upper]:.1f} N above, {answer.thrust_N[lower]:.1f} N below"
    print(f"{answer.law}: {pair}, error {answer.error[0]:+.2f} N")

figure = Figure(figsize=(6, 4), layout="constrained")
axes = figure.subplots()
axes.bar(laws, [a.thrust_N[upper] for a in flown], label="upper rotor")
axes.bar(
    laws, [a.thrust_N[lower] for a in flown], bottom=[a.thrust_N[upper] for a in flown], label="lower rotor"
)
axes.set(ylabel="thrust of a pair in hover, N")
axes.legend()
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "split.png")
