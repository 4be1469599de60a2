"""The two mixers with the paper's own mistakes in them, as it prints them: nobody flies these.

The standard mixer's yaw row (eq. 18) is the ratio of torque to thrust where the torque is meant; Algorithm 1
(eq. 8-14, 16) never uses the torques that it allocates, so its yaw error is the whole yaw demand.
"""

from __future__ import annotations

from coaxlink.mixer import Law, standard_coefficients
from coaxlink.mixer.coaxial import coaxial_printed
from coaxlink.mixer.linear import SquareLaw, square_law
from coaxlink.vehicle import Vehicle


def printed_laws(vehicle: Vehicle) -> dict[str, Law]:
    """`standard-printed` and `coaxial-printed`. Raises InputError on an airframe that they cannot serve."""
    return {"standard-printed": standard_printed(vehicle), "coaxial-printed": coaxial_printed(vehicle)}


def standard_printed(vehicle: Vehicle) -> SquareLaw:
    """The standard mixer with the yaw row as printed: 0.026 m where 1.9 N m is meant."""
    airframe, c = vehicle.airframe, standard_coefficients(vehicle.model)
    per_thrust, per_torque = airframe.effectiveness()
    thrust_gain, torque_gain = airframe.gains
    matrix = c.p * per_thrust * thrust_gain + c.q / c.p * per_torque * torque_gain
    return square_law("standard-printed", vehicle, matrix)
