"""What this install or this system lacks, in one line instead of an ImportError."""

from __future__ import annotations

import sys

from coaxlink.errors import InputError

# what the light install leaves out (companion/pyproject.toml), by the name it is imported under
LEFT_OUT = {
    "cvxpy": "cvxpy",
    "llvmlite": "numba",
    "jinja2": "jinja2",
    "lupa": "lupa",
    "matplotlib": "matplotlib",
    "mavsdk": "mavsdk",
    "numba": "numba",
    "python_calamine": "python-calamine",
    "pyulog": "pyulog",
    "scipy": "scipy",
    "sklearn": "scikit-learn",
    "threadpoolctl": "threadpoolctl",
}


def absent(error: ImportError, verb: str) -> InputError | None:
    """The error in words, if it is about a package that may well be missing; else None: a fault of ours."""
    name = (error.name or "").partition(".")[0]
    if name == "sim":
        return InputError(verb, "", "this light install has no simulated world: pip install coaxlink has it")
    if name not in LEFT_OUT:
        return None
    package = LEFT_OUT[name]
    problem = f"{package} is needed, which this light install leaves out: pip install {package}"
    return InputError(verb, "", f"{problem}, or all of coaxlink")


def refuse_windows(verb: str) -> None:
    """Raise InputError where the simulated world cannot run."""
    if sys.platform == "win32":
        problem = "the simulated world needs POSIX signals and sockets; on Windows run it inside WSL"
        raise InputError(verb, "", problem)
