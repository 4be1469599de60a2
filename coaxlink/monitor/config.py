"""The monitor's settings file (TOML). Options of the command line come before it; every key may be left out.

connect = "udpin:127.0.0.1:14550"
airframe = "my_x8.toml"     # paths are relative to this file
rotor = "my_rotor.toml"
page = "split"              # split, error, parameters, messages, health
plot_s = 60                 # seconds of a plot, 2 to 600
snapshots = "pictures"      # where s puts the SVG files
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coaxlink import files
from coaxlink.errors import InputError
from coaxlink.monitor.screen.history import KEPT_S, LEAST_S
from firmware_params.keys import unknown_key

DEFAULT_URL = "udpin:0.0.0.0:14550"
PAGES = ("split", "error", "parameters", "messages", "health")
_PATHS = ("airframe", "rotor", "snapshots")
KEYS = ("connect", "airframe", "rotor", "page", "plot_s", "snapshots")


@dataclass(frozen=True)
class Config:
    """See the module."""

    connect: str = DEFAULT_URL
    airframe: Path | None = None
    rotor: Path | None = None
    page: str = "split"
    plot_s: float = 60.0
    snapshots: Path | None = None


def config_path() -> Path:
    """Where the file is looked for when none is named."""
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "coaxlink" / "monitor.toml"


def load_config(path: Path | None) -> Config:
    """The file `path`, or the usual one if it is there. Raises InputError with the key."""
    if path is None:
        path = config_path()
        if not path.exists():
            return Config()
    found = files.read_toml(path)
    if odd := unknown_key(found, KEYS):
        raise InputError(path, *odd)
    return Config(**{key: _value(path, key, value) for key, value in found.items()})


def _value(path: Path, key: str, value: Any) -> Any:
    if key == "plot_s":
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not LEAST_S <= value <= KEPT_S:
            expected = f"seconds from {LEAST_S:g} to {KEPT_S:g} are expected, found {value!r}"
            raise InputError(path, key, expected)
        return float(value)
    if not isinstance(value, str) or not value:
        raise InputError(path, key, f"a text is expected, found {value!r}")
    if key == "page" and value not in PAGES:
        raise InputError(path, key, f"one of {', '.join(PAGES)} is expected, found {value!r}")
    return path.parent / Path(value).expanduser() if key in _PATHS else value
