"""coaxlink: make the lower rotors of coaxial multirotors pull their weight.

    import coaxlink as cx

    log = cx.read_log("stand.csv")                       # any stand or flight log, SI units
    rotors = cx.identify(log).model                      # a rotor model with held-out errors
    vehicle = cx.Vehicle(cx.load_airframe("x8.toml"), rotors)
    law = cx.make_law("exact", vehicle)
    print(cx.allocate(law, vehicle, [196.1, 0, 0, 0]))   # thrust up N; roll, pitch, yaw N m (FRD)
    table = cx.make_table(vehicle, "px4")                # parameters and files, no disk
    with cx.connect("udpin:0.0.0.0:14550") as session:
        cx.upload(session, table)
    found = cx.refine("flight.ulg", vehicle)             # residual, effect, error before and after
    print(cx.check_health("flight.ulg", vehicle))        # is every rotor sound
    cx.write_report("flight.ulg", "flight.html", vehicle)

Everything loads when it is first used. Errors are `cx.CoaxlinkError` and its kin (coaxlink/errors.py).
"""

from __future__ import annotations

from coaxlink import notebook
from coaxlink._version import __version__

TYPE_CHECKING = False  # typing's own takes longer to load than all of this
if TYPE_CHECKING:
    from typing import Any

    from coaxlink.airframe import Airframe, load_airframe
    from coaxlink.data import Samples
    from coaxlink.errors import CheckFailed, CoaxlinkError, InputError, LinkError, SafetyRefusal
    from coaxlink.library import (
        Table,
        check_health,
        identify,
        make_table,
        mix,
        read_log,
        refine,
        upload,
        write_report,
    )
    from coaxlink.mavlink import connect
    from coaxlink.mixer import allocate, compare, make_law
    from coaxlink.rotor import RotorModel, load_rotor_model, save_rotor_model
    from coaxlink.vehicle import Conditions, Vehicle, load_vehicle

_ROOMS = {
    "coaxlink.airframe": ("Airframe", "load_airframe"),
    "coaxlink.data": ("Samples",),
    "coaxlink.errors": ("CheckFailed", "CoaxlinkError", "InputError", "LinkError", "SafetyRefusal"),
    "coaxlink.library": (
        *("Table", "check_health", "identify", "make_table", "mix"),
        *("read_log", "refine", "upload", "write_report"),
    ),
    "coaxlink.mavlink": ("connect",),
    "coaxlink.mixer": ("allocate", "compare", "make_law"),
    "coaxlink.rotor": ("RotorModel", "load_rotor_model", "save_rotor_model"),
    "coaxlink.vehicle": ("Conditions", "Vehicle", "load_vehicle"),
}
_HOME = {name: room for room, names in _ROOMS.items() for name in names}

__all__ = [
    "Airframe",
    "CheckFailed",
    "CoaxlinkError",
    "Conditions",
    "InputError",
    "LinkError",
    "RotorModel",
    "SafetyRefusal",
    "Samples",
    "Table",
    "Vehicle",
    "__version__",
    "allocate",
    "check_health",
    "compare",
    "connect",
    "identify",
    "load_airframe",
    "load_rotor_model",
    "load_vehicle",
    "make_law",
    "make_table",
    "mix",
    "read_log",
    "refine",
    "save_rotor_model",
    "upload",
    "write_report",
]


def _with_picture(thing: Any) -> str:
    from coaxlink.report.notebook import html_of  # only who looks at a result waits for the pictures

    return html_of(thing)


notebook.register(_with_picture)


def __getattr__(name: str) -> Any:
    # numpy alone costs more than `coaxlink --help` does: who asks for a name waits for its room
    if name in _HOME:
        import importlib

        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'coaxlink' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
