"""The exact law as Lua: the speeds of the law in Python, few instructions, flown in the stand-in."""

from __future__ import annotations

import re
import threading
from typing import Any

import numpy as np
import pytest
from live_flight import EXAMPLES, Companion, Flight

from coaxlink.airframe import load_airframe
from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.errors import InputError
from coaxlink.live.scripts.bridge import SCRIPT_NAME, board_factors, bridge_script
from coaxlink.live.scripts.onboard import INSTRUCTIONS, onboard_script
from coaxlink.mixer import standard_coefficients
from coaxlink.mixer.exact import ExactLaw, kernel
from coaxlink.mixer.exact.lua import SINGLE
from coaxlink.mixer.exact.onboard import settle
from coaxlink.rotor.model import RotorModel, load_rotor_model
from coaxlink.tables.ardupilot import report_ap
from coaxlink.uploading.ardupilot_scripts import ScriptFolder, is_table
from coaxlink.vehicle import Vehicle
from firmware_params.ardupilot import scripts
from firmware_params.ardupilot.table import ApTable, used_factors
from firmware_params.errors import TableError

lua53 = pytest.importorskip("lupa.lua53", reason="the stand-in runs scripts through lupa")
X8 = load_airframe(EXAMPLES / "x8_demo.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
GUIDED = 4
FOLDER = scripts.SCRIPT_FOLDERS[0]

# enough of ArduPilot for the script to start, and a way in
HARNESS = """
param = { get = function() return nil end }
gcs = { send_text = function() end }
arming = { is_armed = function() return false end }
SRV_Channels = { find_channel = function(_, f) return f - 33 end }
motors = {}
"""
WAY_IN = """
return function(a, b, d, e)
  mu[0], mu[1], mu[2], mu[3] = a, b, d, e
  local count = 0
  debug.sethook(function() count = count + 1 end, "", 1)
  local steps = settle(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box, past, STEPS)
  debug.sethook()
  return steps, count, x
end
"""


@pytest.fixture(scope="module")
def in_lua() -> Any:
    text = onboard_script(Vehicle(X8, CRM))
    ending = text.index("local function update()")
    return lua53.LuaRuntime(unpack_returned_tuples=True).execute(HARNESS + text[:ending] + WAY_IN)


def streams() -> dict[str, np.ndarray]:
    rng, t = np.random.default_rng(5), np.arange(200) / 250
    flown = np.stack([196 + 20 * np.sin(3 * t), 4 * np.sin(5 * t), 4 * np.cos(4 * t), np.sin(7 * t)], 1)
    return {
        "flown": flown,
        "noisy": flown + rng.normal(0, [3, 0.4, 0.4, 0.1], flown.shape),
        "anything": rng.uniform([150, -4, -4, -1], [260, 4, 4, 1], (100, 4)),
    }


def single(value: Any) -> Any:
    return [single(v) for v in value] if isinstance(value, list) else np.float32(value)


def test_the_law_in_lua_gives_the_speeds_of_the_law_in_python(in_lua: Any) -> None:
    law, most = ExactLaw(Vehicle(X8, CRM)), 0
    p = law.problem
    for name, demands in streams().items():
        worst = 0.0
        for demand in demands:
            law.solve(demand.tolist())
            steps, count, x = in_lua(*np.clip(demand[p.order] / p.scale, -4, 4).tolist())
            assert steps > 0
            worst = max(worst, *(abs(x[i] - law._x[i]) for i in range(8)))
            most = max(most, count)
        assert worst < 1e-6, name
    assert most < INSTRUCTIONS / 5


def test_in_single_precision_as_on_a_board_it_settles_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "MISS_ENOUGH", SINGLE["MISS_ENOUGH"])
    law = ExactLaw(Vehicle(X8, CRM))
    p = law.problem
    arrays = [a.tolist() if a.dtype.kind == "i" else single(a.tolist()) for a in law.arrays()]
    for demand in streams()["flown"]:
        arrays[10][:] = single(np.clip(demand[p.order] / p.scale, -4, 4).tolist())
        assert settle(*arrays, 6) > 0
        speeds = np.array([float(arrays[5][i]) for i in p.slots])
        assert X8.wrench(*X8.loads(CRM, speeds)) == pytest.approx(demand, abs=2e-4)


