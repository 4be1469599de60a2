"""A table for PX4, what PX4 will make of it, and the file that `coaxlink upload` takes."""

import coaxlink as cx
from coaxlink.files import example

vehicle = cx.load_vehicle(example("x8_paper.toml"))
table = cx.make_table(vehicle, "px4", "fitted")
print(table)
for name in ("CA_ROTOR0_CT", "CA_ROTOR4_CT", "THR_MDL_FAC", "MPC_THR_HOVER"):
    print(f"{name} {table.parameters[name]:.4g}")
hover = table.speeds(0.0, 0.0, 0.0, table.parameters["MPC_THR_HOVER"])
thrust, torque = vehicle.airframe.loads(vehicle.model, hover)
print(
    f"hover: {vehicle.airframe.wrench(thrust, torque)[0]:.1f} N of {vehicle.airframe.mass_kg * 9.80665:.1f} N"
)
print(", ".join(table.files))
