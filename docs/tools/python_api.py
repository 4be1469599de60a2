"""The Python reference: mkdocstrings over the names of `coaxlink.__all__`."""

from __future__ import annotations

import coaxlink

HEAD = """# Python

```python
{example}
```

Everything loads when it is first used. Below are the names of `coaxlink.__all__`; the rooms behind them
(`coaxlink.rotor`, `coaxlink.mixer`, ...) have more, each with its docstring.

"""
ROOMS = coaxlink._ROOMS


def page() -> str:
    """Markdown with one mkdocstrings directive a public name."""
    lines = (coaxlink.__doc__ or "").splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("    "))
    last = max(i for i, line in enumerate(lines) if line.startswith("    "))
    example = "\n".join(line[4:] for line in lines[first : last + 1])
    parts = [HEAD.format(example=example)]
    for room, names in ROOMS.items():
        parts += [f"::: {_home(room, name)}\n" for name in sorted(names)]
    return "\n".join(parts)


def _home(room: str, name: str) -> str:
    """Where it is defined: the reference reads sources, it does not import."""
    found = getattr(coaxlink, name)
    return f"{getattr(found, '__module__', room)}.{name}"
