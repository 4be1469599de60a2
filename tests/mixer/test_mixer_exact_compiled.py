"""The exact law compiled: in Python's loop, in a batch, and as a C function; kept by its own source."""

import ctypes
import shutil
from pathlib import Path

import numpy as np
import pytest

from coaxlink import files
from coaxlink.mixer.exact import compiled
from coaxlink.mixer.exact.native import NativeExact
from coaxlink.vehicle import load_vehicle

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
    for name, rotors in (("x8_demo.toml", 8), ("y6.toml", 6)):
        law = NativeExact(load_vehicle(files.example(name)))
        random = np.random.default_rng(2)
        demands = np.column_stack([*random.uniform(-0.3, 0.3, (3, 200)), random.uniform(0.1, 0.9, 200)])
        flown = _run(law, rotors, demands)
        wanted = np.array([law.command(*demand) for demand in demands])
        assert np.abs(flown - wanted).max() < 1e-9
        assert np.array_equal(flown, _run(law, rotors, demands))  # whatever was flown before


def test_what_is_compiled_is_kept_by_every_source_of_the_law(tmp_path):
    copy = shutil.copytree(Path(compiled.__file__).parent, tmp_path / "exact")
    assert compiled.source_digest(copy) == compiled.source_digest()
    (copy / "solver.py").write_text((copy / "solver.py").read_text() + "\n")
    assert compiled.source_digest(copy) != compiled.source_digest()
