"""A stand log becomes a rotor model, with its errors on points the fit has not seen."""

import coaxlink as cx
from coaxlink.files import example

log = cx.read_log(example("stand_eq17.csv"))
found = cx.identify(log, "crm")
for name, channel in found.as_json()["channels"].items():
    print(f"{name}: {channel['rmse']:.3g} on {channel['held_out_rows']} held-out rows")
pair = found.model.loads(0.44, 0.65)
print(f"at u = 0.44 / 0.65: {float(pair.upper_thrust):.1f} N above, {float(pair.lower_thrust):.1f} N below")
