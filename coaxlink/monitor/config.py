"""The monitor's settings file (TOML). Options of the command line come before it; every key may be left out.

connect = "udpin:127.0.0.1:14550"
airframe = "my_x8.toml"     # paths are relative to this file
rotor = "my_rotor.toml"
theme = "dark"              # dark, light, none
page = "split"              # split, error, parameters, messages, health
plot_s = 60                 # seconds of a plot, 2 to 600
snapshots = "pictures"      # where s puts the SVG files
backups = "backups"         # where backups of parameters go
table = "table"             # what the page of parameters compares with first
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coaxlink import files
from coaxlink.errors import InputError
from coaxlink.monitor.screen.history import KEPT_S, LEAST_S
from coaxlink.monitor.screen.themes import PALETTES
from firmware_params.keys import unknown_key

DEFAULT_URL = "udpin:0.0.0.0:14550"
PAGES = ("split", "error", "parameters", "messages", "health")
_PATHS = ("airframe", "rotor", "snapshots", "backups", "table")
_WORDS = {"theme": tuple(PALETTES), "page": PAGES}
KEYS = ("connect", "airframe", "rotor", "theme", "page", "plot_s", "snapshots", "backups", "table")


@dataclass(frozen=True)
class Config:
    """See the module."""

    connect: str = DEFAULT_URL
    airframe: Path | None = None
    rotor: Path | None = None
    theme: str | None = None
    page: str = "split"
    plot_s: float = 60.0
    snapshots: Path | None = None
    backups: Path | None = None
    table: Path | None = None


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
    if key in _WORDS and value not in _WORDS[key]:
        raise InputError(path, key, f"one of {', '.join(_WORDS[key])} is expected, found {value!r}")
    return path.parent / Path(value).expanduser() if key in _PATHS else value
