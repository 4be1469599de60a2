"""Words of our own that a reader would have to translate, counted; CI forbids them where people read.

    python docs/tools/words.py            # how many of each stand in documents, on screens, in code
    python docs/tools/words.py --where    # and in which line

The words, and the field's terms in place of them, are the last table of docs/glossary.md. Documents are every
page and README; screens every string of the product with a space in it (keys of files and of JSON are a
contract and have none); code is the rest: names, comments, docstrings.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
TABLE = "## Words that we do not use"
KEYS = ("not told",)  # a value of `identify --json`, spelt as the contract has it
CODE = ("coaxlink", "firmware_params", "sim")
PLACES = ("documents", "screens", "code")


@dataclass(frozen=True)
class Found:
    """A word where a reader meets it."""

    place: str
    path: str
    line: int
    word: str


def words() -> dict[str, re.Pattern[str]]:
    """What the glossary's table names, as whole words; several forms stand beside one another."""
    text = (ROOT / "docs" / "glossary.md").read_text()
    rows = text[text.index(TABLE) :].split("\n## ")[0].splitlines() if TABLE in text else []
    cells = [row.split("|")[1].strip() for row in rows if row.startswith("| ")][1:]
    return {
        cell: re.compile(rf"\b(?:{'|'.join(re.escape(w.strip()) for w in cell.split(','))})\b", re.IGNORECASE)
        for cell in cells
    }


def documents() -> Iterator[tuple[str, int, str]]:
    """(path, line, text) of what is prose: without code, addresses, and the table of the words itself."""
    for path in (*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))):
        if path.name == "CHANGELOG.md":
            continue
        fenced = tabled = False
        for number, line in enumerate(path.read_text().splitlines(), 1):
            fenced ^= line.lstrip().startswith("```")
            tabled = line == TABLE or (tabled and not line.startswith("## "))
            if not (fenced or tabled):
                yield (
                    str(path.relative_to(ROOT)),
                    number,
                    re.sub(r"`[^`]*`|\]\([^)]*\)|<!--.*?-->", " ", line),
                )


def python() -> Iterator[tuple[str, str, int, str]]:
    """(place, path, line, text) of all code."""
    for path in sorted(p for room in CODE for p in (ROOT / room).rglob("*.py")):
        source, name = path.read_text(), str(path.relative_to(ROOT))
        lines = source.splitlines()
        for node in list(_screens(ast.parse(source))):
            yield "screens", name, node.lineno, str(node.value)
            for row in range(node.lineno - 1, node.end_lineno or node.lineno):
                lines[row] = lines[row].replace(str(node.value), "")
        for number, line in enumerate(lines, 1):
            yield "code", name, number, line.replace("_", " ")


def _screens(tree: ast.Module) -> Iterator[ast.Constant]:
    told = {id(n.body[0].value) for n in ast.walk(tree) if _documented(n)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Constant) or not isinstance(node.value, str) or id(node) in told:
            continue
        if " " in node.value.strip() and node.value not in KEYS:
            yield node


def _documented(node: ast.AST) -> bool:
    body = getattr(node, "body", None)
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    return isinstance(node, kinds) and bool(body) and isinstance(body[0], ast.Expr)


def found() -> Iterator[Found]:
    """Every word of the table."""
    known = words()
    any_of = re.compile("|".join(pattern.pattern for pattern in known.values()), re.IGNORECASE)
    texts = [("documents", *row) for row in documents()]
    for place, path, line, text in (*texts, *python()):
        if not any_of.search(text):
            continue
        for word, pattern in known.items():
            for _ in pattern.finditer(text):
                yield Found(place, path, line, word)


def main() -> None:
    """Print the count; with --where the places too."""
    every = list(found())
    if "--where" in sys.argv:
        for f in every:
            print(f"{f.path}:{f.line}: {f.word} ({f.place})")
    count = Counter((f.word, f.place) for f in every)
    print(f"{'':32s}" + "".join(f"{place:>11s}" for place in PLACES))
    for word in words():
        print(f"{word:32.32s}" + "".join(f"{count[word, place]:11d}" for place in PLACES))
    print(f"{'all':32s}" + "".join(f"{sum(f.place == p for f in every):11d}" for p in PLACES))


if __name__ == "__main__":
    main()
