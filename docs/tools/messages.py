"""The reference of MAVLink messages and parameters: every name of one that stands in the code, and where.

A message counts as sent where its class is made (`MAVLink_param_set_message`), as used where its name or its id
stands. Nothing is listed by hand.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega

from coaxlink.live.paths import PATHS, PX4

ROOT = Path(__file__).parents[2]
MESSAGES = {kind.msgname: kind.id for kind in ardupilotmega.mavlink_map.values()}
BY_ID = {f"MAVLINK_MSG_ID_{name}": name for name in MESSAGES}
SENT = re.compile(r"MAVLink_(\w+)_message")
PARAMETER = re.compile(
    r"(?:CA|THR|MPC|MC|SYS|PWM|HIL|COM|MAV|SDLOG|DTRG|IMU"
    r"|MOT|FRAME|SCR|SERVO|ATC|CXL|BRD|INS|LOG|SR\d|ESC|BATT)\w*_[A-Z0-9_n{}%]*[A-Z0-9_]"
)
HEAD = """# Messages and parameters

Made from the code (`docs/tools/messages.py`): every MAVLink message and every autopilot parameter whose name stands in
coaxlink, and where. Frames are MAVLink 2, dialect ardupilotmega (common within it).

## Live mixing: who can be flown so

"""


def page() -> str:
    """Markdown: the ways of live mixing, messages, parameters."""
    parts = [HEAD, "| autopilot | from | to | demand | answer | source |", "|---|---|---|---|---|---|"]
    parts += list(_ways())
    parts += ["\n## Messages\n", "| message | id | sent by | read or asked for by |", "|---|---|---|---|"]
    sent, used, parameters = scan()
    for name in sorted(set(sent) | set(used)):
        by = used.get(name, set()) - sent.get(name, set())
        parts.append(f"| `{name}` | {MESSAGES[name]} | {_rooms(sent.get(name, set()))} | {_rooms(by)} |")
    parts += [
        "\n## Parameters\n",
        "What `upload` may write is in the table's own files and shown before it is written; what a board writes itself "
        "is in `firmware_params/*/owned.py` and never restored by `--all`. `n` stands for a rotor's or an output's number.\n",
        "| parameter | where |", "|---|---|",
    ]  # fmt: skip
    parts += [f"| `{name}` | {_rooms(where)} |" for name, where in sorted(parameters.items())]
    return "\n".join(parts) + "\n"


def scan() -> tuple[dict[str, set[str]], dict[str, set[str]], dict[str, set[str]]]:
    """Messages made, messages named, parameters named; each with the modules where."""
    sent, used, parameters = defaultdict(set), defaultdict(set), defaultdict(set)
    for package in ("coaxlink", "firmware_params"):
        for file in sorted((ROOT / package).rglob("*.py")):
            module = (
                file.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".").removesuffix(".__init__")
            )
            for name, kind in _names(ast.parse(file.read_text())):
                if kind == "class" and (made := SENT.fullmatch(name)) and made[1].upper() in MESSAGES:
                    sent[made[1].upper()].add(module)
                elif name in BY_ID:
                    used[BY_ID[name]].add(module)
                elif kind == "text" and name in MESSAGES:
                    used[name].add(module)
                elif kind == "text" and PARAMETER.fullmatch(name) and name not in MESSAGES:
                    parameters[re.sub(r"\{\}|%d", "n", name)].add(module)
    return dict(sent), dict(used), dict(parameters)


def _names(tree: ast.Module) -> Iterator[tuple[str, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            yield node.attr, "class"
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value, "text"
        elif isinstance(node, ast.JoinedStr):
            yield "".join(p.value if isinstance(p, ast.Constant) else "{}" for p in node.values), "text"


def _ways() -> Iterator[str]:
    for row in PATHS:
        name = (
            "PX4" if row.autopilot == PX4 else "ArduPilot" + (" with coaxlink's script" if row.bridge else "")
        )
        first, last = (
            ("any" if v[0] in (0, 255) else ".".join(map(str, v))) for v in (row.oldest, row.newest)
        )
        yield f"| {name} | {first} | {last} | {_code(row.demand)} | {_code(row.answer)} | {row.source} |"


def _code(name: str) -> str:
    return f"`{name}`" if name else "none"


def _rooms(modules: set[str]) -> str:
    return ", ".join(f"`{module}`" for module in sorted(modules))
