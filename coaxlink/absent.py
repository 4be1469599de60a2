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

ALL_OF_IT = "for all of it put coaxlink in place of coaxlink-companion (docs/install.md)"


def absent(error: ImportError, verb: str) -> InputError | None:
    """The error in words, if it is about a package that may well be missing; else None: a fault of ours."""
    name = (error.name or "").partition(".")[0]
    if name == "sim":
        return InputError(
            verb, "", f"this light install has no simulated vehicle: pip install coaxlink; {ALL_OF_IT}"
        )
    if name not in LEFT_OUT:
        return None
    package = LEFT_OUT[name]
    others = [one for one in lacking() if one != package]
    beside = f", as it does {', '.join(others)}" if others else ""
    problem = f"{package} is needed, which this light install leaves out{beside}"
    return InputError(verb, "", f"{problem}: pip install {package}, or {ALL_OF_IT}")


def lacking() -> list[str]:
    """Names of the packages of a whole install that are not here."""
    return sorted({package for module, package in LEFT_OUT.items() if not _is_here(module)})


def _is_here(module: str) -> bool:
    from importlib.util import find_spec

    try:
        return find_spec(module) is not None
    except ImportError:
        return False


def refuse_windows(verb: str) -> None:
    """Raise InputError where the simulated world cannot run."""
    if sys.platform == "win32":
        problem = "the simulated vehicle needs POSIX signals and sockets; on Windows run it inside WSL"
        raise InputError(verb, "", problem)
