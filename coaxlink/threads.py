"""The environment variables that make the libraries of linear algebra use one thread each.

Ours are products of many small matrices: several threads only wait for each other, spinning, and where other
processes want the processors they take thirty times as long. They are read when numpy loads.
"""

ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
SWITCH_S = 2e-4  # how long another thread may keep a live loop from the interpreter
