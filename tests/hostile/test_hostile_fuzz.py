"""Spoiled files of every kind through every reader; `research/fuzz.py` runs as many as one likes."""

from pathlib import Path

import pytest
from bounded_readers import run
from damage import damaged
from sound_files import MAKERS, sound_files

EACH = 4


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_spoiled_files_are_read_or_refused_in_one_line(tmp_path):
    sound_files(tmp_path)
    cases = [(kind, number) for kind in MAKERS for number in range(EACH)]
    outcomes = list(run(cases, tmp_path))
    assert [(o.kind, o.number) for o in outcomes] == cases
    assert [o for o in outcomes if o.result not in ("ok", "refused")] == []
    assert all(o.peak_MB < 1024 for o in outcomes)
    assert sum(o.result == "refused" for o in outcomes) > len(outcomes) // 2  # damage reached the readers
    assert all(o.text for o in outcomes if o.result == "refused")


def test_the_same_seed_spoils_a_file_the_same_way():
    data, others = Path(__file__).read_bytes(), [b"other" * 100]
    spoiled = [damaged(data, f"x/{n}", others) for n in range(200)]
    assert spoiled == [damaged(data, f"x/{n}", others) for n in range(200)]
    assert len(set(spoiled)) > 150 and sum(s != data for s in spoiled) > 190
