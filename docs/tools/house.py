"""Folder sizes and line counts of two commits, as docs/explanation/house.md draws them.

python docs/tools/house.py 5e71a39 HEAD
"""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from pathlib import PurePosixPath

ROOTS = ("firmware_params", "sim", "coaxlink")


def git(*words: str) -> str:
    """What git prints."""
    return subprocess.run(["git", *words], check=True, capture_output=True, text=True).stdout


def rooms(commit: str) -> dict[str, tuple[int, int]]:
    """{folder: (files, lines)} of the Python modules of a commit."""
    files, lines = Counter[str](), Counter[str]()
    # the empty tree against the commit: a line a file, its lines first
    empty = git("hash-object", "-t", "tree", "/dev/null").strip()
    for row in git("diff", "--numstat", "--no-renames", empty, commit, "--", *ROOTS).splitlines():
        added, _, name = row.split("\t")
        if name.endswith(".py"):
            folder = str(PurePosixPath(name).parent)
            files[folder] += 1
            lines[folder] += int(added)
    return {folder: (files[folder], lines[folder]) for folder in sorted(files)}


def drawn(commit: str) -> str:
    """The folders of a commit as an indented tree with files and lines."""
    found = rooms(commit)
    out = []
    for folder, (count, size) in found.items():
        depth = folder.count("/")
        name = "    " * depth + folder.rpartition("/")[2] + "/"
        out.append(f"{name:28s}{count:4d} files {size:6d} lines")
    most = max(found.items(), key=lambda item: item[1][0])
    total = f"{sum(c for c, _ in found.values())} files, {sum(s for _, s in found.values())} lines"
    return "\n".join([*out, f"{total}; the fullest folder: {most[0]}, {most[1][0]} files"])


def main() -> None:
    """Draw every commit that is named."""
    for commit in sys.argv[1:]:
        sys.stdout.write(f"{commit} ({git('rev-parse', '--short', commit).strip()})\n{drawn(commit)}\n\n")


if __name__ == "__main__":
    main()
