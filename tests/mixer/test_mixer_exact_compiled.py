"""The exact law compiled: in Python's loop, in a batch, and as a C function; kept by its own source."""

import ctypes
import dataclasses
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from coaxlink import files
from coaxlink.mixer.exact import ExactLaw, compiled
from coaxlink.mixer.exact.native import NativeExact
from coaxlink.rotor.drive import Drive, SideDrive
from coaxlink.vehicle import Vehicle, load_vehicle

KIND = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3)


def _run(law, rotors, demands):
    book, out, function = law.book(), [], KIND(law.address)
    for demand in demands:
        row, command = np.ascontiguousarray(demand), np.zeros(rotors)
        function(book.ctypes.data, row.ctypes.data, command.ctypes.data)
        out.append(command)
    return np.array(out)


@pytest.mark.slow
def test_the_c_function_is_the_law():
    x8 = load_vehicle(files.example("x8_demo.toml"))
    drive = Drive(
        SideDrive((0.02, 0.6, 0.1), 0.15), SideDrive((0.03, 0.5, 0.2), 0.1, range=(0.05, 1.0)), 22.0
    )
    driven = Vehicle(x8.airframe, dataclasses.replace(x8.rotors, drive=drive))
    for vehicle, rotors in ((x8, 8), (driven, 8), (load_vehicle(files.example("y6.toml")), 6)):
        law = NativeExact(vehicle)
        random = np.random.default_rng(2)
        demands = np.column_stack([*random.uniform(-0.3, 0.3, (3, 200)), random.uniform(0.1, 0.9, 200)])
        flown = _run(law, rotors, demands)
        wanted = np.array([law.command(*demand) for demand in demands])
        assert np.abs(flown - wanted).max() < 1e-9
        assert np.array_equal(flown, _run(law, rotors, demands))  # whatever was flown before


@pytest.mark.slow
def test_the_next_process_loads_the_c_function_and_compiles_nothing():
    code = (
        "from coaxlink.mixer.exact import compiled, native\n"
        "print(native._function().cache_hits, len(compiled.function().signatures))"
    )
    found = [subprocess.check_output([sys.executable, "-c", code], text=True).split() for _ in range(2)]
    assert found[1] == ["1", "0"]


def test_what_is_compiled_is_kept_by_every_source_of_the_law(tmp_path):
    copy = shutil.copytree(Path(compiled.__file__).parent, tmp_path / "exact")
    assert compiled.source_digest(copy) == compiled.source_digest()
    (copy / "solver.py").write_text((copy / "solver.py").read_text() + "\n")
    assert compiled.source_digest(copy) != compiled.source_digest()


@pytest.mark.slow
def test_compiled_or_not_it_is_the_same_law_and_ten_thousand_wrenches_are_delivered(tmp_path, monkeypatch):
    x8 = load_vehicle(files.example("x8_paper.toml"))
    fast, plain = ExactLaw(x8, compiled=True), ExactLaw(x8)
    assert fast.compiled and not plain.compiled
    fast.speeds([150.0, 0.0, 0.0, 0.0])  # what is compiled is kept
    assert compiled.is_kept()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert not compiled.is_kept()
    rng = np.random.default_rng(4)
    demands = rng.uniform([100, -6, -6, -3], [320, 6, 6, 3], (40, 4))
    demands[::8, 3] = 20.0
    rows = np.array([plain.speeds(d) for d in demands])
    assert np.array([fast.speeds(d) for d in demands]) == pytest.approx(rows, abs=1e-7)
    fast.reset()
    assert fast.many(demands) == pytest.approx(rows, abs=1e-7)
    frame, u = x8.airframe, rng.uniform(0.2, 0.9, (10_000, 8))
    demands = frame.wrench(*frame.loads(x8.model, u))  # all within reach, most far from any hover
    found = fast.many(demands)
    assert found.min() >= 0.0 and found.max() <= 1.0
    thrust, torque = frame.loads(x8.model, found)
    assert np.abs(frame.wrench(thrust, torque) - demands).max() < 5e-7  # 1e-9 of the authority
    assert ((torque * found).sum(axis=1) <= (frame.loads(x8.model, u)[1] * u).sum(axis=1) * (1 + 1e-9)).all()


def test_while_another_process_compiles_the_law_this_one_waits(tmp_path):
    class Function:
        def compile(self, signature):
            return signature

    function = compiled.one_at_a_time(Function(), tmp_path)
    other = (
        "import portalocker, sys\n"
        "f = open(sys.argv[1], 'w'); portalocker.lock(f, portalocker.LOCK_EX); print(flush=True); input()"
    )
    line = [sys.executable, "-c", other, str(tmp_path / "lock")]
    with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holds:
        holds.stdout.readline()
        done = []
        mine = threading.Thread(target=lambda: done.append(function.compile("sum")))
        mine.start()
        mine.join(0.2)
        assert not done
        holds.communicate(b"\n")
    mine.join()
    assert done == ["sum"]
