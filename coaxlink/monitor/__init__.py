"""The live screen: what flies, arm by arm.

`readings` keeps what came over the link, `state` makes one frozen view of it, `screen` formats that view.
Nothing here commands a vehicle.
"""
