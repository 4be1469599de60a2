"""Tests in real time that failed are tried again on a slower clock, and leave no companion behind."""

from collections.abc import Iterator

import pytest
import slow_clock
from live_flight import Companion


@pytest.fixture(autouse=True)
def clock(request: pytest.FixtureRequest) -> Iterator[None]:
    """Three times as slow each time; the first time as it is."""
    again = getattr(request.node, "execution_count", 1) - 1
    if request.node.get_closest_marker("flaky") is None or again <= 0:
        yield
    else:
        with slow_clock.slowed(3.0**again):
            yield
    for companion in list(Companion.left):
        companion.close()
