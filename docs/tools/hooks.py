"""MkDocs hooks: the reference pages made from the code, equations as MathML, links out of docs/ to the repository.

`mkdocs build --strict` fails where a link, an anchor or a name of the Python reference is wrong.
"""

from __future__ import annotations

import html
import re
import sys
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File

sys.path.insert(0, str(Path(__file__).parent))  # MkDocs loads this file alone

import formats
import messages
import python_api
import verbs

ROOT = Path(__file__).parents[2]
MADE = {
    "reference/verbs.md": verbs.page,
    "reference/python.md": python_api.page,
    "reference/formats.md": formats.page,
    "reference/messages.md": messages.page,
}
_MATHS = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
_OUTWARD = re.compile(r"(\]\()((?:\.\./)+)([^)#\s]+)((?:#[^)]*)?\))")


def on_config(config: Any) -> Any:
    """Pages that the navigation does not name yet stand under "More": none is lost."""
    named = set(_leaves(config["nav"]))
    docs = Path(config["docs_dir"])
    left = sorted(p.relative_to(docs).as_posix() for p in docs.rglob("*.md"))
    more = [name for name in left if name not in named and not name.startswith("tools/")]
    if more:
        config["nav"].append({"More": more})
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are made from the code."""
    for name, make in MADE.items():
        files.append(File.generated(config, name, content=make()))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """A link to a file of the repository outside docs/ becomes the file's name: the site stands alone."""
    depth = len(Path(page.file.src_uri).parts)

    def outward(found: re.Match[str]) -> str:
        if found[2].count("../") < depth:
            return found[0]
        if not (ROOT / found[3]).exists():
            raise SystemExit(f"{page.file.src_uri}: {found[3]} is not in the repository")
        return f"](https://github.com/coaxlink/coaxlink/blob/main/{found[3]}{found[4]}"

    return _OUTWARD.sub(outward, markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Equations as MathML: browsers draw it, no script is fetched."""

    def drawn(found: re.Match[str]) -> str:
        display = "block" if found[1] == "div" else "inline"
        return convert(html.unescape(found[2]), display=display)

    return _MATHS.sub(drawn, content)


def _leaves(nav: Any) -> list[str]:
    if isinstance(nav, str):
        return [nav]
    inside = nav.values() if isinstance(nav, dict) else nav
    return [leaf for one in inside for leaf in _leaves(one)]