def test_a_surface_of_the_sixth_degree_settles_on_board_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rotors of the form `surface`: within the script's budget, and in single precision."""
    terms = {load: dict(of) for load, of in CRM.terms().items()}
    for k, load in enumerate(terms):
        terms[load]["u_u^6"] = 0.02 * terms["upper.thrust_N" if k % 2 == 0 else "upper.torque_Nm"]["u_u^2"]
        terms[load]["u_u^3 u_l^3"] = -terms[load]["u_u^6"]
    model = RotorModel.from_terms("surface", CRM.speed_max_rpm, terms)
    law = ExactLaw(Vehicle(X8, model))
    p = law.problem
    text = onboard_script(Vehicle(X8, model))
    start = lua53.LuaRuntime(unpack_returned_tuples=True).execute
    run_in_lua = start(HARNESS + text[: text.index("local function update()")] + WAY_IN)
    for demand in streams()["flown"][:40]:
        law.solve(demand.tolist())
        steps, count, x = run_in_lua(*np.clip(demand[p.order] / p.scale, -4, 4).tolist())
        assert steps > 0 and count < INSTRUCTIONS / 2
        assert max(abs(x[i] - law._x[i]) for i in range(8)) < 1e-5
    monkeypatch.setattr(kernel, "MISS_ENOUGH", SINGLE["MISS_ENOUGH"])
    arrays = [
        a.tolist() if a.dtype.kind == "i" else single(a.tolist())
        for a in ExactLaw(Vehicle(X8, model)).arrays()
    ]
    for demand in streams()["flown"][:40]:
        arrays[10][:] = single(np.clip(demand[p.order] / p.scale, -4, 4).tolist())
        assert settle(*arrays, 6) > 0
        speeds = np.array([float(arrays[5][i]) for i in p.slots])
        assert X8.wrench(*X8.loads(model, speeds)) == pytest.approx(demand, abs=5e-4)


def test_what_is_out_of_reach_costs_no_more_than_the_script_may_spend(in_lua: Any) -> None:
    rng, answers = np.random.default_rng(6), 0
    for demand in rng.uniform(-3, 3, (60, 4)):
        steps, count, x = in_lua(*demand.tolist())
        assert count < INSTRUCTIONS / 2
        answers += steps > 0
        assert all(0.0 <= x[i] <= 1.0 for i in range(8))
    assert answers < 60


class Copter(Flight):
    firmware = "ardupilot"
    files: dict[str, str] = {}  # noqa: RUF012
    params: dict[str, float] = {}  # noqa: RUF012

    def prepare(self) -> None:
        a = self.autopilot
        a.scripts_start_s = 0.0  # no start to wait for
        for name, value in {"SCR_ENABLE": 1.0, **self.params}.items():
            a.store.write(name, value)
        a.boot()  # the loader's own parameters are not there before its script has run
        a.files.folders.add("scripts")
        a.files.files.update({f"scripts/{k}": v.encode() for k, v in self.files.items()})
        a.boot()
        for name, value in self.params.items():
            a.store.write(name, value)
        self.rush(0.5)
        assert a.scripts.failed == ""

    def depart(self) -> None:
        self.autopilot.set_ap_mode(GUIDED)
        super().depart()

    @property
    def driven(self) -> bool:
        return bool(self.autopilot.bridged)


def test_it_flies_the_stand_in_and_the_demand_is_what_the_rotors_deliver() -> None:
    class OnBoard(Copter):
        files = {SCRIPT_NAME: onboard_script(Vehicle(X8, CRM))}  # noqa: RUF012
        params = {"SCR_VM_I_COUNT": float(INSTRUCTIONS)}  # noqa: RUF012

    copter = OnBoard()
    try:
        a = copter.autopilot
        copter.rush(4.0)
        assert all(row[1] for row in copter.rows[-500:])  # the script drives all along
        assert copter.outputs_are_sound()
        assert abs(copter.rows[-1][3] - 4.0) < 0.7
        assert copter.steepest_deg < 5.0
        per_motor = standard_coefficients(CRM).p * X8.effectiveness()[0]  # hover wants no yaw
        wanted = per_motor @ used_factors(ApTable(4))
        got, demanded = [], []
        for _ in range(250):
            demand = [a.demand.roll, a.demand.pitch, a.demand.yaw, a.demand.thrust]
            copter.rush(0.004)
            got.append(X8.wrench(*X8.loads(CRM, np.array(a.command))))
            demanded.append(wanted @ demand)
        miss = np.abs(np.mean(got, axis=0) - np.mean(demanded, axis=0))
        assert miss[0] < 0.3  # pulses of 1 us and the loop's own delay are left
        assert miss[1:3].max() < 0.05
        a.armed = False
        copter.rush(0.2)
        assert not copter.driven
    finally:
        copter.close()


