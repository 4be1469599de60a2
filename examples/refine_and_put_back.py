"""An effect that the model lacks: found in a stand log, put into the vehicle, answered by every law."""

from dataclasses import replace

import numpy as np

import coaxlink as cx
from coaxlink.files import example

# a stand log of a pair whose supply sagged: the speeds fall with the voltage, and nobody told the model
rotors = cx.load_rotor_model(example("rotor_paper.toml"))
rng = np.random.default_rng(1)
u, v = (x.ravel() for x in np.meshgrid(*[np.linspace(0.2, 0.9, 9)] * 2, indexing="ij"))
volts = rng.permutation(np.linspace(21.0, 25.2, len(u)))
turned = (volts / 25.2) ** 0.8
pair = rotors.loads(u * turned, v * turned)
log = cx.Samples(
    {
        "time_s": 2.0 * np.arange(len(u)),
        "upper_throttle": u,
        "lower_throttle": v,
        "upper_thrust_N": pair.upper_thrust + rng.normal(0, 0.1, len(u)),
        "upper_torque_Nm": pair.upper_torque + rng.normal(0, 0.003, len(u)),
        "lower_thrust_N": pair.lower_thrust + rng.normal(0, 0.1, len(u)),
        "lower_torque_Nm": pair.lower_torque + rng.normal(0, 0.003, len(u)),
        "voltage_V": volts,
    },
    "a stand with a tired battery",
)
found = cx.refine(log, rotors=rotors)
for effect in found.effects:
    print(effect.name, {p.name: round(p.value, 3) for p in effect.parameters})
for name, channel in found.channels.items():
    print(f"{name}: {channel.rmse_before:.3g} {channel.unit} before, {channel.rmse_after:.3g} after")

airframe = cx.load_airframe(example("x8_paper.toml"))
refined = replace(rotors, effects=found.model.effects)
print(cx.Vehicle(airframe, refined))  # no voltage stated: said, not dropped
tired = cx.Vehicle(airframe, refined, cx.Conditions(voltage_V=22.2))
print(cx.make_law("exact", tired).speeds([196.1, 0.0, 0.0, 0.0]).round(3))
