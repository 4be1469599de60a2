"""Processes that start together compile once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FUNCTION = """
import os, sys, time
from pathlib import Path

from sim.physics.compile_cache import cached

@cached()
def total(x):
    s = 0.0
    for k in range(len(x)):
        s += x[k] * x[k]
    return s

import numpy as np

(Path(sys.argv[1]) / str(os.getpid())).touch()
while len(list(Path(sys.argv[1]).iterdir())) < 3:  # all are at the door
    time.sleep(0.01)
assert total(np.ones(3)) == 3.0
print(sum(total.stats.cache_misses.values()), sum(total.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_of_processes_that_start_together_one_compiles(tmp_path: Path) -> None:
    script, door = tmp_path / "total.py", tmp_path / "door"
    script.write_text(FUNCTION)
    door.mkdir()
    root = str(Path(__file__).parents[2])
    env = os.environ | {"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": root}
    started = [
        subprocess.Popen([sys.executable, script, door], env=env, stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    counts = [tuple(map(int, process.communicate()[0].split())) for process in started]
    assert sorted(counts) == [(0, 1), (0, 1), (1, 0)]
