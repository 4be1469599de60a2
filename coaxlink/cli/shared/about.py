"""What `coaxlink --version --verbose` says: all that a report of a fault needs of the machine."""

from __future__ import annotations

import importlib.metadata as metadata
import platform
import re
from collections.abc import Iterator

from coaxlink._version import __version__
from coaxlink.absent import lacking

_OURS = ("coaxlink", "coaxlink-companion")  # what may be installed under the package's name


def lines(*, verbose: bool) -> Iterator[str]:
    """The version; of a verbose answer the system, what is installed beside it, and what is left out."""
    yield f"coaxlink {__version__}"
    if not verbose:
        return
    yield f"Python {platform.python_version()} ({platform.python_implementation()})"
    yield f"{platform.system()} {platform.release()}, {platform.machine()}"
    for name, version in _beside():
        yield f"{name} {version}"
    if missing := lacking():
        yield f"left out: {', '.join(missing)}"


def _beside() -> Iterator[tuple[str, str]]:
    """Name and version of every package that this install needs, and what it is itself."""
    for own in _OURS:
        try:
            needed = metadata.requires(own) or []
        except metadata.PackageNotFoundError:
            continue
        yield f"installed as {own}", metadata.version(own)
        for requirement in needed:
            name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
            if "extra ==" not in requirement:
                yield name, _version(name)


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "is missing"
