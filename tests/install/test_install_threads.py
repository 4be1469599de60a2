"""The command computes with one thread whatever the machine has set: the same answer bit for bit."""

import os
import subprocess
import sys

CODE = """
from coaxlink import _start
import coaxlink.cli

def asked():
    import numpy, threadpoolctl
    print({lib["num_threads"] for lib in threadpoolctl.threadpool_info()})

coaxlink.cli.main = asked
_start.main()
"""


def test_a_machine_that_asks_for_more_threads_gets_one():
    asked = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "2")
    reported = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, env=asked)
    assert reported.stdout.strip() == "{1}", reported.stderr
