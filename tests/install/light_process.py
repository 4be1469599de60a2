"""A process that has only what the light install has, and `coaxlink` command lines run in it.

    python light_process.py COMMANDS.json [--windows]

Every import of what is neither Python's own nor in the light list's closure fails, as it would on such a
machine. With --windows everything may be imported but what Windows has not. Prints one JSON list of
[exit code, stdout, stderr] a command.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.metadata as metadata
import io
import json
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
OURS = {"coaxlink", "firmware_params"}
# what CPython's documentation of these modules marks "Availability: Unix" or "not Windows"
NOT_ON_WINDOWS = {
    "modules": ("fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"),
    "os": (
        "fork",
        "geteuid",
        "getuid",
        "killpg",
        "setsid",
        "O_CLOEXEC",
        "O_NOCTTY",
        "O_NONBLOCK",
        "fchmod",
        "getpgid",
    ),
    "select": ("poll", "epoll"),
    "socket": ("MSG_DONTWAIT", "AF_UNIX", "SO_REUSEPORT"),
    "signal": ("SIGALRM", "SIGHUP", "SIGKILL", "SIGUSR1"),
}


def light_requirements() -> list[str]:
    """The requirements of the companion's install."""
    document = tomllib.loads((ROOT / "companion" / "pyproject.toml").read_text())
    return list(document["project"]["dependencies"])


def closure(requirements: list[str]) -> set[str]:
    """Normalised names of the distributions that these bring along."""
    found, waiting = set[str](), [_name(r) for r in requirements]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        with contextlib.suppress(metadata.PackageNotFoundError):  # of another system or Python
            for requirement in metadata.requires(name) or ():
                if "extra ==" not in requirement:
                    waiting.append(_name(requirement))
            found.add(name)
    return found


def _name(requirement: str) -> str:
    return re.sub(r"[-_.]+", "-", re.split(r"[^\w.-]", requirement, maxsplit=1)[0]).lower()


class OnlyLight:
    """Refuses to find what the light install does not bring."""

    def __init__(self) -> None:
        distributions = closure(light_requirements())
        brought = {
            module
            for module, owners in metadata.packages_distributions().items()
            if any(_name(owner) in distributions for owner in owners)
        }
        self.allowed = set(sys.stdlib_module_names) | OURS | brought

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        top = name.partition(".")[0]
        if top not in self.allowed and not top.startswith("_sysconfigdata_"):  # a module a platform
            raise ModuleNotFoundError(f"No module named '{top}'", name=top)


def as_on_windows() -> None:
    """Take away what Windows has not; third parties look at the platform when imported, so before that."""
    parties = ("numpy", "scipy.optimize", "pydantic", "typer", "rich.table", "rich.console", "tomli_w")
    for module in (*parties, "serial", "portalocker", "psutil", "textual.app"):
        importlib.import_module(module)
    import asyncio  # noqa: F401
    import subprocess  # noqa: F401

    for module in NOT_ON_WINDOWS.pop("modules"):
        sys.modules[module] = None  # type: ignore[assignment]
    for module, names in NOT_ON_WINDOWS.items():
        for name in names:
            with contextlib.suppress(AttributeError):
                delattr(importlib.import_module(module), name)
    sys.platform = "win32"


def run(command: list[str]) -> tuple[int, str, str]:
    """One command line in this process."""
    from coaxlink.cli import main

    out, talk = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(talk):
        try:
            main(command)
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
    return code, out.getvalue(), talk.getvalue()


if __name__ == "__main__":
    commands = json.loads(Path(sys.argv[1]).read_text())
    if "--windows" in sys.argv:
        as_on_windows()
    else:
        sys.meta_path.insert(0, OnlyLight())
    results = [run(command) for command in commands]
    sys.__stdout__.write(json.dumps(results))
