"""No word of our own stands where people read, and no more of them in code than there were."""

import runpy
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
WORDS = runpy.run_path(str(ROOT / "docs" / "tools" / "words.py"))
IN_CODE = 299  # names, comments and docstrings, 849 on 2026-11-26: may only fall


def test_documents_and_screens_have_none_of_our_own_words():
    found = list(WORDS["found"]())
    read = [f"{f.path}:{f.line}: {f.word}" for f in found if f.place != "code"]
    assert not read, read
    count = Counter(f.word for f in found)
    assert count.total() <= IN_CODE, count


def test_a_word_is_found_where_people_read_and_not_in_a_key(tmp_path, monkeypatch):
    (tmp_path / "docs").mkdir()
    (tmp_path / "coaxlink").mkdir()
    table = "## Words that we do not use\n\n| not | but |\n|---|---|\n| nat, nats | log evidence |\n"
    (tmp_path / "docs" / "glossary.md").write_text(table)
    (tmp_path / "README.md").write_text("12 nats, `nats`\n\n```\nnats\n```\n")
    code = '"""Of nats."""\nKEY = "nats"\nSAID = "12 nats behind"\nnats_of = 1\n'
    (tmp_path / "coaxlink" / "a.py").write_text(code)
    monkeypatch.setitem(WORDS["found"].__globals__, "ROOT", tmp_path)
    places = [(f.place, f.path, f.line) for f in WORDS["found"]()]
    assert sorted(places) == [
        *(("code", "coaxlink/a.py", line) for line in (1, 2, 4)),
        ("documents", "README.md", 1),
        ("screens", "coaxlink/a.py", 3),
    ]


def test_the_map_of_the_house_names_every_room():
    house = (ROOT / "docs" / "explanation" / "house.md").read_text()
    rooms = {p.parent for room in ("coaxlink", "sim") for p in (ROOT / room).rglob("*.py")}
    missing = [str(r.relative_to(ROOT)) for r in sorted(rooms) if r.name not in house]
    assert not missing, missing
