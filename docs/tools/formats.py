"""The reference of file formats: schemas from the models that read the files, columns from the readers."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from coaxlink.airframe import airframe_schema
from coaxlink.data.aliases import OWN_COLUMNS, QUANTITIES, quantity_of, unit_names
from coaxlink.data.logs.flight import MOTION
from coaxlink.rotor.model import rotor_schema
from sim.effects import FORMS
from sim.stand import schedule

EXAMPLES = Path(__file__).parents[2] / "examples"
HEAD = """# File formats

Made from the readers (`docs/tools/formats.py`). Body frame FRD (x forward, y right, z down), world NED, SI units, the
unit in every name. A file that cannot be read ends a verb with exit code 2 and one line: the file, the key or the
line, what was expected. The schemas serve an editor with taplo (VS Code: Even Better TOML).

"""
STAND = """## Stand log

CSV or a spreadsheet, one row a sample. These are our own columns; foreign headings and units are recognised or mapped
([stand logs](../stand.md)).

"""
FLIGHT = """## Flight log

ULog, ArduPilot DataFlash, tlog, or CSV with the columns below (the binary ones become the same table).

"""
EXTRA = (
    ("`vel_n_m_s`, `vel_e_m_s`, `vel_d_m_s`", "velocity over ground", "m/s", ""),
    ("`height_m`", "height above the ground", "m", ""),
    ("`voltage_V`", "of the pack", "V", ""),
    ("`rpm1` .. `rpmN`", "measured speeds", "rpm", ""),
    ("`armed`, `landed`", "0 or 1", "", ""),
)


def page() -> str:
    """Markdown of all formats."""
    parts = [
        HEAD,
        _toml(
            "Vehicle",
            airframe_schema(),
            "airframe.schema.json",
            "x8_paper.toml",
            "[the vehicle file](../airframe.md)",
        ),
        _toml(
            "Rotor model",
            rotor_schema(),
            "rotor.schema.json",
            "rotor_paper.toml",
            "[identify](verbs.md#identify)",
        ),
        STAND + _table(("column", "quantity", "unit", "foreign units that are read"), _stand()),
        FLIGHT + _table(("column", "what", "unit", "needed"), _flight()),
        "## Truth of a world\n\nFor `coaxlink sim --truth`; nothing else reads it. `[[effects]]` with `name`, `size`, "
        "and where wanted `onset_s` and `law`.\n\n"
        + _table(("name", "size is", "further keys", "laws"), _truths()),
        "## Schedule of a stand\n\n`coaxlink refine --plan` writes it, "
        f"`coaxlink sim --stand OUT.csv --schedule FILE` runs it.\n\n```toml\n{_schedule()}\n```\n",
    ]
    return "\n".join(parts)


def _toml(title: str, schema: dict[str, Any], file: str, example: str, more: str) -> str:
    """A heading, the keys, an example and the schema itself."""
    shipped = json.loads((EXAMPLES / file).read_text())
    if shipped != schema:
        raise SystemExit(f"examples/{file} is not the reader's own schema")
    text = (EXAMPLES / example).read_text().rstrip()
    lines = text.splitlines()
    cut = "\n".join((*lines[:24], "# ...")) if len(lines) > 26 else text
    return (
        f"## {title}\n\nTOML; more: {more}. The schema is shipped: `coaxlink examples {file}`.\n\n"
        + _table(("key", "type", "needed", "what it is"), _keys(schema, schema))
        + f"\n`{example}`:\n\n```toml\n{cut}\n```\n\n<details><summary>JSON schema</summary>\n\n"
        + f"```json\n{json.dumps(schema, indent=2)}\n```\n\n</details>\n"
    )


def _keys(schema: dict[str, Any], root: dict[str, Any], above: str = "") -> Iterator[tuple[str, ...]]:
    for key, value in schema.get("properties", {}).items():
        inner = _inner(value, root)
        name = f"{above}{key}"
        needed = "yes" if key in schema.get("required", ()) else "no"
        yield f"`{name}`", _type(value, root), needed, value.get("description", "")
        if inner and inner.get("properties"):
            yield from _keys(inner, root, f"{name}.")


def _inner(value: dict[str, Any], root: dict[str, Any]) -> dict[str, Any] | None:
    reference = value.get("$ref") or value.get("items", {}).get("$ref", "") if isinstance(value, dict) else ""
    return root["$defs"].get(reference.rpartition("/")[2]) if reference else None


def _type(value: dict[str, Any], root: dict[str, Any]) -> str:
    if "$ref" in value:
        return "table"
    if "anyOf" in value:
        return " or ".join(_type(one, root) for one in value["anyOf"] if one.get("type") != "null")
    if "enum" in value:
        return ", ".join(f'"{one}"' for one in value["enum"])
    kind = str(value.get("type", "any"))
    if kind == "array":
        least, most = value.get("minItems"), value.get("maxItems")
        count = str(least) if least is not None and least == most else ""
        return f"{count} numbers" if count else ("array of tables" if _inner(value, root) else "array")
    return {"object": "table", "integer": "whole number"}.get(kind, kind)


def _stand() -> Iterator[tuple[str, ...]]:
    for name in OWN_COLUMNS:
        quantity = quantity_of(name)
        unit = name.rsplit("_", 1)[-1] if "_" in name else ""
        shown = {"rpm": "rpm", "Nm": "N m", "throttle": "0..1"}.get(unit, unit)
        foreign = ", ".join(unit_names(quantity)) if quantity in QUANTITIES else ""
        yield f"`{name}`", quantity or name.rpartition("_")[0].replace("_", " "), shown, foreign


def _flight() -> Iterator[tuple[str, ...]]:
    yield "`time_s`", "increasing", "s", "yes"
    yield "`motor1` .. `motorN`", "commanded speed, in the vehicle file's numbers", "0..1", "yes"
    for name in MOTION:
        what = {"accel": "specific force, body", "gyro": "turn rate, body"}.get(
            name.split("_")[0], "attitude"
        )
        unit = "m/s²" if name.endswith("m_s2") else ("rad/s" if name.endswith("rad_s") else "rad")
        yield f"`{name}`", what, unit, "yes"
    yield from EXTRA


def _truths() -> Iterator[tuple[str, ...]]:
    for name, form in FORMS.items():
        yield f"`{name}`", form.size, ", ".join(form.extra), ", ".join(form.laws)


def _schedule() -> str:
    lines = (schedule.__doc__ or "").strip().splitlines()
    return "\n".join(lines[2:])


def _table(heads: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    body = ("| " + " | ".join(str(c).replace("|", "\\|") for c in row) + " |" for row in rows)
    return "\n".join(("| " + " | ".join(heads) + " |", "|---" * len(heads) + "|", *body)) + "\n"
