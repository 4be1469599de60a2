"""From the library's words to the command line's: a parameter that it names in backticks, as an option.

The library says `upper` or `voltage_V`, as a caller in Python writes it; who typed a command reads --upper
and --voltage. Everything that a verb prints goes through `by_option`.
"""

from __future__ import annotations

import re

OPTIONS = {
    "air_density_kg_m3": "--density",
    "airframe": "--airframe",
    "arm_m": "--arm",
    "blades": "--blades",
    "board": "--connect",
    "battery": "--battery",
    "bridge": "coaxlink bridge AIRFRAME --out DIR, then coaxlink upload DIR",
    "climb_m_s": "--climb",
    "columns": "--columns MAP.toml",
    "diameter_m": "--diameter",
    "fly_table_4": "--no-fly",
    "form": "--form",
    "frame_class": "--frame-class",
    "height_m": "--height",
    "identify": "coaxlink identify",
    "join": "--join",
    "keep_gains": "--keep-gains",
    "law": "--law",
    "mass_kg": "--mass",
    "new_geometry": "--new-geometry",
    "out": "--out",
    "pair": "--pair",
    "pitch_m": "--pitch",
    "plan": "--plan",
    "px4_module": "coaxlink bridge --firmware px4",
    "poles": "--poles",
    "record": "coaxlink mix --record",
    "restore": "coaxlink restore",
    "rotor": "--rotor",
    "scheduler": "--scheduler",
    "sheet": "--sheet",
    "signing_key": "--signing-key",
    "spacing_m": "--spacing",
    "spin_from_table": "--spin-from-table",
    "speed_max_rpm": "--speed-max-rpm",
    "split_reach": "--split-reach",
    "system": "--system",
    "tables": "--tables",
    "take_over": "--take-over",
    "target_system": "--system",
    "template": "--template",
    "timeout_s": "--timeout",
    "trust_units": "--trust-units",
    "turn_motors": "coaxlink motors",
    "upper": "--upper",
    "url": "--connect",
    "voltage_V": "--voltage",
    "everything": "--all",
}
_NAMED = re.compile(r"`(\w+)`")
_RESTORE = re.compile(r"`restore` (.+?) over (\S+)")


def by_option(text: str) -> str:
    """The text with the parameters that it names as options; other words in backticks stay.

    >>> by_option("needs its voltage stated (`voltage_V`)")
    'needs its voltage stated (--voltage)'
    """
    text = _RESTORE.sub(r"coaxlink restore \1 --connect \2", text)
    return _NAMED.sub(lambda match: OPTIONS.get(match[1], match[0]), text)
