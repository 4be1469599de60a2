"""A log that begins after the loss, in rows that fall in step with a loop of 50 Hz: the rotor, or nobody."""

from pathlib import Path

import pytest

from coaxlink.data import read_flight_log
from coaxlink.files import example
from coaxlink.health.premises import judged
from coaxlink.health.priors import WATCH
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import load_vehicle
from sim.effects import HiddenEffect
from sim.flights import write_flight
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.vehicle import read_vehicle

AIRFRAME, ROTORS = example("x8_demo.toml"), example("rotor_paper.toml")
WEAK, SECONDS, LOST_S = 3, 30.0, 15.0


@pytest.mark.slow
def test_no_other_rotor_is_named_where_the_log_begins_after_the_loss(tmp_path: Path) -> None:
    vehicle = load_vehicle(AIRFRAME, ROTORS)
    table = report_px4(vehicle, "fitted").params
    lost = HiddenEffect("degraded_rotor", 0.2, LOST_S, {"rotor": float(WEAK)})
    world = FlightWorld((lost,), 3, "wander", SECONDS)
    design = make_design(read_vehicle(AIRFRAME), read_pair(ROTORS), table)
    write_flight(tmp_path / "flight.csv", fly_quick(design, world, 8)[1])
    log = read_flight_log(tmp_path / "flight.csv")
    for begins in (19.2, 21.0):
        late = log.take(log["time_s"] > begins)
        found = judged([late], ["late"], vehicle)
        assert found.suspects[0].rotor == WEAK and not found.reasons
        assert sum(s.probability for s in found.suspects[1:]) < WATCH