def test_the_verb_writes_the_law_in_the_bridges_place(tmp_path: Any) -> None:
    arguments = ["bridge", str(EXAMPLES / "x8_demo.toml"), "--out", str(tmp_path), "--on-board"]
    assert run(build_app(), arguments) == 0
    text = (tmp_path / "scripts" / SCRIPT_NAME).read_text()
    assert text == onboard_script(Vehicle(X8, CRM))
    (params,) = tmp_path.glob("*.param")
    assert re.search(r"SCR_VM_I_COUNT[ ,\t]+200000", params.read_text())
    with pytest.raises(InputError, match="frame_class"):
        onboard_script(Vehicle(X8, CRM), frame_class=5)
    with pytest.raises(InputError, match="frame_class"):
        onboard_script(Vehicle(X8, CRM), frame_class=1)
    assert onboard_script(Vehicle(X8, CRM), frame_class=15) != text


@pytest.mark.parametrize("frame_class", [15, 17])
def test_the_companion_reads_the_factors_of_a_scripted_frame_from_the_board(frame_class: int) -> None:
    report = report_ap(Vehicle(X8, CRM), "fitted", frame_class=frame_class)

    class Scripted(Copter):
        files = {**report.scripts, SCRIPT_NAME: bridge_script(8)}  # noqa: RUF012
        params = {k: v for k, v in report.params.items() if k != "SCR_LD_CHECKSUM"}  # noqa: RUF012

    copter = Scripted(airborne=False)
    companion = Companion(copter)
    found: list[Any] = []
    reading = threading.Thread(target=lambda: found.append(board_factors(companion.session)))
    reading.start()
    copter.fly(20.0, until=lambda: not reading.is_alive())
    reading.join(1.0)
    companion.close()
    flown = copter.autopilot.mixer.mix.factors
    copter.close()
    assert np.array(found[0]) == pytest.approx(np.array(flown), abs=2e-6)
    assert np.array(found[0]) == pytest.approx(used_factors(report.table), abs=2e-6)


def test_half_a_table_or_anothers_is_not_read() -> None:
    report = report_ap(Vehicle(X8, CRM), "fitted")
    (text,) = report.scripts.values()
    assert np.array(scripts.script_factors(text)) == pytest.approx(np.array(report.table.factors), abs=1e-6)
    with pytest.raises(TableError, match="no mixer table"):
        scripts.script_factors(text.replace("500000", "400000", 1))
    with pytest.raises(TableError, match="no mixer table"):
        scripts.script_factors("return 1")
    params = scripts.loader_params(report.table.factors)
    assert np.array(scripts.params_factors(params)) == pytest.approx(np.array(report.table.factors), abs=1e-6)
    with pytest.raises(TableError, match="half a table"):
        scripts.params_factors({**params, "CXL_R1": 0.1})
    with pytest.raises(TableError, match="missing"):
        scripts.params_factors({"CXL_N": 8.0})


class Board:
    def __init__(self, files: dict[str, bytes]) -> None:
        self.files = files

    def listing(self, folder: str) -> list[str]:
        return [n.rpartition("/")[2] for n in self.files]

    def read(self, path: str) -> bytes | None:
        return self.files.get(path)

    def crc(self, path: str) -> int:
        return scripts.file_crc(self.files[path])


def test_a_bridge_leaves_the_table_on_board_and_counts_it_in_the_checksum() -> None:
    table, bridge = b"-- a table", b"-- a bridge"
    board: Any = Board({f"{FOLDER}/{scripts.MATRIX_NAME}": table})
    folder = ScriptFolder(board)
    bridged = folder.planned({SCRIPT_NAME: bridge}, table=is_table([SCRIPT_NAME]))
    assert bridged == {f"{FOLDER}/{SCRIPT_NAME}": bridge}
    assert folder.checksum(bridged) == scripts.load_checksum([table, bridge])
    other = folder.planned({scripts.LOADER_NAME: b"x"}, table=is_table([scripts.LOADER_NAME]))
    assert other[f"{FOLDER}/{scripts.MATRIX_NAME}"] is None
    assert folder.checksum(other) == scripts.load_checksum([b"x"])
