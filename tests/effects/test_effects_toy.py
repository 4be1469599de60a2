"""An effect from outside the package: one file, and it is traced, held by tables, taken back live, worded.

The file is `blade_flutter.py`; the stand that it is traced on shares no code with it, nor with coaxlink.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blade_flutter import FLUTTER
from pymavlink.dialects.v20 import common as mavlink
from residual_rig import FULL_RPM, steady_loads

from coaxlink.airframe import load_airframe
from coaxlink.data import Samples
from coaxlink.effects import effect, registered
from coaxlink.files import example
from coaxlink.live.effects import LiveEffects, wanted_streams
from coaxlink.mavlink.telemetry import Telemetry
from coaxlink.mixer import make_law
from coaxlink.report.refine import tables, verdict
from coaxlink.residual import refine_stand
from coaxlink.rotor import load_rotor_model
from coaxlink.rotor.model import EffectEntry
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import Conditions, Vehicle

X8 = load_airframe(example("x8_paper.toml"))
CRM = load_rotor_model(example("rotor_paper.toml"))
FROM_V, LOSS = 22.0, 0.015
FLUTTERING = {"thrust_loss_per_V": LOSS, "from_V": FROM_V}


def stand(loss, seed=3):
    rng = np.random.default_rng(seed)
    steps = np.linspace(0.2, 0.9, 9)
    u, v = (x.ravel() for x in np.meshgrid(steps, steps, indexing="ij"))
    u, v = np.tile(u, 2), np.tile(v, 2)
    volts = 25.2 - 4.2 * (np.arange(len(u)) % 41) / 40.0  # four packs, each of which empties
    upper, upper_q, lower, lower_q = steady_loads(u, v)
    left = 1.0 - loss * np.where(volts > FROM_V, volts - FROM_V, 0.0)
    return Samples(
        {
            "time_s": 2.0 * np.arange(len(u)),
            "upper_rpm": FULL_RPM * u,
            "lower_rpm": FULL_RPM * v,
            "upper_thrust_N": upper * left + rng.normal(0, 0.15, len(u)),
            "lower_thrust_N": lower * left + rng.normal(0, 0.15, len(u)),
            "upper_torque_Nm": upper_q + rng.normal(0, 0.004, len(u)),
            "lower_torque_Nm": lower_q + rng.normal(0, 0.004, len(u)),
            "voltage_V": volts,
        },
        "toy stand",
    )


@pytest.fixture
def known():
    with registered(FLUTTER):
        yield
    assert effect("blade_flutter") is None


def having():
    return replace(CRM, effects=(EffectEntry("blade_flutter", FLUTTERING, ("voltage_V",)),))


def test_it_is_traced_and_worded(known):
    answer = refine_stand(stand(LOSS), CRM)
    assert [e.name for e in answer.effects] == ["blade_flutter"]
    numbers = {p.name: p for p in answer.effects[0].parameters}
    for name, true in FLUTTERING.items():
        assert numbers[name].ci[0] <= true <= numbers[name].ci[1]
        assert numbers[name].value == pytest.approx(true, rel=0.1)
    assert "found: blade_flutter" in verdict(answer)
    assert len(list(tables(answer))) == 2
    assert answer.model is not None and answer.model.effects[0].name == "blade_flutter"


def test_where_there_is_none_it_is_not_traced(known):
    assert refine_stand(stand(0.0), CRM).effects == ()


def test_a_table_and_a_law_hold_it_at_the_stated_voltage(known):
    vehicle = Vehicle(X8, having(), Conditions(voltage_V=25.0))
    assert "4.5 %" in vehicle.compensated["blade_flutter"]
    u = make_law("exact", vehicle).speeds([200.0, 1.0, -1.0, 0.3])
    pull, drag = X8.loads(CRM, u)
    assert X8.wrench(pull * (1.0 - LOSS * 3.0), drag) == pytest.approx([200.0, 1.0, -1.0, 0.3], abs=1e-6)
    hover = [report_px4(v, "fitted").behaviour.hover for v in (vehicle, Vehicle(X8, CRM))]
    assert hover[0] > hover[1] + 0.005
    assert "stated" in Vehicle(X8, having()).left_out["blade_flutter"]


def test_live_mixing_takes_it_back_from_what_the_vehicle_sends(known):
    telemetry = Telemetry()
    vehicle = Vehicle(X8, having(), measured_live=True)
    taking = LiveEffects(None, vehicle, telemetry)
    assert taking.names == ["blade_flutter"] and wanted_streams(taking.names) == {147: 10.0}
    speeds = np.full(8, 0.6)
    assert taking.wrench(speeds).tolist() == [0.0] * 4  # nothing heard yet
    cells = [3125] * 8 + [0xFFFF] * 2  # 25 V
    telemetry.hear(mavlink.MAVLink_battery_status_message(0, 0, 1, 0x7FFF, cells, 0, 0, -1, 50))
    lost = X8.wrench(*X8.loads(CRM, speeds))[0] * LOSS * 3.0
    assert taking.wrench(speeds)[0] == pytest.approx(-lost, rel=1e-6)


def test_before_it_is_registered_nobody_knows_it():
    assert "not known" in Vehicle(X8, having()).left_out["blade_flutter"]
    assert refine_stand(stand(LOSS), CRM).effects == ()
